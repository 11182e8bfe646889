"""Whether phases of slots scatter more than noise makes them, and by how much.

Noise and other echoes change the amplitude of a path as much as its phase, oscillators its phase
alone: the difference is theirs.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CHANCE = 1e-3  # probability that noise alone counts as changes of phase from slot to slot
_CELLS_OF_A_LINE = 1.5  # that share noise, with the window of Hann


def white_variance(turn: Complex) -> float:
    """Variance in rad^2 of the phases of single slots, if white, beyond noise; 0 where what is
    seen may be noise.

    ``turn`` (n_rounds, n_turns): a path in the order of time, over its mean. Slow changes do not
    count, nor what a transmitter's slots have in common.

    An echo of another rate at the path's delay is a line in the spectra of both, and the phase of a
    sum is that of the oscillators and of the echoes alone. A window holds the side lobes of
    lines, and medians the lines themselves.
    """
    n_rounds, n_turns = turn.shape
    size = np.maximum(np.abs(turn), np.finfo(float).tiny)
    parts = [(part - part.mean(axis=0)).ravel() for part in (np.angle(turn), np.log(size))]
    number = np.arange(turn.size // 2 + 1)
    # The mean of each transmitter's slots, its direction, is taken out at multiples of n_rounds.
    fast = (number >= turn.size / (2 * max(n_turns, 4))) & (number % n_rounds != 0)
    if not fast.any():
        return 0.0
    window = np.hanning(turn.size + 2)[1:-1]
    window /= np.linalg.norm(window)
    of_phase, of_amplitude = (
        float(np.median(np.abs(np.fft.rfft(window * part)[fast]) ** 2)) / np.log(2)
        for part in parts
    )
    # A median has as many degrees of freedom as the mean of half as many; a window has neighbours
    # that share noise.
    free = int(np.count_nonzero(fast) / _CELLS_OF_A_LINE)
    return of_phase - of_amplitude if scatter_more(of_phase, of_amplitude, free) else 0.0


def scatter_more(of_phase: float, of_amplitude: float, free: int) -> bool:
    """Whether a variance of phases is beyond that of amplitudes, each of so many degrees of
    freedom, by an F-test.
    """
    from scipy.special import fdtri

    return bool(free and of_phase > fdtri(free, free, 1 - _CHANCE) * of_amplitude)
