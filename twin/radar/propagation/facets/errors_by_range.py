"""Where along the range the errors are that a solver accepts: squared errors by body and range."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Of keys: number of a body times this, and the number of a bin of the range.
_BINS = 2**32


@dataclass(frozen=True, eq=False)
class ErrorsByRange:
    """Squared errors of bodies' echoes, taken as independent, in bins of the path's length.

    ``bin_m``: width of a bin of the length out and back, m. ``key`` (n,), sorted: body and bin;
    ``square`` (n,): the squared error in each.
    """

    bin_m: float
    key: NDArray[np.int64]
    square: Array

    @staticmethod
    def none(bin_m: float) -> "ErrorsByRange":
        """Nothing yet."""
        return ErrorsByRange(bin_m, np.zeros(0, dtype=np.int64), np.zeros(0))

    @staticmethod
    def key_of(body: NDArray[np.integer], number: NDArray[np.integer]) -> NDArray[np.int64]:
        """Keys of bodies and numbers of their bins, (n,) each."""
        return np.asarray(body.astype(np.int64) * _BINS + number)

    @property
    def body(self) -> NDArray[np.int64]:
        """Of each, (n,)."""
        return self.key // _BINS

    @property
    def length_m(self) -> Array:
        """Middle of each bin, (n,)."""
        return np.asarray((self.key % _BINS + 0.5) * self.bin_m)

    def plus(self, body: NDArray[np.integer], length_m: Array, square: Array) -> "ErrorsByRange":
        """With those of more echoes, (n,) each."""
        some = np.flatnonzero(square)
        number = np.floor(length_m[some] / self.bin_m).astype(np.int64)
        return self._summed(self.key_of(body[some], number), square[some])

    def and_of(self, other: "ErrorsByRange") -> "ErrorsByRange":
        """With those of another, of equal bins."""
        return self._summed(other.key, other.square)

    def of(self, bodies: NDArray[np.bool_]) -> "ErrorsByRange":
        """Of some bodies only, (n_bodies,)."""
        some = bodies[self.body]
        return ErrorsByRange(self.bin_m, self.key[some], self.square[some])

    def times(self, factor: float) -> "ErrorsByRange":
        """With all amplitudes times a factor."""
        return ErrorsByRange(self.bin_m, self.key, factor**2 * self.square)

    def renumbered(self, pairs: NDArray[np.integer], factor: Array) -> "ErrorsByRange":
        """Of bodies by new numbers: ``pairs`` (n_pairs, 2) of the new and the old number of each,
        times a ``factor`` of each old one, (n_old,).
        """
        found = ErrorsByRange.none(self.bin_m)
        for new, old in pairs.tolist():
            some = self.body == old
            key = self.key[some] + (new - old) * _BINS
            found = found._summed(key, factor[old] * self.square[some])
        return found

    def _summed(self, key: NDArray[np.int64], square: Array) -> "ErrorsByRange":
        keys, number = np.unique(np.concatenate([self.key, key]), return_inverse=True)
        squares = np.concatenate([self.square, square])
        sums: Array = np.bincount(number, squares, len(keys)).astype(np.float64)
        return ErrorsByRange(self.bin_m, keys, sums)
