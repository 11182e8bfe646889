"""The image of a moving scene from its measurements: linear, and of least total variation.

Linear (LMMSE under a prior of power spectrum 1/f^(2 e) and covariance C): (A^T A + r C^-1) x =
A^T y, r the noise over the prior's scale, by conjugate gradients. The preconditioner is diagonal in
the cosine transform: a full set at rest has A^T A = M I behind the averaging over each cell. Few
measurements, or small images, are solved by their own covariance instead, x = C A^T w with
(A C A^T + r I) w = y, to roundoff.

Total variation: least sum of |grad x| whose misfit is a share of the noise's, by the alternating
direction method of multipliers (split Bregman: Goldstein and Osher, SIAM J. Imaging Sci. 2, 2009),
the weight of the misfit adapted until it has that size.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.cosine import filtered
from hardware.reconstruction.motion.grid import Grid
from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.operators import MovingPatterns

Array = NDArray[np.float64]

#: Of the alternations, and conjugate-gradient steps within each.
_ALTERNATIONS, _INNER_STEPS = 60, 2
#: Squared misfit over its expectation, tuned on every other test picture.
MISFIT = 0.8
#: First weight of total variation over the noise variance and the mean gradient of the LMMSE.
_FIRST_WEIGHT = 0.1
#: Products up to which a covariance of measurements is formed: a second.
_MOST_PRODUCTS = 2.0**33
#: Share of the image's spread that no noise is below: what the grid itself leaves open.
_LEAST_NOISE = 1e-3


@dataclass(frozen=True)
class Prior:
    """A prior of power spectrum 1/f^(2 exponent); ``ratio`` is the noise variance of a measurement
    over its scale.
    """

    ratio: float
    exponent: float = 1.0


@dataclass(frozen=True, eq=False)
class Solved:
    """Unknowns of the grid, and the relative residual that the solver ended at."""

    unknowns: Array
    residual: float
    iterations: int


def linear_solver(
    patterns: MovingPatterns, prior: Prior, count: int, knobs: Compensation
) -> Callable[[Array], Solved]:
    """The linear estimate as a function of values ``(count,)``."""
    unknowns = patterns.grid.shape[0] * patterns.grid.shape[1]
    if count * count * unknowns <= _MOST_PRODUCTS:
        return _by_covariance(patterns, prior, count)
    spectrum = patterns.grid.spectrum(prior.exponent)
    penalty = np.divide(prior.ratio, spectrum, out=np.zeros_like(spectrum), where=spectrum > 0)
    weight = 1 / (count * averaging(patterns.grid) + penalty)

    def apply(x: Array) -> Array:
        return patterns.adjoint(patterns.forward(x)) + _filtered(x, penalty)

    return lambda values: conjugate_gradients(
        apply,
        patterns.adjoint(values),
        lambda residual: _filtered(residual, weight),
        knobs.residual,
        knobs.most_iterations,
    )


def _by_covariance(patterns: MovingPatterns, prior: Prior, count: int) -> Callable[[Array], Solved]:
    """By the measurements' covariance; the mean of the unknowns, which the prior leaves free, is
    that of generalised least squares.
    """
    from scipy.linalg import cho_factor, cho_solve  # takes 0.1 s to import

    spectrum = patterns.grid.spectrum(prior.exponent)
    covariance = covariance_of(in_cosines(patterns.rows(np.arange(count))), spectrum)
    np.fill_diagonal(covariance, covariance.diagonal() + prior.ratio)
    factor = cho_factor(covariance, lower=True, overwrite_a=True, check_finite=False)
    level = patterns.forward(np.ones(patterns.grid.shape))
    of_level = cho_solve(factor, level, check_finite=False)
    power = float(level @ of_level)

    def solve(values: Array) -> Solved:
        weights = cho_solve(factor, values, check_finite=False)
        mean = float(level @ weights) / power if power > 1e-12 else 0.0
        weights = weights - mean * of_level
        return Solved(_filtered(patterns.adjoint(weights), spectrum) + mean, 0.0, 1)

    return solve


def in_cosines(rows: Array) -> Array:
    """Cosine coefficients of rows ``(n, *grid.shape)``."""
    from scipy import fft  # takes 0.1 s to import

    return np.asarray(fft.dctn(rows, axes=(1, 2), norm="ortho"))


def covariance_of(parts: Array, spectrum: Array) -> Array:
    """A C A^T of rows in cosine coefficients ``(n, *grid.shape)``, for a prior's eigenvalues."""
    weighted = (parts * np.sqrt(spectrum)).reshape(len(parts), -1)
    return np.asarray(weighted @ weighted.T)


def posterior_draw(
    patterns: MovingPatterns,
    prior: Prior,
    solver: Callable[[Array], Solved],
    count: int,
    rng: np.random.Generator,
) -> Array:
    """The error of one draw from prior and noise, cells (rows, columns), for a prior of scale 1.

    An image drawn from the prior, its measurements with noise of its ratio, and the linear
    estimate from them: its error has the posterior's covariance (Papandreou and Yuille, NIPS 2010).
    """
    grid = patterns.grid
    truth = _filtered(rng.normal(size=grid.shape), np.sqrt(grid.spectrum(prior.exponent)))
    values = patterns.forward(truth) + np.sqrt(prior.ratio) * rng.normal(size=count)
    return patterns.image(solver(values).unknowns - truth)


