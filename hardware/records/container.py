"""The file behind every record: HDF5 with a format name and a schema version.

Arrays have checksums (Fletcher-32), and so has all else, as the format of HDF5 1.10 has it: a bit
that has flipped is an error, not another count. Texts have a fixed length for it, in UTF-8: those
of variable length stand in a heap that has none.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hardware.errors import InputError
from hardware.files import whole_file
from hardware.records.global_heap import has_endless_heap

#: Bytes that an array may unpack to, over those that it takes in the file: deflate's limit.
_MOST_RATIO = 1032
#: The same of arrays that are written as they are, and the bytes that such a one may unpack to in
#: any case: whoever compresses them may read them again.
_MOST_RATIO_OF_PLAIN, _ANY_BYTES = 16, 1 << 26
_MOST_ATTRIBUTE_BYTES = 1 << 16
#: Bytes of an array with one checksum; HDF5 checks none of an array in one piece.
_CHUNK_BYTES = 1 << 20
#: Oldest format of HDF5 that has checksums of attributes, and of arrays without 2 kB for each.
_HDF5_FORMAT = "v110"
_NUMBER = int | float | np.integer | np.floating


class Flag(IntFlag):
    """What may be wrong with one exposure or slot; one that is lost never arrived, and its counts
    are none.
    """

    SATURATED = 1
    OVERRUN = 2
    RESET = 4
    LOST = 8


def unknown_flags(flags: NDArray[np.uint8], of: str) -> list[str]:
    """A warning of bits that are none of `Flag`, in the flags of exposures or slots (``of``)."""
    unknown = int(np.bitwise_or.reduce(flags, axis=None)) & ~sum(Flag)
    if not unknown:
        return []
    return [
        f"flags of {np.count_nonzero(flags & unknown)} {of} hold bits of unknown meaning "
        f"({unknown}), which are ignored"
    ]


@dataclass(frozen=True)
class Layout:
    """What a record's file holds: its name, version, settings, arrays and one group of parameters.

    ``arrays`` maps a name to its type on disk and its meaning. ``added`` names the version since
    which an array or a setting is there; older files are read without it. ``optional`` parameters
    are lists of integers that stand in the file only where they are set. ``parts`` maps a field of
    the record to its class, whose own fields stand in the file beside those of the record;
    ``objects`` maps a field to what makes it of its array. ``group_arrays`` maps an array of the
    group that stands in the file only where it is set to its type; ``make_group`` makes the group
    of its parameters and arrays.
    """

    format: str
    version: int
    settings: tuple[str, ...]
    arrays: Mapping[str, tuple[DTypeLike, str]]
    group: str
    parameters: tuple[str, ...]
    added: Mapping[str, int] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    group_arrays: Mapping[str, DTypeLike] = field(default_factory=dict)
    make_group: Callable[..., Any] = dict
    parts: Mapping[str, type[Any]] = field(default_factory=dict)
    objects: Mapping[str, Callable[[Any], Any]] = field(default_factory=dict)

    def value(self, record: Any, name: str) -> Any:
        """A setting or an array of a record."""
        for part, kind in self.parts.items():
            if name in {own.name for own in fields(kind)}:
                return getattr(getattr(record, part), name)
        return getattr(record, name)

    def parameter(self, record: Any, name: str) -> Any:
        """A parameter or an array of the group; None: it has none of that name."""
        return getattr(getattr(record, self.group), name, None)

    def arguments(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of the record's class, of settings and arrays by their names in the file."""
        made = dict(values)
        for part, kind in self.parts.items():
            own = [field.name for field in fields(kind) if field.name in made]
            made[part] = kind(**{name: made.pop(name) for name in own})
        for name in self.objects.keys() & made.keys():
            try:
                made[name] = self.objects[name](made[name])
            except (TypeError, ValueError) as error:
                raise InputError(f"{name}: {error}") from error
        return made

    def has(self, name: str, version: int) -> bool:
        """Whether a setting or an array was there already in a schema version."""
        return self.added.get(name, 1) <= version


def write(layout: Layout, record: Any, path: str | Path) -> None:
    """Write a record; an existing file is replaced at the very end, or not at all.

    The same record gives the same bytes. Raises InputError for a path in the record's place.
    """
    import h5py

    if isinstance(record, str | Path):
        raise InputError(f"record: {str(record)!r:.60}, expected a record, and its path after it")

    # In memory first: where the disk fills up, HDF5 cannot close its file and takes the process
    # with it.
    how = {"driver": "core", "backing_store": False, "libver": (_HDF5_FORMAT, _HDF5_FORMAT)}
    with h5py.File("record", "w", **how) as file:
        file.attrs["format"] = _fixed(layout.format)
        file.attrs["schema_version"] = layout.version
        for name in layout.settings:
            file.attrs[name] = _fixed(layout.value(record, name))
        group = file.create_group(layout.group)
        for name in layout.parameters:
            group.attrs[name] = _fixed(layout.parameter(record, name))
        for name in layout.optional:
            if (value := layout.parameter(record, name)) is not None:
                _create(group, name, np.asarray(value, dtype=np.int64))
        for name, dtype in layout.group_arrays.items():
            if (value := layout.parameter(record, name)) is not None:
                data = np.asarray(value, dtype=dtype)
                _create(group, name, data, compression="gzip", shuffle=True)
        for name, (dtype, meaning) in layout.arrays.items():
            data = np.asarray(layout.value(record, name), dtype=dtype)
            _create(file, name, data).attrs["meaning"] = _fixed(meaning)
        file.flush()
        image = file.id.get_file_image()
    with whole_file(path) as partial:
        partial.write_bytes(image)


