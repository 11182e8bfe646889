"""Constant false-alarm rate: thresholds from training cells, at a given probability.

`cfar_rule` selects the training cells and computes the factor on their level.

Noise that depends on range rate (carrier steps of a synthesiser that drifts within a slot) is
estimated by the median over range at every rate, and thresholds follow it. K-distributed clutter
(see `k_distribution`) exceeds thresholds for noise many times too often; with its shape, given or
fitted to each map, the distributions of cell and reference follow the K-distribution.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.cfar_rule import Cfar, MapNoise, offsets_of, rule
from hardware.radar.k_distribution import fit
from hardware.radar.windows import normalised_window

Array = NDArray[np.float64]
Power = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Cells = tuple[NDArray[np.intp], NDArray[np.intp]]
_MOST_GATHERED = 2000  # cells whose training cells are gathered one by one
_FEWEST_RANGES = 16  # enough for a median that one echo does not raise
_MOST_RANGES = 1024  # used to estimate the noise of a rate
_UNLIKE = 1.5  # standard errors by which medians must differ to count as different


def cfar_threshold(
    power: Power, cfar: Cfar, noise: MapNoise | None = None, *, at: Cells | None = None
) -> Array:
    """Threshold of every cell, or of those at rows and columns ``at``; the map wraps around.

    Parameters
    ----------
    power : (n_ranges, n_rates)
        In any unit.
    cfar
        Probability of false alarm, method and cells.
    noise
        Properties of the map's noise; default: independent cells of one channel.

    Raises InputError when the map has no training cells, or is none.
    """
    if not isinstance(power, np.ndarray) or power.ndim != 2:
        raise InputError(f"power: {power!r:.60}, expected an array (n_ranges, n_rates)")
    noise = noise or MapNoise()
    if noise.relative_noise is not None:
        uneven = np.broadcast_to(noise.relative_noise, power.shape)
        level = cfar_threshold(power / uneven, cfar, replace(noise, relative_noise=None), at=at)
        return level * (uneven if at is None else uneven[at])
    cfar = with_fitted_shape(power, cfar, noise.n_channels)
    regions, factor, rank = rule(power.shape, cfar, noise)
    bin_noise = noise_per_doppler_bin(power, noise)
    power = normalise_doppler_bins(power, bin_noise)
    whole = at is None
    if at is None and rank:
        rows, columns = np.unravel_index(np.arange(power.size), power.shape)
        at = rows, columns
    if at is None or (not rank and len(at[0]) > _MOST_GATHERED):
        level = np.max([box_sums(power, region) / region.sum() for region in regions], axis=0)
        # A running sum loses digits next to a peak 1e10 times higher: never below zero.
        level = factor * bin_noise * np.maximum(level, 0)
        return np.asarray(level if at is None else level[at])
    levels = [_reference_levels(power, offsets_of(region), rank, at) for region in regions]
    level = factor * np.max(levels, axis=0) * bin_noise[at[1]]
    return np.asarray(level.reshape(power.shape) if whole else level)


def with_fitted_shape(power: Power, cfar: Cfar, n_channels: int = 1) -> Cfar:
    """The rule with the clutter's shape fitted to a map, where ``shape`` is "fitted"."""
    if cfar.shape != "fitted":
        return cfar
    return replace(cfar, shape=fit(power, n_channels).shape)


def noise_per_doppler_bin(power: Power, noise: MapNoise) -> Array:
    """Noise in each Doppler bin (range rate) over the mean of all, (n_rates,).

    Ones where the differences are no larger than random ones.
    """
    if len(power) < _FEWEST_RANGES:
        return np.ones(power.shape[1])
    stride = max(1, len(power) // _MOST_RANGES)
    rows = power[::stride]
    middle = len(rows) // 2
    columns = np.ascontiguousarray(rows.T)
    medians = np.partition(columns, middle, axis=1)[:, middle].astype(np.float64)
    if not np.all(medians > 0):
        return np.ones(len(medians))
    # Of the median of gamma distributed cells, some of which a window correlates.
    alike = float(np.mean(normalised_window(noise.window, len(power)) ** 2)) / min(stride, 2)
    error = 1.44 * np.sqrt(max(alike, 1.0) / (noise.n_channels * len(rows)))
    ratio = medians / medians.mean()
    return ratio if np.std(ratio) > _UNLIKE * error else np.ones(len(medians))


def normalise_doppler_bins(power: Power, bin_noise: Array) -> Power:
    """Power over the noise of its Doppler bin: training cells lie in other bins than the cell
    tested.
    """
    if np.all(bin_noise == 1):
        return power
    return np.asarray(power / bin_noise.astype(power.dtype))


def box_sums(power: Power, region: Mask) -> Array:
    """Sum over a region, a box or a box with a hole, around every cell; the map wraps around."""
    if power.flags.f_contiguous and not power.flags.c_contiguous:
        return box_sums(power.T, region.T).T
    pad = [(n // 2, n - n // 2) for n in region.shape]
    total = np.zeros([n + a + b + 1 for n, (a, b) in zip(power.shape, pad, strict=True)])
    np.cumsum(np.pad(power, pad, mode="wrap"), axis=1, dtype=np.float64, out=total[1:, 1:])
    np.cumsum(total, axis=0, out=total)

    def box(rows: tuple[int, int], columns: tuple[int, int]) -> Array:
        top, bottom = (slice(r, r + power.shape[0]) for r in rows)
        left, right = (slice(c, c + power.shape[1]) for c in columns)
        summed = total[bottom, right] - total[top, right]
        summed -= total[bottom, left]
        summed += total[top, left]
        return summed

    spans = [_extent(inside) for inside in np.nonzero(region)]
    hole = np.nonzero(~region[slice(*spans[0]), slice(*spans[1])])
    around = box(*spans)
    if len(hole[0]):
        around -= box(*(_extent(h + start) for h, (start, _) in zip(hole, spans, strict=True)))
    return around


def _extent(indices: NDArray[np.intp]) -> tuple[int, int]:
    return int(indices.min()), int(indices.max()) + 1


def _reference_levels(power: Power, offsets: NDArray[np.intp], rank: int, at: Cells) -> Array:
    """Mean, or with a rank (from 1) the rank-th smallest, of the training cells of each cell."""
    level = np.empty(len(at[0]))
    for start in range(0, len(level), 8192):
        part = slice(start, start + 8192)
        rows = (at[0][part, None] + offsets[:, 0]) % power.shape[0]
        columns = (at[1][part, None] + offsets[:, 1]) % power.shape[1]
        around = power[rows, columns]
        if rank:
            level[part] = np.partition(around, rank - 1, axis=1)[:, rank - 1]
        else:
            level[part] = around.mean(axis=1, dtype=np.float64)
    return level
