"""Subtraction of the leakage, and of all static echoes."""

import numpy as np

from hardware.formatting import counted
from hardware.radar.demodulation import Complex
from hardware.waveform import OfdmWaveform

_DEGREE = 4  # of the leakage's amplitude over the band
_SMOOTH = 1e-9  # of its power, up to which what changes over the band is the leakage's own
_LEAST_SLOTS = 3  # two leave their difference, which is the same at all rates but for its size


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


def too_few_slots(n_slots: int) -> str:
    """That so many slots of a transmitter tell no rate beside their mean; empty where they do."""
    if n_slots >= _LEAST_SLOTS:
        return ""
    return (
        f"{counted(n_slots, 'slot')} of a transmitter, expected {_LEAST_SLOTS} or more to tell "
        "what moves from what is static (moving_only)"
    )


def without_static(channel: Complex) -> Complex:
    """A channel minus its mean over slots: targets slower than half a rate cell are lost. Others
    lose a part, see `hardware.radar.moving`.
    """
    return np.asarray(channel - channel.mean(axis=-1, keepdims=True))
