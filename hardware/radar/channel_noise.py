"""What noise that the channels of an array share does to level, delay, rate and direction.

The amplitudes of an echo on the channels are a = s + n: those without noise, all of one modulus,
and noise of covariance C, measured on the cells around the echo. Whitening serves detection alone;
everything is measured on the channels as they are:

- the power is the mean of |a|^2 over V channels: its variance is 2 s'Cs / V^2, and tr(C^2) / V^2;
- delay and rate are where the sum of powers is highest: their variance is that of one channel at
  the SNR (s's)^2 / s'Cs, and more at low SNR, where s'Cs + tr(C^2) stands for s'Cs;
- the direction is that of the highest beam, a least-squares fit to phases, of which each errs by
  the part of n across s: covariance K = Re(S'CS) / 2 |s|^2, with S the phases of s.

The mean of a'Ca is s'Cs + tr(C^2), since C and n are of different cells: no more is needed of them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LEAST_SIGNAL = 0.1  # of the measured power: an echo that is hardly one has large errors, not none


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """Noise of an echo's amplitudes: ``covariance_w`` (n_channels, n_channels), and the mean power
    ``least_w`` of a channel, below which no combination of channels counts.
    """

    covariance_w: Complex
    least_w: float

    @classmethod
    def white(cls, n_channels: int, noise_w: float) -> "ChannelNoise":
        """Of independent channels."""
        return cls(np.zeros((n_channels, n_channels), dtype=np.complex128), noise_w)

    @classmethod
    def of_cells(cls, cells: Complex, least_w: float) -> "ChannelNoise":
        """Of cells (n_channels, n_cells) that contain noise alone; where a map has none, what they
        contain is the rounding of what was subtracted.
        """
        if not least_w:
            return cls.white(len(cells), 0.0)
        return cls(cells @ cells.conj().T / max(cells.shape[1], 1), least_w)

    @property
    def mean_w(self) -> float:
        """Mean power of a channel."""
        return max(float(np.mean(np.diag(self.covariance_w).real)), self.least_w)

    def along(self, vector: Complex) -> float:
        """Power of the combination of channels along a vector (n_channels,)."""
        power_w = float(np.vdot(vector, self.covariance_w @ vector).real)
        return max(power_w / max(float(np.vdot(vector, vector).real), 1e-300), self.least_w)

    def signal_w(self, amplitude: Complex) -> float:
        """Power of an echo on one channel, without that of the noise."""
        power_w = float(np.mean(np.abs(amplitude) ** 2))
        return max(power_w - self.mean_w, _LEAST_SIGNAL * power_w)

    def snr(self, amplitude: Complex) -> float:
        """SNR of one channel on which delay and rate would have the errors that they have."""
        power_w = float(np.mean(np.abs(amplitude) ** 2))
        disturbance_w = power_w * self.along(amplitude)
        if not disturbance_w:
            return float("inf") if power_w else 0.0
        return self.signal_w(amplitude) ** 2 * len(amplitude) / disturbance_w

    def power_error_w(self, amplitude: Complex) -> float:
        """Standard error of the mean power of the channels."""
        power_w = float(np.mean(np.abs(amplitude) ** 2))
        return float(np.sqrt(2 * power_w * self.along(amplitude) / len(amplitude)))

    def cosine_covariance(self, amplitude: Complex, phases: Complex, places: Array) -> Array:
        """Covariance (n_axes, n_axes) of direction cosines.

        ``phases`` (n_channels,): of the echo without noise, of modulus 1. ``places`` (n_channels,
        n_axes): of the channels, in wavelengths.
        """
        centred = places - places.mean(axis=0)
        fit = centred @ np.linalg.pinv(centred.T @ centred) / (2 * np.pi)
        weights = phases[:, None] * fit
        shared = np.real(weights.conj().T @ self.covariance_w @ weights)
        white = self.least_w * fit.T @ fit
        # Along each axis as `along`; of both together what either noise has in common.
        sizes = np.sqrt(np.maximum(np.diag(shared), np.diag(white)))
        both = shared + white
        scale = sizes / np.sqrt(np.maximum(np.diag(both), 1e-300))
        return np.asarray(both * np.outer(scale, scale) / (2 * self.signal_w(amplitude)))

    def errors(self, weights: Complex) -> Array:
        """Standard errors (n,) of the estimates Re(w^H a) of amplitudes a by weights w (n_channels,
        n).
        """
        powers_w = [self.along(w) * np.vdot(w, w).real for w in weights.T]
        return np.asarray(np.sqrt(np.array(powers_w) / 2))

    def explains(self, rest: Complex, fitted: Complex, other_w: float, false_alarm: float) -> bool:
        """Whether ``rest`` (n_channels,), what a fit of vectors (n_channels, n) leaves, may be
        noise and ``other_w`` of power beside it.

        Noise that channels share is a sum of exponentials of unlike means: a gamma distribution of
        the same mean and variance stands for it (Satterthwaite 1946).
        """
        from scipy.special import gammainccinv

        basis = np.linalg.qr(fitted)[0]
        off = np.eye(len(rest)) - basis @ basis.conj().T
        left = off @ self.covariance_w @ off
        n_free = max(len(rest) - basis.shape[1], 1)
        mean_w = max(float(np.trace(left).real), n_free * self.least_w)
        square = float(np.vdot(left, left).real)
        looks = min(float(np.trace(left).real) ** 2 / square, n_free) if square else float(n_free)
        most_w = mean_w / looks * float(gammainccinv(looks, false_alarm))
        return float(np.vdot(rest, rest).real) <= most_w + other_w

    def and_white(self, power_w: float) -> "ChannelNoise":
        """With white noise of so much power on every channel beside it."""
        more = power_w * np.eye(len(self.covariance_w))
        return ChannelNoise(self.covariance_w + more, self.least_w + power_w)

    def scaled(self, factor: float) -> "ChannelNoise":
        """With ``factor`` times the power on all channels."""
        return ChannelNoise(factor * self.covariance_w, factor * self.least_w)

    def raised(self, factor: float, mode: Complex) -> "ChannelNoise":
        """With ``factor`` times the power along each of the modes (n_channels, n_modes), which are
        orthonormal.
        """
        change = np.eye(len(mode)) + (np.sqrt(factor) - 1) * mode @ mode.conj().T
        return replace(self, covariance_w=change @ self.covariance_w @ change.conj().T)
