"""Helpers beside the tests can be imported, wherever pytest is started; which tests run where.

What the vehicle does without is named by the mark ``library``, never by `importorskip`: the other
tests here carry the mark ``vehicle``, and `make test` runs those in the vehicle's environment only.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from hardware import compiled

_HERE = Path(__file__).parent

sys.path.insert(0, str(_HERE))


@pytest.hookimpl(tryfirst=True)  # before marks are selected by
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if not item.path.is_relative_to(_HERE):
            continue
        libraries = [name for mark in item.iter_markers("library") for name in mark.args]
        if not libraries:
            item.add_marker(pytest.mark.vehicle)
        for name in libraries:
            missing = find_spec(name) is None
            item.add_marker(pytest.mark.skipif(missing, reason=f"{name} is not installed"))


@pytest.fixture(params=[pytest.param("compiled", marks=pytest.mark.library("numba")), "NumPy"])
def path(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both paths of everything that has a compiled one."""
    if request.param == "NumPy":
        monkeypatch.setattr(compiled, "available", lambda: False)
