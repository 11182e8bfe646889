"""Depth from the phase of modulated light: amplitude, distance, its error, and unwrapping.

The light is modulated at ``modulation_hz`` f; a cell's phasor is the sum over its paths of
a exp(-j 2 pi f tau), tau the whole way over c. One path gives the phase -4 pi f d / c, the same for
all distances d that differ by c / (2 f). Several frequencies together are the same only at the
distances at which all of them wrap at once (for 10 and 11 MHz: 150 m instead of 15 m).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError
from hardware.reconstruction.unwrapping import unwrapped
from hardware.waveform import C_M_PER_S

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth per cell; all arrays ``(n_cells,)``.

    ``amplitude`` in the phasors' unit: mean over the frequencies. Of ``standard_error_m`` 1.96 hold
    95 % of the likelihood for the noise given, if the unwrapping is right: in noise of less than a
    fifth of the amplitude the Cramer-Rao bound. ``confidence`` is the posterior probability that it
    is, among all distances up to ``longest_m``, each cell taken to hold one surface and amplitudes
    alike before: where noise is as large as the amplitude, 1.2 times too high in the mean, 2 times
    where it is above 0.5 with three frequencies. Where no one surface explains the phases and
    amplitudes of all frequencies (two in a cell, air that sends light back), confidence falls with
    the probability of that by chance, and the error grows by the root of chi^2 over its degrees of
    freedom. One frequency cannot contradict itself, and several do so unseen within the device's
    tolerance: thin fog (2 km of visibility, a wall at 10 m, 10 and 11 MHz) moves distances by ten
    times their errors at a confidence of 1. Cells without light have NaN for distance and 0 for
    confidence.

    Distances that repeat lie from 0 to ``longest_m``: nearer to either end than their error they
    may belong to the other one, with a confidence of one half at the end itself. Where
    ``longest_m`` is less than that of the frequencies, a distance may lie outside by its error.
    """

    amplitude: Array
    distance_m: Array
    standard_error_m: Array
    confidence: Array
    longest_m: float


def depth(
    phasors: NDArray[np.complexfloating],
    modulation_hz: ArrayLike,
    noise: ArrayLike,
    *,
    longest_m: float | None = None,
    tolerance: float = 0.005,
) -> Depth:
    """Amplitude and distance of every cell.

    Parameters
    ----------
    phasors : (n_frequencies, n_cells) complex array
        One reconstruction for the real part, one for the imaginary part.
    modulation_hz : (n_frequencies,)
        Frequencies of the modulation.
    noise
        Standard deviation of the real part (and of the imaginary part) of a phasor: a number,
        ``(n_frequencies,)`` or ``(n_frequencies, n_cells)``.
    longest_m
        Farthest distance to consider; default, and at most, where all frequencies wrap at once.
    tolerance
        What a device's own contrasts, relative, and phases, rad, may differ by from frequency to
        frequency: frequencies that differ by no more do not contradict each other.

    Raises InputError for shapes that do not fit, frequencies that are not positive, or values
    that are not numbers.
    """
    z = np.atleast_2d(np.asarray(phasors, dtype=np.complex128))
    f = np.atleast_1d(np.asarray(modulation_hz, dtype=np.float64))
    if z.ndim != 2 or len(f) != len(z):
        raise InputError(f"phasors: shape {z.shape}, expected ({len(f)}, n_cells)")
    if not (np.isfinite(f).all() and (f > 0).all()):
        raise InputError(f"modulation_hz: {f} are not all positive numbers")
    sigma = np.asarray(noise, dtype=np.float64)
    sigma = np.broadcast_to(sigma[:, None] if sigma.ndim == 1 else sigma, z.shape)
    if not (np.isfinite(z).all() and np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise InputError("phasors: values or noise are not numbers, or noise is negative")
    limit = common_range_m(f)
    longest = limit if longest_m is None else float(longest_m)
    if not 0 < longest <= limit * (1 + 1e-12):
        raise InputError(f"longest_m: {longest} is not above 0 and at most {limit:.6g}")

    size = np.abs(z)
    least = 1e-12 * size.max(initial=0.0)  # keeps a noiseless phasor's precision finite
    noise = np.maximum(sigma, least or 1.0)
    distance, spread, confidence = unwrapped(np.where(size > 0, z, noise), f, noise, longest)
    seen = (size > 0).all(axis=0)
    loose = np.hypot(np.maximum(sigma, least), tolerance * size)
    scale, doubt = contradiction(_misfit(z, f, distance, loose), 2 * (len(f) - 1))
    confidence = confidence * doubt
    return Depth(
        amplitude=size.mean(axis=0),
        distance_m=np.where(seen, distance, np.nan),
        standard_error_m=np.where(seen, scale * spread, np.inf),
        confidence=np.where(seen, confidence, 0.0),
        longest_m=longest,
    )


def common_range_m(modulation_hz: ArrayLike) -> float:
    """Distance after which all frequencies repeat: c / (2 gcd), the gcd taken to 1 Hz."""
    whole = np.rint(np.atleast_1d(modulation_hz)).astype(np.int64)
    return float(C_M_PER_S / (2 * np.gcd.reduce(whole)))


def contradiction(chi2: Array, freedom: int) -> tuple[Array, Array]:
    """What errors grow by where data contradict their model, and what confidence is multiplied by.

    Both are 1 where chance alone gives such a chi^2 once in a thousand times or more often; beyond,
    the root of chi^2 over its degrees of freedom, and a thousand times that probability.
    """
    if freedom < 1:
        return np.ones_like(chi2), np.ones_like(chi2)
    from scipy.special import chdtrc  # takes 0.1 s to import

    doubt = np.minimum(chdtrc(freedom, chi2) / 1e-3, 1.0)
    return np.where(doubt < 1, np.sqrt(np.maximum(chi2 / freedom, 1)), 1.0), doubt


def _misfit(z: NDArray[np.complex128], f: Array, distance_m: Array, sigma: Array) -> Array:
    """chi^2 of phasors against one echo at a distance whose amplitude all frequencies share: of
    their parts in phase with it, and of those across.
    """
    turned = z * np.exp(4j * np.pi * f[:, None] * distance_m / C_M_PER_S)
    weight = np.divide(1, sigma**2, out=np.zeros(sigma.shape), where=sigma > 0)
    total = np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
    amplitude = (weight * turned.real).sum(axis=0) / total
    return np.asarray((weight * np.abs(turned - amplitude) ** 2).sum(axis=0))
