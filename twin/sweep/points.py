"""Numbers of a sweep's points on disk: a file for each column, and one of their checksums.

A file that is missing or damaged as a whole is made anew where points are to be computed; numbers
of its column are then others than their checksums say. Where the checksums themselves are gone, the
numbers stand, unchecked.
"""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from hardware.files import read_array, said
from twin.files import InputError
from twin.sweep.checksums import DamagedError, checksums_of_points

#: Of points that are not computed yet.
_NO_NUMBER, _NO_CHECKSUM = np.float64(np.nan), np.uint32(0)


class PointNumbers:
    """Numbers of ``n`` points by column, in files of a folder that `reserve` made.

    ``has_checksums``: a folder of an older version has none. ``writable``: points are to be
    computed; else no file is written to. ``lost``: files of columns that are missing or damaged as
    a whole, with what is wrong; ``lost_checksums``: the same of the checksums, or empty.
    """

    def __init__(
        self,
        folder: Path,
        columns: Iterable[str],
        n: int,
        *,
        has_checksums: bool,
        writable: bool,
    ) -> None:
        self.lost: list[str] = []
        self.lost_checksums = ""
        self.arrays: dict[str, NDArray[np.float64]] = {}
        self._checksums: NDArray[np.uint32] | None = None
        for name in columns:
            try:
                self.arrays[name] = _open(_file(folder, name), n, np.float64, writable=writable)
            except DamagedError as error:
                self.lost.append(str(error))
                self.arrays[name] = _anew(_file(folder, name), n, _NO_NUMBER, writable=writable)
        self._gone = np.full(n, bool(self.lost))
        if not has_checksums:
            return
        path = _checksum_file(folder)
        try:
            self._checksums = _open(path, n, np.uint32, writable=writable)
        except DamagedError as error:
            self.lost_checksums = str(error)
            if writable:
                self._checksums = _anew(path, n, _NO_CHECKSUM, writable=True)
                if not self.lost:
                    self._checksums[:] = checksums_of_points(self.arrays)

    def write(self, points: NDArray[np.intp], values: Mapping[str, NDArray[np.float64]]) -> None:
        """Numbers of some points, by column."""
        for name, array in self.arrays.items():
            array[points] = values[name]
            _flush(array)
        self._gone[points] = False
        if self._checksums is not None:
            written = {name: values[name] for name in self.arrays}
            self._checksums[points] = checksums_of_points(written)
            _flush(self._checksums)

    def written(self) -> NDArray[np.bool_]:
        """Of each point, whether its checksum was written; of none where there are no checksums."""
        if self._checksums is None or self.lost_checksums:
            return np.zeros(len(self._gone), np.bool_)
        return np.asarray(self._checksums != _NO_CHECKSUM)

    def differ(self) -> NDArray[np.bool_]:
        """Of each point, whether its numbers are others than were written, or none were yet."""
        if self._checksums is None:
            return self._gone.copy()
        return checksums_of_points(self.arrays) != self._checksums


def reserve(folder: Path, columns: Iterable[str], n: int) -> None:
    """Files for the numbers of ``n`` points, room for all of them taken at once: a full disk is
    found now.
    """
    folder.mkdir()
    for name in columns:
        _reserve(_file(folder, name), n, _NO_NUMBER)
    _reserve(_checksum_file(folder), n, _NO_CHECKSUM)


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


def _flush(array: NDArray[Any]) -> None:
    if isinstance(array, np.memmap):
        array.flush()


def _anew(path: Path, n: int, begun: np.generic, *, writable: bool) -> NDArray[Any]:
    """Numbers in place of a file that is lost."""
    if not writable:
        return np.full(n, begun)
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    _reserve(path, n, begun)
    return open_memmap(path, mode="r+")


def _open(path: Path, n: int, dtype: type[np.generic], *, writable: bool) -> NDArray[Any]:
    """One number per point, as `_reserve` made it; DamagedError for anything else.

    A file cut short is no array to go on with: where it is mapped for writing it grows again, and
    its end reads as zeros.
    """
    try:
        begun = read_array(path)
    except FileNotFoundError as error:
        raise DamagedError(f"{path}: is missing") from error
    except OSError as error:
        raise InputError(said(error)) from error
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk's, not the file's
            raise
        told = str(error).removeprefix(f"{path}: ")
        raise DamagedError(f"{path}: is damaged ({told})") from error
    if begun.shape != (n,) or begun.dtype != dtype:
        fault = f"{begun.dtype} {begun.shape}, expected {np.dtype(dtype)} {(n,)}"
        raise DamagedError(f"{path}: is damaged ({fault})")
    return open_memmap(path, mode="r+") if writable else begun
