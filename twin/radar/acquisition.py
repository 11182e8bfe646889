"""Bursts of the radar, from scene and design to IQ counts."""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.records import QuaternionPose, RadarRecord
from twin import __version__
from twin.accuracy import Decision
from twin.errors import check_kind, check_seed
from twin.fidelity import Accuracy, Fidelity, knobs_of
from twin.files import InputError
from twin.kept_results import KeptResults
from twin.progress import OpenStage
from twin.radar.device.burst import blended_channel, burst_channel
from twin.radar.device.design import RadarDesign
from twin.radar.device.front_end import digitize
from twin.radar.diagnostics import assumptions, warnings
from twin.radar.propagation.interval.instants import traced_interval, weights
from twin.radar.propagation.kept import kept_interval
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.solvers import seen_by, solver_of
from twin.radar.synthesis import Complex, Contributions
from twin.radar.synthesis.contributions import PLANE
from twin.radar.truth import TrueTarget, true_targets
from twin.scene import Scene
from twin.scene.rig import Pose
from twin.system import Weather
from twin.warned import CaptureWarning, is_void

_NEAREST_M = 0.1  # a point target nearer than this is no point
_MOST_CELLS = 2**28  # of one record: a gigabyte
#: Stages of `radar_capture`.
STAGES = ("radar paths", "radar signal")


@dataclass(frozen=True, eq=False, repr=False)
class RadarCapture(Described):
    """A record with everything the twin knows about it. Only ``record`` exists on the vehicle.

    ``truth`` is that of the first burst, ``bursts`` what was found at each. ``is_bounded``: whether
    the propagation model tells the errors of its echoes.
    """

    record: RadarRecord
    truth: tuple[TrueTarget, ...]
    bursts: tuple[Propagation, ...]
    air: Atmosphere
    sample_noise_w: float
    assumptions: tuple[str, ...]
    warnings: tuple[CaptureWarning, ...]
    is_bounded: bool = True

    @property
    def void(self) -> bool:
        """Whether the record holds nothing to detect anything in."""
        return is_void(self.warnings)

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """What was taken or left out at the first burst, with the bounds that decided."""
        return self.propagation.decisions

    @property
    def propagation(self) -> Propagation:
        """What was found at the first burst."""
        return self.bursts[0]


@dataclass(frozen=True, eq=False)
class RadarEcho:
    """Bursts before anything is sent: what the scene and the noise will make of it.

    ``worlds`` are the scene at each burst, ``interval_s`` apart, ``bursts`` what was found there;
    or, once `condensed`, ``channels`` what `channel` made of it.
    """

    worlds: tuple[Scene, ...]
    radar: RadarDesign
    bursts: tuple[Propagation, ...]
    air: Atmosphere
    interval_s: float
    noise_seed: np.random.SeedSequence
    fidelity: Fidelity
    channels: tuple[Complex, ...] | None = None

    def condensed(self) -> "RadarEcho":
        """The same for more than one record, or for another process: channels in place of what
        they were made of.
        """
        worlds = tuple(replace(world, objects=()) for world in self.worlds)
        return replace(self, worlds=worlds, bursts=(), channels=tuple(self._channels()))

    def reseeded(self, seed: int) -> "RadarEcho | None":
        """The same with another seed, where nothing but the noise is drawn from it; else None."""
        if solver_of(self.fidelity).is_seeded:
            return None
        return replace(self, noise_seed=_seeds(seed)[1])

    def record(self, sent: Complex | None = None) -> RadarRecord:
        """What the radar records.

        Parameters
        ----------
        sent : (n_steps, n_slots, n_subcarriers)
            Subcarriers that really go out in each burst, in place of the waveform's own. What a
            step records depends on its own part only.
        """
        # Spawning leaves its mark on a seed: the second record is drawn from the same one.
        seed = np.random.SeedSequence(self.noise_seed.entropy, spawn_key=self.noise_seed.spawn_key)
        rng = np.random.default_rng(seed)
        iq_bursts = [
            digitize(there, self.radar, rng=rng, noisy=self.fidelity.noise != "none", sent=sent)
            for there in self.channels or self._channels()
        ]
        iq, flags = (np.stack([burst[k] for burst in iq_bursts]) for k in (0, 1))
        return _record(self.worlds, self.radar, self.interval_s, iq, flags, iq_bursts[0][2])

    def warnings(self, record: RadarRecord) -> tuple[CaptureWarning, ...]:
        """What a capture of it, with this record, warns of; before it is `condensed`."""
        first, solver = self.worlds[0], solver_of(self.fidelity)
        truth = true_targets(first, self.radar, self.bursts[0], self.air)
        return warnings(first, self.radar, self.bursts, truth, record, solver)

    def _channels(self) -> Iterator[Complex]:
        tolerance = self.fidelity.nufft_tolerance
        return (
            channel(propagation, self.radar, self.air, tolerance) for propagation in self.bursts
        )


