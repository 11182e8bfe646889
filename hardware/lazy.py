"""Names of a package that are looked up when first used: a command must not wait for what it does
not need.
"""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package; its stub, ``__init__.pyi``, says what it holds:
    lines ``from MODULE import NAME as NAME``. Type checkers read the same stub.
    """
    homes: dict[str, str] = {}

    def names() -> dict[str, str]:
        if not homes:
            homes.update(_homes(package))
        return homes

    def look_up(name: str) -> Any:
        if name == "__all__":
            return sorted(names())
        if name.startswith("__") or name not in names():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(names()[name]), name)

    return look_up, lambda: sorted({*vars(import_module(package)), *names()})


def _homes(package: str) -> dict[str, str]:
    """Module of each name that a package's stub says."""
    import ast

    spec = find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    stub = ast.parse(Path(spec.origin).with_suffix(".pyi").read_text("utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {item.name: str(node.module) for node in imports for item in node.names}
