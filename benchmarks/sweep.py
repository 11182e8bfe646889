"""Figures of sweeps: points per second, renders shared, what a second worker brings, and what a
tolerance costs and leaves of an error.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure
from twin.camera import capture
from twin.fidelity import Fidelity
from twin.sweep import Study, load_study, open_sweep, run_sweep
from twin.sweep.evaluate import evaluate_chunk, outcome_of
from twin.sweep.front import designs_on_front
from twin.sweep.inputs import inputs_of

_CLOSED = """
model = "closed-form"
metrics = ["snr", "minimum_time_s", "maximum_distance_m"]
[sample]
method = "latin-hypercube"
n = {n}
[sample.ranges]
"link.distance_m" = {{ low = 1.0, high = 100.0, log = true }}
"system.optics.f_number" = {{ low = 1.0, high = 4.0 }}
"system.acquisition.integration_time_s" = {{ low = 1e-6, high = 1e-4, log = true }}
"""
_FEW_PATHS = '"fidelity.samples" = 16\n"fidelity.max_depth" = 1'
_RENDERED = """
scene = "table1"
metrics = ["snr_median", "psnr_db", "ssim"]
{front}
[set]
{fidelity}
"system.acquisition.n_patterns" = 1024
[grid]
"system.detector.width_m" = ["150 um", "1 mm", "3 mm"]
"scene.objects.*.reflectance" = [0.2, 0.5, 0.8]
"scene.rig.x_m" = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
"system.sky.illuminance_lx" = [0, 400, 1e3, 1e4, 1e5]
"processing.method" = ["zero-fill", "lmmse"]
"""
#: Sensors at places of the rig: points of one place share their light.
_PLACES = """
scene = "yard"
metrics = ["snr_median", "psnr_db", "ssim"]
{front}
[set]
{fidelity}
"system.acquisition.n_patterns" = 1024
[grid]
"scene.rig.x_m" = {places}
"system.readout.read_noise_e" = [3e3, 1e4, 3e4]
"system.sky.illuminance_lx" = [0, 400, 1e3, 1e4, 1e5]
"processing.method" = ["zero-fill", "lmmse"]
"""
_STEP_M = 0.02
_ACCURACIES = {
    "standard": '"fidelity.preset" = "standard"',
    "tolerance 0.2": '"fidelity.tolerance" = 0.2',
    "tolerance 1": '"fidelity.tolerance" = 1.0',
}
_FRONT = ("snr_median", "psnr_db")
#: 16 times the paths of `reference`, whose own error is not far below a tolerance of 0.2.
_REFERENCE = Fidelity(samples=2**14, max_depth=8)
_EACH_RENDERS = """
scene = "yard"
metrics = ["snr_median"]
[set]
"fidelity.samples" = 256
"system.acquisition.n_patterns" = 1024
[grid]
"scene.rig.x_m" = {places}
"""


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for n in (100_000, 1_000_000):
        yield f"sweep, closed form, {n} points", _run(_CLOSED.format(n=n))[0], "s"
    seconds, renders = _run(_filled(_RENDERED, _FEW_PATHS))
    yield "sweep, 900 rendered points, two workers", seconds, "s"
    yield "sweep, 900 rendered points: renders", float(renders), ""
    yield from accuracy_figures()
    many, few = (_EACH_RENDERS.format(places=[i / 100 for i in range(n)]) for n in (96, 32))
    # A long run less a short one: what starting workers costs drops out. One core for each worker;
    # left alone, a single worker would take both.
    taken = []
    for workers in (1, 2):
        with _cores(workers):
            taken.append(_run(many, workers)[0] - _run(few, workers)[0])
    yield "sweep, 64 points that each render: two workers over one", taken[0] / taken[1], ""


def accuracy_figures() -> Iterator[Figure]:
    """Time of 900 rendered points at `standard` and at a tolerance, with and without a front, and
    errors of their light; those on the front have the errors of the tolerance, others those of
    `tolerance 1`.
    """
    kinds = {
        "table1, 30 renders": _RENDERED,
        "yard, 30 renders": _PLACES.replace("{places}", str(_places(30))),
    }
    for kind, text in kinds.items():
        yield from _times(f"sweep, 900 rendered points, {kind}", text)
    for name, accuracy in _ACCURACIES.items():
        text = _filled(_PLACES.replace("{places}", str(_places(3))), accuracy)
        yield from _errors(name, _study(text))


def _times(kind: str, text: str) -> Iterator[Figure]:
    """Processor and wall time in one process, of the whole command's work; whether the front is
    that of all points as asked for.
    """
    fronts = {}
    runs = [(name, accuracy, False) for name, accuracy in _ACCURACIES.items()]
    for name, accuracy, front in (*runs, ("tolerance 0.2", _ACCURACIES["tolerance 0.2"], True)):
        called = f"{kind}, {name}{', two passes for a front' if front else ''}"
        study = _study(_filled(text, accuracy, front=_FRONT if front else None))
        with tempfile.TemporaryDirectory() as folder:
            evaluate_chunk(study.with_set({**study.set, "seed": 1}), 0, 1)  # kernels are compiled
            processor, wall = time.process_time(), time.perf_counter()
            done = run_sweep(study, out=Path(folder) / "out", workers=0)
            if done.n_failed:
                raise RuntimeError(f"{done.n_failed} points failed")
            yield f"{called}: processor time", time.process_time() - processor, "s"
            yield f"{called}: wall time", time.perf_counter() - wall, "s"
            fronts[called] = designs_on_front(open_sweep(done.out), *_FRONT).rows
            if done.n_coarse is not None:
                yield f"{called}: renders", float(done.renders), ""
                yield f"{called}: points left coarse", float(done.n_coarse), ""
                full = fronts[f"{kind}, {name}"]
                yield f"{called}: designs on the front", float(len(fronts[called])), ""
                same = sum(row in full for row in fronts[called])
                yield f"{called}: of them on that of all points to 0.2", float(same), ""


def _filled(text: str, accuracy: str, front: tuple[str, str] | None = None) -> str:
    """A study of this accuracy, which names a front or none."""
    named = f"front = {list(front)}" if front else ""
    return text.replace("{fidelity}", accuracy).replace("{front}", named)


def _places(n: int) -> list[float]:
    return [round(_STEP_M * i, 3) for i in range(n)]


def _study(text: str) -> Study:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(text)
        return load_study(path)


def _errors(name: str, study: Study) -> Iterator[Figure]:
    """Light of the quietest sensor against the reference's, over the noise of a pixel, root mean
    square: of points, and of differences between neighbouring places.
    """
    inputs, light, stated, reference = inputs_of(study), [], [], []
    for place in range(3):
        outcome = outcome_of(study, place * study.n_points // 3, inputs)
        found, made = outcome.capture, outcome.setup
        noise = found.noise.cells_noise_e(made.system.patterns).reshape(found.cells_e.shape)
        exact = capture(made.scene, made.system, seed=77, fidelity=_REFERENCE)
        light.append(found.cells_e / noise)
        stated.append(found.cells_error_e / noise)
        reference.append(exact.cells_e / noise)
    off = np.array(light) - reference
    kind = f"sweep of the yard, {name}: error over a pixel's noise"
    yield f"{kind}, stated", _rms(np.array(stated)), ""
    yield f"{kind}, against the reference", _rms(off), ""
    yield f"{kind}, of differences of neighbouring places", _rms(np.diff(off, axis=0)), ""


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


@contextmanager
def _cores(n: int) -> Iterator[None]:
    """Processes started here share ``n`` cores."""
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(own)[:n]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, own)


def _run(text: str, workers: int | None = None) -> tuple[float, int]:
    folder = Path(tempfile.mkdtemp())
    try:
        (folder / "study.toml").write_text(text)
        start = time.perf_counter()
        done = run_sweep(folder / "study.toml", out=folder / "out", workers=workers)
        if done.n_failed:
            raise RuntimeError(f"{done.n_failed} points failed")
        return time.perf_counter() - start, done.renders
    finally:
        shutil.rmtree(folder)
