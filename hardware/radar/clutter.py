"""Taking away what is known to be there: the leakage, and everything that stands still."""

import numpy as np

from hardware.radar.demodulation import Complex
from hardware.waveform import OfdmWaveform


def without_leakage(channel: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """A channel (..., n_subcarriers, n_slots) less a constant path of known delay.

    Its amplitude is the least-squares one, so a static echo at the same delay goes with it; one a
    cell of range apart loses nothing, one between less.
    """
    path = np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s).astype(channel.dtype)
    amplitude = np.einsum("...nm,n->...", channel, path.conj())
    amplitude /= channel.shape[-2] * channel.shape[-1]
    return np.asarray(channel - amplitude[..., None, None] * path[:, None])


def without_static(channel: Complex) -> Complex:
    """A channel less its mean over slots: what moves by less than half a cell of rate is lost."""
    return np.asarray(channel - channel.mean(axis=-1, keepdims=True))
