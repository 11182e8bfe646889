"""Error of time-of-flight distances due to backscatter of the air."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.ranging import distances
from hardware.records import SpiRecord
from hardware.records.state import ALWAYS_OPEN
from twin.warned import CaptureWarning

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BackscatterRangeError:
    """Least and largest share of backscatter in the light of a shutter, and the resulting error of
    the distance of cells with light of the scene: median error, m; median standard error that the
    vehicle reports from noise alone; largest error.
    """

    least_share: float
    most_share: float
    error_m: float
    claimed_m: float
    largest_m: float

    @property
    def matters(self) -> bool:
        """Whether the median error exceeds the standard error that the vehicle reports."""
        return self.error_m > self.claimed_m

    def __str__(self) -> str:
        """The result in a few words."""
        return f"distances {self.error_m:.2g} m off because of backscatter (median)"

    @property
    def warnings(self) -> tuple[CaptureWarning, ...]:
        """A warning where the error matters."""
        if not self.matters:
            return ()
        return (
            CaptureWarning(
                "design",
                f"backscatter is {self.least_share:.0%} to {self.most_share:.0%} of the light "
                f"by phase or gate: distances are {self.error_m:.2g} m off (median; up to "
                f"{self.largest_m:.2g} m), compared with {self.claimed_m:.2g} m by noise alone; "
                "one modulation frequency cannot separate the two, gates that open later can: "
                "time_of_flight",
            ),
        )


def backscatter_range_error(
    record: SpiRecord, cells_e: Array, backscatter_e: Array, noise_e: Array
) -> BackscatterRangeError | None:
    """Difference of the vehicle's distances from noise-free images with and without backscatter.

    Parameters
    ----------
    cells_e, backscatter_e
        Electrons of each cell, and the air's part of them, (n_shutters, n_detectors, n_cells).
    noise_e
        Of each cell in one shutter's image, (n_detectors, n_cells).

    None without time of flight or backscatter, and where nothing of the scene comes back.
    """
    scene_e = cells_e - backscatter_e
    lit = scene_e.sum(axis=0) > 1e-6 * scene_e.sum(axis=0).max(initial=0.0)
    timed = any(shutter != ALWAYS_OPEN for shutter in record.shutters)
    if not (timed and backscatter_e.any() and lit.any()):
        return None
    shape = (*cells_e.shape[:2], record.patterns.rows, record.patterns.columns)
    errors = np.broadcast_to(noise_e.reshape(shape[1:]), shape)
    seen, true = (distances(record, part.reshape(shape), errors) for part in (cells_e, scene_e))
    off = np.abs(seen.distance_m - true.distance_m)
    if any(shutter.modulated for shutter in record.shutters):  # phases repeat
        off = np.minimum(off, np.abs(seen.longest_m - off))
    off, claimed = (x.ravel()[lit.ravel()] for x in (off, true.standard_error_m))
    known = np.isfinite(off) & np.isfinite(claimed)
    if not known.any():
        return None
    total = cells_e.sum(axis=(1, 2))
    share = np.divide(
        backscatter_e.sum(axis=(1, 2)), total, out=np.zeros_like(total), where=total > 0
    )
    return BackscatterRangeError(
        least_share=float(share.min()),
        most_share=float(share.max()),
        error_m=float(np.median(off[known])),
        claimed_m=float(np.median(claimed[known])),
        largest_m=float(off[known].max()),
    )