def _fixed(value: Any) -> Any:
    """A text of fixed length; anything else as it is."""
    import h5py

    if not isinstance(value, str):
        return value
    text = value.encode("utf-8", "surrogateescape")
    return np.array(text, h5py.string_dtype("utf-8", max(1, len(text))))


def _create(group: Any, name: str, data: "np.ndarray[Any, Any]", **filters: Any) -> Any:
    """An array with checksums, in pieces along its first axes."""
    if not data.size:
        return group.create_dataset(name, data=data)
    chunks, inner = list(data.shape), data.nbytes
    for axis, n in enumerate(data.shape):
        inner //= n
        chunks[axis] = min(n, max(1, _CHUNK_BYTES // inner))
        if inner <= _CHUNK_BYTES:
            break
    return group.create_dataset(name, data=data, chunks=tuple(chunks), fletcher32=True, **filters)


def read(layout: Layout, path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings with arrays, and the group's parameters, of a file in this layout.

    Raises FileNotFoundError; another OSError where the file cannot be read; InputError for another
    format, another version, a file that is cut short or damaged.
    """
    import h5py

    if not isinstance(path, str | Path):
        raise InputError(f"path = {path!r:.60}: expected the path of a {layout.format}")
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such record")
    with path.open("rb") as unread:  # HDF5 tells nothing apart here
        if not unread.read(1):
            raise InputError(f"{path}: is empty, expected a {layout.format} (HDF5)")
    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: is no HDF5 file, expected a {layout.format}")
    if has_endless_heap(path):
        raise InputError(f"{path}: is damaged, HDF5 cannot read it: texts of size 0")
    try:
        with h5py.File(path, "r") as file:
            version = _check(layout, file)
            there = [n for n in layout.settings if layout.has(n, version)]
            values = {n: _value(file, n) for n in there}
            for name, (dtype, _) in layout.arrays.items():
                if layout.has(name, version):
                    values[name] = _array(file, name, np.dtype(dtype))
            group = _inside(file, layout.group)
            if not isinstance(group, h5py.Group):
                raise InputError(f"{layout.group}: expected a group")
            here = [n for n in layout.parameters if layout.has(n, version)]
            parameters = {name: _value(group, name) for name in here}
            for name in layout.optional:
                if name in group:
                    parameters[name] = tuple(_array(group, name, np.dtype(np.int64)).tolist())
            for name, dtype in layout.group_arrays.items():
                if name in group:
                    parameters[name] = _array(group, name, np.dtype(dtype), is_packed=True)
            return values, parameters
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (KeyError, OSError, RuntimeError, TypeError, ValueError) as error:  # HDF5 has them all
        raise InputError(f"{path}: {_damage(error)}") from error


def _damage(error: Exception) -> str:
    """What is wrong with a file that HDF5 cannot read, by what it raised."""
    said = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    if cut := re.search(r"truncated file: eof = (\d+),.* stored_eof = (\d+)", said):
        held, whole = cut.groups()
        return f"is cut short: expected {whole} bytes, the file holds {held}"
    if missing := re.search(r"object '(.+)' doesn't exist|locate attribute: '(.+)'", said):
        return f"{missing[1] or missing[2]}: missing from the file"
    return f"is damaged, HDF5 cannot read it: {said}"


def check_shapes(record: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError unless every named array is one and has its shape."""
    check_types(record, **dict.fromkeys(shapes, np.ndarray))
    for name, shape in shapes.items():
        if getattr(record, name).shape != shape:
            raise InputError(f"{name}: shape {getattr(record, name).shape}, expected {shape}")


def check_types(record: Any, **types: type) -> None:
    """Raise InputError unless every named field is of its type."""
    for name, kind in types.items():
        if not isinstance(value := getattr(record, name), kind):
            raise InputError(f"{name}: a {type(value).__name__}, expected a {kind.__name__}")


def check_whole_numbers(record: Any, *names: str) -> None:
    """Raise InputError unless every named array holds integers."""
    for name in names:
        dtype = getattr(record, name).dtype
        if not np.issubdtype(dtype, np.integer):
            raise InputError(f"{name}: dtype {dtype}, expected integers")


def check_within(record: Any, **most: int) -> None:
    """Raise InputError unless every named array holds numbers from 0 to its most."""
    for name, top in most.items():
        values = getattr(record, name)
        if values.size and not (values.min() >= 0 and values.max() <= top):
            raise InputError(f"{name}: {values.min()} to {values.max()}, expected 0 to {top}")


def check_tuples(record: Any, **types: type) -> None:
    """Raise InputError unless every named field is a tuple of values of its type."""
    for name, kind in types.items():
        value = getattr(record, name)
        if type(value) is not tuple or not all(isinstance(one, kind) for one in value):
            raise InputError(
                f"{name}: a {type(value).__name__}, expected a tuple of {kind.__name__}"
            )


def check_positive(record: Any, *names: str) -> None:
    """Raise InputError unless every named field is a positive, finite number."""
    for name in names:
        value = getattr(record, name)
        if not (isinstance(value, _NUMBER) and np.isfinite(value) and value > 0):
            raise InputError(f"{name}: {value} is not a positive number")


def check_between(record: Any, least: float, most: float, *names: str) -> None:
    """Raise InputError unless every named field is a number from ``least`` to ``most``."""
    for name in names:
        value = getattr(record, name)
        if not (isinstance(value, _NUMBER) and least <= value <= most):
            raise InputError(f"{name}: {value!r:.60}, expected a number from {least:g} to {most:g}")


def _check(layout: Layout, file: Any) -> int:
    """The file's schema version, if it can be read."""
    format_name = _value(file, "format") if "format" in file.attrs else None
    if format_name != layout.format:
        raise InputError(f"not a {layout.format}: its format is {format_name!r:.60}")
    version = _value(file, "schema_version")
    if not isinstance(version, int):
        raise InputError(f"schema_version: {version!r:.40} is no whole number")
    if not 1 <= version <= layout.version:
        raise InputError(f"schema version {version}, this software reads 1 to {layout.version}")
    return version


def _inside(group: Any, name: str) -> Any:
    """What stands in the file itself under a name: no link leads out of it."""
    import h5py

    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        raise InputError(f"{name}: stands in another file, expected it in this one")
    return group[name]


def _array(group: Any, name: str, dtype: "np.dtype[Any]", *, is_packed: bool = False) -> Any:
    """An array of a type, if the file holds it: neither empty promises nor another file's bytes.
    ``is_packed``: it is written compressed.
    """
    import h5py

    dataset = _inside(group, name)
    if not isinstance(dataset, h5py.Dataset) or not np.can_cast(dataset.dtype, dtype, "same_kind"):
        kind = getattr(dataset, "dtype", "a group")
        raise InputError(f"{name}: {kind}, expected an array of {dtype}")
    if dataset.is_virtual or dataset.external:
        raise InputError(f"{name}: stands in another file, expected it in this one")
    held = min(dataset.id.get_storage_size(), dataset.file.id.get_filesize())
    most = max(_MOST_RATIO_OF_PLAIN * held, _ANY_BYTES)
    if dataset.nbytes > _MOST_RATIO * held or (dataset.nbytes > most and not is_packed):
        raise InputError(
            f"{name}: {dataset.nbytes} bytes of shape {dataset.shape}, but the file holds {held}"
        )
    values = dataset[()]
    if dtype.kind in "iu" and values.size:  # which else would wrap to other numbers
        least, most, known = int(values.min()), int(values.max()), np.iinfo(dtype)
        if least < known.min or most > known.max:
            raise InputError(
                f"{name}: {least} to {most}, expected {known.min} to {known.max} ({dtype})"
            )
    return values.astype(dtype)


def _value(group: Any, name: str) -> Any:
    """A single number or text among the attributes. Raises InputError for anything else."""
    import h5py

    held = h5py.h5a.open(group.id, name.encode())
    if shape := held.get_space().shape:
        raise InputError(f"{name}: an array of shape {shape}, expected one value")
    # Of other types (sequences, references) a broken file ends the process in HDF5 itself.
    if held.get_type().get_class() not in _plain_types():
        raise InputError(f"{name}: neither a number nor a text")
    if (size := held.get_storage_size()) > _MOST_ATTRIBUTE_BYTES:
        raise InputError(
            f"{name}: a text of {size} bytes, at most {_MOST_ATTRIBUTE_BYTES} are read"
        )
    value = group.attrs[name]
    if isinstance(value, bytes | str):
        try:  # h5py gives what is no UTF-8 as surrogates, or as bytes
            text = value if isinstance(value, bytes) else value.encode("utf-8", "surrogateescape")
            return text.decode("utf-8")
        except UnicodeError as error:
            raise InputError(f"{name}: {error}") from error
    return value.item() if isinstance(value, np.generic) else value


def _plain_types() -> set[int]:
    from h5py import h5t

    return {h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM}
