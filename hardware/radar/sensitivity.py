"""Weak echoes, detected on the map without a window, above the side lobes of strong ones.

A window with low side lobes adds noise: 6 dB with ``blackmanharris`` along both axes. Without a
window the noise is least, but side lobes of strong echoes fill their rows and columns of the map.
They are bounded: an echo of power P gives at most P / (N sin(pi k / N))^2 at k of N cells from it,
and the windowed map shows where strong echoes are. A cell above the threshold for the sum of noise
and that bound contains an echo.

An echo midway between four cells is 7.8 dB weaker on each of them. Candidates are selected by a
matched filter over three by three cells, their power is measured over more. The rate at which noise
exceeds a level anywhere between the cells is the expected Euler characteristic of the excursion set
(Worsley, Adv. Appl. Prob. 26, 1994, for chi-squared fields).
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.radar.cfar import Cells, cfar_threshold
from hardware.radar.cfar_rule import Cfar, MapNoise, white_threshold
from hardware.radar.demodulation import Complex
from hardware.radar.k_distribution import ClutterFit, fit
from hardware.radar.peaks import Peaks
from hardware.radar.range_doppler import (
    RangeDopplerMap,
    complex_map,
    mean_power,
    noise_level,
    range_doppler,
)
from hardware.radar.screening import cells_above
from hardware.radar.whitening import whiten
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_TILE = 4  # cells along each side, for which side lobes are bounded at once
# Of the threshold: cells below it are no candidates. An echo as high as the threshold has at least
# a sixth of its power on the nearest cell; the cells next to it hold at least 0.73 of it, with an
# error of at most 0.3.
_ON_CELLS = 0.28
_FROM_NEXT = 0.47
# Cells to each side of the matched filter, and positions between cells at which it is evaluated:
# cells farther away hold at most 7 % of the power, and 1 % is lost between two positions.
_NEXT = (1, 7)
_NEAR = (5, 13)
_CLUTTER_BELOW = 1e3  # times the noise: stronger cells count as echoes, not as clutter
_MOST_CANDIDATES = 0.05  # of all cells, in noise


def weak_echoes(
    channel: Complex, waveform: OfdmWaveform, tapered: RangeDopplerMap, cfar: Cfar, window: str
) -> tuple[Peaks, float, float]:
    """Echoes on the map without a window, the mean noise of its cells, and the share of the false
    alarms that remains: side lobes raise the threshold.

    Parameters
    ----------
    channel, waveform
        Input of `range_doppler`.
    tapered, window
        Its map with a window, and that window.
    cfar
        ``false_alarm`` is the expected number of false echoes per cell.
    """
    from scipy.special import gammaincc

    n, m = channel.shape[-2:]
    images, _ = whiten([complex_map(part, "boxcar") for part in channel.reshape(-1, n, m)])
    power = mean_power(images)
    looks, noise_w = len(images), noise_level(power, len(images))
    uneven = np.ones((n, m))
    if tapered.relative_noise is not None:
        uneven = np.broadcast_to(_on_cells(tapered), (n, m))
        scale = np.roll(1 / np.sqrt(uneven), -((m - 1) // 2), 1).T.astype(power.dtype)
        images = [image * scale for image in images]
        power = power / uneven.astype(power.dtype)
    even_w = noise_level(power, looks)
    cfar = replace(
        cfar, false_alarm=on_a_cell(cfar.false_alarm, looks, sum(size > 2 for size in (n, m)))
    )
    factor = _white_threshold(cfar.false_alarm, looks)
    least = max(_ON_CELLS * factor, _white_threshold(_MOST_CANDIDATES, looks)) * even_w
    rows, columns = cells_above(power, least)
    tiles = _side_lobes(tapered, window, factor, (n, m)) / uneven[::_TILE, ::_TILE]
    come = float(np.mean(gammaincc(looks, looks * factor * (1 + tiles / (even_w or 1.0)))))
    share = come / cfar.false_alarm
    lobes = tiles[rows // _TILE, columns // _TILE]
    if len(lobes):  # the highest cell is no side lobe; in a small map its own bound covers all
        lobes[np.argmax(power[rows, columns])] = 0.0
    clear = power[rows, columns] > _ON_CELLS * factor * (even_w + lobes)
    rows, columns, lobes = rows[clear], columns[clear], lobes[clear]
    level = _between_cells(images, (rows, columns), *_NEXT)
    clear = level > _FROM_NEXT * factor * (even_w + lobes)
    rows, columns, lobes = rows[clear], columns[clear], lobes[clear]
    level = _between_cells(images, (rows, columns), *_NEAR)
    noise = MapNoise(n_channels=looks)
    threshold = cfar_threshold(power, cfar, noise, at=(rows, columns))
    clear = level > threshold + factor * lobes
    rows, columns, level, threshold = rows[clear], columns[clear], level[clear], threshold[clear]
    peaks = Peaks(
        delay_s=np.asarray(rows * waveform.delay_cell_s, dtype=np.float64),
        delay_rate=(columns - (m - 1) // 2) * waveform.delay_rate_cell,
        power_w=level * uneven[rows, columns],
        noise_w=threshold * uneven[rows, columns] / white_threshold(power.shape, cfar, noise),
    )
    return peaks, noise_w, share


def clutter_between_echoes(
    channel: Complex, waveform: OfdmWaveform, tapered: RangeDopplerMap, window: str
) -> ClutterFit:
    """Deviation from noise of the map without a window, away from the side lobes of echoes.

    A window averages the clutter of several cells: shapes are larger on its map.
    """
    n, m = channel.shape[-2:]
    plain = range_doppler(channel, waveform, "boxcar")
    power = plain.power_w.astype(np.float64)
    power /= _on_cells(tapered)
    lobes = _side_lobes(tapered, window, _CLUTTER_BELOW, (n, m))
    lobes = np.repeat(np.repeat(lobes, _TILE, 0)[:n], _TILE, 1)[:, :m]
    power[lobes > plain.noise_w] = np.nan
    return fit(power, plain.n_channels)


def _on_cells(image: RangeDopplerMap) -> Array:
    """Known noise of a map on the cells of one that is not oversampled."""
    if image.relative_noise is None:
        return np.ones((1, 1))
    return image.relative_noise[:: image.oversampling, :: image.oversampling]


def side_lobe(cells: Array, size: int | Array) -> Array:
    """Bound of an echo's power over its peak, at cells from it along an axis of so many cells.

    Without a window: the envelope of the Dirichlet kernel, half a cell nearer.
    """
    away = np.minimum(np.maximum(np.abs(cells) - 0.5, 0), size / 2)
    return np.asarray(1 / np.maximum(1, size * np.sin(np.pi * away / size)) ** 2)


@lru_cache(maxsize=64)
def on_a_cell(false_alarm: float, n_channels: float = 1, axes: int = 2) -> float:
    """Probability of exceeding, on a cell, the level that peaks of noise exceed ``false_alarm``
    times per cell.

    Without a window; peaks between cells count, along so many ``axes``.
    """
    from scipy.optimize import brentq
    from scipy.special import gammaincc, gammaincinv, gammaln

    if axes == 0:
        return false_alarm

    def excess(level: float) -> float:
        """Log of the expected number of peaks per cell above a level, over ``false_alarm``."""
        density = (n_channels - 1) * np.log(level) - level - gammaln(n_channels)
        if axes == 1:
            shape = np.sqrt(np.pi * level / 3)
        else:
            shape = np.pi / 6 * (2 * level - 2 * n_channels + 1)
        return float(density + np.log(shape) - np.log(false_alarm))

    least = float(gammaincinv(n_channels, 1 - false_alarm))
    if least < n_channels or excess(least) <= 0:
        return false_alarm  # so common that peaks run into each other
    level = brentq(excess, least, least + 100)
    return float(gammaincc(n_channels, level))


def _white_threshold(false_alarm: float, n_channels: int) -> float:
    """Level over the mean of known noise."""
    from scipy.special import gammainccinv

    return float(gammainccinv(n_channels, false_alarm) / n_channels)


def _side_lobes(
    tapered: RangeDopplerMap, window: str, factor: float, shape: tuple[int, int]
) -> Array:
    """Bound of the side lobes without a window in every tile, in watts: powers are added.

    An echo's own tile and those beside it hold its whole power.
    """
    fine = tapered.oversampling
    # Twice the threshold: an echo below leaves no side lobe that stands out of noise.
    power, noise_w = tapered.power_w, tapered.noise_w
    if tapered.relative_noise is not None:
        power = power / tapered.relative_noise.astype(power.dtype)
        noise_w = noise_level(power, tapered.n_channels)
    rows, columns = cells_above(power, 2 * factor * noise_w)
    tiles = np.zeros([-(-size // _TILE) for size in shape])
    at = rows // (fine * _TILE), columns // (fine * _TILE)
    np.add.at(tiles, at, tapered.power_w[rows, columns])
    # A lone echo's cells sum to its power times the windows' mean squares.
    tiles /= np.prod([fine * np.mean(normalised_window(window, size) ** 2) for size in shape])
    used = [np.unique(i) for i in at]
    by_range, by_rate = (
        _tile_lobes(size, sources) for size, sources in zip(shape, used, strict=True)
    )
    return np.asarray(by_range @ tiles[np.ix_(*used)] @ by_rate.T)


def _tile_lobes(size: int, sources: NDArray[np.intp]) -> Array:
    """Side-lobe bound in every tile of one axis from each source tile, (n_tiles, n_sources)."""
    away = np.abs(np.arange(-(-size // _TILE))[:, None] - sources) * _TILE
    away = np.minimum(away, size - away)  # the map wraps around
    return side_lobe(np.maximum(away - _TILE - (_TILE - 1), 0), size)


def _between_cells(images: list[Complex], at: Cells, reach: int, n_places: int) -> Array:
    """Highest power near cells; 0 where a neighbour on the map is higher.

    Matched filter over the cells up to ``reach`` along both axes, for an echo at any of
    ``n_places`` along each. The power of noise is that on a cell; an echo loses the part outside.
    Neighbouring cells of one echo differ in phase by pi (1 - 1/N).
    """
    m, n = images[0].shape
    (by_range, down), (by_rate, across) = (_weights(size, reach, n_places) for size in (n, m))
    rows = (at[0][:, None] + down) % n
    columns = (at[1][:, None] + across - (m - 1) // 2) % m
    on_cells = np.zeros((len(rows), len(down), len(across)))
    between = np.zeros((len(rows), len(by_range), len(by_rate)))
    for image in images:
        cells = image[columns[:, None, :], rows[:, :, None]]
        on_cells += np.abs(cells) ** 2 / len(images)
        between += np.abs(by_range @ cells @ by_rate.T) ** 2 / len(images)
    next_to = [slice(max(len(i) // 2 - 1, 0), len(i) // 2 + 2) for i in (down, across)]
    middle = on_cells[:, len(down) // 2, len(across) // 2]
    highest = middle >= on_cells[:, next_to[0], next_to[1]].max(axis=(1, 2), initial=0)
    return np.where(highest, between.max(axis=(1, 2), initial=0), 0.0)


def _weights(
    size: int, reach: int, n_places: int
) -> tuple[NDArray[np.complex128], NDArray[np.intp]]:
    """Of a matched filter along an axis: weights (n_places, n_cells), whose squares sum to 1, and
    cells (n_cells,).
    """
    reach = min(reach, (size - 1) // 2)
    cells = np.arange(-reach, reach + 1)
    places = np.linspace(-0.5, 0.5, n_places) if reach else np.zeros(1)
    echo = np.sinc(cells - places[:, None])
    turn = np.exp(-1j * np.pi * cells * (size - 1) / size)
    return turn * echo / np.linalg.norm(echo, axis=1, keepdims=True), cells
