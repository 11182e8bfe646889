"""Taking away what is known to be there: the leakage, and everything that stands still."""

import numpy as np

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import OfdmWaveform


_BESIDE = 3  # cells either side of the leakage from which fluctuation is taken


def without_leakage(channel: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """A channel (..., n_subcarriers, n_slots) less a path of known delay, and less what fluctuates
    from slot to slot within three cells of range of it.

    The constant amplitude is the least-squares one, so a static echo at the same delay goes with
    it; one a cell of range apart loses nothing, one between less. What fluctuates is fitted with a
    window that keeps echoes from seven cells on out of it; moving ones within three cells are lost.
    """
    f = waveform.frequency_offsets_hz
    path = np.exp(-2j * np.pi * f * delay_s).astype(channel.dtype)
    mean = channel.mean(axis=-1, keepdims=True)
    constant = (path.conj() @ mean)[..., None] / len(path)
    beside = np.arange(-_BESIDE, _BESIDE + 1) / waveform.bandwidth_hz
    if len(path) > 4 * len(beside):
        paths = np.exp(-2j * np.pi * np.outer(f, delay_s + beside))
        weighted = paths.conj().T * taper("hann", len(path))
        fit = np.linalg.solve(weighted @ paths, weighted).astype(channel.dtype)
        by_slot = fit @ channel
        by_slot -= by_slot.mean(axis=-1, keepdims=True)
        channel = channel - paths.astype(channel.dtype) @ by_slot
    return np.asarray(channel - constant * path[:, None])


def without_static(channel: Complex) -> Complex:
    """A channel less its mean over slots: what moves by less than half a cell of rate is lost."""
    return np.asarray(channel - channel.mean(axis=-1, keepdims=True))
