"""Screening: excludes most cells of a map as detections at a fraction of the cost of CFAR."""

from functools import lru_cache

import numpy as np

from hardware.radar.cfar import (
    Array,
    Cells,
    Mask,
    Power,
    box_sums,
    noise_per_doppler_bin,
    normalise_doppler_bins,
    with_fitted_shape,
)
from hardware.radar.cfar_rule import Cfar, MapNoise, rule, white_threshold

_TILE = 4  # cells along each side
_QUIETER = 0.4  # of the threshold in a map's quietest tenth: bound for os


def candidate_cells(power: Power, cfar: Cfar, noise: MapNoise | None = None) -> Cells:
    """Rows and columns of all cells above their threshold, and of a few others.

    A lower bound of the sum over the training cells, from tiles that are training cells for every
    cell of a tile, excludes most cells. For ``os`` the bound is 0.4 of the threshold in the map's
    quietest tenth; where the noise is lower than 0.4 of that, cells below the bound are lost.
    """
    noise = noise or MapNoise()
    if noise.relative_noise is not None:
        power = power / noise.relative_noise.astype(power.dtype)
    cfar = with_fitted_shape(power, cfar, noise.n_channels)
    regions, factor, rank = rule(power.shape, cfar, noise)
    if rank:
        white = white_threshold(power.shape, cfar, noise)
        return cells_above(power, _QUIETER * white * _floor(power, noise.n_channels))
    if any(size % _TILE for size in power.shape):
        rows, columns = np.nonzero(power > 0)
        return rows, columns
    bin_noise = noise_per_doppler_bin(power, noise)
    least = np.max(
        [_least(normalise_doppler_bins(power, bin_noise), region) for region in regions], axis=0
    )
    least *= factor * bin_noise.reshape(-1, _TILE).min(axis=1)
    # Rounding of single precision must not rule a cell out.
    bound = (least * (1 - 1e-5)).astype(power.dtype)
    rows, columns = np.nonzero(power > np.repeat(np.repeat(bound, _TILE, 0), _TILE, 1))
    return rows, columns


def cells_above(power: Power, level: float) -> Cells:
    """Rows and columns of the cells above a level."""
    above = (power > level).ravel(order="K")  # in one dimension it is ten times as fast
    if power.flags.f_contiguous:
        columns, rows = np.divmod(np.flatnonzero(above), len(power))
    else:
        rows, columns = np.divmod(np.flatnonzero(above), power.shape[1])
    return rows, columns


def _floor(power: Power, n_channels: int) -> float:
    """Mean of the noise, from the map's quietest tenth (of every seventh cell of a large map)."""
    from scipy.special import gammaincinv

    cells = power.ravel(order="K")[:: 7 if power.size > 2**18 else 1]
    tenth = np.partition(cells, len(cells) // 10)[len(cells) // 10]
    return float(tenth / gammaincinv(n_channels, 0.1) * n_channels)


def _least(power: Power, region: Mask) -> Array:
    """Lower bound of a region's mean for all cells of every tile."""
    rows, columns = (size // _TILE for size in power.shape)
    tiles = power.reshape(rows, _TILE, columns, _TILE).sum(axis=(1, 3), dtype=np.float64)
    certain = _certain(region.tobytes(), region.shape)
    if not certain.any() or any(c > t for c, t in zip(certain.shape, tiles.shape, strict=True)):
        return np.zeros_like(tiles)
    return np.maximum(box_sums(tiles, certain), 0) / region.sum()


@lru_cache(maxsize=16)
def _certain(packed: bytes, shape: tuple[int, int]) -> Mask:
    """Tiles around a cell's own that lie within a region wherever in its tile the cell is."""
    region = np.frombuffer(packed, dtype=bool).reshape(shape)
    reach = [n // 2 // _TILE for n in shape]
    certain = np.zeros([2 * r + 1 for r in reach], dtype=bool)
    for tile in np.ndindex(certain.shape):
        starts = [
            n // 2 + (i - r) * _TILE - (_TILE - 1)
            for n, i, r in zip(shape, tile, reach, strict=True)
        ]
        stops = [start + 2 * _TILE - 1 for start in starts]
        if min(starts) >= 0 and all(stop <= n for stop, n in zip(stops, shape, strict=True)):
            certain[tile] = region[starts[0] : stops[0], starts[1] : stops[1]].all()
    return certain
