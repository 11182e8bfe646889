"""Hadamard measurements and their noise, from raw counts alone."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.reconstruction.noise import finest_patterns, noise_beside_detail, noise_of_sums
from hardware.records import SpiRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a set of patterns measured.

    ``values`` is H x in electrons, shape ``(count, n_images)``; ``noise_variance`` the variance
    of one value, shape ``(n_images,)``, and ``most_noise_variance`` the largest that the record
    allows. ``most_level`` is the most that the mean of the cells can be, ``(n_images,)``: that of
    all light, the background's with it. An image has one detector, or two when complementary.
    """

    values: Array
    noise_variance: Array
    most_noise_variance: Array
    most_level: Array


def with_level(record: SpiRecord) -> SpiRecord:
    """A record of a reference set in which row 0 stands, all cells lit; any other record itself.

    Row 0 lights all cells, as the first of the two references does: where it is lost or was not
    asked for, that exposure stands for it, 2 (all lit) - (all lit) - (all dark).
    """
    patterns = record.patterns
    if patterns.mode != "reference" or (patterns.indices == 0).any():
        return record
    n = len(record.shutters)
    exposures = np.arange(patterns.n_exposures * n).reshape(-1, n)
    rows = np.concatenate([exposures[:2], exposures[:1], exposures[2:]]).ravel()
    return replace(
        record,
        patterns=PatternSet.of(
            patterns.rows, patterns.columns, (0, *patterns.indices.tolist()), "reference"
        ),
        counts=record.counts[rows],
        device_time_ns=record.device_time_ns[rows],
        sequence=record.sequence[rows],
        flags=record.flags[rows],
    )


def measurements(record: SpiRecord) -> Measurements:
    """Hadamard measurements of a record.

    Differential, complementary: pattern minus complement. Their *sum* is the same for every pair
    (all cells lit once, plus background), so its scatter is the noise of the difference: no model,
    no dark frame (`hardware.reconstruction.noise.noise_of_sums`). The two arms of a complementary
    set are taken as equally sensitive; where they are not, the noise comes out too high. What of
    their 1/f noise is slower than an exposure is not in it.

    Reference: 2 (lit) - (all lit) - (all dark), free of background. The noise of the two reference
    exposures is one constant in every value, which is an error of the cells that are lit in every
    pattern (`PatternSet.common_cells`).

    Plain: 2 (lit) - (all lit), which needs the first Hadamard row (all ones) among the patterns
    and leaves the background as a constant in every value. S-matrix: (dark frame) - 2 (lit), which
    leaves the background and (all lit) as a constant. The finest patterns, which carry least of
    the scene, tell that constant by their mean. Cells on which all patterns agree are a constant
    in every value as well, and are therefore not measured.

    Reference, plain and S-matrix sets show nothing twice. What tells noise from detail is then
    their spectra (`hardware.reconstruction.noise.noise_beside_detail`), and the scatter of the
    finest patterns is the most that noise can be.
    """
    electrons, patterns = record.electrons, record.patterns
    values = hadamard_values(electrons, patterns)
    if patterns.mode in ("differential", "complementary"):
        lit, complement = _pairs(electrons, patterns)
        noise = noise_of_sums(lit + complement, in_turn=patterns.mode == "differential")
        level = np.abs((lit + complement).mean(axis=0)) / patterns.n_cells
        return Measurements(values, noise, noise, level)
    finest = finest_patterns(patterns)
    most = values[finest].var(axis=0) if finest.size else np.zeros(values.shape[1])
    quantisation = (2 * record.electrons_per_count) ** 2 / 12
    noise = noise_beside_detail(values, patterns)
    level = 2 * np.abs(electrons).max(axis=0) / patterns.n_cells
    return Measurements(values, np.minimum(np.maximum(noise, quantisation), most), most, level)


def hadamard_values(electrons: Array, patterns: PatternSet) -> Array:
    """Hadamard measurements (count, n_images) of exposures (n_exposures, n_detectors), as
    `measurements` explains them; linear in the exposures.
    """
    if patterns.mode in ("differential", "complementary"):
        lit, complement = _pairs(electrons, patterns)
        return lit - complement
    if patterns.mode == "reference":
        return np.asarray(2 * electrons[2:] - electrons[0] - electrons[1])
    return _without_constant(electrons, patterns, finest_patterns(patterns))


def _pairs(electrons: Array, patterns: PatternSet) -> tuple[Array, Array]:
    """Exposures to the patterns, and those to their complements."""
    if patterns.mode == "differential":
        return electrons[0::2], electrons[1::2]
    lit, complement = np.split(electrons, 2, axis=1)
    return lit, complement


def _without_constant(electrons: Array, patterns: PatternSet, finest: NDArray[np.intp]) -> Array:
    """Values of a plain set or an S-matrix, the constant they share told by the finest patterns."""
    whole = np.flatnonzero(patterns.indices == 0)
    if whole.size == 0:
        raise ValueError("patterns: a plain set needs the all-lit pattern among its patterns")
    lit = electrons if patterns.mode == "plain" else -electrons
    values = 2 * lit - lit[whole[0]]
    return values - values[finest].mean(axis=0) if finest.size else values
