"""Checksums of a sweep's folder: a bit that has flipped is an error, not another result.

Of ``study.json`` and of each line of ``journal.jsonl`` a CRC-32 that stands in it; of the numbers
in ``points`` one of each point; of ``results.zarr`` the SHA-256 of each file in ``results.sha256``,
which ``sha256sum -c`` reads too. The CRC of Zarr's own codecs holds neither names, shapes and units
nor files that are missing, which read as fill values.
"""

import hashlib
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_KEY = "crc32"


class DamagedError(ValueError):
    """What was read is not what was written."""


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
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    lines = (f"{_digest(path)}  {path.relative_to(folder.parent).as_posix()}\n" for path in files)
    sums_file(folder).write_text("".join(lines), encoding="utf-8")


def fault_in(folder: Path) -> str:
    """The first file of a folder that is not what `write_sums` saw, in words; else empty."""
    for line in sums_file(folder).read_text(encoding="utf-8", errors="replace").splitlines():
        digest, _, name = line.partition("  ")
        path = folder.parent / name
        if not path.is_file():
            return f"{name}: is missing"
        if _digest(path) != digest:
            return f"{name}: is damaged, not what its checksum in {sums_file(folder).name} says"
    return ""


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
