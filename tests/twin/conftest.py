"""Helpers beside the tests can be imported, wherever pytest is started."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def world():
    from virtual_camera import quick_world

    return quick_world()


@pytest.fixture(scope="session")
def yard(twin_truth):
    """scenes/yard, the system of 32 x 32 cells, and its light."""
    from yard_32x32 import SYSTEM

    from twin.scene import load_scene
    from twin.system import load_system

    scene, system = load_scene("yard"), load_system(SYSTEM)
    return scene, system, twin_truth.light(scene, system)
