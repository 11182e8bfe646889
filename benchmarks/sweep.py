"""Figures of sweeps: points per second, renders shared, what a second worker brings."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.timing import Figure
from twin.sweep import run_sweep

_CLOSED = """
model = "closed-form"
metrics = ["snr", "minimum_time_s", "maximum_distance_m"]
[sample]
method = "latin-hypercube"
n = {n}
[sample.ranges]
"link.distance_m" = {{ low = 1.0, high = 100.0, log = true }}
"system.optics.f_number" = {{ low = 1.0, high = 4.0 }}
"system.acquisition.integration_time_s" = {{ low = 1e-6, high = 1e-2, log = true }}
"""
_RENDERED = """
scene = "table1"
metrics = ["snr_median", "psnr_db", "ssim"]
[set]
"fidelity.samples" = 16
"fidelity.max_depth" = 1
"system.acquisition.n_patterns" = 1024
[grid]
"system.detector.width_m" = ["150 um", "1 mm", "3 mm"]
"scene.objects.*.reflectance" = [0.2, 0.5, 0.8]
"scene.rig.x_m" = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
"system.sky.illuminance_lx" = [0, 400, 1e3, 1e4, 1e5]
"processing.method" = ["zero-fill", "lmmse"]
"""
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
    seconds, renders = _run(_RENDERED)
    yield "sweep, 900 rendered points, two workers", seconds, "s"
    yield "sweep, 900 rendered points: renders", float(renders), ""
    many, few = (_EACH_RENDERS.format(places=[i / 100 for i in range(n)]) for n in (96, 32))
    # A long run less a short one: what starting workers costs drops out. One core for each worker;
    # left alone, a single worker would take both.
    taken = []
    for workers in (1, 2):
        with _cores(workers):
            taken.append(_run(many, workers)[0] - _run(few, workers)[0])
    yield "sweep, 64 points that each render: two workers over one", taken[0] / taken[1], ""


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
