"""Figures of the vehicle's radar processing: errors, resolution, false alarms, images, times.

Monte Carlo figures come with their 95 % interval, in the name or in the figures that follow.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import stats

from benchmarks.timing import Figure, timed
from hardware.radar import Cfar, MapNoise, OfdmWaveform, cfar_threshold, range_doppler
from hardware.radar.burst import demodulate
from hardware.radar.detection import detect_echoes
from hardware.radar.imaging import image
from hardware.radar.measurement import standard_errors
from hardware.radar.process import process
from hardware.radar.settings import Processing
from tests.hardware.radar_cubes import (
    CARRIERS,
    MIMO,
    STEP,
    WIDE,
    C,
    Echo,
    cube,
    peaks,
    resolved,
    track,
    two_cylinders,
    two_targets,
)
from twin.radar import load_radar

#: Of the error statistics.
WAVEFORMS = {
    "79 GHz": replace(WIDE, n_slots=32),
    "prototype, 500 MHz": OfdmWaveform(2.5e9, 400, 1.25e6, 16, 1e-3, 1, 0.4e-6),
}


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _times()
    yield from _errors()
    yield from _angles()
    yield from _resolution()
    yield from _false_alarms()
    yield from _detection()
    yield from _cylinders()


def _share(name: str, hits: int, runs: int) -> Iterator[Figure]:
    """A probability with its exact 95 % interval (Clopper and Pearson)."""
    interval = stats.binomtest(hits, runs).proportion_ci()
    yield f"{name} ({runs} runs)", hits / runs, ""
    yield f"{name}: 95 % interval, low", float(interval.low), ""
    yield f"{name}: 95 % interval, high", float(interval.high), ""


def _times() -> Iterator[Figure]:
    """The yard's kind of scene: five targets in noise, 4096 x 256; a track of 65 positions."""
    wave = load_radar("hybrid-79").ofdm
    places = ((20, 3, 100), (50, -10, 40), (80, 0, 20), (120, 8, 10), (140, -2, 10))
    echoes = [Echo((r, 0, 0), 1e-12 * p, (v, 0, 0)) for r, v, p in places]
    record = cube(wave, echoes, noise_w=1e-8, counts=400)
    for precision in ("single", "double"):
        how = Processing(precision=precision)  # type: ignore[arg-type]
        time = timed(lambda how=how: process(record, 0, how), runs=25, warm_up=3)
        yield f"IQ to detections, 4096 x 256, {precision}", time, ""
    maps = [
        range_doppler(demodulate(record, precision=p).channel, wave) for p in ("single", "double")
    ]
    strongest = np.sqrt(maps[1].power_w.max())
    off = np.abs(np.sqrt(maps[0].power_w) - np.sqrt(maps[1].power_w)).max() / strongest
    yield "single precision: largest error of a cell over the strongest", float(off), ""
    prototype = OfdmWaveform(2.5e9, 1600, 312.5e3, 1, 1e-3, 1, 0.4e-6)
    record = cube(prototype, [Echo((0.9, 0.075, 0)), Echo((0.9, -0.075, 0))], pose=track(65, 0.96))
    cells = np.linspace(0.5, 1.5, 200), np.linspace(-0.5, 0.5, 200)
    time = timed(lambda: image(record, *cells), runs=5)
    yield "back-projection, 200 x 200 cells, 65 positions, 1600 frequencies", time, ""


def _errors() -> Iterator[Figure]:
    """RMSE over the Cramer-Rao bound by default, and how many are missed at 1e-8 of false alarms.

    79 GHz with 4 GHz in 256 subcarriers and 32 slots: the statistics of a map do not hang on its
    size but for the number of cells among which noise can win (8192 here, a million in full).
    """
    for name, wave in WAVEFORMS.items():
        for snr_db in (14, 16, 18, 20, 30, 40):
            what = f"{name}, {snr_db} dB"
            ratios, missed = rmse(wave, snr_db, 400, np.random.default_rng(snr_db))
            if snr_db >= 18:
                yield f"{what}: range RMSE over bound (400 runs, 95 %: +/- 7 %)", ratios[0], ""
                yield f"{what}: rate RMSE over bound (400 runs, 95 %: +/- 7 %)", ratios[1], ""
            yield f"{what}: missed", missed, ""


