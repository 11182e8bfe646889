"""Settings of a camera from a TOML file."""

import tomllib
from pathlib import Path
from typing import Any

from hardware.drivers.spi import SpiSettings
from hardware.patterns import PatternSet


def read_settings(path: str | Path) -> SpiSettings:
    """Read a file: the fields of `SpiSettings`, and those of `PatternSet` in a table ``patterns``.

    Raises FileNotFoundError; ValueError naming the file and the field.
    """
    try:
        fields = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        patterns = PatternSet(**_tuples(fields.pop("patterns", {})))
        return SpiSettings(patterns, **_tuples(fields))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {str(error).replace('__init__()', 'it')}") from error


def _tuples(fields: dict[str, Any]) -> dict[str, Any]:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value

    return {name: frozen(value) for name, value in fields.items()}