def total_variation(
    patterns: MovingPatterns, values: Array, noise_variance: float, start: Array
) -> Array:
    """Unknowns of least total variation within the noise, from an estimate ``start``."""
    grid, count = patterns.grid, len(values)
    least = _LEAST_NOISE * float(np.ptp(start))
    noise = max(noise_variance, least**2 * grid.rows * grid.columns)
    weights = min(grid.rows, grid.columns) / np.array([grid.columns, grid.rows])
    slope = float(_length(_gradient(start, weights)).mean())
    if slope == 0:
        return start
    weight = _FIRST_WEIGHT * noise / slope
    tie = 2 * weight / slope
    laplacian = _laplacian(grid, weights)
    x, data = start.copy(), patterns.adjoint(values)
    split = _gradient(x, weights)
    lifted = np.zeros_like(split)

    def apply(p: Array) -> Array:
        return patterns.adjoint(patterns.forward(p)) + tie * _filtered(p, laplacian)

    def precondition(residual: Array) -> Array:
        return _filtered(residual, 1 / (count * averaging(grid) + tie * laplacian))

    for step in range(_ALTERNATIONS):
        target = data + tie * _divergence(lifted - split, weights)
        x = (
            x
            + conjugate_gradients(
                apply, target - apply(x), precondition, 0.0, _INNER_STEPS
            ).unknowns
        )
        raised = _gradient(x, weights) + lifted
        length = _length(raised)
        split = raised * np.maximum(1 - weight / tie / np.maximum(length, 1e-300), 0.0)
        lifted = raised - split
        if step % 5 == 4 and step < _ALTERNATIONS - 10:
            misfit = float(np.sum((patterns.forward(x) - values) ** 2)) / (count * noise)
            change = float(np.clip(np.sqrt(MISFIT / max(misfit, 1e-9)), 0.5, 2.0))
            weight, tie = weight * change, tie * change
    return x


def averaging(grid: Grid) -> Array:
    """What averaging over cells leaves of each cosine function of the unknowns, squared, over the
    unknowns in a cell: A^T A of a full set at rest, per pattern, in the mean over places.
    """
    n = grid.oversampling
    parts = [np.sinc(np.arange(size) / (2 * size) * n) ** 2 for size in grid.shape]
    floor = 1e-3  # near the zeros of sinc the shifts within a frame leave something
    return np.maximum(parts[0][:, None] * parts[1], floor) / n**2


def conjugate_gradients(
    apply: Callable[[Array], Array],
    right: Array,
    precondition: Callable[[Array], Array],
    residual: float,
    most: int,
) -> Solved:
    """Preconditioned, from 0; ends where the residual's norm in the preconditioner has fallen to
    ``residual`` of its first.

    SciPy's ends by the plain norm, which the coarsest functions rule.
    """
    x, left = np.zeros_like(right), right.copy()
    upward = precondition(left)
    direction, energy = upward.copy(), float(np.vdot(left, upward))
    first, steps = energy, 0
    while steps < most and energy > residual**2 * first:
        steps += 1
        image = apply(direction)
        length = energy / float(np.vdot(direction, image))
        x += length * direction
        left -= length * image
        upward = precondition(left)
        before, energy = energy, float(np.vdot(left, upward))
        direction *= energy / before
        direction += upward
    share = float(np.sqrt(max(energy, 0.0) / first)) if first > 0 else 0.0
    return Solved(x, share, steps)


def _filtered(image: Array, weight: Array) -> Array:
    return filtered(image.reshape(-1), weight).reshape(image.shape)


def _laplacian(grid: Grid, weights: Array) -> Array:
    """Eigenvalues of grad^T grad with free edges, by cosine function."""
    down, along = (
        4 * w**2 * np.sin(np.pi * np.arange(n) / (2 * n)) ** 2
        for n, w in zip(grid.shape, weights, strict=True)
    )
    return np.asarray(down[:, None] + along)


def _gradient(x: Array, weights: Array) -> Array:
    found = np.zeros((2, *x.shape))
    found[0, :-1] = weights[0] * np.diff(x, axis=0)
    found[1, :, :-1] = weights[1] * np.diff(x, axis=1)
    return found


def _divergence(field: Array, weights: Array) -> Array:
    """Minus the transpose of `_gradient`."""
    found = np.zeros(field.shape[1:])
    found[:-1] += weights[0] * field[0, :-1]
    found[1:] -= weights[0] * field[0, :-1]
    found[:, :-1] += weights[1] * field[1, :, :-1]
    found[:, 1:] -= weights[1] * field[1, :, :-1]
    return found


def _length(field: Array) -> Array:
    return np.sqrt((field**2).sum(axis=0))
