"""Constant false-alarm rate: thresholds from the cells around, at a chosen probability.

A noise cell, the mean of V channels, is gamma distributed with shape V. The reference z is

- ``ca``: the mean of n training cells;
- ``go``: the greater of the means before and behind in range, for edges of clutter;
- ``os``: the k-th smallest of n, k = 3 n / 4, for neighbours among the training cells;

and a cell is a detection above factor * z. The factor solves E[Q(V, V factor z)] = Pfa over z's
distribution (Q the regularised upper gamma function). For one channel and independent cells that
is the textbooks' n (Pfa^(-1/n) - 1) for ``ca`` and prod (n - i) / (n - i + factor) = Pfa for ``os``
(Rohling, IEEE Trans. AES 19, 1983).

A window makes neighbouring cells alike: n cells then tell as much as fewer independent ones. That
number replaces n: for a mean, the one with the same variance; for a quantile, the one with the same
variance of the share of cells below it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.radar.windows import correlation, taper

Array = NDArray[np.float64]
Method = Literal["ca", "go", "os"]
_QUANTILE = 0.75  # of the training cells, for os
_MOST_ORDERED = 96  # cells that os sorts


@dataclass(frozen=True)
class Cfar:
    """How detections are told from noise.

    Parameters
    ----------
    false_alarm
        Probability per cell that noise alone is called a target.
    method
        ``ca``, ``go`` or ``os``.
    guard, training
        Cells on each side along range and rate that are left out, and that tell the noise. The
        guard must hold what a window spreads a cell over: 3 for ``blackmanharris``.
    """

    false_alarm: float = 1e-8
    method: Method = "ca"
    guard: tuple[int, int] = (6, 6)
    training: tuple[int, int] = (16, 12)

    def __post_init__(self) -> None:
        if not 0 < self.false_alarm < 1:
            raise ValueError(f"false_alarm: {self.false_alarm} is no probability")
        if self.method not in get_args(Method):
            raise ValueError(f"method: {self.method!r} is none of {', '.join(get_args(Method))}")
        for name in ("guard", "training"):
            if min(getattr(self, name)) < 0:
                raise ValueError(f"{name}: {getattr(self, name)} is negative")


def cfar_threshold(
    power: NDArray[np.floating[Any]],
    cfar: Cfar,
    *,
    window: str = "boxcar",
    n_channels: int = 1,
    oversampling: int = 1,
    at: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
) -> Array:
    """Threshold of every cell, or of those at rows and columns ``at``; the map wraps around.

    Parameters
    ----------
    power : (n_ranges, n_rates)
        In any unit.
    cfar
        What is asked for.
    window, n_channels, oversampling
        How the map was made: they set how alike its cells are, and how they scatter.

    Raises ValueError when the map leaves no cells to tell the noise from.
    """
    regions = _regions(power.shape, cfar)
    offsets, rank = _offsets(regions[0]), 0
    if cfar.method == "os":
        offsets = _thinned(offsets, power.shape, window, oversampling)
        rank = round(_QUANTILE * len(offsets))
        level = _ordered(power, offsets, rank, at)
    else:
        means = [_means(power, region) for region in regions]
        level = means[0] if cfar.method == "ca" else np.maximum(*means)
        level = level if at is None else level[at]
        # A running sum loses digits next to a peak 1e10 times higher: never below zero.
        np.maximum(level, 0, out=level)
    cells = len(offsets)
    alike = _independent(power.shape, offsets, window, oversampling, rank / cells)
    factor = cfar_factor(cfar.false_alarm, alike, cfar.method, n_channels, rank * alike / cells)
    level *= factor
    return level


@lru_cache(maxsize=64)
def cfar_factor(
    false_alarm: float,
    cells: float,
    method: Method = "ca",
    n_channels: int = 1,
    rank: float | None = None,
) -> float:
    """Threshold over the reference of ``cells`` independent cells (in each half, for ``go``)."""
    from scipy.optimize import brentq
    from scipy.special import betaincinv, gammaincc, gammaincinv
    from scipy.stats import norm

    # Over the reference's quantiles, spaced evenly in a normal variable: its tails are reached.
    x = np.linspace(-12, 12, 4001)
    weight = norm.pdf(x) * (x[1] - x[0])
    u = norm.cdf(x)
    shape = n_channels * cells
    if method == "ca":
        z = gammaincinv(shape, u) / shape
    elif method == "go":
        z = gammaincinv(shape, np.sqrt(u)) / shape
    else:
        rank = _QUANTILE * cells if rank is None else rank
        z = gammaincinv(n_channels, betaincinv(rank, cells - rank + 1, u)) / n_channels

    def excess(log_factor: float) -> float:
        rate = weight @ gammaincc(n_channels, n_channels * np.exp(log_factor) * z)
        return float(np.log(rate + 1e-300) - np.log(false_alarm))

    return float(np.exp(brentq(excess, -20, 20, xtol=1e-10)))


def _regions(shape: tuple[int, ...], cfar: Cfar) -> list[NDArray[np.bool_]]:
    """Training cells as masks around a cell, (n_rows, n_columns), both odd unless they fill a map.

    One ring, or for ``go`` the parts before and behind in range.
    """
    inner = [min(2 * g + 1, n) for g, n in zip(cfar.guard, shape, strict=True)]
    outer = [
        min(2 * (g + t) + 1, n) for g, t, n in zip(cfar.guard, cfar.training, shape, strict=True)
    ]
    middle = [
        slice(o // 2 - i // 2, o // 2 - i // 2 + i) for i, o in zip(inner, outer, strict=True)
    ]
    ring = np.ones(outer, dtype=bool)
    if cfar.method == "go":
        ring[middle[0]] = False
        before, behind = ring.copy(), ring.copy()
        before[outer[0] // 2 :] = False
        behind[: outer[0] // 2] = False
        regions = [before, behind]
    else:
        ring[tuple(middle)] = False
        regions = [ring]
    if not all(region.any() for region in regions):
        raise ValueError(f"training: no cells left of a map of {tuple(shape)} to tell the noise")
    return regions


def _offsets(region: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Rows and columns of a region's cells relative to its middle, (n_cells, 2)."""
    return np.argwhere(region) - np.array(region.shape) // 2


