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

Noise that is stronger at some rates than at others (steps of a synthesiser that drifts within a
slot) is told by the median over range of every rate: thresholds follow it. K-distributed clutter
(see `k_distribution`) exceeds thresholds for noise many times too often; with its shape, given or
fitted to each map, cells and reference are distributed as that says.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.radar.k_distribution import fit, quantile, survival
from hardware.radar.windows import correlation, taper

Array = NDArray[np.float64]
Power = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Cells = tuple[NDArray[np.intp], NDArray[np.intp]]
Method = Literal["ca", "go", "os"]
_QUANTILE = 0.75  # of the training cells, for os
_MOST_ORDERED = 96  # cells that os sorts
_TILE = 4  # cells along each side
_QUIETER = 0.4  # of its threshold, down to which a map's quietest tenth is trusted
_MOST_GATHERED = 2000  # cells looked at one by one
_FEWEST_RANGES = 16  # whose median an echo among them does not raise
_MOST_RANGES = 1024  # that tell the noise of a rate
_UNLIKE = 1.5  # times their standard error, by which medians must differ to be followed


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
    shape
        Of K-distributed clutter; infinite for noise. ``"fitted"``: to each map.
    """

    false_alarm: float = 1e-8
    method: Method = "os"
    guard: tuple[int, int] = (6, 6)
    training: tuple[int, int] = (16, 12)
    shape: float | Literal["fitted"] = float("inf")

    def __post_init__(self) -> None:
        if not 0 < self.false_alarm < 1:
            raise ValueError(f"false_alarm: {self.false_alarm} is no probability")
        if self.method not in get_args(Method):
            raise ValueError(f"method: {self.method!r} is none of {', '.join(get_args(Method))}")
        for name in ("guard", "training"):
            if min(getattr(self, name)) < 0:
                raise ValueError(f"{name}: {getattr(self, name)} is negative")
        shape: object = self.shape
        if shape != "fitted" and not (isinstance(shape, int | float) and shape > 0):
            raise ValueError(f"shape: {self.shape!r}, expected a positive number or 'fitted'")


def cfar_threshold(
    power: Power,
    cfar: Cfar,
    *,
    window: str = "boxcar",
    n_channels: int = 1,
    oversampling: int = 1,
    noise_by_range: Array | None = None,
    at: Cells | None = None,
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
    noise_by_range : (n_ranges,)
        Mean noise over range, in any unit, where it is known to change within the training cells.

    Raises ValueError when the map leaves no cells to tell the noise from.
    """
    made: dict[str, Any] = {
        "window": window,
        "n_channels": n_channels,
        "oversampling": oversampling,
    }
    if noise_by_range is not None:
        level = cfar_threshold(power / noise_by_range[:, None], cfar, at=at, **made)
        return level * (noise_by_range[:, None] if at is None else noise_by_range[at[0]])
    cfar = fitted(power, cfar, n_channels)
    regions, factor, rank = _rule(power.shape, cfar, window, n_channels, oversampling)
    by_rate = _by_rate(power, window, n_channels)
    power = _even(power, by_rate)
    whole = at is None
    if at is None and rank:
        rows, columns = np.unravel_index(np.arange(power.size), power.shape)
        at = rows, columns
    if at is None or (not rank and len(at[0]) > _MOST_GATHERED):
        level = np.max([_sums(power, region) / region.sum() for region in regions], axis=0)
        # A running sum loses digits next to a peak 1e10 times higher: never below zero.
        level = factor * by_rate * np.maximum(level, 0)
        return np.asarray(level if at is None else level[at])
    levels = [_gathered(power, _offsets(region), rank, at) for region in regions]
    level = factor * np.max(levels, axis=0) * by_rate[at[1]]
    return np.asarray(level.reshape(power.shape) if whole else level)


def fitted(power: Power, cfar: Cfar, n_channels: int = 1) -> Cfar:
    """The same with the shape of its clutter fitted to a map, where that is asked for."""
    if cfar.shape != "fitted":
        return cfar
    return replace(cfar, shape=fit(power, n_channels).shape)


def possible(
    power: Power,
    cfar: Cfar,
    *,
    window: str = "boxcar",
    n_channels: int = 1,
    oversampling: int = 1,
    noise_by_range: Array | None = None,
) -> Cells:
    """Rows and columns of all cells above their threshold, and of few others.

    A lower bound of the training cells' sum, from tiles that lie among them wherever in its own
    tile a cell is, rules most cells out at a small part of the cost. For ``os`` the bound is 0.4
    of the threshold in the map's quietest tenth: where it is quieter still by more than that, the
    threshold is the bound.
    """
    if noise_by_range is not None:
        power = power / noise_by_range.astype(power.dtype)[:, None]
    cfar = fitted(power, cfar, n_channels)
    regions, factor, rank = _rule(power.shape, cfar, window, n_channels, oversampling)
    if rank:
        white = white_threshold(
            power.shape, cfar, window=window, n_channels=n_channels, oversampling=oversampling
        )
        return cells_above(power, _QUIETER * white * _floor(power, n_channels))
    if any(size % _TILE for size in power.shape):
        rows, columns = np.nonzero(power > 0)
        return rows, columns
    by_rate = _by_rate(power, window, n_channels)
    least = np.max([_least(_even(power, by_rate), region) for region in regions], axis=0)
    least *= factor * by_rate.reshape(-1, _TILE).min(axis=1)
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


def white_threshold(
    shape: tuple[int, ...],
    cfar: Cfar,
    *,
    window: str = "boxcar",
    n_channels: int = 1,
    oversampling: int = 1,
) -> float:
    """Threshold over the mean of noise, where it is the same all over a map."""
    from scipy.special import gammaincinv

    _, factor, rank = _rule(shape, cfar, window, n_channels, oversampling)
    return float(factor * gammaincinv(n_channels, _QUANTILE) / n_channels) if rank else factor