def rmse(
    wave: OfdmWaveform, snr_db: float, runs: int, rng: np.random.Generator
) -> tuple[tuple[float, float], float]:
    """RMSE of range and rate over their bounds, and the share of echoes that are missed.

    As a user gets it by default; an echo counts as found within two cells.
    """
    n, m = wave.n_subcarriers, wave.n_slots
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    snr = 10 ** (snr_db / 10)
    bounds = np.array(standard_errors(wave, "boxcar", snr))
    cells = np.array([wave.delay_cell_s, wave.delay_rate_cell])
    errors = []
    for _ in range(runs):
        delay_s = rng.uniform(0.1, 0.9) * wave.max_delay_s
        delay_rate = rng.uniform(-0.4, 0.4) * wave.max_delay_rate
        delay = delay_s + delay_rate * t
        channel = np.exp(-2j * np.pi * (wave.carrier_hz * delay % 1.0 + f * delay))
        noise = rng.normal(size=(n, m, 2)).view(np.complex128)[..., 0]
        channel += noise * np.sqrt(n * m / snr / 2)
        for echo in detect_echoes(channel, wave, range_doppler(channel, wave), Cfar()):
            off = np.array([echo.delay_s - delay_s, echo.delay_rate - delay_rate])
            if np.all(np.abs(off) < 2 * cells):
                errors.append(off)
                break
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / bounds
    return (float(ratio[0]), float(ratio[1])), 1 - len(errors) / runs


def _angles() -> Iterator[Figure]:
    """Two transmitters, four receivers, half a wavelength; SNR after beamforming."""
    from hardware.radar.angles import direction
    from hardware.radar.array_plane import ArrayPlane
    from hardware.radar.channel_noise import ChannelNoise

    burst = demodulate(cube(replace(WIDE, n_slots=8), [Echo((4, 0, 0))], **MIMO))
    rng = np.random.default_rng(0)
    places = np.arange(8) / 2
    still = replace(burst, tdm_offset_s=np.zeros(8))  # standing target: no turns to unfold
    plane = ArrayPlane.of(still)
    assert plane is not None
    for snr_db in (17, 20, 30, 40):
        each = 10 ** (snr_db / 10) / 8
        errors = []
        for _ in range(1000):
            sine = rng.uniform(-0.8, 0.8)
            noise = rng.normal(size=(8, 2)).view(np.complex128)[..., 0] / np.sqrt(2 * each)
            seen = np.exp(2j * np.pi * places * sine) + noise
            noise_w = ChannelNoise.white(8, 1 / each)
            errors.append(direction(seen, still, 0.0, noise_w, plane).left - sine)
        bound = np.sqrt(6 / (8 * each * 63)) / np.pi
        near = np.abs(errors) < 0.5
        ratio = np.sqrt(np.mean(np.square(errors)[near])) / bound
        yield (
            f"azimuth, {snr_db} dB: RMSE over bound (1000 runs, 95 %: +/- 4.4 %)",
            float(ratio),
            "",
        )
        yield f"azimuth, {snr_db} dB: outliers", float(1 - near.mean()), ""


def _resolution() -> Iterator[Figure]:
    wave = replace(WIDE, n_slots=16)
    rng = np.random.default_rng(1)
    runs = [two_targets(rng, wave, 20.0, 1.5) for _ in range(200)]
    hits = sum(resolved(channel, wave, ranges) for channel, ranges in runs)
    yield from _share("two targets 1.5 cells apart, 20 dB: both found", hits, len(runs))


