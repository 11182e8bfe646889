"""A user's own patterns: any stack of images, binary or with grey levels.

Records hold them whole, so that a log explains itself.
"""

from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError
from hardware.patterns.interface import MOST_CELLS, Mode, Patterns
from hardware.patterns.stacks import MOST_VALUES, read_stack
from hardware.read_only import cached_read_only

Array = NDArray[np.float64]
#: Of a fully lit cell.
LIT = 65535


@dataclass(frozen=True, eq=False)
class OwnPatterns(Patterns):
    """Patterns of a user's own; `own_patterns` makes them of arrays and files.

    Parameters
    ----------
    levels : (count, rows, columns) uint16
        Light of each cell, 0 dark to 65535 lit.
    mode
        As of `PatternSet`, but ``s-matrix``, which is of Hadamard rows. The complement of a level
        p is 65535 - p. ``plain``: the background is taken out as the mean of all exposures.
    """

    levels: NDArray[np.uint16]
    mode: Mode = "differential"
    rows: int = field(init=False)
    columns: int = field(init=False)
    count: int = field(init=False)
    order: str = field(init=False, default="own")

    def __post_init__(self) -> None:
        if self.levels.ndim != 3 or self.levels.dtype != np.uint16 or not self.levels.size:
            raise InputError(
                f"patterns: {self.levels.dtype} of shape {self.levels.shape}, expected levels "
                "uint16 (count, rows, columns)"
            )
        if self.mode == "s-matrix" or self.mode not in get_args(Mode):
            expected = ", ".join(mode for mode in get_args(Mode) if mode != "s-matrix")
            raise InputError(f"mode: {self.mode!r}: own patterns are shown {expected}")
        levels = np.ascontiguousarray(self.levels)
        levels.flags.writeable = False
        object.__setattr__(self, "levels", levels)
        for name, size in zip(("count", "rows", "columns"), levels.shape, strict=True):
            object.__setattr__(self, name, size)
        if self.n_cells > MOST_CELLS or self.levels.size > MOST_VALUES:
            raise InputError(
                f"patterns: {self.count} of {self.rows} x {self.columns} cells, at most "
                f"{MOST_VALUES} values are held"
            )

    def __repr__(self) -> str:
        return f"{self.count} own patterns of {self.rows} x {self.columns} ({self.digest[:8]})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OwnPatterns):
            return NotImplemented
        return self is other or (self.mode, self.digest) == (other.mode, other.digest)

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.mode, self.digest))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the levels and their shape."""
        shape = repr(self.levels.shape).encode()
        return sha256(shape + self.levels.astype("<u2", copy=False).tobytes()).hexdigest()

    @cached_property
    def is_binary(self) -> bool:
        """Whether each cell is either lit or dark."""
        return bool(((self.levels == 0) | (self.levels == LIT)).all())

    @cached_read_only
    def lit(self) -> Array:
        """Light of each cell of each pattern, 0 to 1, ``(count, n_cells)``."""
        return self.levels.reshape(self.count, -1) / LIT

    @cached_read_only
    def matrix(self) -> Array:
        """What measurements are of the cells, ``(count, n_cells)``: pattern less complement, -1 to
        +1; of plain sets twice the pattern, less the mean of all patterns.
        """
        if self.mode == "plain":
            return np.asarray(2 * (self.lit - self.lit.mean(axis=0)))
        return 2 * self.lit - 1

    @cached_read_only
    def common_cells(self) -> NDArray[np.bool_]:
        """Cells on which all patterns agree, ``(n_cells,)``."""
        return np.asarray((self.levels == self.levels[0]).all(axis=0).ravel())

    @cached_read_only
    def unmeasured_cells(self) -> NDArray[np.bool_]:
        """Cells of which the exposures tell nothing: of a plain set those on which all patterns
        agree, else those that are half lit in each.
        """
        if self.mode == "plain":
            return self.common_cells
        return np.asarray(~(self.matrix != 0).any(axis=0))

    def take(self, places: NDArray[np.bool_]) -> "OwnPatterns":
        """The patterns at these places, ``(count,)``, in the order shown."""
        return OwnPatterns(self.levels[places], self.mode)

    def first(self, count: int) -> "OwnPatterns":
        """The first so many. Raises InputError where there are fewer."""
        if not 1 <= count <= self.count:
            raise InputError(f"count: {count} is not between 1 and {self.count}")
        return self if count == self.count else OwnPatterns(self.levels[:count], self.mode)

    def signal(self, cells: NDArray[np.floating]) -> Array:
        """See `Patterns.signal`."""
        t = np.asarray(cells, dtype=np.float64)
        if t.shape[0] != self.n_cells:
            raise InputError(f"cells: first axis is {t.shape[0]}, expected {self.n_cells}")
        lit, total = np.tensordot(self.lit, t, 1), t.sum(axis=0)
        if self.mode == "differential":
            return np.stack([lit, total - lit], axis=1).reshape(-1, *t.shape[1:])
        if self.mode == "complementary":
            lit = lit.reshape(self.count, -1)
            return np.hstack([lit, np.ravel(total) - lit])
        if self.mode == "reference":
            return np.concatenate([total[None], np.zeros_like(total)[None], lit])
        return np.asarray(lit)

    def masks(self, exposures: slice = slice(None)) -> NDArray[np.uint8]:
        """Patterns as shown, 1 lit and 0 dark, shape ``(n, rows, columns)``.

        Raises InputError for patterns with grey levels.
        """
        self.check_binary("a mask is lit or dark")
        shown = (self.levels > 0).astype(np.uint8)
        if self.mode == "differential":
            shown = np.stack([shown, 1 - shown], axis=1).reshape(-1, self.rows, self.columns)
        if self.mode == "reference":
            whole = np.ones_like(shown[:1])
            shown = np.concatenate([whole, 1 - whole, shown])
        return shown[exposures]

    def check_binary(self, why: str) -> None:
        """Raise InputError, with the first grey level, unless each cell is lit or dark."""
        if self.is_binary:
            return
        n, row, column = np.argwhere((self.levels > 0) & (self.levels < LIT))[0]
        level = self.levels[n, row, column] / LIT
        raise InputError(
            f"patterns: {why}, but pattern {n} has the grey level {level:.3g} in row {row}, "
            f"column {column}; expected 0 and 1 alone"
        )

    @property
    def packed(self) -> NDArray[np.uint8] | None:
        """Binary patterns with eight cells to a byte, ``(count, bytes)``; None with grey levels."""
        if not self.is_binary:
            return None
        return np.packbits(self.levels.reshape(self.count, -1) > 0, axis=1)

    @property
    def grey_levels(self) -> NDArray[np.uint16] | None:
        """Levels ``(count, n_cells)`` where not all are lit or dark, else None."""
        return None if self.is_binary else self.levels.reshape(self.count, -1)

    @classmethod
    def unpacked(
        cls, packed: NDArray[np.integer], rows: int, columns: int, mode: Mode
    ) -> "OwnPatterns":
        """Patterns from `packed`. Raises InputError for another number of bytes."""
        bytes_each = -(-rows * columns // 8)
        if packed.ndim != 2 or packed.shape[1] != bytes_each:
            raise InputError(
                f"patterns: {packed.shape} bytes, expected (count, {bytes_each}) for "
                f"{rows} x {columns} cells"
            )
        bits = np.unpackbits(packed.astype(np.uint8), axis=1, count=rows * columns)
        return cls((bits.astype(np.uint16) * LIT).reshape(-1, rows, columns), mode)


def own_patterns(
    given: "str | Path | ArrayLike | OwnPatterns",
    mode: Mode = "differential",
    *,
    shape: tuple[int, int] | None = None,
) -> OwnPatterns:
    """Patterns of a user's own.

    Parameters
    ----------
    given : array or file
        ``(count, rows, columns)``, or ``(count, cells)`` with ``shape``: 0 and 1; -1 and +1; grey
        levels 0 to 1 or -1 to +1 as floats; 0 to 255 or 65535 as unsigned integers. A file is
        ``.npy``, ``.npz`` (one array, or one named ``patterns``), an image of several frames such
        as TIFF, or a folder of images, one pattern each, by name.
    mode
        How they are shown, see `OwnPatterns`.
    shape
        Rows and columns, where the array does not say them.

    Grey levels are kept to 16 bits. Raises FileNotFoundError; InputError for anything else.

    >>> rng = np.random.default_rng(0)
    >>> patterns = own_patterns(rng.integers(0, 2, (128, 16, 16)), mode="differential")
    >>> patterns.n_cells, patterns.n_exposures, patterns.is_binary
    (256, 256, True)
    """
    if isinstance(given, OwnPatterns):
        return given if given.mode == mode else OwnPatterns(given.levels, mode)
    named = ""
    if isinstance(given, str | Path):
        named, given = f"{given}: ", read_stack(Path(given))
    try:
        stack = np.asarray(given)
        if stack.ndim == 2 and shape is not None and stack.shape[1] == shape[0] * shape[1]:
            stack = stack.reshape(-1, *shape)
        if stack.ndim != 3 or (shape is not None and stack.shape[1:] != shape):
            expected = f"(count, {shape[0]}, {shape[1]})" if shape else "(count, rows, columns)"
            raise InputError(f"patterns: shape {stack.shape}, expected {expected}")
        return OwnPatterns(_levels(stack), mode)
    except InputError as error:
        raise InputError(f"{named}{error}") from None


def _levels(stack: NDArray[np.generic]) -> NDArray[np.uint16]:
    """Levels of what an array says, by the range of its values."""
    kind = stack.dtype.kind
    if kind not in "biuf" or not stack.size:
        raise InputError(f"patterns: {stack.dtype} of shape {stack.shape}, expected numbers")
    values = stack.astype(np.float64)
    least, most = values.min(), values.max()
    if not np.isfinite(values).all():
        raise InputError("patterns: contain NaN or infinity")
    if (np.abs(values) == 1).all() or (kind == "f" and -1 <= least < 0 and most <= 1):
        share = (values + 1) / 2
    elif least >= 0 and most <= 1:
        share = values
    elif kind == "u" and stack.dtype.itemsize <= 2:
        share = values / (2 ** (8 * stack.dtype.itemsize) - 1)
    else:
        raise InputError(
            f"patterns: {stack.dtype} from {least:g} to {most:g}, expected 0 and 1, -1 and +1, "
            "levels 0 to 1 or -1 to +1, or unsigned integers of 8 or 16 bits"
        )
    return np.rint(share * LIT).astype(np.uint16)