def _thinned(
    offsets: NDArray[np.intp], shape: tuple[int, ...], window: str, oversampling: int
) -> NDArray[np.intp]:
    """Of the training cells those on a grid wide enough that few are left to sort, nearly alone."""
    steps = [
        max(1, int(np.argmax(correlation(taper(window, n // oversampling), oversampling) < 0.05)))
        for n in shape
    ]
    while np.count_nonzero(np.all(offsets % steps == 0, axis=1)) > _MOST_ORDERED:
        steps[int(np.argmin(steps))] += 1
    thin = offsets[np.all(offsets % steps == 0, axis=1)]
    return thin if len(thin) > 1 else offsets


def _means(power: NDArray[np.floating[Any]], region: NDArray[np.bool_]) -> Array:
    """Mean over a region, a box or a box with a hole, around every cell; the map wraps around."""
    if power.flags.f_contiguous and not power.flags.c_contiguous:
        return _means(power.T, region.T).T
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

    around = box(*(_extent(inside) for inside in np.nonzero(region)))
    filled = tuple(slice(*_extent(inside)) for inside in np.nonzero(region))
    hole = np.nonzero(~region[filled])
    if len(hole[0]):
        starts = [side.start for side in filled]
        spans = [_extent(h + start) for h, start in zip(hole, starts, strict=True)]
        around -= box(*spans)
    around /= region.sum()
    return around


def _extent(indices: NDArray[np.intp]) -> tuple[int, int]:
    return int(indices.min()), int(indices.max()) + 1


def _ordered(
    power: NDArray[np.floating[Any]],
    offsets: NDArray[np.intp],
    rank: int,
    at: tuple[NDArray[np.intp], NDArray[np.intp]] | None,
) -> Array:
    """The rank-th smallest (from 1) of the cells at the offsets around every or chosen cells."""
    if at is None:
        every = np.unravel_index(np.arange(power.size), power.shape)
        return _ordered(power, offsets, rank, (every[0], every[1])).reshape(power.shape)
    level = np.empty(len(at[0]))
    for start in range(0, len(level), 65536):
        part = slice(start, start + 65536)
        rows = (at[0][part, None] + offsets[:, 0]) % power.shape[0]
        columns = (at[1][part, None] + offsets[:, 1]) % power.shape[1]
        level[part] = np.partition(power[rows, columns], rank - 1, axis=1)[:, rank - 1]
    return level


def _independent(
    shape: tuple[int, ...],
    offsets: NDArray[np.intp],
    window: str,
    oversampling: int,
    quantile: float,
) -> float:
    """Number of independent cells with the same variance of the mean, or of a quantile."""
    if window == "boxcar" and oversampling == 1:
        return float(len(offsets))
    return _equivalent(shape, offsets.tobytes(), window, oversampling, quantile)


@lru_cache(maxsize=16)
def _equivalent(
    shape: tuple[int, ...], packed: bytes, window: str, oversampling: int, quantile: float
) -> float:
    offsets = np.frombuffer(packed, dtype=np.intp).reshape(-1, 2)
    rho = [correlation(taper(window, n // oversampling), oversampling) for n in shape]
    lags = offsets[:, None] - offsets
    alike = rho[0][lags[..., 0] % shape[0]] * rho[1][lags[..., 1] % shape[1]]
    if quantile == 0:
        return float(len(offsets) ** 2 / alike.sum())
    # Correlation of two indicators x < q: Laguerre polynomials expand the joint distribution,
    # each order weighted by that power of the cells' squared correlation.
    from scipy.special import eval_laguerre

    q = -np.log1p(-quantile)
    indicator = np.zeros_like(alike)
    for order in range(1, 60):
        part = np.exp(-q) * (eval_laguerre(order, q) - eval_laguerre(order - 1, q))
        indicator += part**2 / (quantile * (1 - quantile)) * alike**order
    np.fill_diagonal(indicator, 1.0)
    return float(len(offsets) ** 2 / indicator.sum())
