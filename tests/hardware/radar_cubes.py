"""Radar records of point echoes by direct sum in float64: delays exact for every sample's burst,
step, slot, pair of antennas and subcarrier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

from hardware.radar import Cfar, OfdmWaveform, range_doppler
from hardware.radar.detection import detect_echoes
from hardware.radar.superresolution import resolve
from hardware.records import QuaternionPose, RadarFrontEnd, RadarRecord

C = 299_792_458.0
HERE = np.zeros((1, 3))

WIDE = OfdmWaveform(79e9, 256, 15e6, 64, 39.0625e-6, 37, 0.06e-6)
#: One step of the prototype: 64 x 312.5 kHz, 16 symbols; 25 of them make 500 MHz.
STEP = OfdmWaveform(2.26e9, 64, 312.5e3, 16, 3.6e-6, 1, 0.4e-6)
CARRIERS = 2.26e9 + 20e6 * np.arange(25)
#: Two transmitters, four receivers: eight places half a wavelength apart.
HALF = WIDE.wavelength_m / 2
MIMO = {
    "transmitter": (0, 1),
    "transmitters_m": np.array([[0, 0, 0], [0, 4 * HALF, 0]]),
    "receivers_m": np.array([[0, i * HALF, 0] for i in range(4)]),
}
#: 3 transmitters by turns and 4 receivers, as `hybrid-79-mimo`, an eighth of its cells.
TURNS = OfdmWaveform(79e9, 1024, 3.90625e6, 129, 39.0625e-6, 37, 0.25e-6)
#: 500 MHz at once, in coarse subcarriers; a burst of one slot.
BAND = OfdmWaveform(2.5e9, 100, 5e6, 1, 1e-3, 1, 0.1e-6)


@dataclass(frozen=True)
class Echo:
    """A point at ``place_m`` (world), moving, of received power ``power_w``."""

    place_m: tuple[float, float, float]
    power_w: float = 1e-9
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    phase_rad: float = 0.0


def cube(
    waveform: OfdmWaveform,
    echoes: Sequence[Echo],
    *,
    carriers_hz: np.ndarray | None = None,
    transmitter: Sequence[int] = (0,),
    transmitters_m: np.ndarray = HERE,
    receivers_m: np.ndarray = HERE,
    pose: np.ndarray | None = None,
    noise_w: float = 0.0,
    leakage: tuple[float, float] | None = None,
    retune_s: float = 1e-3,
    counts: float = 8000.0,
    seed: int = 0,
    gain_dbi: float = 20.0,
    scrambled: bool = True,
    path_m=None,
) -> RadarRecord:
    """A record. ``transmitter`` repeats over the slots; ``leakage`` is (power, delay); ``noise_w``
    is the thermal power of one sample; ``scrambled``: each step of several has a random phase.
    ``path_m(echo place, antenna place)`` replaces the straight way.
    """
    rng = np.random.default_rng(seed)
    n, m = waveform.n_subcarriers, waveform.n_slots
    carriers = np.array([waveform.carrier_hz]) if carriers_hz is None else carriers_hz
    poses = np.array([[0, 0, 0, 1, 0, 0, 0]], dtype=float) if pose is None else pose
    senders = np.resize(np.asarray(transmitter, dtype=np.uint8), m)
    shape = (len(poses), len(carriers), m, len(receivers_m), n)
    step_s = m * waveform.slot_period_s + (retune_s if len(carriers) > 1 else 0.0)
    received = np.zeros(shape, dtype=np.complex128)
    path_m = path_m or (lambda place, antenna: np.linalg.norm(place - antenna, axis=-1))
    for b, s in np.ndindex(shape[:2]):
        axes = Rotation.from_quat(poses[b, [4, 5, 6, 3]])
        # Echoes stand where they are said to be in the middle of a burst.
        t = waveform.slot_times_s + (s - (len(carriers) - 1) / 2) * step_s
        f = waveform.frequency_offsets_hz
        turn = rng.uniform(-np.pi, np.pi) if len(carriers) > 1 and scrambled else 0.0
        for r, receiver in enumerate(receivers_m):
            sum_ = np.zeros((m, n), dtype=np.complex128)
            ends = [poses[b, :3] + axes.apply(a) for a in (receiver, *transmitters_m)]
            for echo in echoes:
                place = np.asarray(echo.place_m) + np.outer(t, echo.velocity_m_per_s)
                legs = [path_m(place, end) for end in ends]
                delay = (legs[0] + np.choose(senders, legs[1:])) / C
                cycles = (carriers[s] * delay % 1.0)[:, None] + delay[:, None] * f
                sum_ += np.sqrt(echo.power_w) * np.exp(1j * (echo.phase_rad - 2 * np.pi * cycles))
            if leakage:
                cycles = (carriers[s] + f) * leakage[1]
                sum_ += np.sqrt(leakage[0]) * np.exp(-2j * np.pi * cycles)
            received[b, s, :, r] = sum_ * np.exp(1j * turn)
    spectrum = np.fft.ifftshift(received * waveform.sent() / np.sqrt(n), axes=-1)
    wave = np.fft.ifft(spectrum, axis=-1) * n
    noise = rng.normal(size=(*shape, 2)) * np.sqrt(noise_w / 2) if noise_w else 0.0
    exact = np.stack([wave.real, wave.imag], axis=-1) + noise
    scale = (np.abs(exact).max() or 1.0) / counts
    slot_times = np.arange(m) * waveform.slot_period_s
    times = np.arange(len(carriers))[:, None] * step_s + slot_times
    times = times + np.arange(len(poses))[:, None, None] * (len(carriers) * step_s + 1e-3)
    return RadarRecord(
        iq=np.rint(exact / scale).astype(np.int16),
        device_time_ns=np.rint(1e9 * times).astype(np.int64),
        flags=np.zeros(shape[:3], np.uint8),
        carriers_hz=carriers,
        transmitter=senders,
        waveform=waveform,
        front_end=RadarFrontEnd(
            root_watt_per_count=float(scale),
            transmit_power_w=0.01,
            antenna_gain_dbi=gain_dbi,
            losses_db=0.0,
            leakage_delay_s=leakage[1] if leakage else float("nan"),
            transmitters_m=np.asarray(transmitters_m, dtype=float),
            receivers_m=np.asarray(receivers_m, dtype=float),
        ),
        device="test",
        pose=tuple(QuaternionPose(*numbers) for numbers in poses.tolist()),
    )


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Complex, of mean power 1."""
    return rng.normal(size=(*shape, 2)).view(np.complex128)[..., 0] / np.sqrt(2)


