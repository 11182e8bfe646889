"""Which of the distances that phases allow is right, and how far off it may be.

Noise turns a phasor of amplitude a by angles that are normal only where it is much less than a. So
errors and probabilities come from the likelihood of all frequencies' phasors z_f, noise s_f in
either part, at the distance d, integrated over the amplitude that they share, all amplitudes from 0
being alike before: with u_f = z_f exp(4 pi j f d / c), W = sum 1 / s_f^2 and
a = sum Re u_f / s_f^2 / W,

    exp(-sum |u_f - a|^2 / (2 s_f^2)) Phi(a W^(1/2)),   Phi the normal distribution.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

_NODES = 6  # on either side of a distance, for the integral over it
_FINE_NODES = 24  # for the error
_WIDEST = 12.0  # standard deviations of normal phases; nothing is beyond
_AT_ONCE = 2**15  # distances in memory, with their nodes
#: What the logarithm of the likelihood by normal phases is less than the best where a distance is
#: ruled out; by phasors it is a tenth of it or more: half a turn costs r^2 / 2, not (pi r)^2 / 2.
_RULED_OUT = 150.0


def unwrapped(
    phasors: NDArray[np.complex128], modulation_hz: Array, noise: Array, longest_m: float
) -> tuple[Array, Array, Array]:
    """Most probable distance, its standard error if it is the right one, and the probability of
    that; all combinations of wraps tried.

    ``phasors``, none of them 0, and ``noise``, (n_frequencies, n_cells). For each number of wraps
    of the most precise frequency the others take their nearest ones: least squares between the
    distances, weighted by their precision for normal phases. 1.96 standard errors hold 95 % of the
    likelihood within half a period of that frequency. The prior is flat from 0 to ``longest_m``: a
    combination is as probable as its likelihood times the share of its own error that lies there,
    which near an end is shared with the combination a whole period away.
    """
    per_m = 4 * np.pi * modulation_hz / C_M_PER_S
    size, phase = np.abs(phasors), np.angle(phasors)
    precision = (per_m[:, None] * size / noise) ** 2
    anchor = int(np.argmax(precision.mean(axis=1)))
    mean, misfit = _combinations(phase, modulation_hz, precision, longest_m, anchor)

    def likelihood(at: tuple[Integers, Integers], n_nodes: int) -> tuple[Array, Array]:
        cells = at[1]
        turned = phase[:, cells] + per_m[:, None] * mean[at]
        turned -= 2 * np.pi * np.rint(turned / (2 * np.pi))
        z = size[:, cells] * np.exp(1j * turned)
        return _likelihood(z, noise[:, cells], per_m, np.pi / per_m[anchor], n_nodes)

    log, spread = np.full(mean.shape, -np.inf), np.full(mean.shape, longest_m)
    rows, cells = np.nonzero(misfit <= misfit.min(axis=0) + 2 * _RULED_OUT)
    for first in range(0, len(cells), _AT_ONCE):
        some = rows[first : first + _AT_ONCE], cells[first : first + _AT_ONCE]
        log[some], spread[some] = likelihood(some, _NODES)
    inside = _log_share(mean, spread, longest_m)
    log += inside
    best = log.argmax(axis=0), np.arange(phase.shape[1])
    relative = np.exp(log - log[best])
    # A phase that no distance up to ``longest_m`` gives contradicts that there is one.
    doubt = np.minimum(np.exp(inside[best]) / 1e-3, 1.0)
    return mean[best], likelihood(best, _FINE_NODES)[1], doubt / relative.sum(axis=0)


def _combinations(
    phase: Array, f: Array, precision: Array, longest: float, anchor: int
) -> tuple[Array, Array]:
    """Distances, and what they leave of the phases by least squares, (n_combinations, n_cells)."""
    unambiguous = C_M_PER_S / (2 * f)
    folded = (-phase / (2 * np.pi) % 1.0) * unambiguous[:, None]
    wraps = np.arange(-1, np.ceil(longest / unambiguous[anchor] - 1e-9) + 1)
    first = folded[anchor] + unambiguous[anchor] * wraps[:, None]  # (n_wraps, n_cells)
    turns = np.rint((first - folded[:, None]) / unambiguous[:, None, None])
    each = folded[:, None] + turns * unambiguous[:, None, None]
    mean = (precision[:, None] / precision.sum(axis=0) * each).sum(axis=0)
    return mean, (precision[:, None] * (each - mean) ** 2).sum(axis=0)


def _likelihood(
    z: NDArray[np.complex128], noise: Array, per_m: Array, half_m: float, n_nodes: int
) -> tuple[Array, Array]:
    """Logarithm of the likelihood's integral within ``half_m`` of distances at which phasors turned
    back are ``z`` (n_frequencies, n), and the error of which 1.96 hold 95 % of it, both (n,).
    """
    from scipy.special import log_ndtr, ndtri  # takes 0.1 s to import

    normal = 1 / np.sqrt(((per_m[:, None] * np.abs(z) / noise) ** 2).sum(axis=0))
    reach = np.arcsinh(np.minimum(half_m / normal, _WIDEST))  # dense where normal phases are
    place = (np.arange(n_nodes) + 0.5)[:, None] / n_nodes * reach
    width = normal * np.cosh(place) * reach / n_nodes
    away = normal * np.sinh(place)
    turn = np.exp(1j * per_m[:, None, None] * away)  # (n_frequencies, n_nodes, n)
    turned = z[:, None, None] * np.stack([turn, turn.conj()], axis=1)
    weight = 1 / noise[:, None, None] ** 2
    total = weight.sum(axis=0)
    amplitude = (weight * turned.real).sum(axis=0) / total
    log = log_ndtr(amplitude * np.sqrt(total))
    log -= (weight * ((turned.real - amplitude) ** 2 + turned.imag**2)).sum(axis=0) / 2
    highest = log.max(axis=(0, 1))
    mass = (np.exp(log - highest).sum(axis=0) * width).cumsum(axis=0)
    beyond = np.concatenate([np.ones((1, len(normal))), 1 - mass / mass[-1]])
    outer, each = (beyond > 0.05).sum(axis=0), np.arange(len(normal))
    # Between two edges of the nodes as many normal deviations as hold what lies within.
    deviations = ndtri(1 - np.maximum(beyond[[outer - 1, outer], each], 1e-3) / 2)
    edges = normal * np.sinh(np.stack([outer - 1, outer]) / n_nodes * reach)
    share = (1.96 - deviations[0]) / (deviations[1] - deviations[0])
    return highest + np.log(mass[-1]), (edges[0] + share * (edges[1] - edges[0])) / 1.96


def _log_share(mean: Array, spread: Array, longest: float) -> Array:
    """Logarithm of the share of a normal distribution that lies from 0 to ``longest``."""
    from scipy.special import log_ndtr  # takes 0.1 s to import

    outer = np.abs(mean - longest / 2) - longest / 2  # beyond the nearer end
    near, far = log_ndtr(-outer / spread), log_ndtr(-(outer + longest) / spread)
    return np.asarray(near + np.log1p(-np.exp(far - near)))