def radar_echo(
    scene: Scene,
    radar: RadarDesign,
    *,
    seed: int = 0,
    fidelity: Accuracy | None = None,
    weather: Weather | None = None,
    poses: Sequence[Pose] | None = None,
    interval_s: float | None = None,
    stage: OpenStage = lambda name: nullcontext(),
    earlier: Propagation | None = None,
    keep: bool = False,
    kept: KeptResults | None = None,
) -> RadarEcho:
    """The bursts that `radar_capture` records; same parameters, same errors."""
    check_kind("scene", scene, Scene, "twin.load_scene")
    check_kind("radar", radar, RadarDesign, "twin.load_radar")
    check_seed(seed)
    knobs, air = knobs_of(fidelity, radar.total_bandwidth_hz), _air(weather, radar)
    worlds = [seen_by(radar, w, knobs) for w in _worlds(scene, radar, poses, interval_s)]
    for world in worlds:
        _check_targets(world, radar)
    ray_seed, noise_seed = _seeds(seed)
    with stage("radar paths"):
        rays = int(ray_seed.generate_state(1)[0]) >> 1
        bursts = []
        for world in worlds:
            first = keep and earlier is None
            if kept is not None and not first and earlier is None:
                own = kept_interval(world, radar, knobs, rays, kept)
            else:
                own = traced_interval(world, radar, knobs, rays, earlier, keep=first)
            bursts.append(own)
            earlier = own if first else earlier
    interval_s = interval_s or _interval(scene, radar)
    return RadarEcho(tuple(worlds), radar, tuple(bursts), air, interval_s, noise_seed, knobs)


def radar_capture(
    scene: Scene,
    radar: RadarDesign,
    *,
    seed: int = 0,
    fidelity: Accuracy | None = None,
    weather: Weather | None = None,
    poses: Sequence[Pose] | None = None,
    interval_s: float | None = None,
    stage: OpenStage = lambda name: nullcontext(),
    earlier: Propagation | None = None,
    keep: bool = False,
    kept: KeptResults | None = None,
) -> RadarCapture:
    """Acquire one burst, or one at each stop of a track.

    Parameters
    ----------
    scene, radar
        The scene, and the radar in it.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    fidelity
        Knobs, each with the error it bounds; a preset's name; or a `Tolerance`. Default:
        `Tolerance()`, each body's echo to 10 % of its level; reflections, images, edges, rough
        surfaces and ways round obstacles as far as bounds of what they add ask for.
    weather
        Of the air in between; default: it does not attenuate.
    poses, interval_s
        Of the rig at each burst, and the time from one burst to the next, in which everything that
        moves moves on; default: the scene's track, else one burst where the rig stands.
    stage
        Called with each stage's name, for progress and timing.
    earlier, keep
        What was found at a burst that was traced with ``keep`` (``propagation`` of its capture),
        by the same design and ``fidelity.radar``: those echoes of meshes' facets are kept on whose
        paths nothing has changed since, and only the others are found anew. All are found anew
        where more has changed than that objects moved, turned or are of another material: the rig
        or where its radar sits; the ground, what else mirrors, or a pane that the radar sees
        through; which objects there are, their names, order or facets; ``radar_tolerance`` or
        ``radar_bounces``; more than 24 separate places; or where bodies are so much fainter now
        that what was left out beside them counts.
        Results depend on that burst, within the errors that they tell, so without it there is no
        such dependence. ``keep``: later bursts may keep what is found here, those of this capture
        after its first one do; takes some 500 bytes for each contribution and ray tube.
    kept
        Where echoes are kept from one process to the next: those found for the same scene, design
        and ``fidelity``, by this version, are taken from there, bit for bit. Not with ``earlier``
        or ``keep``.

    Raises InputError where a material has no data at the carrier, a target stands at the radar, a
    record would not fit in memory, bursts overlap, or ``earlier`` is not such a burst.

    >>> from twin.radar import load_radar
    >>> from twin.scene import load_scene
    >>> radar, declared = load_radar("hybrid-79"), Fidelity(radar="targets")
    >>> taken = radar_capture(load_scene("yard"), radar, seed=1, fidelity=declared)
    >>> [target.name for target in taken.truth][:2]
    ['trihedral', 'car']
    """
    echo = radar_echo(
        scene,
        radar,
        seed=seed,
        fidelity=fidelity,
        weather=weather,
        poses=poses,
        interval_s=interval_s,
        stage=stage,
        earlier=earlier,
        keep=keep,
        kept=kept,
    )
    with stage("radar signal"):
        record = echo.record()
    first, bursts, air = echo.worlds[0], echo.bursts, echo.air
    truth, solver = true_targets(first, radar, bursts[0], air), solver_of(echo.fidelity)
    return RadarCapture(
        record=record,
        truth=truth,
        bursts=bursts,
        air=air,
        sample_noise_w=radar.sample_noise_w,
        assumptions=assumptions(first, radar, bursts, air, solver),
        warnings=echo.warnings(record),
        is_bounded=solver.has_tolerance or _is_declared_alone(first, echo.fidelity),
    )


