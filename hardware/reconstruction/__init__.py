"""From a record to an image: one interface, one function per method."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.reconstruction.measurements import Measurements, measurements
from hardware.reconstruction.registry import METHODS, Method, discover, load_plugins, method
from hardware.reconstruction.sensing import Mixing, Sensing
from hardware.records import Flag, SpiRecord

__all__ = [
    "METHODS",
    "Measurements",
    "Method",
    "Mixing",
    "Reconstruction",
    "Sensing",
    "fits_in_memory",
    "load_plugins",
    "measurements",
    "method",
    "reconstruct",
]

discover()


def fits_in_memory(name: str, patterns: PatternSet) -> bool:
    """Whether a method's matrices for a set of patterns fit into memory."""
    from hardware.reconstruction.walsh_blocks import MOST_BYTES, bytes_needed

    subset = patterns.count < patterns.n_cells
    shape = (patterns.rows, patterns.columns)
    return name != "lmmse" or not subset or bytes_needed(shape, patterns.indices) <= MOST_BYTES


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """An image with its uncertainty.

    ``image`` and ``standard_error`` have shape ``(n_detectors, rows, columns)``, in the
    photo-electrons that a cell, lit alone for one exposure, would give; ``standard_error`` is None
    where the method gives none. ``noise_electrons`` is the noise of one measurement, as found in
    the record itself.
    """

    method: str
    image: NDArray[np.float64]
    standard_error: NDArray[np.float64] | None
    noise_electrons: NDArray[np.float64]
    warnings: tuple[str, ...]

    @property
    def picture(self) -> NDArray[np.float64]:
        """All detectors' images side by side, ``(rows, n_detectors * columns)``."""
        return np.hstack(list(self.image))


def reconstruct(
    record: SpiRecord, method: str = "lmmse", *, mixing: Mixing | None = None
) -> Reconstruction:
    """Reconstruct an image from a record.

    Parameters
    ----------
    record
        From the twin or from a device.
    method
        A name in `METHODS`. Default: linear minimum mean-square error under a 1/f^2 prior, noise
        level taken from the record.
    mixing
        Calibrated map from image cells to emitter elements, where these are no clean grid.

    Patterns that were lost on their way are left out, as if they had not been asked for.

    Raises ValueError for an unknown method, a mixing that does not fit, patterns whose matrices
    would not fit into memory, or a record in which too much is lost.
    """
    if method not in METHODS:
        load_plugins()
    if method not in METHODS:
        raise ValueError(f"method: {method!r} is none of {', '.join(METHODS)}")
    received = record.received
    solve, sensing = METHODS[method], Sensing(received.patterns, mixing)
    measured = measurements(received)
    values, variance = measured.values, measured.noise_variance
    if solve.joint:
        cells, error = solve(values, variance, sensing)
    else:
        solved = [solve(y, float(s), sensing) for y, s in zip(values.T, variance, strict=True)]
        cells = np.stack([cells for cells, _ in solved], axis=1)
        errors = [error for _, error in solved if error is not None]
        error = np.stack(errors, axis=1) if errors else None
    shape = (-1, *sensing.shape)
    return Reconstruction(
        method=method,
        image=cells.T.reshape(shape),
        standard_error=None if error is None else error.T.reshape(shape),
        noise_electrons=np.sqrt(variance),
        warnings=_warnings(record),
    )


def _warnings(record: SpiRecord) -> tuple[str, ...]:
    n = record.flags.size
    return tuple(
        f"{bad} of {n} exposures are marked {flag.name.lower()}"
        for flag in Flag
        if flag.name and (bad := int(np.count_nonzero(record.flags & flag)))
    )
