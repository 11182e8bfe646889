"""Sparse patches: every small patch has few DCT coefficients, and so has their overlap-average.

Plug-and-play with a classical denoiser, alternating with the data: (1) take the DCT of all
overlapping patches, set coefficients below a threshold to 0, and average the patches with weights
by their sparsity (Guleryuz, IEEE Trans. Image Process. 15, 2006); (2) project onto the images that
agree with the measurements within their noise. The threshold falls geometrically from coarse to
fine. Total variation and a global DCT have different errors, so the result is a mean of the three,
which agrees with the measurements as well.

Nothing is learned: thresholds, steps and shares were tuned on every other image of the benchmark.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.methods.fista import fista
from hardware.reconstruction.methods.lmmse import lmmse_plan
from hardware.reconstruction.methods.total_variation import MISFIT, total_variation
from hardware.reconstruction.projection import projection
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing

#: Side of a patch of square cells. Where cells are wider than high it is higher by the square root
#: of that ratio, or the other way round.
PATCH = 8
#: Alternations of denoising and projection.
ITERATIONS = 40
#: First and last threshold over the standard deviation of the image, for 8 x 8 cells.
THRESHOLDS = (1.4, 0.05)
#: Last threshold, at least, over the noise of a cell.
NOISE_THRESHOLD = 2.0
#: Shares in the mean of patches, total variation and global DCT.
SHARES = (0.6, 0.2, 0.2)


@method("patches", slow=True)
def patches(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, None]:
    """Sparse overlapping patches, alternating with the data, averaged with TV and FISTA."""
    plan = lmmse_plan(sensing)
    scale = plan.scale(values, noise_variance)
    if scale == 0:
        return plan.flat(values), None
    cells = plan.image(values, noise_variance / scale)
    spread = float(cells.std())
    radius = np.sqrt(MISFIT * sensing.count * noise_variance)
    onto = projection(values[:, None], np.array([radius]), sensing)
    cell_noise = np.sqrt(noise_variance * sensing.count / sensing.n_cells / sensing.largest_squared)
    first, last = (t * spread * np.sqrt(np.prod(sides(sensing.shape))) / 8 for t in THRESHOLDS)
    last = max(last, NOISE_THRESHOLD * cell_noise)
    for threshold in np.geomspace(max(first, last), last, ITERATIONS):
        smooth = sparse_patches(cells.reshape(sensing.shape), float(threshold))
        cells = onto(smooth.reshape(-1, 1))[:, 0]
    edges = total_variation(values, noise_variance, sensing)[0]
    waves = fista(values, noise_variance, sensing)[0]
    return SHARES[0] * cells + SHARES[1] * edges + SHARES[2] * waves, None


def sparse_patches(image: Array, threshold: float) -> Array:
    """All overlapping patches hard-thresholded in their DCT, averaged by their sparsity.

    The image is mirrored at its edges, so that each cell lies in the same number of patches.
    """
    high, wide = sides(image.shape)
    padded = np.pad(image, ((high - 1,) * 2, (wide - 1,) * 2), mode="symmetric")
    transform = np.kron(dct_matrix(high), dct_matrix(wide))
    windows = sliding_window_view(padded, (high, wide))
    coefficients = windows.reshape(-1, high * wide) @ transform.T
    is_significant = np.abs(coefficients) > threshold
    is_significant[:, 0] = True
    weight = 1 / np.count_nonzero(is_significant, axis=1)
    denoised = ((coefficients * is_significant) @ transform * weight[:, None]).reshape(
        windows.shape
    )
    weight = weight.reshape(windows.shape[:2])
    total, weights = np.zeros_like(padded), np.zeros_like(padded)
    rows, columns = weight.shape
    for i in range(high):
        for j in range(wide):
            total[i : i + rows, j : j + columns] += denoised[:, :, i, j]
            weights[i : i + rows, j : j + columns] += weight
    down, along = image.shape
    return np.asarray((total / weights)[high - 1 : high - 1 + down, wide - 1 : wide - 1 + along])


def sides(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of a patch."""
    ratio = np.sqrt(shape[0] / shape[1])
    high, wide = round(PATCH * max(ratio, 1)), round(PATCH * max(1 / ratio, 1))
    return min(high, shape[0]), min(wide, shape[1])
