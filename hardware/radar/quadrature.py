"""I/Q imbalance, estimated on what was received and taken out.

A mixer whose branches differ in gain or in angle adds an image to every signal x: the record is
x + b conj(x), to a common factor (Valkama, Renfors, Koivunen, IEEE Trans. Signal Processing 49,
2001). After division by the sent symbols echoes fill the delays up to the farthest one, and their
image spreads over all of them. Where there is least of the echoes, b is the regression of the
record on its conjugate.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import OfdmWaveform

_CERTAIN = 6.0  # standard errors from which an image is taken for real


def without_images(steps: Sequence[Complex], waveform: OfdmWaveform) -> list[Complex]:
    """Samples (n_slots, n_receivers, n_subcarriers) of every carrier step less their images.

    Receivers for which no image stands out of the noise stay as they are.
    """
    ratios = image_ratios(steps, waveform)
    if not ratios.any():
        return list(steps)
    b = ratios.astype(steps[0].dtype)[:, None]
    return [np.asarray((step - b * step.conj()) / (1 - np.abs(b) ** 2)) for step in steps]


def image_ratios(steps: Sequence[Complex], waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """Amplitude of the image over the conjugate of the signal, (n_receivers,); 0 where it is less
    than its error allows to tell. What moves is left out: means over slots are compared.
    """
    n = waveform.n_subcarriers
    if n < 8:
        return np.zeros(steps[0].shape[1], dtype=np.complex128)
    still = np.stack([step.mean(axis=0) for step in steps], axis=1).astype(np.complex128)
    # A window keeps the echoes' side lobes out of the quiet delays.
    undone = np.fft.ifftshift(waveform.sent().conj() * taper("blackmanharris", n))

    def by_delay(samples: Complex) -> Complex:
        return np.asarray(np.fft.ifft(np.fft.fft(samples) * undone))

    direct, image = by_delay(still), by_delay(still.conj())
    # The quieter half of all delays, as both halves' energy over all steps and receivers tell.
    energy = np.sum(np.abs(direct) ** 2, axis=(0, 1))
    quiet = energy <= np.median(energy)
    direct, image = (part[..., quiet].reshape(len(still), -1) for part in (direct, image))
    power = np.maximum(np.sum(np.abs(image) ** 2, axis=1), 1e-300)
    b = np.sum(image.conj() * direct, axis=1) / power
    rest = np.mean(np.abs(direct - b[:, None] * image) ** 2, axis=1)
    return np.asarray(np.where(np.abs(b) ** 2 > _CERTAIN**2 * rest / power, b, 0))
