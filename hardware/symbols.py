"""Symbols of a user's own on the subcarriers of a waveform."""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError
from hardware.files import read_array

#: By which a modulus may differ from 1: that of single precision.
_MODULUS = 1e-6


@dataclass(frozen=True, eq=False)
class OwnSymbols:
    """One symbol per subcarrier, ascending in frequency, of modulus 1: division by it then changes
    no subcarrier's noise.

    Parameters
    ----------
    values : (n_subcarriers,) complex, or (n_subcarriers, 2)
        Real and imaginary parts.
    """

    values: NDArray[np.complex128]

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        if values.ndim == 2 and values.shape[1] == 2 and values.dtype.kind in "fi":
            values = values[:, 0] + 1j * values[:, 1]
        if values.ndim != 1 or not values.size or values.dtype.kind not in "fic":
            raise InputError(
                f"symbols: {values.dtype} of shape {values.shape}, expected complex numbers "
                "(n_subcarriers,)"
            )
        exact = values.astype(np.complex128)
        off = np.abs(np.abs(exact) - 1)
        if not (off <= _MODULUS).all():
            at = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
            raise InputError(
                f"symbols: subcarrier {at} has the modulus {abs(exact[at]):.6g}, expected 1 of all"
            )
        exact.flags.writeable = False
        object.__setattr__(self, "values", exact)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OwnSymbols):
            return NotImplemented
        return self is other or self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"{self.values.size} own symbols ({self.digest[:8]})"

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the values."""
        return sha256(self.values.astype("<c16", copy=False).tobytes()).hexdigest()

    @property
    def pairs(self) -> NDArray[np.float64]:
        """Real and imaginary parts, (n_subcarriers, 2)."""
        return self.values.view(np.float64).reshape(-1, 2)


def own_symbols(given: "str | Path | ArrayLike | OwnSymbols") -> OwnSymbols:
    """Symbols of an array or of a ``.npy`` file. Raises FileNotFoundError; InputError for what are
    none.
    """
    if isinstance(given, OwnSymbols):
        return given
    if not isinstance(given, str | Path):
        return OwnSymbols(np.asarray(given))
    if not Path(given).is_file():
        raise FileNotFoundError(f"{given}: no such file of symbols")
    array = read_array(given)
    try:
        return OwnSymbols(array)
    except ValueError as error:
        raise InputError(f"{given}: {error}") from error
