"""1/f noise of an amplifier: covariance of exposures, draws of it, and what of it is in an image.

The amplifier's noise has the density S0 (1 + fc / f), where S0 T is the variance of its white noise
in one exposure of length T. Over 1/f alone, two exposures a time t apart have the covariance
S0 fc T^2 g(t / T): g is -2 ln(t / T), the Fourier transform of 1 / f, averaged over both exposures,
which is the integral over the spectrum times sinc^2. Its constant is infinite: noise slower than a
frame is an offset of all of its exposures. So covariances count up to a constant, and an exposure's
noise less the mean of the frame.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns
from twin.detector.inverse import variance_of_cells
from twin.detector.noise import NoiseBudget

Array = NDArray[np.float64]

#: Among the contributions of a `NoiseBudget`.
FLICKER = "1/f noise of the amplifier"
#: Exposure lengths from which on an average logarithm is that of the distance and two terms more,
#: exact to 2e-11.
_FAR = 30.0


@dataclass(frozen=True)
class ExposureTimes:
    """When exposures are taken: ``period`` from one to the next, over their length. Each pattern
    has ``n_shutters`` of them, in turn or ``at_once``.
    """

    period: float = 1.0
    n_shutters: int = 1
    at_once: bool = False

    def covariance(self, n: int) -> Array:
        """Of 1/f noise of exposures 0 to n - 1 periods apart, (n,), in S0 fc T^2."""
        return covariance(self.period * np.arange(n, dtype=np.float64))

    def covariance_of_patterns(self, n: int) -> Array:
        """The same of patterns 0 to n - 1 apart, all shutters of each added up, over their number:
        as if each shutter had noise of its own.
        """
        if self.at_once:
            return self.n_shutters * self.covariance(n)
        shutters_apart = np.arange(1 - self.n_shutters, self.n_shutters)
        share = 1 - np.abs(shutters_apart) / self.n_shutters
        apart = np.abs(self.n_shutters * np.arange(n)[:, None] + shutters_apart)
        return np.asarray(covariance(self.period * apart) @ share)

    @property
    def in_a_pair(self) -> float:
        """Half the variance of the difference of two patterns in turn, in S0 fc T^2."""
        same, next_one = self.covariance_of_patterns(2)
        return float(same - next_one)


#: One exposure of each pattern, without a pause.
ONE_AFTER_THE_OTHER = ExposureTimes()


def covariance(apart: Array) -> Array:
    """Of 1/f noise of exposures of length 1 that begin so far apart, in S0 fc T^2, up to a
    constant: the average of -2 ln|t| by second differences of its double integral.
    """
    far = np.maximum(apart, _FAR)
    of_far = -2 * np.log(far) + 1 / (6 * far**2) + 1 / (30 * far**4)
    near = np.minimum(apart, _FAR)
    of_near = 2 * _integral(near) - _integral(near + 1) - _integral(np.abs(near - 1))
    return np.where(apart < _FAR, of_near, of_far)


def _integral(t: Array) -> Array:
    """The second derivative of this is 2 ln t."""
    return np.asarray(t**2 * (np.log(np.where(t > 0, t, 1.0)) - 1.5))


def drawn(shape: tuple[int, ...], times: ExposureTimes, rng: np.random.Generator) -> Array:
    """1/f noise of a frame, (n_exposures, n_detectors), less its mean, where S0 fc T^2 is 1.

    Drawn on a circle of twice the length (Dietrich and Newsam, SIAM J. Sci. Comput. 18, 1997). The
    covariance falls, ever more slowly, so that no frequency of the circle has less than nothing,
    and the covariance drawn is exact.
    """
    at_once = times.n_shutters if times.at_once else 1
    n = -(-shape[0] // at_once)
    half = times.covariance(n + 1)
    density = np.fft.rfft(np.concatenate([half, half[-2:0:-1]])).real
    density[0] = 0.0  # an offset
    white = np.fft.rfft(rng.normal(size=(2 * n, *shape[1:])), axis=0)
    gain = np.sqrt(np.maximum(density, 0.0))[:, None]
    noise = np.repeat(np.fft.irfft(white * gain, n=2 * n, axis=0)[:n], at_once, axis=0)[: shape[0]]
    return np.asarray(noise - noise.mean(axis=0))


def in_image(budget: NoiseBudget, patterns: Patterns, times: ExposureTimes) -> NoiseBudget:
    """A budget whose 1/f noise is counted as it survives pairs, with what survives these patterns:
    root mean square over the cells that are measured, of the sum of all shutters, as noise of one
    exposure.
    """
    slow_e = budget.noise_e.get(FLICKER, 0.0)
    if not slow_e:
        return budget
    of_pixel = budget.pixel_noise_e(patterns) / budget.total_noise_e
    more = np.sqrt(_of_measured(patterns, times) / times.in_a_pair) / of_pixel
    return replace(budget, noise_e={**budget.noise_e, FLICKER: slow_e * float(more)})


def by_cell(budget: NoiseBudget, patterns: Patterns, times: ExposureTimes) -> Array:
    """Noise of every cell, (n_cells,), of such a budget: as `NoiseBudget.cells_noise_e`, with the
    1/f noise of each.
    """
    noise, slow_e = budget.cells_noise_e(patterns), budget.noise_e.get(FLICKER, 0.0)
    if not slow_e:
        return noise
    share = (slow_e / budget.total_noise_e) ** 2
    relative = flicker_of_cells(patterns, times) / _of_measured(patterns, times)
    slow = relative * budget.pixel_noise_e(patterns) ** 2
    return np.asarray(np.sqrt((1 - share) * noise**2 + share * slow))


def _of_measured(patterns: Patterns, times: ExposureTimes) -> float:
    """Mean of `flicker_of_cells` over the cells that the set measures; 0 where there are none."""
    measured = ~patterns.unmeasured_cells
    of_cells = flicker_of_cells(patterns, times)
    return float(np.mean(of_cells[measured])) if measured.any() else 0.0


@lru_cache(maxsize=8)
def flicker_of_cells(patterns: Patterns, times: ExposureTimes) -> Array:
    """Variance of 1/f noise in each cell of the image, (n_cells,), over the number of shutters that
    are added up, in S0 fc T^2.
    """
    return variance_of_cells(times.covariance_of_patterns(patterns.n_exposures), patterns)
