"""Whole commands, as a user waits for them, and where their time goes."""

import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.timing import Figure, timed, timed_command

#: Parts of a run of which processor time is told.
_PARTS = ("imports", "light", "radar", "report", "files and the rest", "all")


def figures() -> Iterator[Figure]:
    """Start-up, and the main job with everything warm."""
    python = sys.executable
    yield "import hardware", timed_command([python, "-c", "import hardware"]), ""
    yield "twin --help", timed_command([python, "-m", "twin", "--help"]), ""
    with tempfile.TemporaryDirectory() as folder:
        command = [python, "-m", "twin", "run", "yard", "--out", str(Path(folder) / "out")]
        label = "twin run scenes/yard, optics (two systems) and radar, warm"
        yield f"{label}, --anew", timed_command([*command, "--anew"], runs=3), ""
        kept = {**os.environ, "UGV_TWIN_CACHE": str(Path(folder) / "kept")}
        again = timed_command(command, runs=3, environment=kept)  # the first, not timed, keeps all
        yield f"{label}, light and echoes kept by an earlier run", again, ""
        seeds = itertools.count(1)

        def another_light() -> None:
            asked = [*command, "--seed", str(next(seeds))]
            subprocess.run(asked, check=True, capture_output=True, env=kept)

        yield f"{label}, echoes kept, light anew", timed(another_light, runs=3), ""
        yield from run_figures(Path(folder))
    for scene in ("table1", "yard"):
        yield from first_image(scene)


def first_image(scene: str) -> Iterator[Figure]:
    """From the start of `twin run` to one camera's image and report, with an empty cache of
    compiled kernels, which Dr.Jit keeps in the home folder, and then with the one that it left.
    """
    options = ("--radar", "none", "--compare", "none", "--anew", "--out")
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, "-m", "twin", "run", scene, *options, str(Path(home) / "out")]
        for cache in ("an empty", "a filled"):
            begin_s, wall_s = _of_children_s(), time.perf_counter()
            environment = {**os.environ, "HOME": home}
            subprocess.run(command, check=True, capture_output=True, env=environment)
            label = f"twin run {scene}, one camera's image and report, {cache} cache of kernels"
            yield label, time.perf_counter() - wall_s, "s"
            yield f"{label}, processor time", _of_children_s() - begin_s, "s"


def _of_children_s() -> float:
    """Processor time of all processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def run_figures(folder: Path) -> Iterator[Figure]:
    """Where the processor time of `twin run scenes/yard` goes, once kernels are compiled."""
    command = [sys.executable, "-m", "benchmarks.run_costs", "yard", str(folder / "costs")]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    spent = json.loads(done.stdout.splitlines()[-1])
    for name in _PARTS:
        yield f"twin run scenes/yard, processor time: {name}", spent[name], "s"
    for of, whole in (
        ("the run", spent["all"]),
        ("light and radar", spent["light"] + spent["radar"]),
    ):
        for name in ("choosing", "choosing waves", "checking motion"):
            yield f"twin run scenes/yard: {name}, of {of}", 100 * spent[name] / whole, "%"
