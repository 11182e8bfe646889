"""How often printed intervals hold the same figure of another draw of the sensor's noise.

Intervals without the model's part: light and echoes are the same in all draws. Asked are 95 %.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure
from hardware.reconstruction import reconstruct
from twin.accuracy import Interval
from twin.camera.acquisition import measure
from twin.camera.intervals import psnr_interval, ssim_interval
from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.camera.snr_intervals import snr_interval
from twin.fidelity import Fidelity
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.radar.acquisition import channel as received
from twin.radar.detection_count import targets_detected
from twin.radar.device.front_end import digitize
from twin.radar.evaluation import RadarEvaluation, evaluate_radar
from twin.scene import Scene, load_scene
from twin.system import System, load_system

_SNRS = (0.01, 0.03, 0.1, 1.0, 10.0, 100.0, 1000.0)
_METHODS = ("zero-fill", "lmmse", "tv")
_SETS: dict[str, dict[str, object]] = {
    "full set": {},
    "quarter of it": {"acquisition.n_patterns": 256},
    "1/f noise, reference set": {
        "readout.flicker_corner_hz": 1e3,
        "acquisition.mode": "reference",
    },
}
_SEEDS, _RADAR_SEEDS = 200, 40
_LESS_DB = (0.0, 20.0, 40.0)  # of the radar's power

#: One figure with its interval at each seed.
Drawn = Sequence[Interval]


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for name, changes in _SETS.items():
        system = load_system("workable").with_(
            {"emitter.rows": 32, "emitter.columns": 32, "acquisition.n_patterns": 1024, **changes}
        )
        for snr in _SNRS:
            for figure, drawn in camera_draws(load_scene("table1"), system, snr, _SEEDS).items():
                yield from told(f"camera, {name}, SNR {snr:g}, {figure}", drawn)
    for less_db in _LESS_DB:
        radar = load_radar("hybrid-79")
        power_w = radar.front_end.transmit_power_w.value * 10 ** (-less_db / 10)
        radar = radar.with_({"front_end.transmit_power_w": power_w})
        for figure, drawn in radar_draws(load_scene("yard"), radar, _RADAR_SEEDS).items():
            yield from told(f"radar, {less_db:g} dB less power, {figure}", drawn)


def told(what: str, drawn: Drawn) -> Iterator[Figure]:
    """Coverage of a figure's intervals, and their width."""
    scatter = np.std([interval.value for interval in drawn], ddof=1)
    stated = np.sqrt(np.mean([interval.noise**2 for interval in drawn]))
    yield f"{what}: within the interval of another draw", 100 * coverage(drawn), "%"
    yield f"{what}: stated over true scatter", float(stated / scatter) if scatter else 1.0, ""


def coverage(drawn: Drawn) -> float:
    """Share of pairs of draws in which the interval of one holds the value of the other."""
    value = np.array([interval.value for interval in drawn])
    half_width = np.array([Interval(0.0, noise=interval.noise).half_width for interval in drawn])
    within: NDArray[np.bool_] = np.abs(value[:, None] - value) <= half_width[:, None]
    return float(within[~np.eye(len(value), dtype=bool)].mean())


def camera_draws(scene: Scene, system: System, snr: float, n: int) -> dict[str, list[Interval]]:
    """Figures of images of the same light, at a median SNR of lit cells."""
    light = render(scene, system, fidelity=Fidelity(samples=64), seed=np.random.SeedSequence(1))
    system = _of_snr(system, snr, scene, light)
    found: dict[str, list[Interval]] = defaultdict(list)
    for seed in range(n):
        taken = measure(scene, system, light, rng=np.random.default_rng(seed))
        for method in _METHODS:
            image = reconstruct(taken.record, method)
            found[f"{method}, PSNR"].append(psnr_interval(taken, image))
            found[f"{method}, SSIM"].append(ssim_interval(taken, image))
        found["median SNR"].append(snr_interval(taken, "median"))
    return found


def _of_snr(system: System, snr: float, scene: Scene, light: RenderedLight) -> System:
    """With an emitter of the power that this takes, and a converter that holds it."""
    system = system.with_({"readout.adc_bits": 24})
    for _ in range(6):
        taken = measure(scene, system, light, rng=np.random.default_rng(0))
        factor = snr / max(snr_interval(taken, "median").value, 1e-9)
        used = float(taken.record.counts.max()) / 2**24
        power = system.emitter.radiant_intensity_w_per_sr.value * factor
        range_v = system.readout.adc_full_scale_v.value * max(2 * used * factor, 1.0)
        system = system.with_(
            {
                "emitter.radiant_intensity_w_per_sr": power,
                "readout.adc_full_scale_v": range_v,
            }
        )
    return system


def radar_draws(
    scene: Scene, radar: RadarDesign, n: int, fidelity: Fidelity | None = None
) -> dict[str, list[Interval]]:
    """Figures of targets of the same echoes, of those detected in all draws; and their number."""
    found: dict[str, list[Interval]] = defaultdict(list)
    for evaluation in evaluations(scene, radar, n, fidelity):
        found["targets detected"].append(targets_detected(evaluation))
        for target, intervals in zip(evaluation.matches, evaluation.intervals, strict=True):
            if target is not None:
                for name, interval in vars(intervals).items():
                    if np.isfinite(interval.value):
                        found[f"{target.name}, {name}"].append(interval)
    return {name: drawn for name, drawn in found.items() if len(drawn) == n}


def evaluations(
    scene: Scene, radar: RadarDesign, n: int, fidelity: Fidelity | None = None
) -> Iterator[RadarEvaluation]:
    """What the vehicle makes of the same echoes in so many draws of the noise."""
    capture = radar_capture(scene, radar, fidelity=fidelity)
    quiet = received(capture.bursts[0], radar, capture.air)
    for seed in range(n):
        iq, flags = (x[None] for x in digitize(quiet, radar, rng=np.random.default_rng(seed))[:2])
        yield evaluate_radar(
            radar, replace(capture, record=replace(capture.record, iq=iq, flags=flags))
        )
