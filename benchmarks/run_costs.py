"""Processor time of one `twin run`, by what it is spent on: printed as JSON by
``python -m benchmarks.run_costs SCENE FOLDER``.
"""

import builtins
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

#: Processor time in s: of stages and of what chooses, see `count_choosing`, which is part of them.
spent: dict[str, float] = defaultdict(float)
_CHOOSING, _WAVES, _MOTION = "choosing", "choosing waves", "checking motion"


def count_imports() -> None:
    """Count what the first import of each module takes, wherever it stands."""
    load, within = builtins.__import__, False

    def timed(*args: Any, **options: Any) -> Any:
        nonlocal within
        if within:
            return load(*args, **options)
        within, known, start = True, len(sys.modules), time.process_time()
        try:
            return load(*args, **options)
        finally:
            within = False
            if len(sys.modules) > known:
                spent["imports"] += time.process_time() - start

    builtins.__import__ = timed


@contextmanager
def counted(name: str) -> Iterator[None]:
    """Count what is done inside, less imports."""
    start, imports = time.process_time(), spent["imports"]
    try:
        yield
    finally:
        spent[name] += time.process_time() - start - (spent["imports"] - imports)


def count(owner: Any, function: str, name: str, sign: int = 1) -> None:
    """Count calls of a function of a module or class under a name."""
    inner: Callable[..., Any] = getattr(owner, function)

    @wraps(inner)
    def timed(*args: Any, **options: Any) -> Any:
        start = time.process_time()
        try:
            return inner(*args, **options)
        finally:
            spent[name] += sign * (time.process_time() - start)

    setattr(owner, function, timed)


def count_choosing() -> None:
    """Bounds that decide what is modelled, and the numbers of paths: `choosing`. Apart from these
    `choosing waves`, bounds of the waves round obstacles, by which cells and ways are taken that
    these are followed to, and `checking motion`, echoes of other instants, which tell what one
    leaves out. Of the radar's reflections the bound is a by-product of the rays that are traced for
    them, and is not counted.
    """
    from twin.camera import light_within
    from twin.optics.path_sets import PathSets
    from twin.optics.problem import LightProblem
    from twin.radar.propagation import effects_by_bounds, physical_optics, physical_optics_solver
    from twin.radar.propagation.diffraction import behind_obstacles
    from twin.radar.propagation.interval import instants

    count(light_within, "gather_within", _CHOOSING)
    count(PathSets, "draw", _CHOOSING, sign=-1)
    count(LightProblem, "largest_indirect", _CHOOSING)
    count(physical_optics, "edge_bound", _CHOOSING)
    count(physical_optics_solver, "silent_objects", _CHOOSING)
    for name in ("on_faint_bodies", "on_edges", "on_reflections"):
        count(effects_by_bounds, name, _CHOOSING)
    count(behind_obstacles, "_of_body", _WAVES)
    for name in ("worth_following", "mirrored_ways", "edges_beside", "mirror_borders"):
        count(physical_optics_solver, name, _WAVES)
    count(instants, "largest_change", _MOTION)
    count(instants, "checked", _MOTION)


def costs(scene: str, folder: Path) -> dict[str, float]:
    """Processor time in s of a run in this process, which is new: in all, of imports, and of each
    part of the run without them.
    """
    count_imports()
    with counted("start"):
        import numpy as np

        from hardware.patterns.transform import fwht
        from twin.job import run
        from twin.progress import Stages
        from twin.radar.acquisition import STAGES

        count_choosing()
    before, start = spent["imports"], time.process_time()
    fwht(np.ones(2))  # loads compiled steps, which the first use of the patterns would pay
    spent["imports"] = before + time.process_time() - start
    inner = Stages.stage

    @contextmanager
    def stage(self: Stages, name: str) -> Iterator[None]:
        with counted(_part(name, (*STAGES, "radar processing"))), inner(self, name):
            yield

    Stages.stage = stage  # type: ignore[method-assign]
    run(scene, out=folder)
    spent["all"] = time.process_time()
    parts = sum(spent[name] for name in ("imports", "start", "light", "radar", "report"))
    spent["files and the rest"] = spent["all"] - parts
    return dict(spent)


def _part(stage: str, of_radar: tuple[str, ...]) -> str:
    if stage == "charts":
        return "report"
    return "radar" if stage in of_radar else "light"


if __name__ == "__main__":
    print(json.dumps(costs(sys.argv[1], Path(sys.argv[2]))))
