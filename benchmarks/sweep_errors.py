"""True errors of a sweep's points, and of differences between them, against what is stated.

The truth of a point is measured of light with 16 times the paths of `reference`, with the same
draw of the noise, which follows the light smoothly (normal, and a converter of fine steps), so that
what is left is the model's error alone.
"""

import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.timing import Figure
from hardware.reconstruction import reconstruct
from twin.accuracy import Interval
from twin.camera.acquisition import Capture, measure
from twin.camera.intervals import psnr_interval, ssim_interval
from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.camera.snr_intervals import snr_interval
from twin.fidelity import Fidelity
from twin.sweep import Study, load_study
from twin.sweep.evaluate import outcome_of
from twin.sweep.inputs import inputs_of

_REFERENCE = Fidelity(samples=2**14, max_depth=8)
_STUDY = """
scene = "yard"
metrics = ["snr_median", "psnr_db", "ssim"]
[set]
"fidelity.tolerance" = 0.2
"fidelity.noise" = "gaussian"
"system.readout.adc_bits" = 24
"system.acquisition.n_patterns" = 1024
[grid]
"scene.rig.x_m" = [0.0, 0.02, 0.3, 0.9]
"system.readout.read_noise_e" = [3e3, 1e4, 3e4]
"system.sky.illuminance_lx" = [0, 400, 1e3, 1e4, 1e5]
"processing.method" = ["zero-fill", "lmmse"]
"""
_POINTS, _SEED = 20, 17019


@dataclass(frozen=True)
class _Point:
    """Metrics of a point with their intervals, and what they are in truth."""

    stated: dict[str, Interval]
    true: dict[str, float]

    def off(self, metric: str) -> float:
        return self.stated[metric].value - self.true[metric]


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    points = list(_points(_study()))
    for metric in points[0].stated:
        stated = np.array([p.stated[metric].of_model.half_width for p in points])
        ratio = np.abs([p.off(metric) for p in points]) / stated
        yield from _told(f"{_POINTS} points of the yard, {metric}", ratio, stated)
        pairs = list(itertools.combinations(points, 2))
        both = np.array([_of_difference(a.stated[metric], b.stated[metric]) for a, b in pairs])
        ratio = np.abs([a.off(metric) - b.off(metric) for a, b in pairs]) / both
        yield from _told(f"{len(pairs)} differences of them, {metric}", ratio, both)


def _told(what: str, ratio: np.ndarray, stated: np.ndarray) -> Iterator[Figure]:
    yield f"{what}: within what is stated", 100 * float(np.mean(ratio <= 1)), "%"
    yield f"{what}: true error over the stated, worst", float(ratio.max()), ""
    yield f"{what}: true error over the stated, median", float(np.median(ratio)), ""
    yield f"{what}: stated, median", float(np.median(stated)), ""


def _of_difference(a: Interval, b: Interval) -> float:
    """What two intervals state of a difference: as of independent paths, and both bounds."""
    model = Interval(0.0, float(np.hypot(a.standard_error, b.standard_error)))
    return model.half_width + a.systematic + b.systematic


def _points(study: Study) -> Iterator[_Point]:
    inputs, rng = inputs_of(study), np.random.default_rng(_SEED)
    light: dict[str, RenderedLight] = {}
    for index in sorted(rng.choice(study.n_points, _POINTS, replace=False).tolist()):
        outcome = outcome_of(study, index, inputs)
        made = outcome.setup
        key = str(made.scene.rig.position_m)
        if key not in light:
            seed = np.random.SeedSequence(_SEED)
            light[key] = render(made.scene, made.system, fidelity=_REFERENCE, seed=seed)
        noise = np.random.default_rng(np.random.SeedSequence(made.seed).spawn(2)[1])
        exact = measure(made.scene, made.system, light[key], rng=noise, noise=made.fidelity.noise)
        stated = _metrics(outcome.capture, made.method)
        yield _Point(stated, {name: x.value for name, x in _metrics(exact, made.method).items()})


def _metrics(capture: Capture, method: str) -> dict[str, Interval]:
    image = reconstruct(capture.record, method)
    return {
        "snr_median": snr_interval(capture, "median"),
        "psnr_db": psnr_interval(capture, image),
        "ssim": ssim_interval(capture, image),
    }


def _study() -> Study:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(_STUDY)
        return load_study(path)
