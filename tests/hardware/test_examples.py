"""Examples in docstrings are right."""

import doctest
import importlib
from pathlib import Path

import pytest

import hardware

_ROOT = Path(hardware.__file__).parent


def _with_examples(root: Path) -> list[str]:
    """Modules of a package whose docstrings hold examples."""
    return sorted(
        ".".join((root.name, *path.relative_to(root).with_suffix("").parts)).removesuffix(
            ".__init__"
        )
        for path in root.rglob("*.py")
        if ">>> " in path.read_text("utf-8")
    )


@pytest.mark.parametrize("name", _with_examples(_ROOT))
def test_examples(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.attempted > 0
    assert found.failed == 0