def calibrated(record: RadarRecord, **changes: float) -> RadarRecord:
    """The record of a front end that is known otherwise."""
    return replace(record, front_end=replace(record.front_end, **changes))


def two_targets(rng: np.random.Generator, wave: OfdmWaveform, snr_db: float, cells: float):
    """Channel of two equal targets ``cells`` apart with random phases, and their ranges."""
    first = rng.uniform(0.2, 0.8) * wave.max_range_m
    ranges = first + np.array([0, cells]) * wave.range_cell_m
    rate = rng.uniform(-0.8, 0.8) * wave.max_velocity_m_per_s
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    amplitude = np.sqrt(10 ** (snr_db / 10) / (wave.n_subcarriers * wave.n_slots))
    channel = rng.normal(size=(wave.n_subcarriers, wave.n_slots, 2)).view(np.complex128)[..., 0]
    channel /= np.sqrt(2)
    for r in ranges:
        delay = 2 / C * (r + rate * t)
        cycles = rng.uniform() + wave.carrier_hz * (delay - 2 / C * r) + f * delay
        channel += amplitude * np.exp(-2j * np.pi * cycles)
    return channel, ranges


def resolved(channel: np.ndarray, wave: OfdmWaveform, ranges: np.ndarray) -> bool:
    """Whether there are two detections, each within half a cell of its target.

    By default but for `resolve`, which a user asks for.
    """
    echoes = detect_echoes(channel, wave, range_doppler(channel, wave), Cfar(1e-6))
    if not echoes:
        return False
    noise_w = range_doppler(channel, wave, "boxcar").noise_w
    parts = resolve(channel, wave, echoes[0], noise_w, fastest=0.0)
    off_s = [abs(p.delay_s - 2 / C * r) for p, r in zip(parts, ranges, strict=False)]
    return len(parts) == 2 and max(off_s) < wave.delay_cell_s / 2


def track(n: int, length_m: float, origin=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Poses along y, looking along x."""
    poses = np.tile([*origin, 1.0, 0, 0, 0], (n, 1))
    poses[:, 1] += np.linspace(-length_m / 2, length_m / 2, n)
    return poses


def peaks(found, count: int) -> np.ndarray:
    """Places (count, 2) of the highest local peaks, to a tenth of a cell or so."""
    from scipy.ndimage import maximum_filter

    power = np.abs(found.value)
    rows, columns = np.nonzero((maximum_filter(power, 7) == power) & (power > 0.2 * power.max()))
    best = np.argsort(-power[rows, columns])[:count]
    return np.stack([found.down_range_m[rows[best]], found.cross_range_m[columns[best]]], axis=-1)


def cylinder_echo(frequency_hz: np.ndarray, radius_m: float) -> np.ndarray:
    """Far field of a conducting cylinder, E along its axis, phase from the axis.

    The series sum e_n (-1)^n J_n(ka) / H_n(ka) (Harrington, Time-Harmonic Electromagnetic Fields,
    5.9), with exp(-j 2 pi f t) delays.
    """
    ka = 2 * np.pi * frequency_hz / C * radius_m
    n = np.arange(40)[:, None]
    term = special.jv(n, ka) / special.hankel2(n, ka) * (-1.0) ** n
    return -(2 * term.sum(axis=0) - term[0]) * np.exp(-1j * np.pi / 4)


def two_cylinders(centre_hz: float, n_bursts: int = 65, noise: float = 0.0) -> RadarRecord:
    """A record of the track, 100 frequencies over 500 MHz, axes at +/- 7.5 cm and 0.9 m."""
    wave = replace(BAND, carrier_hz=centre_hz)
    poses = track(n_bursts, 0.96)
    record = cube(wave, [], pose=poses)
    f = wave.carrier_hz + wave.frequency_offsets_hz
    spectrum = np.zeros((n_bursts, 100), dtype=complex)
    for side in (-0.075, 0.075):
        way = np.hypot(0.9, side - poses[:, 1])[:, None]
        spectrum += cylinder_echo(f, 0.04) / way * np.exp(-4j * np.pi * f * way / C)
    time = np.fft.ifft(np.fft.ifftshift(spectrum * wave.sent(), axes=1), axis=1)
    rng = np.random.default_rng(0)
    time = time + noise * np.abs(time).max() * rng.normal(size=(n_bursts, 100, 2)) @ [1, 1j]
    iq = np.stack([time.real, time.imag], axis=-1)
    counts = np.rint(8000 * iq / np.abs(iq).max()).astype(np.int16)
    return replace(record, iq=counts[:, None, None, None])
