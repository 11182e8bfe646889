"""Checksums of a sweep's folder: a bit that has flipped is an error, not another result.

Of ``study.json`` and of each line of ``journal.jsonl`` a CRC-32 that stands in it; of the numbers
in ``points`` one of each point; of ``results.zarr`` the SHA-256 of each file in ``results.sha256``,
which ``sha256sum -c`` reads too. The CRC of Zarr's own codecs holds neither names, shapes and units
nor files that are missing, which read as fill values.
"""

import hashlib
import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_KEY = "crc32"


#: A line of the checksums of files.
_SUM = re.compile(r"([0-9a-f]{64})  (\S.*)")


class DamagedError(ValueError):
    """What was read is not what was written."""


class DamagedWarning(UserWarning):
    """What of a sweep's folder is damaged or missing, where the rest can be gone on with."""


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """A table of JSON with its checksum."""
    return {**content, _KEY: _checksum(content)}


def unsealed(content: dict[str, Any], *, needs_seal: bool) -> dict[str, Any]:
    """A table of JSON without its checksum; DamagedError where it is of another content.

    ``needs_seal``: one without a checksum is damaged too, none of an older version.
    """
    held = {key: value for key, value in content.items() if key != _KEY}
    if content.get(_KEY, None if needs_seal else _checksum(held)) != _checksum(held):
        raise DamagedError("its content is not that of its checksum")
    return held


def is_sealed(content: Mapping[str, Any]) -> bool:
    """Whether a table of JSON has a checksum, as all have that are not of an older version."""
    return _KEY in content


def _checksum(content: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(content).encode())


def checksums_of_points(columns: Mapping[str, NDArray[np.float64]]) -> NDArray[np.uint32]:
    """One checksum for each point, of its numbers in all columns."""
    rows = np.stack([np.asarray(column) for column in columns.values()], axis=-1)
    content, width = memoryview(rows.tobytes()), rows.shape[-1] * rows.itemsize
    found = (zlib.crc32(content[i : i + width]) for i in range(0, len(content), width))
    return np.fromiter(found, np.uint32, len(rows))


def sums_file(folder: Path) -> Path:
    """Where the checksums of a folder's files stand."""
    return folder.with_suffix(".sha256")


def write_sums(folder: Path) -> None:
    """Write the checksums of all files of a folder beside it."""
    lines = (f"{_digest(folder.parent / name)}  {name}\n" for name in _files(folder))
    sums_file(folder).write_text("".join(lines), encoding="utf-8")


def fault_in(folder: Path) -> str:
    """The first file of a folder that is not what `write_sums` saw, in words; else empty.

    A line of the checksums that is damaged may hold any name: none of it is told but its number.
    """
    sums = sums_file(folder)
    left = set(_files(folder))
    lines = sums.read_text(encoding="utf-8", errors="replace").split("\n")
    missing = []
    for number, line in enumerate(lines[:-1], 1):
        digest, name = found.groups() if (found := _SUM.fullmatch(line)) else ("", "")
        if name in left:
            left.remove(name)
            if _digest(folder.parent / name) != digest:
                return f"{name}: is damaged, or its checksum in {sums.name}, line {number}, is"
        elif not name.isprintable() or not name.startswith(f"{folder.name}/"):
            return f"{sums.name}: is damaged in line {number}"
        else:
            missing.append((number, name))
    if left and missing:  # by another name
        return f"{sums.name}: is damaged in line {missing[0][0]}"
    if missing:
        return f"{missing[0][1]}: is missing"
    if left or lines[-1]:
        return f"{sums.name}: is damaged: lacks {min(left, default='the end of its last line')}"
    return ""


def _files(folder: Path) -> list[str]:
    """All files of a folder, by their places beside it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return [path.relative_to(folder.parent).as_posix() for path in files]


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
