"""Subtraction of the leakage, and of all static echoes."""

import numpy as np

from hardware.radar.demodulation import Complex
from hardware.waveform import OfdmWaveform

_DEGREE = 4  # of the leakage's amplitude over the band
_SMOOTH = 1e-9  # of its power, up to which what changes over the band is the leakage's own


def without_leakage(channel: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """A channel (..., n_subcarriers, n_slots) after subtraction of a constant path of known delay.

    The amplitude is fitted by least squares, so a static echo at the same delay is subtracted as
    well; an echo one range cell away loses nothing, one in between a part. The change of amplitude
    over the band (a polynomial of degree 4) is subtracted where it is at least 90 dB below the
    leakage: a static echo within two cells of the leakage and weaker than that is lost.
    """
    n = channel.shape[-2]
    path = np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    place = np.polynomial.legendre.legvander(np.linspace(-1, 1, n), _DEGREE if n > 16 else 0)
    over_band = np.linalg.qr(place)[0]
    gain = (channel.mean(axis=-1) * path.conj()) @ over_band
    power = np.abs(gain) ** 2
    smooth = power[..., 1:].sum(axis=-1) < _SMOOTH * power[..., 0]
    gain[..., 1:] *= smooth[..., None]
    leakage = (gain @ over_band.T * path).astype(channel.dtype)
    return np.asarray(channel - leakage[..., None])


def without_static(channel: Complex) -> Complex:
    """A channel minus its mean over slots: targets slower than half a rate cell are lost."""
    return np.asarray(channel - channel.mean(axis=-1, keepdims=True))
