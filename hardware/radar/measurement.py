"""One echo as it is measured on the channel: delay, delay rate and amplitude, with their errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.refinement import Blocks
from hardware.radar.windows import frequency_variance, normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

#: However strong the noise, an echo stands within a cell of its peak: without a window the error is
#: then that of a place anywhere in one cell to either side, 0.58 cells.
_LEAST_SNR = 0.45


@dataclass(frozen=True, eq=False)
class EchoMeasurement:
    """Delay there and back, its rate (s/s, positive: receding) and power of one echo.

    ``power_w``: received by one antenna, with its standard error ``power_error_w``. ``amplitude``
    (n_channels,): on every channel, in root watts, with its ``noise``. Standard errors follow from
    them and the window; in white noise, without a window, they are the Cramer-Rao bounds. Values
    not measured are NaN: the rate
    from a single slot, the delay from a single subcarrier. ``delay_rate_alternatives``: other rates
    that the record cannot exclude, likeliest first. ``window``: with which it was measured.
    ``is_corrected``: whether what Doppler within symbols makes of it is taken out already.
    """

    delay_s: float
    delay_rate: float
    power_w: float
    snr_db: float
    delay_error_s: float
    delay_rate_error: float
    power_error_w: float
    amplitude: NDArray[np.complex128]
    noise: ChannelNoise
    delay_rate_alternatives: tuple[float, ...] = ()
    window: str = "boxcar"
    is_corrected: bool = False

    @property
    def delay_or_rate_error(self) -> float:
        """Standard error of the delay; of the rate where no delay is measured."""
        return self.delay_rate_error if np.isnan(self.delay_s) else self.delay_error_s


def echo_measurement(
    blocks: Blocks,
    step: Array,
    amplitude: NDArray[np.complex128],
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    noise: ChannelNoise,
) -> EchoMeasurement:
    """The echo ``step`` cells from the middle of blocks.

    ``noise_w``: of the map, for the SNR; ``noise``: of the amplitudes, for the errors. Along an
    axis of one sample nothing is measured: NaN.
    """
    power_w = float(np.mean(np.abs(amplitude) ** 2))
    snr = power_w / noise_w if noise_w else np.inf
    delay_error_s, rate_error = standard_errors(waveform, window, noise.snr(amplitude))
    delay_s = blocks.delay_s + step[0] * blocks.grid.cell[0]
    delay_rate = blocks.delay_rate + step[1] * blocks.grid.cell[1]
    return EchoMeasurement(
        delay_s=float(delay_s % waveform.max_delay_s)
        if waveform.n_subcarriers > 1
        else float("nan"),
        delay_rate=float(delay_rate) if waveform.n_slots > 1 else float("nan"),
        power_w=power_w,
        snr_db=float(10 * np.log10(snr)) if snr else -np.inf,
        delay_error_s=delay_error_s,
        delay_rate_error=rate_error,
        power_error_w=noise.power_error_w(amplitude),
        amplitude=amplitude,
        noise=noise,
        window=window,
    )


def with_noise(echo: EchoMeasurement, noise: ChannelNoise) -> EchoMeasurement:
    """An echo with its standard errors in other noise."""
    before, now = (max(n.snr(echo.amplitude), _LEAST_SNR) for n in (echo.noise, noise))
    wider = float(np.sqrt(before / now)) if now < np.inf else 1.0
    power_error_w = noise.power_error_w(echo.amplitude)
    own_w = echo.noise.power_error_w(echo.amplitude)
    return replace(
        echo,
        delay_error_s=wider * echo.delay_error_s,
        delay_rate_error=wider * echo.delay_rate_error,
        power_error_w=power_error_w * (echo.power_error_w / own_w if own_w else 1.0),
        noise=noise,
    )


def standard_errors(waveform: OfdmWaveform, window: str, snr: float) -> tuple[float, float]:
    """Standard errors of delay and delay rate at an image SNR (after all processing).

    NaN along an axis of one sample.
    """
    if not snr:
        return float("inf"), float("inf")
    told = max(snr, _LEAST_SNR)
    spread = [
        np.sqrt(frequency_variance(normalised_window(window, n)) / told) if n > 1 else np.nan
        for n in (waveform.n_subcarriers, waveform.n_slots)
    ]
    return (
        float(spread[0] / (2 * np.pi * waveform.subcarrier_spacing_hz)),
        float(spread[1] / (2 * np.pi * waveform.carrier_hz * waveform.slot_period_s)),
    )


def without_duplicates(
    echoes: Sequence[EchoMeasurement], waveform: OfdmWaveform, *, folded: bool = True
) -> list[EchoMeasurement]:
    """Strongest first, without duplicates of the same peak, nearer than 0.3 cells.

    ``folded``: rates that differ by whole spans of the Doppler ambiguity count as equal.
    """
    falling = sorted(echoes, key=lambda echo: -echo.power_w)
    near = cells_apart(falling, falling, waveform).max(axis=-1) <= 0.3
    if not folded:
        rates = np.array([echo.delay_rate for echo in falling])
        near &= ~(np.abs(rates[:, None] - rates) > waveform.max_delay_rate)
    distinct: list[int] = []
    for i in range(len(falling)):
        if not near[i, distinct].any():
            distinct.append(i)
    return [falling[i] for i in distinct]


def cells_apart(
    some: Sequence[EchoMeasurement], others: Sequence[EchoMeasurement], waveform: OfdmWaveform
) -> Array:
    """Cells between echoes along delay and rate (n_some, n_others, 2); 0 along what is not
    measured.
    """
    here, there = (
        np.array([(echo.delay_s, echo.delay_rate) for echo in echoes]).reshape(-1, 2)
        for echoes in (some, others)
    )
    cell = np.array([waveform.delay_cell_s, waveform.delay_rate_cell])
    sizes = np.array([waveform.n_subcarriers, waveform.n_slots])
    cells = np.abs(np.nan_to_num((here[:, None] - there) / cell)) % sizes
    return np.minimum(cells, np.abs(sizes - cells))  # the map wraps around