def _is_declared_alone(scene: Scene, fidelity: Fidelity) -> bool:
    """Whether all that answers is declared, by the model for that, and stands for no mesh."""
    return fidelity.radar == "targets" and all(target.object is None for target in scene.targets)


def contributions(propagation: Propagation, radar: RadarDesign, air: Atmosphere) -> Contributions:
    """Echoes as the synthesis takes them, with what air, averaging over a slot and a stepped
    carrier leave of each, and the leakage.
    """
    return Contributions.concatenate(
        [_stepped(propagation.contributions, radar, air), leakage_echo(radar)]
    )


def channel(
    propagation: Propagation, radar: RadarDesign, air: Atmosphere, tolerance: float = 1e-6
) -> Complex:
    """Received over sent wave of one burst, (n_steps, n_slots, n_receivers, n_subcarriers)."""
    if not propagation.instants:
        return burst_channel(contributions(propagation, radar, air), radar.burst, tolerance)
    parts = [_stepped(instant.contributions, radar, air) for instant in propagation.instants]
    times = [instant.time_s for instant in propagation.instants]
    echoes = blended_channel(parts, times, partial(weights, times), radar.burst, tolerance)
    leakage = leakage_echo(radar)
    return echoes + burst_channel(leakage, radar.burst, tolerance) if len(leakage) else echoes


def _seeds(seed: int) -> tuple[np.random.SeedSequence, np.random.SeedSequence]:
    """Of rays, and of noise."""
    rays, noise = np.random.SeedSequence([seed, 79]).spawn(2)
    return rays, noise


def _stepped(echoes: Contributions, radar: RadarDesign, air: Atmosphere) -> Contributions:
    """Echoes with their amplitudes at every carrier step, (n_steps, n)."""
    moving = np.flatnonzero(echoes.delay_rate)
    doppler, carriers = echoes.delay_rate[moving], radar.burst.carriers_hz
    amplitude = np.empty((len(carriers), len(echoes.delay_s)), dtype=np.complex128)
    powers = [
        (power, of_each == power)
        for of_each in (echoes.wavelength_power, echoes.falloff)
        for power in np.unique(of_each)
        if power
    ]
    for row, carrier in zip(amplitude, carriers, strict=True):
        level = np.ones(len(echoes.delay_s))
        if carrier != carriers[0]:
            for power, which in powers:
                level[which] *= (carriers[0] / carrier) ** power
        level[moving] *= radar.ofdm.slot_gain(carrier * doppler)
        if air.weather is not None:
            level *= air.amplitude_transmission(echoes.delay_s, carrier)
        np.multiply(echoes.amplitude, level, out=row)
    return replace(echoes, amplitude=amplitude)