def _false_alarms() -> Iterator[Figure]:
    """White noise through the whole map, 2^20 cells; clumps of a window widen the interval.

    Then false detections by default, each counted once, on maps of 2^16 cells.
    """
    rng = np.random.default_rng(5)
    small = replace(WIDE, n_subcarriers=512, n_slots=128)
    for rate, runs in ((1e-3, 6), (1e-4, 40)):
        found = 0
        for _ in range(runs):
            noise = rng.normal(size=(512, 128, 2)).view(np.complex128)[..., 0]
            map_ = range_doppler(noise, small)
            found += len(detect_echoes(noise, small, map_, Cfar(rate), at_most=10**6))
        expected = rate * 2**16 * runs
        name = f"false detections by default, nominal {rate:g}: measured over nominal"
        yield name, found / expected, ""
        yield f"{name}, 95 % half width", float(1.96 / np.sqrt(expected)), ""
    rng = np.random.default_rng(2)
    wave = replace(WIDE, n_subcarriers=4096, n_slots=256)
    maps = {"boxcar": 12, "blackmanharris": 12}
    for window, runs in maps.items():
        counts = np.zeros((runs, 3, 3))
        for run in range(runs):
            noise = rng.normal(size=(4096, 256, 2)).astype(np.float32).view(np.complex64)[..., 0]
            power = range_doppler(noise, wave, window).power_w
            for i, method in enumerate(("ca", "go")):
                for j, rate in enumerate((1e-3, 1e-4, 1e-6)):
                    cfar = Cfar(rate, method)  # type: ignore[arg-type]
                    counts[run, i, j] = np.sum(
                        power > cfar_threshold(power, cfar, MapNoise(window))
                    )
        for i, method in enumerate(("ca", "go")):
            for j, rate in enumerate((1e-3, 1e-4, 1e-6)):
                name = f"false alarms, {method}, {window}, nominal {rate:g}: measured over nominal"
                expected = rate * 2**20 * runs
                seen = counts[:, i, j].sum()
                clump = 1.0 if window == "boxcar" else 2.6**2
                yield name, float(seen / expected), ""
                yield f"{name}, 95 % half width", float(1.96 * np.sqrt(clump / expected)), ""


def _detection() -> Iterator[Figure]:
    """Detection probability on a cell against theory, then the assumed link budget."""
    cfar = Cfar(1e-6, "ca", (2, 2), (8, 4))
    wave = replace(WIDE, n_subcarriers=64, n_slots=32)
    n = (2 * 10 + 1) * (2 * 6 + 1) - 25
    factor = n * (1e-6 ** (-1 / n) - 1)
    rng = np.random.default_rng(3)
    for swerling in (0, 1):
        worst = 0.0
        for snr_db in (8, 10, 12, 14, 16, 20):
            snr = 10 ** (snr_db / 10)
            hits = sum(_seen(wave, snr, swerling, cfar, rng) for _ in range(1500))
            worst = max(worst, abs(hits / 1500 - _theory(snr, swerling, factor, n)), key=abs)
        yield f"Swerling {swerling}: largest error of P_d (6 SNRs, 1500 runs each)", worst, ""
    yield from _link()


