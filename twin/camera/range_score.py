"""Distances that the vehicle makes of a record, against the true ones."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import si
from hardware.reconstruction.ranging import range_image
from hardware.records.state import ALWAYS_OPEN

if TYPE_CHECKING:
    from twin.camera.acquisition import Capture

Array = NDArray[np.float64]

#: Confidence from which a cell's distance counts.
SURE = 0.95


@dataclass(frozen=True)
class RangeScore:
    """Errors of the distances of a record in cells that the vehicle is sure of.

    ``median_m``, ``worst_tenth_m``: of the absolute errors, median and 90th percentile (cells at an
    object's border hold two distances). ``claimed_m``: the median of the standard errors that the
    vehicle itself gives. ``sure_share``: of the cells with a surface.
    """

    median_m: float
    worst_tenth_m: float
    claimed_m: float
    sure_share: float

    def __str__(self) -> str:
        """The result in a few words."""
        if not self.sure_share:
            return "no cell is sure of its distance"
        return (
            f"{si(self.median_m, 'm', 2)} (median), {si(self.worst_tenth_m, 'm', 2)} (90 %), "
            f"claimed {si(self.claimed_m, 'm', 2)}; {self.sure_share:.0%} of cells sure"
        )


def range_score(capture: "Capture") -> RangeScore | None:
    """`RangeScore` of a capture; None without time of flight, or where nothing is in sight."""
    record, true = capture.record, capture.distance_m
    seen = np.isfinite(true)
    if all(shutter == ALWAYS_OPEN for shutter in record.shutters) or not seen.any():
        return None
    ranges = range_image(record)
    if len(ranges.distance_m) != 1:
        return None
    sure = seen & (ranges.confidence[0] > SURE)
    if not sure.any() or capture.void:
        return RangeScore(np.nan, np.nan, np.nan, 0.0)
    off = np.abs(ranges.distance_m[0] - true)[sure]
    claimed = ranges.standard_error_m[0][sure]
    return RangeScore(
        float(np.median(off)),
        float(np.quantile(off, 0.9)),
        float(np.median(claimed)),
        float(sure.sum() / seen.sum()),
    )
