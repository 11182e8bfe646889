"""The file behind every record: HDF5 with a format name and a schema version."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike


class Flag(IntFlag):
    """What may be wrong with one exposure or slot; one that is lost never arrived, and its counts
    are none.
    """

    SATURATED = 1
    OVERRUN = 2
    RESET = 4
    LOST = 8


@dataclass(frozen=True)
class Layout:
    """What a record's file holds: its name, version, settings, arrays and one group of parameters.

    ``arrays`` maps a name to its type on disk and its meaning. ``added`` names the version since
    which an array or a setting is there; older files are read without it. ``optional`` parameters
    are lists of integers that stand in the file only where they are set.
    """

    format: str
    version: int
    settings: tuple[str, ...]
    arrays: Mapping[str, tuple[DTypeLike, str]]
    group: str
    parameters: tuple[str, ...]
    added: Mapping[str, int] = field(default_factory=dict)
    optional: tuple[str, ...] = ()

    def has(self, name: str, version: int) -> bool:
        """Whether a setting or an array was there already in a schema version."""
        return self.added.get(name, 1) <= version


def write(layout: Layout, record: Any, path: str | Path) -> None:
    """Write a record; an existing file is replaced at the very end, or not at all.

    The same record gives the same bytes.
    """
    import h5py

    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with h5py.File(partial, "w") as file:
            file.attrs["format"] = layout.format
            file.attrs["schema_version"] = layout.version
            for name in layout.settings:
                file.attrs[name] = getattr(record, name)
            group = file.create_group(layout.group)
            for name in layout.parameters:
                group.attrs[name] = getattr(getattr(record, layout.group), name)
            for name in layout.optional:
                if (value := getattr(getattr(record, layout.group), name)) is not None:
                    group.create_dataset(name, data=np.asarray(value, dtype=np.int64))
            for name, (dtype, meaning) in layout.arrays.items():
                data = np.asarray(getattr(record, name), dtype=dtype)
                file.create_dataset(name, data=data).attrs["meaning"] = meaning
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def read(layout: Layout, path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings with arrays, and the group's parameters, of a file in this layout.

    Raises FileNotFoundError, or ValueError for another format, another version, or a broken file.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such record")
    try:
        with h5py.File(path, "r") as file:
            version = _check(layout, file.attrs)
            there = [n for n in layout.settings if layout.has(n, version)]
            fields = {n: _plain(file.attrs[n]) for n in there}
            for name, (dtype, _) in layout.arrays.items():
                if layout.has(name, version):
                    fields[name] = file[name][()].astype(dtype)
            group = file[layout.group]
            parameters = {name: _plain(group.attrs[name]) for name in layout.parameters}
            for name in layout.optional:
                if name in group:
                    parameters[name] = tuple(group[name][()].tolist())
            return fields, parameters
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def check_shapes(record: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise ValueError unless every named array has its shape."""
    for name, shape in shapes.items():
        if getattr(record, name).shape != shape:
            raise ValueError(f"{name}: shape {getattr(record, name).shape}, expected {shape}")


def check_positive(record: Any, *names: str) -> None:
    """Raise ValueError unless every named field is a positive, finite number."""
    for name in names:
        value = getattr(record, name)
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name}: {value} is not a positive number")


def _check(layout: Layout, attributes: Mapping[str, Any]) -> int:
    """The file's schema version, if it can be read."""
    if attributes.get("format") != layout.format:
        raise ValueError(f"not a {layout.format}: its format is {attributes.get('format')!r}")
    version = int(attributes["schema_version"])
    if not 1 <= version <= layout.version:
        raise ValueError(f"schema version {version}, this software reads 1 to {layout.version}")
    return version


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
