"""Doppler within a symbol: by how much it shifts the delay at which an echo is measured.

The samples of a symbol are turned by a moving echo, so that subcarriers leak into each other. After
division by the sent symbols a Zadoff-Chu symbol, a chirp, is shifted by up to as many delay cells
as the echo turns it by cycles, with a sign that depends on where the echo's delay cuts the chirp;
others lose power. Of one echo both are known once its delay and its rate are.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.measurement import EchoMeasurement
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

_NEGLIGIBLE = 0.02  # of the delay's standard error
_NEWTON_STEPS = 4
_LEAST_GAIN = 0.1  # less is no echo that could be measured


def without_doppler_within_symbols(
    echo: EchoMeasurement, waveform: OfdmWaveform
) -> EchoMeasurement:
    """An echo at the delay and with the power that it would be measured with if it did not turn
    the samples of a symbol.
    """
    turns = abs(echo.delay_rate) * waveform.carrier_hz * waveform.symbol_s
    if not turns * waveform.delay_cell_s > _NEGLIGIBLE * echo.delay_error_s:
        return echo  # NaN, too: a delay or rate that is not measured
    response = leaked_response(waveform, echo.delay_s, echo.delay_rate)
    shift_s, gain = _highest_point(response, waveform, echo.window)
    kept = max(gain, _LEAST_GAIN) ** 2
    return replace(
        echo,
        delay_s=(echo.delay_s - shift_s) % waveform.max_delay_s,
        power_w=echo.power_w / kept,
        power_error_w=echo.power_error_w / kept,
    )


def leaked_response(
    waveform: OfdmWaveform, delay_s: float, delay_rate: float
) -> NDArray[np.complex128]:
    """Channel of a moving echo over that of one at rest at the same delay, (n_subcarriers,)."""
    from scipy.fft import fft, fftshift, ifft, ifftshift

    n = waveform.n_subcarriers
    sent = waveform.sent() * np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    along_symbol_s = (np.arange(n) - (n - 1) / 2) * waveform.delay_cell_s
    turned = np.exp(-2j * np.pi * waveform.carrier_hz * delay_rate * along_symbol_s)
    response: NDArray[np.complex128] = fftshift(fft(ifft(ifftshift(sent)) * turned)) * sent.conj()
    return response


def _highest_point(
    response: NDArray[np.complex128], waveform: OfdmWaveform, window: str
) -> tuple[float, float]:
    """Delay in s and modulus of the highest point of a response's transform."""
    from scipy.fft import fft, fftfreq

    n = waveform.n_subcarriers
    taper = normalised_window(window, n) / n
    cells = float(-fftfreq(n, 1 / n)[np.argmax(np.abs(fft(taper * response)))])
    turn = 2j * np.pi / n * (np.arange(n) - n // 2)
    for _ in range(_NEWTON_STEPS):
        weighted = taper * response * np.exp(turn * cells)
        total, slope, bend = (np.sum(weighted * turn**power) for power in range(3))
        # Of the squared modulus.
        first = (slope * total.conj()).real
        second = (bend * total.conj()).real + abs(slope) ** 2
        cells -= float(first / second) if second else 0.0
    weighted = taper * response * np.exp(turn * cells)
    return cells * waveform.delay_cell_s, float(np.abs(weighted.sum()))
