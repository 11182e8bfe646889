"""Measurements by patterns and their noise, from raw counts alone."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import OwnPatterns, Patterns, PatternSet, RasterScan, fwht
from hardware.reconstruction.noise import (
    finest_patterns,
    is_full,
    most_noise,
    most_scatter,
    noise_beside_detail,
    noise_of_repetitions,
    noise_of_sums,
)
from hardware.reconstruction.scanning import scanned_cells
from hardware.records import SpiRecord

Array = NDArray[np.float64]

#: Noise of a full set that shows nothing twice, as a multiple of its photons' own variance, up to
#: which it is believed and smoothed. More is a scene that is flatter than 1/f as often as it is a
#: noisy detector, and is kept in the image. A photodiode's shot noise is 1; an avalanche diode's,
#: 2 to 5 for each primary electron (McIntyre, IEEE Trans. Electron Devices 13, 1966).
MOST_OVER_PHOTONS = 4.0


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a set of patterns measured.

    ``values`` is H x, or W x of a user's own patterns, in electrons, shape ``(count, n_images)``.
    All others are ``(n_images,)``: ``noise_variance`` the variance of one value, with which an
    image is smoothed;
    ``most_noise_variance`` the largest that the record allows, at least that of rounding to counts,
    NaN where no two exposures differ by noise or detail alone; ``noise_told`` whether the record
    tells noise from detail; ``most_level`` the most that the mean of the cells can be where no
    pattern tells it, that of all light, the background's with it; ``constant_variance``
    that of the values which tell the constant that all share, the references' or the finest ones'
    with their detail, 0 where there is none. An image has one detector, or two when complementary.
    """

    values: Array
    noise_variance: Array
    most_noise_variance: Array
    noise_told: NDArray[np.bool_]
    most_level: Array
    constant_variance: Array


def with_level(record: SpiRecord) -> SpiRecord:
    """A record of a reference set in which row 0 stands, all cells lit; any other record itself.

    Row 0 lights all cells, as the first of the two references does: where it is lost or was not
    asked for, that exposure stands for it, 2 (all lit) - (all lit) - (all dark).
    """
    patterns = record.patterns
    if not isinstance(patterns, PatternSet):
        return record
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
        sequence=np.arange(len(rows), dtype=np.uint32),  # the device's own has no place for them
        flags=record.flags[rows],
    )


def measurements(record: SpiRecord) -> Measurements:
    """Measurements of a record.

    Differential, complementary: pattern minus complement. Their *sum* is the same for every pair
    (all cells lit once, plus background), so its scatter is the noise of the difference: no model,
    no dark frame (`hardware.reconstruction.noise.noise_of_sums`). The two arms of a complementary
    set are taken as equally sensitive; where they are not, the noise comes out too high, and
    `hardware.reconstruction.unequal_arms` says so. What of their 1/f noise is slower than an
    exposure is not in it.

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
    finest patterns, or of complete sets that of flat cells, is the most that noise can be
    (`hardware.reconstruction.noise.most_noise`).
    Scenes may be as flat as noise: a single bright cell, a checkerboard. So a full set, or one
    that lacks an eighth at most, is smoothed only by noise that its photons explain
    (`MOST_OVER_PHOTONS`); what is more stays in the image.
    The finest patterns of a subset hold detail whose amount is unknown: its noise is never told.

    A user's own plain set: twice (lit) less the mean of all, which takes the background out; where
    patterns are shown again, their scatter about their means is the noise. Own patterns that are
    shown once do not tell noise from detail: they are smoothed by the photons' own noise, and all
    their scatter is the most that noise can be.

    A raster scan: the Hadamard transform of its cells (`hardware.reconstruction.scanning`), which
    shows nothing twice either.
    """
    if isinstance(record.patterns, RasterScan):
        return _of_scan(record, record.patterns)
    electrons, patterns = record.electrons, record.patterns
    values = measured_values(electrons, patterns)
    if patterns.mode in ("differential", "complementary"):
        lit, complement = pairs(electrons, patterns)
        noise = noise_of_sums(lit + complement, in_turn=patterns.mode == "differential")
        alike = _alike(lit) & _alike(complement)
        of_counts = np.where(alike, 3, 1) * 2 * record.electrons_per_count**2 / 12
        most = np.maximum(noise, of_counts) if len(lit) > 1 else np.full_like(noise, np.nan)
        level = np.abs((lit + complement).mean(axis=0)) / patterns.n_cells
        return Measurements(values, noise, most, np.isfinite(most), level, 0 * most)
    rounding = (2 * record.electrons_per_count) ** 2 / 12
    if isinstance(patterns, OwnPatterns):
        scatter = values.var(axis=0)
        most = np.maximum(scatter, rounding) if len(values) > 1 else np.full_like(scatter, np.nan)
        photons = 4 * np.maximum(electrons.mean(axis=0), 0.0)
        noise = np.minimum(np.maximum(photons, rounding), scatter)
        level = _most_level(np.abs(electrons), patterns)
        again = noise_of_repetitions(values, patterns) if patterns.mode == "plain" else None
        if again is not None:
            noise = most = np.maximum(again, rounding)
            return Measurements(values, noise, most, np.ones(len(noise), np.bool_), level, 0 * most)
        return Measurements(values, noise, most, np.zeros(len(noise), np.bool_), level, 0 * most)
    assert isinstance(patterns, PatternSet)  # a scan is `_of_scan`
    finest = finest_patterns(patterns)
    scatter = values[finest].var(axis=0) if finest.size else np.zeros(values.shape[1])
    of_finest = np.maximum(most_scatter(values, patterns), rounding)
    noise = noise_beside_detail(values, patterns)
    if full := is_full(patterns.count, patterns.n_cells):
        photons = 4 * np.maximum(electrons.mean(axis=0), 0.0)
        noise = np.where(noise > MOST_OVER_PHOTONS * photons, 0.0, noise)
    # Exposures that agree by rounding show less scatter than the noise that they had.
    told = (noise > 0) & np.isfinite(of_finest) & full & (scatter >= rounding)
    noise = np.minimum(np.maximum(noise, rounding), scatter)
    most = np.maximum(np.maximum(most_noise(values, patterns), noise), rounding)
    level = 2 * np.abs(electrons).max(axis=0) / patterns.n_cells
    alike = (scatter < rounding) | _alike(electrons)
    most = np.where(alike, np.maximum(most, 3 * rounding), most)
    of_constant = most if patterns.mode == "reference" else of_finest
    of_constant = np.where(alike, 3 * of_constant, of_constant)  # all of them share one
    return Measurements(values, noise, most, told, level, of_constant)


