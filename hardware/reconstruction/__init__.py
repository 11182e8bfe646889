"""From a record to an image: one interface, one function per method."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.reconstruction.lmmse import lmmse
from hardware.reconstruction.measurements import Measurements, measurements
from hardware.reconstruction.zero_fill import zero_fill
from hardware.records import Flag, SpiRecord

__all__ = ["METHODS", "Measurements", "Reconstruction", "measurements", "reconstruct"]

#: A method turns measurements y (count,) with noise variance into cells (n_cells,) and their
#: standard error (n_cells,), both in electrons.
Method = Callable[
    [NDArray[np.float64], float, PatternSet], tuple[NDArray[np.float64], NDArray[np.float64]]
]
METHODS: dict[str, Method] = {"zero-fill": zero_fill, "lmmse": lmmse}


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """An image with its uncertainty.

    ``image`` and ``standard_error`` have shape ``(n_detectors, rows, columns)``, in the
    photo-electrons that a cell, lit alone for one exposure, would give. ``noise_electrons`` is the
    noise of one measurement, as found in the record itself.
    """

    method: str
    image: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    noise_electrons: NDArray[np.float64]
    warnings: tuple[str, ...]

    @property
    def picture(self) -> NDArray[np.float64]:
        """All detectors' images side by side, ``(rows, n_detectors * columns)``."""
        return np.hstack(list(self.image))


def reconstruct(record: SpiRecord, method: str = "lmmse") -> Reconstruction:
    """Reconstruct an image from a record.

    Parameters
    ----------
    record
        From the twin or from a device.
    method
        ``zero-fill``: inverse transform, patterns not shown count as zero. ``lmmse``: linear
        minimum mean-square error under a 1/f^2 prior, noise level taken from the record.

    Raises ValueError for an unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"method: {method!r} is none of {', '.join(METHODS)}")
    measured = measurements(record)
    shape = (-1, record.patterns.rows, record.patterns.columns)
    solved = [
        METHODS[method](y, variance, record.patterns)
        for y, variance in zip(measured.values.T, measured.noise_variance, strict=True)
    ]
    return Reconstruction(
        method=method,
        image=np.stack([image for image, _ in solved]).reshape(shape),
        standard_error=np.stack([error for _, error in solved]).reshape(shape),
        noise_electrons=np.sqrt(measured.noise_variance),
        warnings=_warnings(record),
    )


def _warnings(record: SpiRecord) -> tuple[str, ...]:
    n = record.flags.size
    return tuple(
        f"{bad} of {n} exposures are marked {flag.name.lower()}"
        for flag in Flag
        if flag.name and (bad := int(np.count_nonzero(record.flags & flag)))
    )
