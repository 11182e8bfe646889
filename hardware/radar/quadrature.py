"""I/Q imbalance, estimated from the received signal and compensated.

A mixer whose branches differ in gain or phase adds an image to every signal x: the record is
x + b conj(x), up to a common factor (Valkama, Renfors, Koivunen, IEEE Trans. Signal Processing 49,
2001). After division by the sent symbols, echoes occupy the delays up to the farthest one, and
their image spreads over all delays. At delays with the weakest echoes, b is the regression of the
record on its conjugate.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.demodulation import Complex
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

_CERTAIN = 6.0  # standard errors above which an image is significant
_DEPENDENT = 0.9  # amplitude of an image, from which on the branches tell no two things


def without_images(steps: Sequence[Complex], waveform: OfdmWaveform) -> list[Complex]:
    """Samples (n_slots, n_receivers, n_subcarriers) of every carrier step without their images.

    Receivers without a significant image are not changed. Raises InputError for a receiver whose I
    and Q depend on each other.
    """
    ratios = image_ratios(steps, waveform)
    if (worst := float(np.abs(ratios).max())) > _DEPENDENT:
        raise InputError(
            f"receiver {int(np.abs(ratios).argmax())}: the image is {worst:.3g} times the signal, "
            "expected far less: I and Q depend on each other, as where a branch is dead or the "
            "samples are constant"
        )
    if not ratios.any():
        return list(steps)
    b = ratios.astype(steps[0].dtype)[:, None]
    return [np.asarray((step - b * step.conj()) / (1 - np.abs(b) ** 2)) for step in steps]


def image_ratios(steps: Sequence[Complex], waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """Amplitude of the image over the conjugate of the signal, (n_receivers,); 0 where it is not
    significant. Only static echoes are used, by means over slots.
    """
    n = waveform.n_subcarriers
    if n < 8:
        return np.zeros(steps[0].shape[1], dtype=np.complex128)
    still = np.stack([step.mean(axis=0) for step in steps], axis=1).astype(np.complex128)
    # A window keeps the echoes' side lobes out of the quiet delays.
    undone = np.fft.ifftshift(waveform.sent().conj() * normalised_window("blackmanharris", n))

    def by_delay(samples: Complex) -> Complex:
        return np.asarray(np.fft.ifft(np.fft.fft(samples) * undone))

    direct, image = by_delay(still), by_delay(still.conj())
    # The half of all delays with less energy over all steps and receivers.
    energy = np.sum(np.abs(direct) ** 2, axis=(0, 1))
    quiet = energy <= np.median(energy)
    direct, image = (part[..., quiet].reshape(len(still), -1) for part in (direct, image))
    power = np.maximum(np.sum(np.abs(image) ** 2, axis=1), 1e-300)
    b = np.sum(image.conj() * direct, axis=1) / power
    rest = np.mean(np.abs(direct - b[:, None] * image) ** 2, axis=1)
    return np.asarray(np.where(np.abs(b) ** 2 > _CERTAIN**2 * rest / power, b, 0))