@lru_cache(maxsize=64)
def _rule(
    shape: tuple[int, ...], cfar: Cfar, window: str, n_channels: int, oversampling: int
) -> tuple[list[Mask], float, int]:
    """Training cells, the factor on their reference, and for ``os`` the rank of that, else 0."""
    regions = _regions(shape, cfar)
    rank = 0
    if cfar.method == "os":
        regions = [_thinned(regions[0], shape, window, oversampling)]
        rank = round(_QUANTILE * int(regions[0].sum()))
    cells = int(regions[0].sum())
    alike = _independent(shape, _offsets(regions[0]), window, oversampling, rank / cells)
    assert not isinstance(cfar.shape, str)
    factor = cfar_factor(
        cfar.false_alarm, alike, cfar.method, n_channels, rank * alike / cells, cfar.shape
    )
    return regions, factor, rank


def _by_rate(power: Power, window: str, n_channels: int) -> Array:
    """Noise at each rate over the mean of all, (n_rates,); ones where only chance differs."""
    if len(power) < _FEWEST_RANGES:
        return np.ones(power.shape[1])
    stride = max(1, len(power) // _MOST_RANGES)
    rows = power[::stride]
    middle = len(rows) // 2
    columns = np.ascontiguousarray(rows.T)
    medians = np.partition(columns, middle, axis=1)[:, middle].astype(np.float64)
    if not np.all(medians > 0):
        return np.ones(len(medians))
    # Of the median of gamma distributed cells, of which a window makes some alike.
    alike = float(np.mean(taper(window, len(power)) ** 2)) / min(stride, 2)
    error = 1.44 * np.sqrt(max(alike, 1.0) / (n_channels * len(rows)))
    ratio = medians / medians.mean()
    return ratio if np.std(ratio) > _UNLIKE * error else np.ones(len(medians))


def _even(power: Power, by_rate: Array) -> Power:
    """Power over the noise of its rate: the training cells' rates are not those of their cell."""
    if np.all(by_rate == 1):
        return power
    return np.asarray(power / by_rate.astype(power.dtype))


@lru_cache(maxsize=64)
def cfar_factor(
    false_alarm: float,
    cells: float,
    method: Method = "ca",
    n_channels: int = 1,
    rank: float | None = None,
    clutter_shape: float = np.inf,
) -> float:
    """Threshold over the reference of ``cells`` independent cells (in each half, for ``go``)."""
    from scipy.optimize import brentq
    from scipy.special import betaincinv, gammaincinv
    from scipy.stats import norm

    # Over the reference's quantiles, spaced evenly in a normal variable: its tails are reached.
    x = np.linspace(-12, 12, 4001)
    weight = norm.pdf(x) * (x[1] - x[0])
    u = norm.cdf(x)
    # Of the mean: 1 over the square of its relative deviation.
    shape = cells / ((1 + 1 / n_channels) * (1 + 1 / clutter_shape) - 1)
    if method == "ca":
        z = gammaincinv(shape, u) / shape
    elif method == "go":
        z = gammaincinv(shape, np.sqrt(u)) / shape
    else:
        rank = _QUANTILE * cells if rank is None else rank
        z = quantile(betaincinv(rank, cells - rank + 1, u), n_channels, clutter_shape)

    def excess(log_factor: float) -> float:
        rate = weight @ survival(np.exp(log_factor) * z, n_channels, clutter_shape)
        return float(np.log(rate + 1e-300) - np.log(false_alarm))

    return float(np.exp(brentq(excess, -20, 20, xtol=1e-10)))


def _regions(shape: tuple[int, ...], cfar: Cfar) -> list[Mask]:
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


def _offsets(region: Mask) -> NDArray[np.intp]:
    """Rows and columns of a region's cells relative to its middle, (n_cells, 2)."""
    return np.argwhere(region) - np.array(region.shape) // 2


def _thinned(region: Mask, shape: tuple[int, ...], window: str, oversampling: int) -> Mask:
    """Of the training cells those on a grid wide enough that few are left to sort, nearly alone."""
    steps = [
        max(1, int(np.argmax(correlation(taper(window, n // oversampling), oversampling) < 0.05)))
        for n in shape
    ]
    rows, columns = (np.arange(n) - n // 2 for n in region.shape)
    while True:
        thin = region & ((rows % steps[0] == 0)[:, None] & (columns % steps[1] == 0))
        if thin.sum() <= _MOST_ORDERED:
            return thin if thin.sum() > 1 else region
        steps[int(np.argmin(steps))] += 1


def _least(power: Power, region: Mask) -> Array:
    """Lower bound of a region's mean for all cells of every tile."""
    rows, columns = (size // _TILE for size in power.shape)
    tiles = power.reshape(rows, _TILE, columns, _TILE).sum(axis=(1, 3), dtype=np.float64)
    certain = _certain(region.tobytes(), region.shape)
    if not certain.any() or any(c > t for c, t in zip(certain.shape, tiles.shape, strict=True)):
        return np.zeros_like(tiles)
    return np.maximum(_sums(tiles, certain), 0) / region.sum()


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


def _sums(power: Power, region: Mask) -> Array:
    """Sum over a region, a box or a box with a hole, around every cell; the map wraps around."""
    if power.flags.f_contiguous and not power.flags.c_contiguous:
        return _sums(power.T, region.T).T
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


def _gathered(power: Power, offsets: NDArray[np.intp], rank: int, at: Cells) -> Array:
    """Mean, or with a rank (from 1) the rank-th smallest, of the cells around chosen ones."""
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
