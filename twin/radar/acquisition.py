"""One coherent processing interval of the radar, from scene and design to IQ counts."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.samples import highest_level, spectrum, symbol
from hardware.radar.waveform import OfdmWaveform
from hardware.records import Flag, RadarRecord
from twin import __version__
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar.design import RadarDesign
from twin.radar.free_space import straight_paths
from twin.radar.propagation import Path, Propagation, trace
from twin.radar.roles import Role
from twin.radar.synthesis import Contributions, synthesize
from twin.scene import Scene, SceneObject
from twin.scene.enclosure import encloses
from twin.scene.meshes import Mesh, divided
from twin.scene.model import Target

_NEAREST_M = 0.1  # a point target nearer than this is no point
_BENT_RAD = 0.02  # phase of a bent path from which it is warned of
Stage = Callable[[str], AbstractContextManager[Any]]

#: Holds for every capture; printed with it.
MODEL_ASSUMPTIONS = (
    "targets answer with a declared, constant cross-section from one point",
    "surfaces are smooth and large against the Fresnel zone where they reflect; "
    "nothing goes through them; objects that are neither only cast shadows",
    "one transmit and one receive antenna at one place, vertical polarisation, "
    "gain G0 cos^q; no leakage between them, no phase noise",
    "velocities are constant within the interval, positions those of its middle, delays linear in "
    f"time to first order in v / c (bends beyond {_BENT_RAD} rad are warned of)",
    "air is clear and does not attenuate",
)


@dataclass(frozen=True)
class TrueTarget:
    """What a detection is judged by. ``received_w`` is the direct path's, slot loss included.

    ``visible``: a direct path exists. ``seen_at`` is range and rate as an unambiguous radar would
    wrap them.
    """

    name: str
    range_m: float
    range_rate_m_per_s: float
    azimuth_deg: float
    rcs_m2: float
    received_w: float
    visible: bool
    seen_at: tuple[float, float]


@dataclass(frozen=True, eq=False)
class RadarCapture:
    """A record with everything the twin knows about it. Only ``record`` exists on the vehicle."""

    record: RadarRecord
    truth: tuple[TrueTarget, ...]
    propagation: Propagation
    sample_noise_w: float
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class RadarEcho:
    """One interval before anything is sent: what the scene and the noise will make of it.

    ``channel`` (n_subcarriers, n_slots) belongs to the sent wave; ``noise_seed`` is of the one
    realisation of the noise, or None for none.
    """

    scene: Scene
    radar: RadarDesign
    propagation: Propagation
    channel: NDArray[np.complex128]
    noise_seed: np.random.SeedSequence | None

    def record(self, sent: NDArray[np.complex128] | None = None) -> RadarRecord:
        """What the radar records.

        Parameters
        ----------
        sent : (n_steps, n_slots, n_subcarriers)
            Sent subcarriers in place of the waveform's own. What a step records depends on its
            own part only.
        """
        iq, flags, scale = digitize(
            self.channel,
            self.radar,
            rng=np.random.default_rng(self.noise_seed),
            noisy=self.noise_seed is not None,
            sent=None if sent is None else sent[0],
        )
        return _record(self.scene, self.radar, iq, flags, scale)


def radar_echo(
    scene: Scene,
    radar: RadarDesign,
    *,
    seed: int = 0,
    fidelity: Fidelity | None = None,
    stage: Stage = lambda name: nullcontext(),
) -> RadarEcho:
    """The interval that `radar_capture` records; same parameters, same errors."""
    _check_targets(scene)
    ray_seed, noise_seed = np.random.SeedSequence([seed, 79]).spawn(2)
    fidelity = fidelity or Fidelity()
    with stage("radar paths"):
        if fidelity.radar == "targets":
            found = straight_paths(scene, radar)
        else:
            found = trace(scene, radar, seed=int(ray_seed.generate_state(1)[0]) >> 1)
    with stage("radar signal"):
        channel = synthesize(
            contributions(found.paths, radar.ofdm), radar.ofdm, fidelity.nufft_tolerance
        )
    noisy = fidelity.noise != "none"
    return RadarEcho(scene, radar, found, channel, noise_seed if noisy else None)


def radar_capture(
    scene: Scene,
    radar: RadarDesign,
    *,
    seed: int = 0,
    fidelity: Fidelity | None = None,
    stage: Stage = lambda name: nullcontext(),
) -> RadarCapture:
    """Acquire one interval.

    Parameters
    ----------
    scene, radar
        What is looked at, and with what.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    fidelity
        Knobs, each with the error it bounds.
    stage
        Called with each stage's name, for progress and timing.

    Raises InputError where a material has no data at the carrier.
    """
    echo = radar_echo(scene, radar, seed=seed, fidelity=fidelity, stage=stage)
    with stage("radar signal"):
        record = echo.record()
    found = echo.propagation
    truth = tuple(_true(t, scene, radar, found.paths) for t in scene.targets)
    return RadarCapture(
        record=record,
        truth=truth,
        propagation=found,
        sample_noise_w=radar.sample_noise_w,
        assumptions=(*MODEL_ASSUMPTIONS, *found.assumptions, *_assumed(scene, radar)),
        warnings=tuple(_warnings(scene, radar, found, truth, record.flags)),
    )


def _check_targets(scene: Scene) -> None:
    place = scene.rig.position_m + scene.rig.device("radar")[0]
    for target in scene.targets:
        distance = float(np.linalg.norm(np.asarray(target.position_m) - place))
        if distance < _NEAREST_M:
            raise InputError(
                f"target {target.name!r}: is {distance:g} m from the radar, "
                f"expected at least {_NEAREST_M:g} m"
            )


def contributions(paths: tuple[Path, ...], waveform: OfdmWaveform) -> Contributions:
    """Paths as the synthesis takes them, with what averaging over a slot leaves of each."""
    if not paths:
        return Contributions.none()
    rate = np.array([path.delay_rate for path in paths])
    amplitude = np.array([path.amplitude for path in paths], dtype=np.complex128)
    return Contributions(
        amplitude=amplitude * waveform.slot_gain(waveform.carrier_hz * rate),
        delay_s=np.array([path.delay_s for path in paths]),
        delay_rate=rate,
        departure=np.array([path.departure for path in paths]),
        arrival=np.array([path.arrival for path in paths]),
    )


def digitize(
    channel: NDArray[np.complex128],
    radar: RadarDesign,
    *,
    rng: np.random.Generator,
    noisy: bool = True,
    sent: NDArray[np.complex128] | None = None,
) -> tuple[NDArray[np.int16], NDArray[np.uint8], float]:
    """Counts (1, n_slots, n_subcarriers, 2), flags (1, n_slots), and root watts per count.

    The sent power is shared by the subcarriers; each slot becomes one symbol in time, with thermal
    noise, clipped to 16 bits. ``sent`` (n_slots, n_subcarriers) stands in for the waveform's own
    subcarriers as a radio sends them, rounded to complex64 samples.
    """
    wave = radar.ofdm
    power = radar.front_end.transmit_power_w.value
    if sent is None:
        level = highest_level(wave)
        sent = spectrum(symbol(wave, level), level)
    amplitude = sent * np.sqrt(power / wave.n_subcarriers)
    received = np.fft.ifft(np.fft.ifftshift(channel.T * amplitude, axes=1), axis=1)
    received *= wave.n_subcarriers
    noise = 0.0
    if noisy:
        noise = rng.normal(size=(*received.shape, 2)) * np.sqrt(radar.sample_noise_w / 2)
    scale = np.sqrt(radar.sample_noise_w) / radar.front_end.noise_counts.value
    exact = (np.stack([received.real, received.imag], axis=-1) + noise) / scale
    counts = np.clip(np.rint(exact), -32768, 32767).astype(np.int16)
    clipped = (np.abs(exact) > 32767).any(axis=(1, 2))
    flags = np.where(clipped, np.uint8(Flag.SATURATED), np.uint8(0))
    return counts[None], flags[None], float(scale)


def _true(target: Target, scene: Scene, radar: RadarDesign, paths: tuple[Path, ...]) -> TrueTarget:
    offset, axes = scene.rig.device("radar")
    towards = np.asarray(target.position_m) - scene.rig.position_m - offset
    distance = float(np.linalg.norm(towards))
    ahead, left, _ = axes @ towards
    rate = float(np.asarray(target.velocity_m_per_s) @ towards / distance)
    wave = radar.ofdm
    gain = float(wave.slot_gain(np.array(2 * rate / wave.wavelength_m)))
    fastest = wave.max_velocity_m_per_s
    return TrueTarget(
        name=target.name,
        range_m=distance,
        range_rate_m_per_s=rate,
        azimuth_deg=float(np.degrees(np.arctan2(left, ahead))),
        rcs_m2=target.rcs_m2,
        received_w=radar.received_power_w(distance, target.rcs_m2, ahead / distance) * gain**2,
        visible=any(path.via == (target.name,) for path in paths),
        seen_at=(distance % wave.max_range_m, (rate + fastest) % (2 * fastest) - fastest),
    )


def _record(
    scene: Scene,
    radar: RadarDesign,
    iq: NDArray[np.int16],
    flags: NDArray[np.uint8],
    scale: float,
) -> RadarRecord:
    wave = radar.ofdm
    starts = np.rint(np.arange(wave.n_slots) * wave.slot_period_s * 1e9).astype(np.int64)
    offset, _ = scene.rig.device("radar")
    rotation = scene.rig.pose.rotation * scene.rig.radar.rotation
    x, y, z, w = rotation.as_quat()
    return RadarRecord(
        iq=iq[None, :, :, None],
        device_time_ns=starts[None, None],
        flags=flags[None],
        carriers_hz=np.array([wave.carrier_hz]),
        transmitter=np.zeros(wave.n_slots, dtype=np.uint8),
        transmitters_m=np.zeros((1, 3)),
        receivers_m=np.zeros((1, 3)),
        waveform=wave,
        root_watt_per_count=scale,
        transmit_power_w=radar.front_end.transmit_power_w.value,
        antenna_gain_dbi=radar.antenna.gain_dbi.value,
        losses_db=radar.front_end.losses_db.value,
        leakage_delay_s=float("nan"),
        device=f"twin {__version__}: {radar.name}",
        pose=np.array([[*(scene.rig.position_m + offset), w, x, y, z]]),
    )


def _assumed(scene: Scene, radar: RadarDesign) -> list[str]:
    values = [
        f"{name} = {value.value}: {value.assumed}"
        for name, value in radar.values()
        if value.assumed
    ]
    targets = [
        f"cross-section of {t.name} = {t.rcs_m2:g} m^2: {t.origin.removeprefix('assumed: ')}"
        for t in scene.targets
        if t.origin.startswith("assumed: ")
    ]
    return [*values, *targets]


def _too_large(item: SceneObject, place: NDArray[np.float64]) -> bool:
    """Whether a renderer's rays would need the object divided; the radar's are not."""
    mesh = Mesh(item.vertices_m - place, item.faces)
    return len(divided(mesh).faces) > len(mesh.faces)


def _bend(target: Target, place: NDArray[np.float64], radar: RadarDesign) -> str | None:
    """Warning where a target crosses so fast that its range is no straight line in time.

    Across the line of sight v moves it by (v t)^2 / (2 R), which a path's one rate leaves out.
    """
    towards = np.asarray(target.position_m) - place
    distance = float(np.linalg.norm(towards))
    velocity = np.asarray(target.velocity_m_per_s)
    across2 = float(velocity @ velocity - (velocity @ towards / distance) ** 2)
    half_time = radar.ofdm.n_slots * radar.ofdm.slot_period_s / 2
    bend = across2 * half_time**2 / (2 * distance)
    phase = 4 * np.pi * bend / radar.ofdm.wavelength_m
    if phase < _BENT_RAD:
        return None
    return (
        f"{target.name} crosses so fast that its range bends by {bend:.2g} m within the interval, "
        f"which is left out: its echo is off by up to {100 * min(phase, 2.0):.3g} % of itself"
    )


def _warnings(
    scene: Scene,
    radar: RadarDesign,
    found: Propagation,
    truth: tuple[TrueTarget, ...],
    flags: NDArray[np.uint8],
) -> list[str]:
    farthest = max((t.range_m for t in truth), default=0.0)
    fastest = max((abs(t.range_rate_m_per_s) for t in truth), default=0.0)
    warnings = radar.warnings(farthest, fastest)
    place = scene.rig.position_m + scene.rig.device("radar")[0]
    inside = [item.name for item in scene.objects if encloses(item, place)]
    if inside:
        warnings.append(f"the radar stands inside {', '.join(inside)}")
    hidden = [t.name for t in truth if not t.visible]
    if hidden:
        warnings.append(f"no direct path to {', '.join(hidden)}")
    surfaces = {a.name for a in found.roles if a.role is Role.SURFACE}
    coarse = [o.name for o in scene.objects if o.name in surfaces and _too_large(o, place)]
    if coarse:
        warnings.append(
            f"triangles of {', '.join(coarse)} are so large that float32 rays may lose their echo "
            "or count it again (off by up to 300 % in what was tried): divide them"
        )
    warnings += [bend for t in scene.targets if (bend := _bend(t, place, radar))]
    if not found.paths:
        warnings.append("no echo at all: the record holds noise only")
    if flags.any():
        warnings.append(
            f"{np.count_nonzero(flags)} of {flags.size} slots clip: lower front_end.noise_counts"
        )
    return warnings
