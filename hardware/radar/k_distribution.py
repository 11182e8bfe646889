"""K-distributed clutter: noise whose mean is itself gamma distributed from cell to cell.

Power x = t s, with s the mean of V exponential looks and t gamma distributed of mean 1 and shape v
(Ward, Tough, Watts, Sea Clutter, IET 2013, section 4.3). Noise is the limit of a large shape; the
smaller the shape, the more often clutter exceeds its mean by far.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Power = NDArray[np.floating[Any]]

_LEVEL = 3e-3  # exceeded by noise: rare enough for shapes to differ, frequent enough to count
_ROWS = 16  # range cells that share a median
_ECHO = 12.0  # times that level, above which a cell and its surroundings count as an echo
_BESIDE = 8  # cells around it
_FEW = 4  # echoes that stand out, at most: more may be clutter's spikes
_CLUMPS = 2.0  # of noise, as many cells as the main lobe of an echo below `_ECHO`
_SHAPES = np.geomspace(0.1, 100.0, 31)
_LOG_X = np.linspace(-16, 9, 401)
_MOST = 2**17  # cells counted, about


@dataclass(frozen=True)
class ClutterFit:
    """Deviation of a map from noise.

    ``exceedance``: share of its cells above the level that noise exceeds in 3 of 1000 cells, over
    3 / 1000; 1 for noise. ``shape``: of the K-distribution with that exceedance, infinite for
    noise. ``uncertain``: relative standard error of the exceedance in noise. ``echoes``: how many
    stand out, which were left out; at most a few count.
    """

    exceedance: float
    shape: float
    uncertain: float
    echoes: int = 0

    @property
    def is_noise(self) -> bool:
        """Whether the exceedance is at most 1.5, within the random error of 1, or what fainter
        echoes add in so few cells that noise hardly ever exceeds the level: one, and one more for
        each that stands out.
        """
        few = _of_echoes(self.uncertain, 1 + self.echoes)
        return self.exceedance <= 1 + max(0.5, 4 * self.uncertain, few)

    def false_alarms(self, false_alarm: float, looks: float) -> float:
        """Rate of false alarms of a threshold for noise, over the rate it was set for."""
        from scipy.special import gammainccinv

        level = gammainccinv(looks, false_alarm) / looks
        return float(survival(np.array([level]), looks, self.shape)[0] / false_alarm)


def survival(x: Array, looks: float, shape: float) -> Array:
    """Probability that a cell of mean 1 exceeds x."""
    from scipy.special import gammaincc

    if np.isinf(shape):
        return np.asarray(gammaincc(looks, looks * x), dtype=np.float64)
    return np.asarray(np.exp(np.interp(np.log(x), _LOG_X, _table(looks, shape))))


def quantile(u: Array, looks: float, shape: float) -> Array:
    """Level below which a cell of mean 1 stays with probability u."""
    from scipy.special import gammaincinv

    if np.isinf(shape):
        return np.asarray(gammaincinv(looks, u) / looks, dtype=np.float64)
    below = -np.expm1(_table(looks, shape))
    rising = np.concatenate([[True], np.diff(below) > 0])
    return np.asarray(np.exp(np.interp(u, below[rising], _LOG_X[rising])))


@lru_cache(maxsize=64)
def _table(looks: float, shape: float) -> Array:
    """Log of the survival function at exp(_LOG_X): a sum over quantiles of the texture."""
    from scipy.special import gammaincc, gammaincinv
    from scipy.stats import norm

    z = np.linspace(-9, 9, 145)
    texture = np.maximum(gammaincinv(shape, norm.cdf(z)), 1e-300) / shape
    texture[z > 0] = _upper(shape, z[z > 0])
    weight = norm.pdf(z)
    levels = np.exp(_LOG_X)[:, None] / texture
    return np.asarray(np.log(gammaincc(looks, looks * levels) @ weight / weight.sum() + 1e-300))


def _upper(shape: float, z: Array) -> Array:
    """Texture at normal deviates above 0, where 1 - cdf keeps its digits."""
    from scipy.special import gammainccinv
    from scipy.stats import norm

    return np.asarray(gammainccinv(shape, norm.sf(z)) / shape, dtype=np.float64)


def fit(power: Power, looks: float, clump: float = 1.0) -> ClutterFit:
    """Fit the shape to a map (n_ranges, n_rates) by how often cells exceed a level.

    Each stripe of 16 ranges is normalised by its own median, so that a change of the mean with
    range does not matter. Surroundings of strong echoes, and cells that are NaN, are left out.
    ``clump``: number of cells that a window makes exceed together.
    """
    from scipy.ndimage import label, maximum_filter

    rows = min(_ROWS, len(power))
    # Few stripes are taken before they are copied: maps come transposed.
    columns = power[: len(power) // rows * rows].T.reshape(power.shape[1], -1, rows)
    some = columns[:, :: max(1, power.size // _MOST)]
    stripes = np.moveaxis(some, 0, -1).reshape(some.shape[1], rows * power.shape[1])
    middle = stripes.shape[1] // 2
    median = np.partition(stripes, middle, axis=1)[:, middle]
    for i in np.flatnonzero(np.isnan(stripes).any(axis=1)):
        known = stripes[i][~np.isnan(stripes[i])]
        median[i] = np.median(known) if len(known) else 0.0
    silent = ~(median > 0)
    relative = stripes / np.where(silent, np.inf, median)[:, None]
    relative = relative.reshape(-1, power.shape[1])
    usable = np.repeat(~silent, rows)[:, None] & np.ones(power.shape[1], dtype=bool)
    usable &= ~np.isnan(relative)
    loud = relative > _ECHO * _level(looks)
    echoes = min(label(loud)[1], _FEW) if loud.any() else 0
    if echoes:
        usable &= ~maximum_filter(loud, 2 * _BESIDE + 1, mode="wrap")
    count = int(usable.sum())
    if not count:
        return ClutterFit(1.0, np.inf, np.inf, echoes)
    noise = _expected(looks, (np.inf,))[0]
    exceedance = float(np.mean(relative[usable] > _level(looks)) / noise)
    uncertain = float(np.sqrt(clump / (count * noise)))
    if exceedance <= 1 + max(2 * uncertain, _of_echoes(uncertain, 1 + echoes)):
        return ClutterFit(exceedance, np.inf, uncertain, echoes)
    rates = np.array(_expected(looks, tuple(_SHAPES))) / noise
    # Rates fall with the shape down to 1 for noise, as 1 / shape in the end.
    known = np.concatenate([[0.0], 1 / _SHAPES[::-1]])
    inverse = np.interp(exceedance, np.concatenate([[1.0], rates[::-1]]), known)
    # On a coarse raster: tables of nearby shapes are the same.
    shape = float(np.exp(np.round(np.log(1 / inverse), 2))) if inverse > 0 else np.inf
    return ClutterFit(exceedance, shape, uncertain, echoes)


def _of_echoes(uncertain: float, count: int) -> float:
    """What the main lobes of a few echoes add to the exceedance of a map of noise: the square is
    what a clump of cells of one adds, over the expected number of clumps.
    """
    return count * _CLUMPS * uncertain**2


def _level(looks: float) -> float:
    """Level over the median that noise exceeds with the probability `_LEVEL`."""
    from scipy.special import gammainccinv

    return float(gammainccinv(looks, _LEVEL) / gammainccinv(looks, 0.5))


@lru_cache(maxsize=16)
def _expected(looks: float, shapes: tuple[float, ...]) -> tuple[float, ...]:
    """Probability of exceeding `_level` times the median, by shape."""
    rates = []
    for shape in shapes:
        median = quantile(np.array([0.5]), looks, shape)
        rates.append(float(survival(_level(looks) * median, looks, shape)[0]))
    return tuple(rates)
