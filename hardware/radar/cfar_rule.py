"""Training cells of CFAR, and the factor of the threshold on their reference level.

A noise cell, the mean of V channels, is gamma distributed with shape V. The reference z is

- ``ca``: the mean of n training cells;
- ``go``: the greater of the means before and behind in range, for edges of clutter;
- ``os``: the k-th smallest of n, k = 3 n / 4, for neighbours among the training cells;

and a cell is a detection above factor * z. The factor solves E[Q(V, V factor z)] = Pfa over z's
distribution (Q the regularised upper gamma function). For one channel and independent cells that
is the textbooks' n (Pfa^(-1/n) - 1) for ``ca`` and prod (n - i) / (n - i + factor) = Pfa for ``os``
(Rohling, IEEE Trans. AES 19, 1983).

A window correlates neighbouring cells: n cells are then equivalent to fewer independent ones, whose
number replaces n. For a mean it is the number with the same variance; for a quantile, the number
with the same variance of the share of cells below it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_choice, check_count
from hardware.radar.k_distribution import quantile, survival
from hardware.radar.windows import correlation, main_lobe, normalised_window

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Method = Literal["ca", "go", "os"]
QUANTILE = 0.75  # of the training cells, for os
_LEAST_SHAPE = 0.1  # of clutter, as `fit` gives it
_RAREST = 1e-100  # probability of false alarm; rarer ones are beyond what numbers hold
_WIDEST = 20.0  # logarithm of the threshold over its reference
_MOST_ORDERED = 96  # cells that os sorts


@dataclass(frozen=True)
class Cfar:
    """Rule of a CFAR detector.

    Parameters
    ----------
    false_alarm
        Probability of false alarm per cell.
    method
        ``ca``, ``go`` or ``os``.
    guard, training
        Guard and training cells on each side along range and rate. The guard must cover the main
        lobe of the window: 3 for ``blackmanharris``.
    shape
        Of K-distributed clutter, from 0.1 on; infinite for noise. ``"fitted"``: to each map, and
        by `process` to the map without a window, which does not average clutter over cells.
    """

    false_alarm: float = 1e-8
    method: Method = "os"
    guard: tuple[int, int] = (6, 6)
    training: tuple[int, int] = (16, 12)
    shape: float | Literal["fitted"] = float("inf")

    def __post_init__(self) -> None:
        rate: object = self.false_alarm
        if not (isinstance(rate, int | float | np.number) and _RAREST <= rate < 1):
            raise InputError(
                f"false_alarm: {rate!r:.60}, expected a number between 0 and 1, from {_RAREST:g} on"
            )
        check_choice("method", self.method, get_args(Method))
        for name in ("guard", "training"):
            sides = getattr(self, name)
            if not (isinstance(sides, tuple) and len(sides) == 2):
                raise InputError(f"{name}: {sides!r:.60}, expected cells along range and rate")
            for side in sides:
                check_count(name, side, 0)
        shape: object = self.shape
        if isinstance(shape, str) and shape == "fitted":
            return
        is_number = isinstance(shape, int | float) and not isinstance(shape, bool)
        if not (is_number and float(self.shape) >= _LEAST_SHAPE):
            raise InputError(
                f"shape: {shape!r:.60}, expected a positive number or 'fitted', from "
                f"{_LEAST_SHAPE:g} on"
            )
        object.__setattr__(self, "shape", float(self.shape))


def has_training_cells(shape: tuple[int, ...], cfar: Cfar) -> bool:
    """Whether the guard cells leave any of a map."""
    return any(size > 2 * guard + 1 for size, guard in zip(shape, cfar.guard, strict=True))


def one_echo_fills(shape: tuple[int, ...], cfar: Cfar, window: str, oversampling: int = 1) -> bool:
    """Whether the main lobe of one echo may hold as many training cells of another as ``os`` leaves
    above its reference: beside it the other's threshold is that of the lobe.
    """
    lobe = [
        min((2 * main_lobe(window, size // oversampling) + 1) * oversampling, size)
        for size in shape
    ]
    cells = min(int(region.sum()) for region in _regions(shape, cfar))
    return float(np.prod(lobe)) > (1 - QUANTILE) * cells


@dataclass(frozen=True, eq=False)
class MapNoise:
    """Properties of a map's noise: correlation of its cells, and their distribution.

    Parameters
    ----------
    window, n_channels, oversampling
        As in `range_doppler`.
    relative_noise : (n_ranges, n_rates) or (n_ranges, 1)
        Mean noise, in any unit, where it is known to vary within the training cells.
    """

    window: str = "boxcar"
    n_channels: int = 1
    oversampling: int = 1
    relative_noise: Array | None = None


def rule(shape: tuple[int, ...], cfar: Cfar, noise: MapNoise) -> tuple[list[Mask], float, int]:
    """Training cells, the factor on their reference, and for ``os`` the rank of that, else 0."""
    return _rule(shape, cfar, noise.window, noise.n_channels, noise.oversampling)


@lru_cache(maxsize=64)
def _rule(
    shape: tuple[int, ...], cfar: Cfar, window: str, n_channels: int, oversampling: int
) -> tuple[list[Mask], float, int]:
    """Training cells, the factor on their reference, and for ``os`` the rank of that, else 0."""
    regions = _regions(shape, cfar)
    rank = 0
    if cfar.method == "os":
        regions = [_sparse_cells(regions[0], shape, window, oversampling)]
        rank = round(QUANTILE * int(regions[0].sum()))
    cells = int(regions[0].sum())
    alike = _independent(shape, offsets_of(regions[0]), window, oversampling, rank / cells)
    assert not isinstance(cfar.shape, str)
    factor = cfar_factor(
        cfar.false_alarm, alike, cfar.method, n_channels, rank * alike / cells, cfar.shape
    )
    return regions, factor, rank


def white_threshold(shape: tuple[int, ...], cfar: Cfar, noise: MapNoise) -> float:
    """Threshold over the mean of uniform noise."""
    from scipy.special import gammaincinv

    _, factor, rank = rule(shape, cfar, noise)
    looks = noise.n_channels
    return float(factor * gammaincinv(looks, QUANTILE) / looks) if rank else factor


@lru_cache(maxsize=64)
def cfar_factor(
    false_alarm: float,
    cells: float,
    method: Method = "ca",
    n_channels: int = 1,
    rank: float | None = None,
    clutter_shape: float = np.inf,
) -> float:
    """Threshold over the reference of ``cells`` independent cells (in each half, for ``go``).

    Raises InputError where no threshold has this probability of false alarm.
    """
    from scipy.optimize import brentq
    from scipy.special import betaincinv, gammaincinv, ndtr

    # Over the reference's quantiles, spaced evenly in a normal variable: its tails are reached.
    x = np.linspace(-12, 12, 4001)
    weight = np.exp(-(x**2) / 2.0) / np.sqrt(2 * np.pi) * (x[1] - x[0])
    u = ndtr(x)
    # Of the mean: 1 over the square of its relative deviation.
    shape = cells / ((1 + 1 / n_channels) * (1 + 1 / clutter_shape) - 1)
    if method == "ca":
        z = gammaincinv(shape, u) / shape
    elif method == "go":
        z = gammaincinv(shape, np.sqrt(u)) / shape
    else:
        rank = QUANTILE * cells if rank is None else rank
        z = quantile(betaincinv(rank, cells - rank + 1, u), n_channels, clutter_shape)

    def excess(log_factor: float) -> float:
        rate = weight @ survival(np.exp(log_factor) * z, n_channels, clutter_shape)
        return float(np.log(rate + 1e-300) - np.log(false_alarm))

    if not excess(-_WIDEST) > 0 > excess(_WIDEST):
        raise InputError(
            f"false_alarm: {false_alarm:g}: no threshold has it, in clutter of shape "
            f"{clutter_shape:g} and with {cells:.3g} training cells"
        )
    return float(np.exp(brentq(excess, -_WIDEST, _WIDEST, xtol=1e-10)))


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
        raise InputError(f"training: no training cells in a map of {tuple(shape)}")
    return regions


def offsets_of(region: Mask) -> NDArray[np.intp]:
    """Rows and columns of a region's cells relative to its middle, (n_cells, 2)."""
    return np.argwhere(region) - np.array(region.shape) // 2


def _sparse_cells(region: Mask, shape: tuple[int, ...], window: str, oversampling: int) -> Mask:
    """Training cells on a coarser grid: nearly uncorrelated ones, few enough to sort."""
    steps = [
        max(
            1,
            int(
                np.argmax(
                    correlation(normalised_window(window, n // oversampling), oversampling) < 0.05
                )
            ),
        )
        for n in shape
    ]
    rows, columns = (np.arange(n) - n // 2 for n in region.shape)
    while True:
        thin = region & ((rows % steps[0] == 0)[:, None] & (columns % steps[1] == 0))
        if thin.sum() <= _MOST_ORDERED:
            return thin if thin.sum() > 1 else region
        steps[int(np.argmin(steps))] += 1


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
    rho = [correlation(normalised_window(window, n // oversampling), oversampling) for n in shape]
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
