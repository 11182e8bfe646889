"""Images of patterns by their inverse transform, for what is linear in the exposures."""

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns, PatternSet, RasterScan, fwht_in_place
from hardware.reconstruction.measurements import measured_values
from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]


def inverse_image(electrons: Array, patterns: Patterns) -> Array:
    """Cells (n_cells, n_images) of exposures (n_exposures, n_images); of a user's own patterns by
    least squares.
    """
    if isinstance(patterns, RasterScan):
        each = 2 if patterns.mode == "differential" else 1
        return electrons[::each] - (electrons[1::2] if each == 2 else 0.0)
    values = measured_values(electrons, patterns)
    if not isinstance(patterns, PatternSet):
        return np.asarray(Sensing(patterns).pseudo_inverse @ values)
    coefficients = np.zeros((patterns.n_cells, electrons.shape[-1]))
    coefficients[patterns.indices] = values
    return np.asarray(fwht_in_place(coefficients) / patterns.n_cells)
