"""Doppler within a symbol: by how much it shifts the delay at which an echo is measured.

The samples of a symbol are turned by a moving echo, so that subcarriers leak into each other. After
division by the sent symbols a Zadoff-Chu symbol, a chirp, is shifted by up to as many delay cells
as the echo turns it by cycles, with a sign that depends on where the echo's delay cuts the chirp;
others lose power. Of one echo both are known once its delay and its rate are.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.measurement import EchoMeasurement
from hardware.radar.refinement import Blocks, echo_amplitudes
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

_NEGLIGIBLE = 0.02  # of the delay's standard error
_FELT = 0.01  # of a cell's noise, from which what an echo leaks is told from it
_NEWTON_STEPS = 4
_LEAST_GAIN = 0.1  # less is no echo that could be measured


def without_doppler_within_symbols(
    echo: EchoMeasurement, waveform: OfdmWaveform
) -> EchoMeasurement:
    """An echo at the delay and with the power that it would be measured with if it did not turn
    the samples of a symbol.
    """
    turns = abs(echo.delay_rate) * waveform.carrier_hz * waveform.symbol_s
    is_felt = turns * waveform.delay_cell_s > _NEGLIGIBLE * echo.delay_error_s  # not of NaN
    if echo.is_corrected or not is_felt:
        return echo
    response = leaked_response(waveform, echo.delay_s, echo.delay_rate)
    shift_s, gain = _highest_point(response, waveform, echo.window)
    kept = max(gain, _LEAST_GAIN) ** 2
    return replace(
        echo,
        delay_s=(echo.delay_s - shift_s) % waveform.max_delay_s,
        power_w=echo.power_w / kept,
        power_error_w=echo.power_error_w / kept,
    )


def channel_without_leakage(
    channel: Complex, echo: EchoMeasurement, waveform: OfdmWaveform, noise_w: float
) -> Complex:
    """A channel (..., n_subcarriers, n_slots) in which an echo, and others of about its delay and
    rate, are as if they did not turn the samples of a symbol; the same one where that is nothing
    beside the noise of a cell.
    """
    if np.isnan(echo.delay_s) or not _leaks(echo.delay_rate, echo.power_w, waveform, noise_w):
        return channel
    response = leaked_response(waveform, echo.delay_s, echo.delay_rate)
    undone = response.conj() / np.maximum(np.abs(response) ** 2, _LEAST_GAIN)
    return np.asarray(channel * undone.astype(channel.dtype)[:, None])


def leakage_of(
    blocks: Blocks, step: NDArray[np.float64], waveform: OfdmWaveform, noise_w: float
) -> NDArray[np.complex128] | None:
    """What an echo at cells (2,) from the middle of blocks leaks to each subcarrier, over the echo,
    (n_subcarriers,); None where it is nothing beside the noise of a cell.
    """
    delay_s, delay_rate = np.array([blocks.delay_s, blocks.delay_rate]) + step * blocks.grid.cell
    power_w = float(np.mean(np.abs(echo_amplitudes(blocks, step)) ** 2))
    if not _leaks(float(delay_rate), power_w, waveform, noise_w):
        return None
    response = leaked_response(waveform, float(delay_s), float(delay_rate))
    return response / response.mean() - 1


def _leaks(delay_rate: float, power_w: float, waveform: OfdmWaveform, noise_w: float) -> bool:
    """Whether what an echo leaks is felt beside the noise of a cell; not at a rate of NaN."""
    turn = np.pi * delay_rate * waveform.carrier_hz * waveform.symbol_s
    return bool(turn**2 / 3 * power_w > _FELT * noise_w)


def leaked_response(
    waveform: OfdmWaveform, delay_s: float, delay_rate: float
) -> NDArray[np.complex128]:
    """Channel of a moving echo over that of one at rest at the same delay, (n_subcarriers,).

    Samples are turned by exp(-2 pi j (fc + f) rate t): exactly at the carrier, by the first term of
    the series in f, the echo's own way within the symbol.
    """
    from scipy.fft import fft, ifft

    n, offsets_hz = waveform.n_subcarriers, waveform.frequency_offsets_hz
    sent = waveform.sent() * np.exp(-2j * np.pi * offsets_hz * delay_s)
    turn = -2j * np.pi * delay_rate * (np.arange(n) - (n - 1) / 2) * waveform.delay_cell_s
    # At an intermediate frequency of half the band, which changes nothing.
    samples = ifft(sent) + turn * ifft(offsets_hz * sent)
    samples *= np.exp(waveform.carrier_hz * turn)
    response: NDArray[np.complex128] = fft(samples) * sent.conj()
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