def _alike(electrons: Array) -> NDArray[np.bool_]:
    """Whether counts, as ``electrons`` (n, n_images), agree but for 1 in 12, ``(n_images,)``: they
    scatter less than rounding would by itself, and its errors are not spread evenly. Each is half a
    count at most, 3 times the variance.
    """
    return np.asarray(np.mean(electrons != np.median(electrons, axis=0), axis=0) < 1 / 12)


def _most_level(light: Array, patterns: OwnPatterns) -> Array:
    """The most that the mean of the measured cells can be, ``(n_images,)``, where exposures gave
    ``light`` (n_exposures, n_images) of a reference or a plain set.

    The all-lit reference holds all light. Of a plain set, no cell being less than dark, all
    exposures together hold a cell as often as patterns light it, and so the sum of the cells at
    least t times, but for those that are lit less than t times: each of these is at most as bright
    as the darkest exposure to it. The t that tells most counts.
    """
    if patterns.mode == "reference":
        return np.asarray(light[0] / patterns.n_cells)
    lit = patterns.lit[:, ~patterns.unmeasured_cells]
    times = lit.sum(axis=0)
    if not times.size:
        return np.asarray(light.max(axis=0))
    seldom_first = np.argsort(times)
    share = np.where(lit > 0, lit, np.nan)[:, seldom_first]
    alone = np.stack([np.nanmin(one[:, None] / share, axis=0) for one in light.T], axis=1)
    of_seldom = np.cumsum(alone, axis=0) - alone
    most = of_seldom + light.sum(axis=0) / times[seldom_first][:, None]
    return np.asarray(most.min(axis=0) / times.size)


def _of_scan(record: SpiRecord, scan: RasterScan) -> Measurements:
    """The Hadamard transform of the cells, with the noise that the finest patterns show."""
    whole, n = PatternSet(scan.rows, scan.columns, scan.n_cells, "natural", "plain"), scan.n_cells
    cells = scanned_cells(record)
    values, finest = fwht(cells), finest_patterns(whole)
    scatter = values[finest].var(axis=0) if finest.size else np.zeros(values.shape[1])
    rounding = n * record.electrons_per_count**2 / 12
    most = np.maximum(most_scatter(values, whole), rounding)
    noise, photons = noise_beside_detail(values, whole), n * np.maximum(cells.mean(axis=0), 0.0)
    noise = np.where(noise > MOST_OVER_PHOTONS * photons, 0.0, noise)
    told = (noise > 0) & np.isfinite(most)
    noise = np.minimum(np.maximum(noise, rounding), scatter)
    return Measurements(values, noise, most, told, np.abs(cells).max(axis=0), 0 * most)


def measured_values(electrons: Array, patterns: Patterns) -> Array:
    """Measurements (count, n_images) of exposures (n_exposures, n_detectors), as
    `measurements` explains them; linear in the exposures.
    """
    if patterns.mode in ("differential", "complementary"):
        lit, complement = pairs(electrons, patterns)
        return lit - complement
    if patterns.mode == "reference":
        return np.asarray(2 * electrons[2:] - electrons[0] - electrons[1])
    if isinstance(patterns, OwnPatterns):
        return np.asarray(2 * (electrons - electrons.mean(axis=0)))
    assert isinstance(patterns, PatternSet)  # a scan has `scanned_cells`
    return _without_constant(electrons, patterns, finest_patterns(patterns))


def pairs(electrons: Array, patterns: Patterns) -> tuple[Array, Array]:
    """Exposures to the patterns, and those to their complements."""
    if patterns.mode == "differential":
        return electrons[0::2], electrons[1::2]
    lit, complement = np.split(electrons, 2, axis=1)
    return lit, complement


def _without_constant(electrons: Array, patterns: PatternSet, finest: NDArray[np.intp]) -> Array:
    """Values of a plain set or an S-matrix, the constant they share told by the finest patterns."""
    whole = np.flatnonzero(patterns.indices == 0)
    if whole.size == 0:
        raise InputError("patterns: a plain set needs the all-lit pattern among its patterns")
    lit = electrons if patterns.mode == "plain" else -electrons
    values = 2 * lit - lit[whole[0]]
    return values - values[finest].mean(axis=0) if finest.size else values
