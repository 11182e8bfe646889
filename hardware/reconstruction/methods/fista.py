"""Sparse coefficients of a DCT by accelerated proximal gradient steps.

    min over a of  1/2 |A D a - y|^2 + sum_k t_k |a_k|

FISTA: Beck and Teboulle, SIAM J. Imaging Sci. 2, 2009. The thresholds t_k fall with the standard
deviation w_k that coefficient k has under the 1/f^2 prior: t_k = noise variance / (u w_k), u the
measured scale of the prior, with a lower limit, so that coefficients that were not measured stay
small without noise. Warm-started from LMMSE; the last step projects onto the images that agree with
the measurements.
"""

import math

import numpy as np

from hardware.reconstruction.dictionaries import DICTIONARIES, prior_deviation
from hardware.reconstruction.methods.lmmse import lmmse_plan
from hardware.reconstruction.projection import allowed
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing

#: Steps; bounds how far the image is from the minimum.
ITERATIONS = 30
#: Lower limit of the noise in the thresholds, as a share of the root-mean-square measurement; tuned
#: on every other test image.
LEAST_NOISE = 0.3


@method("fista")
def fista(
    values: Array, noise_variance: float, sensing: Sensing, *, iterations: int = ITERATIONS
) -> tuple[Array, None]:
    """Sparse DCT coefficients by accelerated proximal gradient steps (FISTA)."""
    plan = lmmse_plan(sensing)
    scale = plan.scale(values, noise_variance)
    if scale == 0:
        return plan.flat(values), None
    start = plan.image(values, noise_variance / scale)
    down, along = (DICTIONARIES["dct"](n) for n in sensing.shape)
    deviation = np.sqrt(scale) * prior_deviation("dct", *sensing.shape)
    lipschitz = sensing.largest_squared
    strength = threshold(noise_variance, scale, lipschitz, sensing.n_cells)
    thresholds = np.divide(strength, deviation, out=np.zeros(sensing.shape), where=deviation > 0)

    current = down @ start.reshape(sensing.shape) @ along.T
    ahead, t = current, 1.0
    for _ in range(iterations):
        picture = (down.T @ ahead @ along).ravel()
        residual = values - sensing.forward(picture, repeated=True)
        gradient = sensing.adjoint(residual, repeated=True).reshape(sensing.shape) / lipschitz
        moved = ahead + down @ gradient @ along.T
        new = moved - np.clip(moved, -thresholds, thresholds)
        t, earlier = (1 + np.sqrt(1 + 4 * t * t)) / 2, t
        ahead = new + (earlier - 1) / t * (new - current)
        current = new
    return allowed((down.T @ current @ along).ravel(), values, noise_variance, sensing), None


def threshold(noise_variance: float, scale: float, lipschitz: float, n_cells: int) -> float:
    """Threshold of a step for a coefficient of prior deviation 1."""
    least = LEAST_NOISE**2 * lipschitz / n_cells * scale
    return math.sqrt(2) / lipschitz * max(noise_variance, least)
