"""Radar records of point echoes by direct sum in float64: delays exact for every sample's burst,
step, slot, pair of antennas and subcarrier.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hardware.radar import OfdmWaveform
from hardware.records import RadarRecord

C = 299_792_458.0
HERE = np.zeros((1, 3))


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
        transmitters_m=np.asarray(transmitters_m, dtype=float),
        receivers_m=np.asarray(receivers_m, dtype=float),
        waveform=waveform,
        root_watt_per_count=float(scale),
        transmit_power_w=0.01,
        antenna_gain_dbi=gain_dbi,
        losses_db=0.0,
        leakage_delay_s=leakage[1] if leakage else float("nan"),
        device="test",
        pose=poses,
    )