def leakage_echo(radar: RadarDesign) -> Contributions:
    """What the antennas receive of their own signal, (steps, 0 or 1), as strong in every pair."""
    if radar.leakage is None:
        none = Contributions.none()
        return replace(none, amplitude=np.zeros((len(radar.burst.carriers_hz), 0), np.complex128))
    level = 10 ** (radar.leakage.level_db.value / 20)
    nowhere = np.zeros((1, 3))
    return Contributions(
        amplitude=np.full((len(radar.burst.carriers_hz), 1), level, dtype=np.complex128),
        delay_s=np.array([radar.leakage.delay_s.value]),
        delay_rate=np.zeros(1),
        delay_acceleration_per_s=np.zeros(1),
        departure=nowhere,
        arrival=nowhere,
        wavefront=np.full(1, PLANE, dtype=np.uint32),
    )


def _air(weather: Weather | None, radar: RadarDesign) -> Atmosphere:
    air = Atmosphere(weather)
    try:
        for carrier in radar.burst.carriers_hz[[0, -1]]:
            air.db_per_m(float(carrier))
    except InputError as error:
        if weather is not None and weather.function is not None:  # its errors name their field
            raise
        raise InputError(f"radar {radar.name}: waveform.{error}") from error
    return air


def _interval(scene: Scene, radar: RadarDesign) -> float:
    return (scene.track.interval_s if scene.track else None) or radar.burst_s


def _worlds(
    scene: Scene, radar: RadarDesign, poses: Sequence[Pose] | None, interval_s: float | None
) -> list[Scene]:
    """The scene at each burst, from where the rig stands then."""
    track = scene.track if poses is None else None
    count = track.count if track else 1 if poses is None else len(poses)
    interval = interval_s or _interval(scene, radar)
    if count == 0:
        raise InputError("poses: none, expected at least one")
    if count > 1 and interval < radar.burst_s * (1 - 1e-9):
        raise InputError(
            f"track: interval_s = {interval:g} is shorter than a burst of {radar.name}, "
            f"{radar.burst_s:g} s"
        )
    burst = radar.burst
    cells = count * len(burst.carriers_hz) * len(burst.receivers_m)
    cells *= burst.waveform.n_slots * burst.waveform.n_subcarriers
    if cells > _MOST_CELLS:
        raise InputError(
            f"track: {count} bursts of {radar.name} are {cells} cells, expected at most "
            f"{_MOST_CELLS}"
        )
    if poses is None:
        if track is None:
            return [scene]
        poses = track.poses(scene.rig.pose)
    return [scene.after(i * interval).at(pose) for i, pose in enumerate(poses)]


def _check_targets(scene: Scene, radar: RadarDesign) -> None:
    offset_m, axes = scene.rig.device("radar")
    place = scene.rig.position_m + offset_m
    elements_m = np.concatenate([radar.burst.transmitters_m, radar.burst.receivers_m]) @ axes
    for target in scene.targets:
        away_m = np.asarray(target.position_m) - place
        from_elements_m = np.linalg.norm(away_m - elements_m, axis=1)
        for distance, what in (
            (float(np.linalg.norm(away_m)), "the radar"),
            (float(from_elements_m.min()), "one of its antennas"),
        ):
            if distance < _NEAREST_M:
                raise InputError(
                    f"target {target.name!r}: is {distance:g} m from {what}, "
                    f"expected at least {_NEAREST_M:g} m"
                )


def _record(
    worlds: Sequence[Scene],
    radar: RadarDesign,
    interval_s: float,
    iq: NDArray[np.int16],
    flags: NDArray[np.uint8],
    scale: float,
) -> RadarRecord:
    burst = radar.burst
    slots = np.arange(burst.waveform.n_slots) * burst.waveform.slot_period_s
    steps = burst.step_times_s - burst.step_times_s[0]
    bursts = np.arange(len(worlds)) * interval_s
    starts = bursts[:, None, None] + steps[:, None] + slots
    return RadarRecord(
        iq=iq,
        device_time_ns=np.rint(starts * 1e9).astype(np.int64),
        flags=flags,
        carriers_hz=burst.carriers_hz,
        transmitter=burst.transmitter,
        waveform=burst.waveform,
        front_end=radar.recorded_front_end(scale),
        device=f"twin {__version__}: {radar.name}",
        pose=tuple(map(_antenna_pose, worlds)),
    )


def _antenna_pose(scene: Scene) -> QuaternionPose:
    offset, _ = scene.rig.device("radar")
    rotation = scene.rig.pose.rotation * scene.rig.radar.rotation
    return QuaternionPose.of(scene.rig.position_m + offset, rotation)