def _seen(
    wave: OfdmWaveform, snr: float, swerling: int, cfar: Cfar, rng: np.random.Generator
) -> bool:
    n, m = wave.n_subcarriers, wave.n_slots
    power = snr * (rng.exponential() if swerling else 1.0)
    row, column = rng.integers(n), rng.integers(m)
    echo = np.exp(2j * np.pi * (rng.uniform() - np.arange(n)[:, None] * row / n))
    echo = echo * np.exp(-2j * np.pi * np.arange(m) * column / m) * np.sqrt(power / (n * m))
    noise = rng.normal(size=(n, m, 2)).view(np.complex128)[..., 0] / np.sqrt(2)
    map_ = range_doppler(echo + noise, wave, "boxcar").power_w
    at = np.array([row]), np.array([(column + (m - 1) // 2) % m])
    return bool(map_[at][0] > cfar_threshold(map_, cfar, at=at)[0])


def _theory(snr: float, swerling: int, factor: float, n: int) -> float:
    """CA-CFAR with its loss: closed form for Swerling 1, an integral over the level for 0."""
    if swerling:
        return float((1 + factor / (n * (1 + snr))) ** -n)
    level = stats.gamma.ppf((np.arange(2000) + 0.5) / 2000, n) / n
    return float(np.mean(stats.ncx2.sf(2 * factor * level, 2, 2 * snr)))


def _link() -> Iterator[Figure]:
    """10 ms of 79 GHz, the vehicle's own window: P_d at 1e-6 anywhere between the cells."""
    radar = load_radar("hybrid-79")
    wave = replace(
        radar.ofdm, n_subcarriers=128, n_slots=64, slot_period_s=radar.ofdm.slot_period_s
    )
    rng = np.random.default_rng(4)
    snr_db = np.arange(12.0, 26.0, 1.0)
    shares = []
    for snr in 10 ** (snr_db / 10):
        shares.append(np.mean([_found(wave, snr, rng) for _ in range(300)]))
    snr_10 = radar.image_snr(radar.received_power_w(150.0, 10.0))
    hits = sum(_found(wave, snr_10, rng) for _ in range(1000))
    yield from _share("10 m^2 at 150 m: P_d at P_fa 1e-6", hits, 1000)
    needed = float(np.interp(0.9, np.maximum.accumulate(shares), snr_db))
    yield "image SNR for P_d 0.9 by default", needed, "dB"
    for rcs in (1.0, 10.0, 50.0):
        at = 150 * (snr_10 * rcs / 10 / 10 ** (needed / 10)) ** 0.25
        yield f"{rcs:g} m^2: distance of P_d 0.9 (unambiguous to 153.5 m)", float(at), "m"


def _found(wave: OfdmWaveform, snr: float, rng: np.random.Generator) -> bool:
    n, m = wave.n_subcarriers, wave.n_slots
    range_m = rng.uniform(0.2, 0.8) * wave.max_range_m
    rate = rng.uniform(-0.2, 0.2) * wave.max_velocity_m_per_s
    delay = 2 / C * (range_m + rate * wave.slot_times_s)
    f = wave.frequency_offsets_hz[:, None]
    channel = np.exp(-2j * np.pi * (wave.carrier_hz * delay % 1.0 + f * delay))
    channel += rng.normal(size=(n, m, 2)).view(np.complex128)[..., 0] * np.sqrt(n * m / snr / 2)
    map_ = range_doppler(channel, wave)
    echoes = detect_echoes(channel, wave, map_, Cfar(1e-6), at_most=4)
    return any(abs(echo.delay_s - 2 / C * range_m) < wave.delay_cell_s for echo in echoes)


def _cylinders() -> Iterator[Figure]:
    """Figure 3 b: both peaks' cross-range against +/- 7.5 cm; then the stepped prototype."""
    cells = np.linspace(0.6, 1.2, 61), np.linspace(-0.3, 0.3, 301)
    for ghz in (2.25, 2.5, 2.8):
        places = peaks(image(two_cylinders(ghz * 1e9, noise=0.01), *cells), 2)
        off = np.abs(np.sort(places[:, 1]) - [-0.075, 0.075]).max()
        yield f"figure 3 b, {ghz} GHz: largest error of a peak", float(1e3 * off), "mm"
    echoes = [Echo((0.86, side, 0)) for side in (-0.075, 0.075)]
    record = cube(
        replace(STEP, n_slots=2), echoes, carriers_hz=CARRIERS, leakage=(1e-6, 1e-9),
        noise_w=1e-11, pose=track(33, 0.96),
    )  # fmt: skip
    places = peaks(image(record, *cells), 2)
    off = np.abs(np.sort(places[:, 1]) - [-0.075, 0.075]).max()
    yield "two points, 25 steps of random phase, 2.5 GHz: largest error", float(1e3 * off), "mm"
