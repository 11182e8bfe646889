"""Numbers of a sweep's points on disk: a file for each column, and one of their checksums."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from twin.files import InputError
from twin.sweep.checksums import checksums_of_points

_Mapped = np.memmap[Any, np.dtype[Any]]


class PointNumbers:
    """Numbers of ``n`` points by column, in files of a folder that `reserve` made.

    ``has_checksums``: a folder of an older version has none. Raises InputError for a file that is
    missing or of another size.
    """

    def __init__(
        self, folder: Path, columns: Iterable[str], n: int, *, has_checksums: bool
    ) -> None:
        self.arrays = {name: _open(_file(folder, name), n, np.float64) for name in columns}
        self._checksums = _open(_checksum_file(folder), n, np.uint32) if has_checksums else None

    def write(self, points: NDArray[np.intp], values: Mapping[str, NDArray[np.float64]]) -> None:
        """Numbers of some points, by column."""
        for name, array in self.arrays.items():
            array[points] = values[name]
            array.flush()
        if self._checksums is not None:
            written = {name: values[name] for name in self.arrays}
            self._checksums[points] = checksums_of_points(written)
            self._checksums.flush()

    def differ(self) -> NDArray[np.bool_]:
        """Of each point, whether its numbers are others than were written, or none were yet."""
        if self._checksums is None:
            return np.zeros(len(next(iter(self.arrays.values()))), np.bool_)
        return checksums_of_points(self.arrays) != self._checksums


def reserve(folder: Path, columns: Iterable[str], n: int) -> None:
    """Files for the numbers of ``n`` points, room for all of them taken at once: a full disk is
    found now.
    """
    folder.mkdir()
    for name in columns:
        _reserve(_file(folder, name), n, np.float64(np.nan))
    _reserve(_checksum_file(folder), n, np.uint32(0))


def _file(folder: Path, metric: str) -> Path:
    return folder / f"{metric.replace(':', '.')}.npy"


def _checksum_file(folder: Path) -> Path:
    return folder / "checksums.npy"


def _reserve(path: Path, n: int, begun: np.generic) -> None:
    array = open_memmap(path, mode="w+", dtype=begun.dtype, shape=(n,))
    with path.open("r+b") as file:
        os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
    for start in range(0, n, 2**20):
        array[start : start + 2**20] = begun
    array.flush()


def _open(path: Path, n: int, dtype: type[np.generic]) -> _Mapped:
    """One number per point, as `_reserve` made it; InputError for anything else.

    A file cut short is no array to go on with: where it is mapped for writing it grows again, and
    its end reads as zeros.
    """
    expected = f"{np.dtype(dtype)} {(n,)}"
    try:
        begun = np.load(path, mmap_mode="r")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except (ValueError, EOFError, TokenError) as error:
        fault = str(error)
    else:
        is_whole = begun.shape == (n,) and begun.dtype == dtype
        fault = "" if is_whole else f"{begun.dtype} {begun.shape}, expected {expected}"
    if fault:
        raise InputError(
            f"{path}: is damaged ({fault}): expected the numbers of {n} points; begin the sweep "
            "anew in another folder (--out)"
        )
    return open_memmap(path, mode="r+")
