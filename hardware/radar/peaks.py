"""Peaks of a range-Doppler map above the noise around them."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.radar.cfar import cfar_threshold
from hardware.radar.cfar_rule import Cfar, MapNoise, white_threshold
from hardware.radar.range_doppler import RangeDopplerMap
from hardware.radar.screening import candidate_cells

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Peaks:
    """Peaks, (n,) each: delay, delay rate, power, and mean noise around them."""

    delay_s: Array
    delay_rate: Array
    power_w: NDArray[np.floating[Any]]
    noise_w: Array

    def __len__(self) -> int:
        return len(self.power_w)

    def __getitem__(self, which: NDArray[np.intp]) -> "Peaks":
        return Peaks(*(getattr(self, field.name)[which] for field in fields(self)))

    def strongest(self, at_most: int) -> "Peaks":
        """The highest few, highest first."""
        return self[np.argsort(-self.power_w, kind="stable")[:at_most]]


def peaks_above(image: RangeDopplerMap, cfar: Cfar, window: str) -> Peaks:
    """Cells above their threshold that are local maxima."""
    power = image.power_w
    noise = MapNoise(window, image.n_channels, image.oversampling, image.relative_noise)
    rows, columns = candidate_cells(power, cfar, noise)
    peak = _are_peaks(power, rows, columns)
    rows, columns = rows[peak], columns[peak]
    threshold = cfar_threshold(power, cfar, noise, at=(rows, columns))
    above = power[rows, columns] > threshold
    rows, columns, threshold = rows[above], columns[above], threshold[above]
    return Peaks(
        delay_s=image.delay_s[rows],
        delay_rate=image.delay_rate[columns],
        power_w=power[rows, columns],
        noise_w=threshold / white_threshold(power.shape, cfar, noise),
    )


def _are_peaks(
    power: NDArray[np.floating[Any]], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether cells are the highest of the 5 x 5 around them; the map wraps around."""
    from scipy.ndimage import maximum_filter

    sizes = [min(5, size) for size in power.shape]
    if len(rows) > power.size // 25:
        top = maximum_filter(power, sizes, mode="wrap")[rows, columns]
    else:
        reach = [np.arange(size) - size // 2 for size in sizes]
        around = power[
            (rows[:, None, None] + reach[0][:, None]) % power.shape[0],
            (columns[:, None, None] + reach[1]) % power.shape[1],
        ]
        top = around.max(axis=(1, 2))
    return np.asarray((power[rows, columns] >= top) & (top > 0))
