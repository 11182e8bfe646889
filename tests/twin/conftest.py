"""Helpers beside the tests can be imported, wherever pytest is started."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def world():
    from virtual_camera import quick_world

    return quick_world()
