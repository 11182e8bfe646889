"""Noise in the cell of an echo, where that of the cells around is another one.

Phase noise of the leakage is subtracted less completely from cells that hold an echo: up to four
times as much of it is left there. It has the leakage's ratios between the receivers.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.burst import DemodulatedBurst
from hardware.radar.measurement import EchoMeasurement, with_noise
from hardware.radar.residue import AROUND

Array = NDArray[np.float64]


def with_noise_of_its_cell(echo: EchoMeasurement, burst: DemodulatedBurst) -> EchoMeasurement:
    """An echo with the noise of its own cell, and standard errors in it.

    Its noise was measured on the cells around; how the cells differ is known.
    """
    if burst.relative_noise is None:
        return echo
    relative, n_channels = burst.relative_noise, len(burst.channel)
    modes = np.eye(n_channels, dtype=np.complex128)
    if burst.leakage is not None:
        by_transmitter = burst.tdm_offset_s[:, None] == np.unique(burst.tdm_offset_s)
        modes = burst.leakage[:, None] * by_transmitter
        modes /= np.linalg.norm(modes, axis=0)
        n_receivers = n_channels // modes.shape[1]
        relative = n_receivers * (relative - 1) + 1  # the others of its parts are even
    wave = burst.waveform
    place = (
        echo.delay_s / wave.delay_cell_s,
        echo.delay_rate / wave.delay_rate_cell + (relative.shape[1] - 1) // 2,
    )
    own = [_shares(size, at) for size, at in zip(relative.shape, place, strict=True)]
    steps = range(-AROUND, AROUND + 1)
    around = [np.mean([np.roll(part, step) for step in steps], axis=0) for part in own]
    factor = own[0] @ relative @ own[1] / (around[0] @ relative @ around[1])
    return with_noise(echo, echo.noise.raised(float(factor), modes))


def _shares(size: int, place: float) -> Array:
    """Share (size,) of every cell's noise in that of an echo between cells; all alike of a place
    that is not measured.
    """
    if size == 1 or np.isnan(place):
        return np.full(size, 1 / size)
    away = np.arange(size) - place
    share = (np.sinc(away) / np.sinc(away / size)) ** 2
    return np.asarray(share / share.sum())
