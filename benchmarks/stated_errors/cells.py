"""An image's errors, each cell against its own interval, and all together against what is expected.

A root mean square over many cells is the standard error, not 1.96 of it: perfect standard errors
give 1 for the ratio of both, and 95 of 100 cells within their intervals.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.accuracy.interval import TWO_SIDED_95

Array = NDArray[np.float64]

#: Share of cells that is to be within their intervals, of 95 % each.
AIM = 0.93
#: Standard errors of a truth, beyond which an error is not the truth's.
_SURE = 4.0


@dataclass(frozen=True)
class CellErrors:
    """Cells that were judged, how many of them are within their intervals, the largest error over
    half the width of one; and cells whose truth is known too little. Dark cells are neither.
    """

    judged: int
    within: int
    largest: float
    undecided: int

    @property
    def share(self) -> float:
        """Of the judged cells, those within their intervals."""
        return self.within / self.judged

    def __str__(self) -> str:
        undecided = f", {self.undecided} undecided" if self.undecided else ""
        if not self.judged:
            return f"no cell judged{undecided}"
        return (
            f"{100 * self.share:.1f} % of {self.judged} cells within their own intervals{undecided}"
            f", largest error {self.largest:.2f} times the stated"
        )


def compared(
    off: Array, error: Array, left_out: Array, truth_error: Array, least: float = 0.0
) -> CellErrors:
    """Cells' errors against their intervals; all arrays (n_cells,). A cell is dark where its error,
    what is stated of it and the truth's own are no more than ``least``.

    An error counts as within where the stated standard error, the truth's own, and the bound of
    what is left out explain it. The truth of a cell is known well enough where it has no larger
    standard error than is stated, or the error is beyond both.
    """
    off = np.abs(off)
    stated = TWO_SIDED_95 * error + left_out
    explained = left_out + TWO_SIDED_95 * np.hypot(error, truth_error)
    is_lit = np.max([off, stated, truth_error], axis=0) > least
    beyond = off > stated + _SURE * truth_error
    is_known = (TWO_SIDED_95 * truth_error <= stated) | beyond
    judged = is_lit & is_known
    with np.errstate(divide="ignore"):
        ratio = off[judged] / explained[judged]
    return CellErrors(
        judged=int(judged.sum()),
        within=int(np.sum(ratio <= 1)),
        largest=float(ratio.max(initial=0.0)),
        undecided=int(np.sum(is_lit & ~is_known)),
    )
