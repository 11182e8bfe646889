"""Hadamard measurements and their noise, from raw counts alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.records import SpiRecord


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a set of patterns measured.

    ``values`` is H x in electrons, shape ``(count, n_detectors)``; ``noise_variance`` the variance
    of one value, shape ``(n_detectors,)``.
    """

    values: NDArray[np.float64]
    noise_variance: NDArray[np.float64]


def measurements(record: SpiRecord) -> Measurements:
    """Hadamard measurements of a record.

    Differential: pattern minus complement. Their *sum* is the same for every pair (all cells lit
    once, plus background), so its scatter is the noise of the difference: no model, no dark frame.
    Successive sums are differenced, which leaves slow drift of the background out.

    Plain: 2 (lit) - (all lit), which needs the first Hadamard row (all ones) among the patterns
    and leaves the background as a constant in every value. The finest patterns, which carry least
    of the scene, tell that constant by their mean and the noise by their scatter (an upper bound).
    """
    electrons = record.electrons
    if record.patterns.mode == "differential":
        lit, complement = electrons[0::2], electrons[1::2]
        return Measurements(lit - complement, _scatter(lit + complement))
    all_lit = np.flatnonzero(record.patterns.indices == 0)
    if all_lit.size == 0:
        raise ValueError("patterns: a plain set needs the all-lit pattern among its patterns")
    values = 2 * electrons - electrons[all_lit[0]]
    finest = np.delete(values, all_lit[0], axis=0)[-max(2, len(values) // 8) :]
    if len(finest) == 0:
        return Measurements(values, np.zeros(values.shape[1]))
    background = finest.mean(axis=0)
    return Measurements(values - background, finest.var(axis=0))


def _scatter(constant: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance of values whose mean is constant or drifts slowly; 0 when there is only one."""
    if len(constant) < 2:
        return np.zeros(constant.shape[1])
    return np.mean(np.diff(constant, axis=0) ** 2, axis=0) / 2
