"""Examples in docstrings are right, and every public name is where its package's stub says."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import hardware
import twin
import twin.regression

_ROOT = Path(twin.__file__).parent
_PACKAGES = (hardware, twin, twin.regression)


def _with_examples() -> list[str]:
    found = (path for path in _ROOT.rglob("*.py") if ">>> " in path.read_text("utf-8"))
    names = (".".join(("twin", *p.relative_to(_ROOT).with_suffix("").parts)) for p in found)
    return sorted(name.removesuffix(".__init__") for name in names)


@pytest.mark.parametrize("name", _with_examples())
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # some write a folder
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.parametrize("package", _PACKAGES)
def test_public_names_are_where_the_stub_says(package: object) -> None:
    names = package.__all__  # type: ignore[attr-defined]
    assert set(names) <= set(dir(package))
    for name in names:
        found = getattr(package, name)
        assert getattr(found, "__doc__", None), f"{name} says nothing of itself"
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        package.nothing  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("package", ["hardware", "twin"])
def test_a_package_loads_nothing_before_it_is_used(package: str) -> None:
    """Not even NumPy: `twin --help` and `ugv --help` wait for nothing."""
    code = f"import sys, {package}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "h5py", "pydantic", "mitsuba", "typer"}
    assert not heavy & set(done.stdout.split())
    typed = Path(sys.modules[package].__file__ or "").with_name("py.typed")
    assert typed.is_file()
