"""What every set of patterns tells, Hadamard's or a user's own."""

from abc import ABC, abstractmethod
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, is_whole

Mode = Literal["differential", "plain", "reference", "s-matrix", "complementary"]

#: Of a virtual image: a file or a device that claims more is not believed.
MOST_CELLS = 2**26


def check_grid(rows: int, columns: int) -> None:
    """Raise InputError unless both are powers of two, of no more cells than are believed."""
    for name, size in (("rows", rows), ("columns", columns)):
        if not is_whole(size) or size < 1 or size & (size - 1):
            raise InputError(f"{name}: {size!r:.60} is not a power of two")
    if rows * columns > MOST_CELLS:
        raise InputError(f"rows, columns: {rows} x {columns} cells, at most {MOST_CELLS} are known")


class Patterns(ABC):
    """A set of patterns on a virtual image of ``rows x columns`` cells, flattened row by row.

    ``count`` of them are shown; ``mode`` says how, see `PatternSet`; ``order`` names which, or is
    ``own``.
    """

    rows: int
    columns: int
    count: int
    mode: Mode
    order: str

    @property
    def n_cells(self) -> int:
        """Cells of the virtual image."""
        return self.rows * self.columns

    @property
    def n_exposures(self) -> int:
        """Patterns shown one after another: each and its complement when differential."""
        if self.mode == "differential":
            return 2 * self.count
        return self.count + (2 if self.mode == "reference" else 0)

    @property
    def n_arms(self) -> int:
        """Detectors that see one image at the same time: two when complementary."""
        return 2 if self.mode == "complementary" else 1

    @property
    @abstractmethod
    def unmeasured_cells(self) -> NDArray[np.bool_]:
        """Cells of which the exposures tell nothing, ``(n_cells,)``."""

    @property
    @abstractmethod
    def common_cells(self) -> NDArray[np.bool_]:
        """Cells on which all patterns agree, ``(n_cells,)``: their light is one constant in all
        exposures, as the background is.
        """

    @property
    @abstractmethod
    def digest(self) -> str:
        """SHA-256 of what name and parameters do not say; empty where they say it all."""

    @abstractmethod
    def take(self, places: NDArray[np.bool_]) -> Self:
        """The patterns at these places, ``(count,)``, in the order shown."""

    @abstractmethod
    def signal(self, cells: NDArray[np.floating]) -> NDArray[np.float64]:
        """Sum of the lit cells for every exposure.

        Parameters
        ----------
        cells : (n_cells, ...) array
            What each cell contributes when lit; any unit.

        Returns
        -------
        (n_exposures, ...) array of the same unit. Complementary: (n_exposures, 2 n_detectors), the
        arms that see the complements last.
        """

    @abstractmethod
    def masks(self, exposures: slice = slice(None)) -> NDArray[np.uint8]:
        """Patterns as shown, 1 lit and 0 dark, shape ``(n, rows, columns)``."""
