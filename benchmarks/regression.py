"""The regression plugin: how often it finds a planted loss, and how often one that is none."""

import time
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from benchmarks.planted_losses import planted, share_worse
from benchmarks.timing import Figure, timed
from twin.camera.light import render
from twin.fidelity import Fidelity
from twin.regression.metrics import CAMERA_METRICS
from twin.regression.runs import run_camera
from twin.regression.statistics import compare
from twin.scene import load_scene
from twin.system import System, load_system
from twin.toml import Sourced

_SEEDS = 48  # of one comparison, as the plugin's default
_POOL = 2400  # seeds from which comparisons are drawn
_TIMES = 4000  # comparisons for each figure
_LOSS_DB = 0.2

Figures = Mapping[str, NDArray[np.float64]]


def figures() -> Iterator[Figure]:
    """Name, value and unit: power and false alarms, for LMMSE on scenes/yard, 32 x 32 cells."""
    start = time.perf_counter()
    scene, system = load_scene("yard"), _small(load_system("workable"))
    light = render(scene, system, fidelity=Fidelity(), seed=np.random.SeedSequence(0))
    found = run_camera(scene, system, light, "lmmse", range(_POOL), CAMERA_METRICS)
    images = np.array(found.results)
    for kind in ("noise", "blur", "gain"):
        worse = _scored(planted(images, found.truth, kind, _LOSS_DB), found.truth)
        for paired in (True, False):
            yield from _share(f"{_LOSS_DB} dB planted as {kind}", found.figures, worse, paired)
    yield from _share("false alarms: same method", found.figures, found.figures, False)
    first, second = (
        _scored(planted(images, found.truth, "noise", _LOSS_DB, seed), found.truth)
        for seed in (1, 2)
    )
    yield from _share("false alarms: method with draws of its own", first, second, True)
    edge = _worse_by_the_tolerance(found.figures)
    yield from _share("false alarms: loss of just the tolerances", found.figures, edge, False)
    yield "planted losses: the whole study", time.perf_counter() - start, "s"
    yield (
        "regression test: 48 seeds measured, reconstructed, scored, compared",
        timed(
            lambda: compare(
                CAMERA_METRICS,
                {name: values[:_SEEDS] for name, values in found.figures.items()},
                run_camera(scene, system, light, "lmmse", range(_SEEDS), CAMERA_METRICS).figures,
            )
        ),
        "",
    )


def _share(name: str, before: Figures, after: Figures, paired: bool) -> Iterator[Figure]:
    """Share of comparisons that say worse, and its bound at 95 % confidence on the bad side."""
    rng = np.random.default_rng(0)
    share = share_worse(
        CAMERA_METRICS, before, after, seeds=_SEEDS, paired=paired, repetitions=_TIMES, rng=rng
    )
    interval = binomtest(round(share * _TIMES), _TIMES).proportion_ci(0.9)
    bound = interval.high if "false" in name else interval.low
    draws = "same draws" if paired else "other draws"
    yield f"{name}, {draws}: found worse", 100 * share, f"% (bound {100 * bound:.3g} %)"


def _scored(images: NDArray[np.float64], truth: NDArray[np.float64]) -> Figures:
    return {m.name: np.array([m.of(truth, image) for image in images]) for m in CAMERA_METRICS}


def _worse_by_the_tolerance(figures: Figures) -> Figures:
    """Figures with a mean loss at the very edge of what is allowed: the hardest case."""
    return {
        m.name: figures[m.name]
        + (-1 if m.higher_is_better else 1)
        * m.tolerance
        * (figures[m.name].mean() if m.relative else 1)
        for m in CAMERA_METRICS
    }


def _small(system: System, side: int = 32) -> System:
    size = Sourced(value=side, assumed="small, so that thousands of frames are quick")
    count = Sourced(value=side * side, assumed="the full set")
    emitter = system.emitter.model_copy(update={"rows": size, "columns": size})
    acquisition = system.acquisition.model_copy(update={"n_patterns": count})
    return system.model_copy(update={"emitter": emitter, "acquisition": acquisition})
