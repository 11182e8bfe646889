"""What a radar frame may cost: no kernel twice, memory that is bounded."""

import subprocess
import sys
from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from tests.physics.radar_worlds import RADAR, ball, ground, plate, trihedral, world
from twin.engine import mitsuba
from twin.fidelity import Fidelity
from twin.radar.propagation.solvers import trace
from twin.scene import Scene


def shifted(scene: Scene, metres: float) -> Scene:
    """One object moved, by a distance that no earlier frame had."""
    first, *others = scene.objects
    moved = first.moved([metres, 0.0, 0.0])
    return replace(scene, objects=(moved, *others))


@pytest.mark.thorough
@pytest.mark.parametrize("rung", ["optics", "rough"])
def test_a_moved_object_compiles_nothing(rung: str) -> None:
    mitsuba()
    scene = world(
        ball("moves", (12, 1, 0), level=4),
        plate("back", (20, 0, 0), side=1.0),
        trihedral("corner", (30, -2, 0)),
        ground(-1.0, "asphalt"),
    )
    fidelity = Fidelity(radar=rung, radar_tolerance=0.3)
    for step in range(3):
        trace(shifted(scene, 0.01 * step), RADAR, fidelity=fidelity)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for step in range(5):
            trace(shifted(scene, 0.3 + 0.173 * step), RADAR, fidelity=fidelity)
        history = dr.kernel_history()
    kernels = [entry for entry in history if "cache_hit" in entry]
    assert len(kernels) > 50
    assert all(entry["cache_hit"] for entry in kernels)


MILLION = """
import resource
import numpy as np
from tests.physics.radar_worlds import OPTICS, RADAR, ball, cross_section_db, wave, world
from twin.radar.propagation.solvers import trace
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
small = trace(world(ball("b", (5.0, 0, 0), level=6)), RADAR, fidelity=OPTICS)
scene = world(ball("b", (5.0, 0, 0), level=8))
start = peak()
found = trace(scene, RADAR, fidelity=OPTICS)
print(len(scene.objects[0].geometry.faces), start, peak())
print(*(cross_section_db(wave(f.echoes), 5.0) for f in (small, found)))
"""


@pytest.mark.slow
def test_a_million_triangles_in_a_scene_in_bounded_memory() -> None:
    """1.3 million: at most 2 GB beyond what the mesh itself took, and the ball's cross-section by
    geometrical optics of the near field, pi a^2 (R / (R - a))^2.
    """
    asked = subprocess.run(
        [sys.executable, "-c", MILLION], check=True, capture_output=True, text=True
    )
    size, levels = asked.stdout.splitlines()
    faces, before, after = (int(part) for part in size.split())
    assert faces == 1310720
    assert (after - before) * 1024 < 2e9
    for level in levels.split():
        assert float(level) == pytest.approx(10 * np.log10(np.pi * (0.15 * 5 / 4.85) ** 2), abs=0.1)
