"""Hadamard measurements and their noise, from raw counts alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.reconstruction.prior import walsh_variance
from hardware.records import SpiRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a set of patterns measured.

    ``values`` is H x in electrons, shape ``(count, n_images)``; ``noise_variance`` the variance
    of one value, shape ``(n_images,)``. An image has one detector, or two when complementary.
    """

    values: Array
    noise_variance: Array


def measurements(record: SpiRecord) -> Measurements:
    """Hadamard measurements of a record.

    Differential, complementary: pattern minus complement. Their *sum* is the same for every pair
    (all cells lit once, plus background), so its scatter is the noise of the difference: no model,
    no dark frame. Successive sums are differenced, which leaves slow drift of the background out.
    The two arms of a complementary set are taken as equally sensitive; where they are not, the
    noise comes out too high.

    Reference: 2 (lit) - (all lit) - (all dark), free of background. The noise of the two reference
    exposures is one constant in every value, which mostly meets the first cell.

    Plain: 2 (lit) - (all lit), which needs the first Hadamard row (all ones) among the patterns
    and leaves the background as a constant in every value. The finest patterns, which carry least
    of the scene, tell that constant by their mean and the noise by their scatter (an upper bound).

    S-matrix: (all lit) - 2 (lit - dark frame). All of them together light every cell n/2 times,
    which gives (all lit); of a subset the finest patterns tell it by their mean.
    """
    electrons, patterns = record.electrons, record.patterns
    if patterns.mode == "differential":
        lit, complement = electrons[0::2], electrons[1::2]
        return Measurements(lit - complement, _scatter(lit + complement))
    if patterns.mode == "complementary":
        lit, complement = np.split(electrons, 2, axis=1)
        return Measurements(lit - complement, _scatter(lit + complement))
    finest = _finest(patterns)
    if patterns.mode == "reference":
        values = 2 * electrons[2:] - electrons[0] - electrons[1]
    elif patterns.mode == "s-matrix":
        values = _from_s_matrix(electrons, patterns, finest)
    else:
        values = _from_plain(electrons, patterns, finest)
    return Measurements(
        values, values[finest].var(axis=0) if finest.size else np.zeros(values.shape[1])
    )


def _from_plain(electrons: Array, patterns: PatternSet, finest: NDArray[np.intp]) -> Array:
    all_lit = np.flatnonzero(patterns.indices == 0)
    if all_lit.size == 0:
        raise ValueError("patterns: a plain set needs the all-lit pattern among its patterns")
    values = 2 * electrons - electrons[all_lit[0]]
    return values - values[finest].mean(axis=0) if finest.size else values


def _from_s_matrix(electrons: Array, patterns: PatternSet, finest: NDArray[np.intp]) -> Array:
    dark = int(np.flatnonzero(patterns.indices == 0)[0])
    lit = electrons - electrons[dark]
    if patterns.count == patterns.n_cells:
        total = 2 * lit.sum(axis=0) / patterns.n_cells
    else:
        total = 2 * lit[finest].mean(axis=0) if finest.size else np.zeros(lit.shape[1])
    return np.asarray(total - 2 * lit)


def _finest(patterns: PatternSet) -> NDArray[np.intp]:
    """Where the eighth of the patterns stands that carries least of a natural image."""
    variance = walsh_variance(patterns.rows, patterns.columns)[patterns.indices]
    variance = np.where(patterns.indices == 0, np.inf, variance)
    order = np.argsort(variance, kind="stable")[: max(2, (patterns.count - 1) // 8)]
    return order[np.isfinite(variance[order])]


def _scatter(constant: Array) -> Array:
    """Variance of values whose mean is constant or drifts slowly; 0 when there is only one."""
    if len(constant) < 2:
        return np.zeros(constant.shape[1])
    return np.asarray(np.mean(np.diff(constant, axis=0) ** 2, axis=0) / 2)
