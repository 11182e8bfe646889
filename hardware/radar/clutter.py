"""Taking away what is known to be there: the leakage, what it fluctuates, what stands still."""

import numpy as np

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import OfdmWaveform

_BESIDE = 3  # cells either side of the leakage from which fluctuation is taken


def without_leakage(channel: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """A channel (..., n_subcarriers, n_slots) less a constant path of known delay.

    Its amplitude is the least-squares one, so a static echo at the same delay goes with it; one a
    cell of range apart loses nothing, one between less.
    """
    path = np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s).astype(channel.dtype)
    amplitude = np.einsum("...nm,n->...", channel, path.conj())
    amplitude /= channel.shape[-2] * channel.shape[-1]
    return np.asarray(channel - amplitude[..., None, None] * path[:, None])


def without_fluctuation(channel: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """A channel (..., n_subcarriers, n_slots) less what changes from slot to slot within three
    cells of range of a delay: what an oscillator's slow phase noise makes of the leakage.

    A fit with a window, which keeps moving echoes from five cells on out of it; nearer ones are
    lost. What stands still stays.
    """
    n = channel.shape[-2]
    beside = np.arange(-_BESIDE, _BESIDE + 1) / waveform.bandwidth_hz
    if n < 4 * len(beside):
        return channel
    paths = np.exp(-2j * np.pi * np.outer(waveform.frequency_offsets_hz, delay_s + beside))
    weighted = paths.conj().T * taper("hann", n)
    fit = np.linalg.solve(weighted @ paths, weighted).astype(channel.dtype)
    by_slot = fit @ channel
    by_slot -= by_slot.mean(axis=-1, keepdims=True)
    return np.asarray(channel - paths.astype(channel.dtype) @ by_slot)


def without_static(channel: Complex) -> Complex:
    """A channel less its mean over slots: what moves by less than half a cell of rate is lost."""
    return np.asarray(channel - channel.mean(axis=-1, keepdims=True))
