"""The channel as a receiver finds it, with Doppler within a symbol.

A sample of a symbol is that of the channel at its own time. What moves has gone on meanwhile, so
that subcarriers leak into each other: division by sent Zadoff-Chu symbols then shifts ranges, and
random ones leave noise beside an echo (Hakobyan and Yang, "A novel intercarrier-interference free
signal processing scheme for OFDM radar", IEEE Trans. Veh. Technol. 67, 2018). The channel of what
moves is interpolated over a symbol from a few times within it.
"""

from collections.abc import Iterator

import numpy as np

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.channel import synthesize
from twin.radar.synthesis.contributions import Array, Complex, Contributions
from twin.radar.synthesis.times import chebyshev_times, interpolation

_MOST_TIMES = 64  # within a symbol, which then turns by 20 cycles
_MOST_CELLS = 2**24  # of the channel at several times: 256 MB


def demodulated(
    contributions: Contributions,
    waveform: OfdmWaveform,
    tolerance: float = 1e-6,
    out: Complex | None = None,
) -> Complex:
    """Channel of all contributions after division by what is sent, ``(n_subcarriers, n_slots)``.

    Parameters as of `synthesize`, whose channel it is where nothing moves by more than the
    tolerance within a symbol.
    """
    from scipy.fft import fft

    times_s = _times(contributions, waveform, tolerance)
    if len(times_s) == 1:
        return synthesize(contributions, waveform, tolerance, out)
    moving = contributions.moving
    out = synthesize(contributions.take(~moving), waveform, tolerance, out)
    n = waveform.n_subcarriers
    sample_times_s = (np.arange(n, dtype=np.float64) - (n - 1) / 2) * waveform.delay_cell_s
    shares = interpolation(times_s, sample_times_s)
    samples = np.zeros((waveform.n_slots, n), dtype=np.complex128)
    received = _received(contributions.take(moving), waveform, tolerance, times_s)
    for share, there in zip(shares, received, strict=True):
        samples += share * there
    spectrum = fft(samples, axis=-1, overwrite_x=True, workers=-1)
    spectrum *= waveform.sent().conj()
    out += spectrum.T
    return out


def _received(
    contributions: Contributions, waveform: OfdmWaveform, tolerance: float, times_s: Array
) -> Iterator[Complex]:
    """Samples (n_slots, n_subcarriers) of each of several times within a symbol, as if all samples
    were taken then; at an intermediate frequency of half the band, which changes no leakage.
    """
    from scipy.fft import ifft

    shape = waveform.n_slots, waveform.n_subcarriers
    together = max(1, _MOST_CELLS // (shape[0] * shape[1]))
    for first in range(0, len(times_s), together):
        some_s = times_s[first : first + together, None] + waveform.slot_times_s
        channel = synthesize(contributions, waveform, tolerance, times_s=some_s.ravel()).T
        channel *= waveform.sent()
        samples = ifft(channel, axis=-1, overwrite_x=True, workers=-1)
        yield from samples.reshape(-1, *shape)


def _times(contributions: Contributions, waveform: OfdmWaveform, tolerance: float) -> Array:
    """Times within a symbol, from its middle, from which it is interpolated."""
    end_s = waveform.symbol_s / 2
    latest_s = float(np.abs(waveform.slot_times_s).max()) + end_s
    rates = np.abs(contributions.delay_rate)
    fastest = rates + np.abs(contributions.delay_acceleration_per_s) * latest_s
    top_hz = waveform.carrier_hz + waveform.bandwidth_hz / 2
    turn_rad = 2 * np.pi * top_hz * float(fastest.max(initial=0.0)) * end_s
    return chebyshev_times(turn_rad, 0.0, end_s, tolerance, _MOST_TIMES)
