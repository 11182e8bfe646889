"""False alarms of every bundled radar with its own faults: measured rate over the nominal one.

Oscillator, leakage, I/Q imbalance and converter are the radar's; nothing is before it, or a few
strong targets. Cells of a target are not counted: its window's main lobe along range and rate. What
its side lobes and its own phase noise raise is counted. ``python -m benchmarks false_alarms``.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure
from hardware.radar import Cfar, MapNoise, RangeDopplerMap, cfar_threshold
from hardware.radar.burst import demodulate
from hardware.radar.process import process
from hardware.radar.range_doppler import range_doppler
from hardware.radar.settings import Processing
from hardware.records import QuaternionPose, RadarRecord
from hardware.waveform import C_M_PER_S
from twin.radar import load_radar
from twin.radar.acquisition import leakage_echo
from twin.radar.device.burst import burst_channel
from twin.radar.device.design import RadarDesign
from twin.radar.device.front_end import digitize
from twin.radar.synthesis import Contributions

RADARS = ("hybrid-79", "hybrid-79-slow", "hybrid-79-mimo", "paper-80", "prototype")
RATES = (1e-4, 1e-6)
#: Range (m), range rate (m/s), cross-section (m^2), azimuth (rad). At 8 and 60 m straight ahead,
#: where an echo is on all receivers what the leakage's phase noise is.
STRONG = ((8.0, 0.0, 30.0, 0.0), (25.0, 0.0, 1000.0, 0.3), (60.0, 3.0, 1000.0, 0.0))
#: A radar that steps its carrier needs a moving target's rate to focus it, see `stitch`.
STILL = tuple((range_m, 0.0, rcs, azimuth) for range_m, _, rcs, azimuth in STRONG)
_MAIN_LOBE = 6  # cells either side of a target


def figures() -> Iterator[Figure]:
    """Rates over maps that show a few alarms at the rarer rate."""
    for name in RADARS:
        maps = 200 if name == "prototype" else 12
        strong = STILL if name == "prototype" else STRONG
        for scene, targets in (("empty", ()), ("strong targets", strong)):
            alarms, cells = count(name, range(maps), targets, RATES)
            for nominal, seen in zip(RATES, alarms, strict=True):
                what = f"{name}, {scene}: false alarms over {nominal:g}"
                yield f"{what} ({seen} in {cells} cells)", seen / cells / nominal, ""
            for nominal in (*RATES, 1e-8):
                seen = false_detections(name, range(maps), targets, nominal)
                what = f"{name}, {scene}: false detections over {nominal:g}"
                yield f"{what} ({seen} in {cells} cells)", seen / cells / nominal, ""


def count(
    name: str,
    seeds: range,
    targets: tuple[tuple[float, float, float, float], ...],
    rates: tuple[float, ...],
    processing: Processing | None = None,
) -> tuple[list[int], int]:
    """Cells above their threshold at each rate, and all cells that were looked at."""
    how = processing or Processing()
    alarms, cells = np.zeros(len(rates), dtype=int), 0
    for seed in seeds:
        taken = demodulate(record(name, seed, targets), precision=how.precision)
        image = range_doppler(
            taken.channel, taken.waveform, how.window, relative_noise=taken.relative_noise
        )
        counted = _empty(image, taken.waveform.max_range_m, targets)
        cells += int(counted.sum())
        for i, rate in enumerate(rates):
            cfar = replace(how.cfar, false_alarm=rate)
            alarms[i] += np.sum(above(image, cfar, how.window) & counted)
    return [int(n) for n in alarms], cells


def false_detections(
    name: str, seeds: range, targets: tuple[tuple[float, float, float, float], ...], rate: float
) -> int:
    """Detections by default, at a rate of false alarms, that are none of the targets.

    Raises ValueError for a target that is not found.
    """
    how = Processing(cfar=Cfar(rate), at_most=10**6)
    alarms = 0
    for seed in seeds:
        frame = process(record(name, seed, targets), 0, how)
        range_m = np.array([one.range_m for one in frame.detections])
        rate_m_per_s = np.array([one.range_rate_m_per_s for one in frame.detections])
        alarm = np.ones(len(range_m), dtype=np.bool_)
        for target in targets:
            wave = frame.waveform
            near = np.all(
                _near(target, range_m, rate_m_per_s, frame.image, wave.max_range_m), axis=0
            )
            if not near.any():
                raise ValueError(f"{name}, seed {seed}: the target at {target[0]} m is not found")
            alarm &= ~near
        alarms += int(alarm.sum())
    return alarms


def above(image: RangeDopplerMap, cfar: Cfar, window: str) -> NDArray[np.bool_]:
    """Cells above their threshold."""
    noise = MapNoise(window, image.n_channels, relative_noise=image.relative_noise)
    threshold = cfar_threshold(image.power_w, cfar, noise)
    return np.asarray(image.power_w > threshold)


def _empty(
    image: RangeDopplerMap, max_range_m: float, targets: tuple[tuple[float, ...], ...]
) -> NDArray[np.bool_]:
    """Cells outside of every target's main lobe, and of what its rate moves it within a burst."""
    counted = np.ones(image.power_w.shape, dtype=np.bool_)
    for target in targets:
        near = _near(target, image.range_m, image.range_rate_m_per_s, image, max_range_m)
        counted[np.ix_(*near)] = False
    return counted


