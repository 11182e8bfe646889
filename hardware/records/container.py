"""The file behind every record: HDF5 with a format name and a schema version."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from hardware.files import whole_file

#: Bytes that an array may unpack to, over those that it takes in the file: deflate's limit.
_MOST_RATIO = 1032
_MOST_ATTRIBUTE_BYTES = 1 << 16


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

    # In memory first: where the disk fills up, HDF5 cannot close its file and takes the process
    # with it.
    with h5py.File("record", "w", driver="core", backing_store=False) as file:
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
        file.flush()
        image = file.id.get_file_image()
    with whole_file(path) as partial:
        partial.write_bytes(image)


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
            version = _check(layout, file)
            there = [n for n in layout.settings if layout.has(n, version)]
            fields = {n: _value(file, n) for n in there}
            for name, (dtype, _) in layout.arrays.items():
                if layout.has(name, version):
                    fields[name] = _array(file, name, np.dtype(dtype))
            group = _inside(file, layout.group)
            if not isinstance(group, h5py.Group):
                raise ValueError(f"{layout.group}: expected a group")
            parameters = {name: _value(group, name) for name in layout.parameters}
            for name in layout.optional:
                if name in group:
                    parameters[name] = tuple(_array(group, name, np.dtype(np.int64)).tolist())
            return fields, parameters
    except (KeyError, OSError, RuntimeError, TypeError, ValueError) as error:  # HDF5 has them all
        text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
        raise ValueError(f"{path}: {text}") from error


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


def _check(layout: Layout, file: Any) -> int:
    """The file's schema version, if it can be read."""
    found = _value(file, "format") if "format" in file.attrs else None
    if found != layout.format:
        raise ValueError(f"not a {layout.format}: its format is {found!r:.60}")
    version = _value(file, "schema_version")
    if not isinstance(version, int):
        raise ValueError(f"schema_version: {version!r:.40} is no whole number")
    if not 1 <= version <= layout.version:
        raise ValueError(f"schema version {version}, this software reads 1 to {layout.version}")
    return version


def _inside(group: Any, name: str) -> Any:
    """What stands in the file itself under a name: no link leads out of it."""
    import h5py

    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        raise ValueError(f"{name}: stands in another file, expected it in this one")
    return group[name]


def _array(group: Any, name: str, dtype: "np.dtype[Any]") -> Any:
    """An array of a type, if the file holds it: neither empty promises nor another file's bytes."""
    import h5py

    found = _inside(group, name)
    if not isinstance(found, h5py.Dataset) or not np.can_cast(found.dtype, dtype, "same_kind"):
        kind = getattr(found, "dtype", "a group")
        raise ValueError(f"{name}: {kind}, expected an array of {dtype}")
    if found.is_virtual or found.external:
        raise ValueError(f"{name}: stands in another file, expected it in this one")
    held = min(found.id.get_storage_size(), found.file.id.get_filesize())
    if found.nbytes > _MOST_RATIO * held:
        raise ValueError(
            f"{name}: {found.nbytes} bytes of shape {found.shape}, but the file holds {held}"
        )
    return found[()].astype(dtype)


def _value(group: Any, name: str) -> Any:
    """A single number or text among the attributes. Raises ValueError for anything else."""
    import h5py

    held = h5py.h5a.open(group.id, name.encode())
    if shape := held.get_space().shape:
        raise ValueError(f"{name}: an array of shape {shape}, expected one value")
    # Of other types (sequences, references) a broken file ends the process in HDF5 itself.
    if held.get_type().get_class() not in _plain_types():
        raise ValueError(f"{name}: neither a number nor a text")
    if (size := held.get_storage_size()) > _MOST_ATTRIBUTE_BYTES:
        raise ValueError(
            f"{name}: a text of {size} bytes, at most {_MOST_ATTRIBUTE_BYTES} are read"
        )
    value = group.attrs[name]
    if isinstance(value, bytes | str):
        try:  # h5py gives what is no UTF-8 as surrogates, or as bytes
            text = value if isinstance(value, bytes) else value.encode("utf-8", "surrogateescape")
            return text.decode("utf-8")
        except UnicodeError as error:
            raise ValueError(f"{name}: {error}") from error
    return value.item() if isinstance(value, np.generic) else value


def _plain_types() -> set[int]:
    from h5py import h5t

    return {h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM}
