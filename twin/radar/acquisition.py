"""Bursts of the radar, from scene and design to IQ counts."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.records import RadarRecord
from twin import __version__
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar.atmosphere import Air
from twin.radar.burst import burst_channel
from twin.radar.design import RadarDesign
from twin.radar.free_space import straight_paths
from twin.radar.front_end import digitize
from twin.radar.propagation import Propagation, trace
from twin.radar.remarks import assumptions, warnings
from twin.radar.synthesis import Complex, Contributions
from twin.radar.truth import TrueTarget, true_targets
from twin.scene import Scene
from twin.scene.model import Pose
from twin.system import Weather

_NEAREST_M = 0.1  # a point target nearer than this is no point
_MOST_CELLS = 2**28  # of one record: a gigabyte
Stage = Callable[[str], AbstractContextManager[Any]]


@dataclass(frozen=True, eq=False)
class RadarCapture:
    """A record with everything the twin knows about it. Only ``record`` exists on the vehicle.

    ``truth`` is that of the first burst, ``bursts`` what was found at each.
    """

    record: RadarRecord
    truth: tuple[TrueTarget, ...]
    bursts: tuple[Propagation, ...]
    air: Air
    sample_noise_w: float
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def propagation(self) -> Propagation:
        """What was found at the first burst."""
        return self.bursts[0]


def radar_capture(
    scene: Scene,
    radar: RadarDesign,
    *,
    seed: int = 0,
    fidelity: Fidelity | None = None,
    weather: Weather | None = None,
    poses: Sequence[Pose] | None = None,
    interval_s: float | None = None,
    stage: Stage = lambda name: nullcontext(),
) -> RadarCapture:
    """Acquire one burst, or one at each stop of a track.

    Parameters
    ----------
    scene, radar
        What is looked at, and with what.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    fidelity
        Knobs, each with the error it bounds.
    weather
        Of the air in between; default: it does not attenuate.
    poses, interval_s
        Of the rig at each burst, and the time from one burst to the next, in which everything that
        moves moves on; default: the scene's track, else one burst where the rig stands.
    stage
        Called with each stage's name, for progress and timing.

    Raises InputError where a material has no data at the carrier, a target stands at the radar, a
    record would not fit in memory, or bursts overlap.
    """
    worlds = _worlds(scene, radar, poses, interval_s)
    for world in worlds:
        _check_targets(world)
    fidelity, air = fidelity or Fidelity(), _air(weather, radar)
    ray_seed, noise_seed = np.random.SeedSequence([seed, 79]).spawn(2)
    with stage("radar paths"):
        rays = int(ray_seed.generate_state(1)[0]) >> 1
        bursts = tuple(
            straight_paths(world, radar)
            if fidelity.radar == "targets"
            else trace(world, radar, seed=rays)
            for world in worlds
        )
    with stage("radar signal"):
        iq, flags, scale = measure(
            bursts,
            radar,
            air,
            rng=np.random.default_rng(noise_seed),
            noisy=fidelity.noise != "none",
            tolerance=fidelity.nufft_tolerance,
        )
    truth = true_targets(worlds[0], radar, bursts[0], air)
    return RadarCapture(
        record=_record(worlds, radar, interval_s or _interval(scene, radar), iq, flags, scale),
        truth=truth,
        bursts=bursts,
        air=air,
        sample_noise_w=radar.sample_noise_w,
        assumptions=assumptions(worlds[0], radar, bursts[0], air),
        warnings=warnings(worlds[0], radar, bursts, truth, flags),
    )


def contributions(found: Propagation, radar: RadarDesign, air: Air) -> Contributions:
    """Echoes as the synthesis takes them, with what air, averaging over a slot and a stepped
    carrier leave of each, and the leakage.
    """
    parts = [_of_paths(found, radar, air), _of_leakage(radar)]
    return Contributions(
        amplitude=np.concatenate([part.amplitude for part in parts], axis=-1),
        delay_s=np.concatenate([part.delay_s for part in parts]),
        delay_rate=np.concatenate([part.delay_rate for part in parts]),
        departure=np.concatenate([part.departure for part in parts]),
        arrival=np.concatenate([part.arrival for part in parts]),
    )


def channel(found: Propagation, radar: RadarDesign, air: Air, tolerance: float = 1e-6) -> Complex:
    """Received over sent wave of one burst, (n_steps, n_slots, n_receivers, n_subcarriers)."""
    return burst_channel(contributions(found, radar, air), radar.burst, tolerance)


def measure(
    bursts: Sequence[Propagation],
    radar: RadarDesign,
    air: Air,
    *,
    rng: np.random.Generator,
    noisy: bool = True,
    tolerance: float = 1e-6,
) -> tuple[NDArray[np.int16], NDArray[np.uint8], float]:
    """Counts and flags of a record, and root watts per count: `digitize`, burst by burst."""
    taken = [
        digitize(channel(found, radar, air, tolerance), radar, rng=rng, noisy=noisy)
        for found in bursts
    ]
    return np.stack([iq for iq, _, _ in taken]), np.stack([f for _, f, _ in taken]), taken[0][2]


def _of_paths(found: Propagation, radar: RadarDesign, air: Air) -> Contributions:
    """Amplitudes (n_steps, n). Mirrors and constant cross-sections answer with the wavelength."""
    if not found.paths:
        return _nothing(radar)
    carriers = radar.burst.carriers_hz
    rate = np.array([path.delay_rate for path in found.paths])
    length = np.array([2 * path.range_m for path in found.paths])
    amplitude = np.array([path.amplitude for path in found.paths], dtype=np.complex128)
    per_step = [
        amplitude
        * (carriers[0] / carrier)
        * radar.ofdm.slot_gain(carrier * rate)
        * air.amplitude(length, carrier)
        for carrier in carriers
    ]
    return Contributions(
        amplitude=np.stack(per_step),
        delay_s=np.array([path.delay_s for path in found.paths]),
        delay_rate=rate,
        departure=np.array([path.departure for path in found.paths]),
        arrival=np.array([path.arrival for path in found.paths]),
    )


def _of_leakage(radar: RadarDesign) -> Contributions:
    if radar.leakage is None:
        return _nothing(radar)
    level = 10 ** (radar.leakage.level_db.value / 20)
    nowhere = np.zeros((1, 3))
    return Contributions(
        amplitude=np.full((len(radar.burst.carriers_hz), 1), level, dtype=np.complex128),
        delay_s=np.array([radar.leakage.delay_s.value]),
        delay_rate=np.zeros(1),
        departure=nowhere,
        arrival=nowhere,
    )


def _nothing(radar: RadarDesign) -> Contributions:
    none = np.zeros(0)
    amplitude = np.zeros((len(radar.burst.carriers_hz), 0), dtype=np.complex128)
    return Contributions(amplitude, none, none, np.zeros((0, 3)), np.zeros((0, 3)))


def _air(weather: Weather | None, radar: RadarDesign) -> Air:
    air = Air(weather)
    try:
        for carrier in radar.burst.carriers_hz[[0, -1]]:
            air.db_per_m(float(carrier))
    except ValueError as error:
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
        poses = track.poses(scene.rig.pose) if track else [scene.rig.pose]
    return [scene.after(i * interval).at(pose) for i, pose in enumerate(poses)]


def _check_targets(scene: Scene) -> None:
    place = scene.rig.position_m + scene.rig.device("radar")[0]
    for target in scene.targets:
        distance = float(np.linalg.norm(np.asarray(target.position_m) - place))
        if distance < _NEAREST_M:
            raise InputError(
                f"target {target.name!r}: is {distance:g} m from the radar, "
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
        transmitters_m=burst.transmitters_m,
        receivers_m=burst.receivers_m,
        waveform=burst.waveform,
        root_watt_per_count=scale,
        transmit_power_w=radar.front_end.transmit_power_w.value,
        antenna_gain_dbi=radar.antenna.ahead_dbi,
        losses_db=radar.front_end.losses_db.value,
        leakage_delay_s=radar.leakage.delay_s.value if radar.leakage else float("nan"),
        device=f"twin {__version__}: {radar.name}",
        pose=np.array([_antenna_pose(world) for world in worlds]),
    )


def _antenna_pose(scene: Scene) -> list[float]:
    offset, _ = scene.rig.device("radar")
    x, y, z, w = (scene.rig.pose.rotation * scene.rig.radar.rotation).as_quat()
    return [*(scene.rig.position_m + offset), w, x, y, z]