def _near(
    target: tuple[float, ...],
    range_m: NDArray[np.float64],
    rate_m_per_s: NDArray[np.float64],
    image: RangeDopplerMap,
    max_range_m: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which ranges and which rates are within a target's main lobe; rates repeat with the map."""
    rates = image.range_rate_m_per_s
    cells = [image.range_m[1], rates[1] - rates[0] if len(rates) > 1 else 1.0]
    span = cells[1] * len(rates)
    away = [
        np.abs(range_m - target[0] % max_range_m) / cells[0],
        np.abs((rate_m_per_s - target[1] + span / 2) % span - span / 2) / cells[1],
    ]
    return away[0] <= _MAIN_LOBE + abs(target[1]) * 0.01 / cells[0], away[1] <= _MAIN_LOBE


def record(
    name: str, seed: int, targets: tuple[tuple[float, float, float, float], ...] = ()
) -> RadarRecord:
    """A burst with targets in free space, and the leakage."""
    radar = load_radar(name)
    burst, wave = radar.burst, radar.ofdm
    echoes = _echoes(radar, targets)
    there = burst_channel(echoes, burst)
    rng = np.random.default_rng(np.random.SeedSequence([seed, 8]))
    iq, flags, scale = digitize(there, radar, rng=rng)
    steps = burst.step_times_s - burst.step_times_s[0]
    times = steps[:, None] + np.arange(wave.n_slots) * wave.slot_period_s
    return RadarRecord(
        iq=iq[None],
        device_time_ns=np.rint(1e9 * times)[None].astype(np.int64),
        flags=flags[None],
        carriers_hz=burst.carriers_hz,
        transmitter=burst.transmitter,
        waveform=wave,
        front_end=radar.recorded_front_end(scale),
        device=name,
        pose=(QuaternionPose(),),
    )


def _echoes(radar: RadarDesign, targets: tuple[tuple[float, ...], ...]) -> Contributions:
    """Point targets by the radar equation, and the leakage, at every carrier step."""
    range_m, rate, _, azimuth_rad = np.array(targets).reshape(-1, 4).T
    received_w = np.array([radar.received_power_w(target[0], target[2]) for target in targets])
    amplitude = np.sqrt(received_w / radar.front_end.transmit_power_w.value).astype(np.complex128)
    amplitude = np.tile(amplitude, (len(radar.burst.carriers_hz), 1))
    ahead = Contributions.ahead(amplitude, 2 * range_m / C_M_PER_S, 2 * rate / C_M_PER_S)
    way = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), 0 * azimuth_rad], axis=1)
    echoes = replace(ahead, departure=way, arrival=way)
    return Contributions.concatenate([echoes, leakage_echo(radar)])
