"""The camera's light of the yard at rest on the processor and, where there is a GPU that Dr.Jit can
use, on it: time, and how far the two are apart.
"""

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure, Timing, timed
from twin.camera.light import render
from twin.fidelity import DEFAULT, PRESETS
from twin.scene import load_scene
from twin.system import load_system

_MANY_PATHS = replace(
    PRESETS["reference"], samples=64**2, indirect_samples=64**2, light_tolerance=None
)
_LEVELS = {**PRESETS, "default": DEFAULT, "64 x 64 paths a cell": _MANY_PATHS}
_NAMES = {"llvm_ad_mono": "processor", "cuda_ad_mono": "GPU"}

Array = NDArray[np.float64]


def figures() -> Iterator[Figure]:
    """64 x 64 cells of `workable`: wall time of all cores, each variant in a process of its own."""
    has_gpu = Path("/dev/nvidiactl").exists()
    cells: dict[str, dict[str, Array]] = {}
    for variant in ("llvm_ad_mono", "cuda_ad_mono")[: 1 + has_gpu]:
        with ProcessPoolExecutor(1, get_context("spawn")) as own:
            cells[variant] = {}
            for level in _LEVELS:
                first_s, warm, cells[variant][level] = own.submit(_light, variant, level).result()
                name = f"light at rest, {level}, {_NAMES[variant]}"
                yield f"{name}, first", first_s, "s"
                yield name, warm, "s"
    for level in _LEVELS if has_gpu else ():
        one, other = (cells[variant][level] for variant in _NAMES)
        apart = np.sqrt(np.mean((one - other) ** 2) / np.mean(one**2))
        yield f"light at rest, {level}: GPU beside processor, rms", float(apart), "of the light"


def _light(variant: str, level: str) -> tuple[float, Timing, Array]:
    """Time of the first one, of later ones, and the cells."""
    os.environ["TWIN_VARIANT"] = variant
    scene, system = load_scene("yard"), load_system("workable")
    fidelity = replace(_LEVELS[level], motion_tolerance=None)

    def light() -> Array:
        seed = np.random.SeedSequence(0)
        return np.asarray(render(scene, system, fidelity=fidelity, seed=seed).light.cells)

    before = time.perf_counter()
    cells = light()
    first_s = time.perf_counter() - before
    return first_s, timed(light, runs=5, warm_up=0), cells
