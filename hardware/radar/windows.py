"""Windows along subcarriers and slots: noise gain, accuracy, correlation of cells."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError

Array = NDArray[np.float64]

#: Blackman-Harris, minimum 4-term (Harris, Proc. IEEE 66, 1978): which every burst needs.
_COSINES = (0.35875, 0.48829, 0.14128, 0.01168)
_LOBE = 1e-3  # of the peak's power, at which a main lobe ends
_NO_WEIGHT = 1e-9  # mean of a window that is 0 everywhere but for rounding, as hann of two samples


def check_window(window: object) -> None:
    """Raise InputError unless it is a window's name."""
    if not isinstance(window, str):
        raise InputError(
            f"window: {window!r:.60}, expected a name that scipy.signal.get_window knows"
        )


@lru_cache(maxsize=64)
def normalised_window(name: str, size: int) -> Array:
    """Window of mean 1: peaks keep their power, noise increases by the mean square. Read-only.

    Raises InputError for a name that SciPy does not know, and where it is 0 everywhere.
    """
    if not has_weight(name, size):
        raise InputError(f"window: {name!r} has no weight on {size} samples")
    window = _window(name, size)
    window = np.asarray(window / window.mean(), dtype=np.float64)
    window.setflags(write=False)
    return window


def has_weight(name: str, size: int) -> bool:
    """Whether a window is not 0 everywhere, as one that ends with 0 is on two samples."""
    return bool(abs(_window(name, size).mean()) > _NO_WEIGHT)


def _window(name: str, size: int) -> Array:
    if name == "boxcar":  # the default: without half a second of scipy.signal's import
        return np.ones(size)
    if name == "blackmanharris" and size > 1:
        turn = np.linspace(-np.pi, np.pi, size)
        return np.asarray(np.sum([a * np.cos(k * turn) for k, a in enumerate(_COSINES)], axis=0))
    from scipy.signal import get_window

    try:
        return np.asarray(get_window(name, size, fftbins=False), dtype=np.float64)
    except ValueError as error:
        expected = "expected a name that scipy.signal.get_window knows"
        raise InputError(f"window: {name!r}: {expected}") from error


def noise_gain(name: str, sizes: tuple[int, ...]) -> float:
    """Noise power of a cell over that without a window, for a window along each axis."""
    return float(np.prod([np.mean(normalised_window(name, size) ** 2) for size in sizes]))


def correlation(window: Array, oversampling: int = 1) -> Array:
    """Squared modulus of the correlation between cells, by their distance, (cells,).

    Of white noise after the window; 1 at distance 0, and at no other for a rectangular window.
    """
    spectrum = np.fft.fft(window**2, oversampling * len(window))
    return np.asarray(np.abs(spectrum / spectrum[0]) ** 2, dtype=np.float64)


@lru_cache(maxsize=64)
def main_lobe(name: str, size: int) -> int:
    """Cells to each side of an echo to which its power falls by 30 dB within the main lobe of a
    window, on a map that is not oversampled.
    """
    fine = 8  # places per cell
    power = np.abs(np.fft.rfft(normalised_window(name, size) / size, fine * size)) ** 2
    below = power < _LOBE
    return -(-int(np.argmax(below)) // fine) if below.any() else size // 2


def frequency_variance(window: Array) -> float:
    """Variance of a tone's frequency times the image SNR, in (radians per sample)^2.

    Of the highest point of the windowed spectrum: the window's sums in the first-order error
    v = sum(w^2 n^2) / (2 snr sum(w n^2)^2) (sum w)^2 / sum(w^2), n from the middle. For a
    rectangular window the Cramer-Rao bound 6 / (snr (N^2 - 1)) (Rife and Boorstyn, IEEE Trans.
    Inf. Theory 20, 1974). One sample tells nothing: infinity.
    """
    n = np.arange(len(window)) - (len(window) - 1) / 2
    turn = np.sum(window * n**2) ** 2
    if turn == 0:
        return float("inf")
    gain = np.sum(window) ** 2 / np.sum(window**2)
    return float(np.sum((window * n) ** 2) / (2 * turn) * gain)
