"""Images from a sliding window of patterns: a new one after every few, not after a whole set.

Patterns come round and round. Each Hadamard row's newest value stays in the window, and counts for
less as it grows old: in a moving scene its noise variance grows by ``motion`` x age x its prior
variance (a random walk). How fast is read off the scene itself, from how much values have changed
when their row comes again. In a static scene nothing ages and the image is the LMMSE estimate of
the whole set; in a fast one the newest patterns rule and the older ones keep what they still know.

Where the motion is given, each value is instead taken at its own time of an image that is predicted
by it: nothing ages, and the image is the linear estimate of all values as of now.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction.cosine import filtered
from hardware.reconstruction.motion.compensated import MovingScene
from hardware.reconstruction.motion.knobs import STANDARD, Compensation
from hardware.reconstruction.motion.model import Motion, Shift, Translation
from hardware.reconstruction.motion.operators import farthest_cells, moving_patterns
from hardware.reconstruction.motion.timing import TimedRows
from hardware.reconstruction.prior import prior_scale, prior_spectrum, walsh_variance
from hardware.reconstruction.sensing import Sensing
from hardware.reconstruction.walsh_blocks import WalshBlocks

Array = NDArray[np.float64]

#: Share of what is known about the motion that one set of patterns keeps.
MEMORY = 0.5


class SlidingWindow:
    """The newest value of each pattern, its time, and how fast the scene moves.

    Parameters
    ----------
    patterns
        The set that comes round.
    noise_variance
        Of one Hadamard measurement, electrons squared.
    motion
        How the image moves, as its prediction from one time to the next; its time 0 is now. None:
        unknown, values age. See `goes_on`.
    compensation
        Knobs of motion compensation; the prior stays 1/f^2, and there are no standard errors.
    """

    def __init__(
        self,
        patterns: PatternSet,
        noise_variance: float,
        motion: Motion | None = None,
        compensation: Compensation = STANDARD,
    ) -> None:
        if not (np.isfinite(noise_variance) and noise_variance >= 0):
            raise InputError(f"noise_variance: {noise_variance} is not a number from 0 on")
        self.patterns, self.noise_variance = patterns, float(noise_variance)
        self.motion, self.compensation = (
            motion,
            replace(compensation, error_samples=0, prior_rows=0),
        )
        self._sensing = Sensing(patterns)
        self._blocks = WalshBlocks.of((patterns.rows, patterns.columns), patterns.indices)
        self._prior = walsh_variance(patterns.rows, patterns.columns)[patterns.indices]
        self._values = np.zeros(patterns.count)
        self._time_s = np.full(patterns.count, -np.inf)
        self._changed, self._expected, self._compared = 0.0, 0.0, 0.0
        self._before: Motion | None = None
        self._since_s = -np.inf  # no motion before

    def goes_on(self, motion: Motion | None, since_s: float) -> None:
        """Another motion from a time on; values before it moved as was said before, or not at all.

        Of motions that are not alike all over the image the new one is taken for all values.
        """
        self._before, self.motion, self._since_s = self.motion, motion, since_s

    @property
    def motion_per_s(self) -> float:
        """Growth of a value's variance with age, over its prior variance; 0 when static.

        What noise alone may show (two standard deviations of it) does not count.
        """
        if self._expected == 0:
            return 0.0
        scatter = 2 * self.noise_variance * np.sqrt(2 * self._compared)
        return max(self._changed - 2 * scatter, 0.0) / self._expected

    def push(self, places: NDArray[np.integer], values: Array, time_s: float | Array) -> Array:
        """Take new measurements and give the image as of now, ``(n_cells,)``.

        Parameters
        ----------
        places : (n,)
            Which patterns of the set: 0 to count - 1, each once.
        values : (n,)
            Their Hadamard measurements, electrons.
        time_s
            When, of all or of each, (n,); now is the last. Must not run backwards.
        """
        places = np.asarray(places)
        if places.shape != np.shape(values):
            raise InputError(f"values: shape {np.shape(values)}, expected {places.shape}")
        if not (np.isfinite(values).all() and np.isfinite(time_s).all()):
            raise InputError("values: hold what is not a number")
        if places.size and (places.min() < 0 or places.max() >= self.patterns.count):
            raise InputError(f"places: outside 0 to {self.patterns.count - 1}")
        times = np.broadcast_to(np.asarray(time_s, np.float64), places.shape)
        now_s = float(np.max(time_s))
        if np.min(time_s) < self._time_s.max():
            raise InputError(f"time_s: {np.min(time_s)} lies before {self._time_s.max()}")
        if self.motion is None:
            self._learn_motion(places, values, times)
        self._values[places] = values
        self._time_s[places] = times
        if self.motion is not None and (moved := self._predicted(now_s, self.motion)) is not None:
            return moved
        return self._image(now_s)

    def _predicted(self, time_s: float, motion: Motion) -> Array | None:
        """The image as of now, of all values at their own times; None where nothing has moved."""
        seen = np.isfinite(self._time_s)
        shape = (self.patterns.rows, self.patterns.columns)
        if np.isfinite(self._since_s) and isinstance(motion, Translation):
            before = Shift(0.0, 0.0) if self._before is None else self._before
            if isinstance(before, Translation):
                motion = _Turned(before, motion, self._since_s - time_s)
        age = (self._time_s[seen] - time_s)[None]
        if not age.size or farthest_cells(motion, age, shape) <= self.compensation.still_cells:
            return None
        rows = self.patterns.indices[seen][None]
        values = self._values[seen][:, None]
        timed = TimedRows(rows, age, np.ones(rows.shape), values, False)
        operator = moving_patterns(timed, motion, shape, self.compensation)
        noise = np.array([self.noise_variance])
        scene = MovingScene(
            motion, self.patterns.take(seen), timed, operator, noise, self.compensation
        )
        return scene.linear(noise)[0][:, 0]

    def _learn_motion(self, places: NDArray[np.integer], values: Array, times: Array) -> None:
        known = np.isfinite(self._time_s[places]) & (self._prior[places] > 0)
        again = places[known]
        if again.size == 0:
            return
        fresh, time_s = np.asarray(values)[known], times[known]
        keep = MEMORY ** (again.size / self.patterns.count)
        change = np.sum((fresh - self._values[again]) ** 2) - 2 * again.size * self.noise_variance
        expected = self._scale() * np.sum(self._prior[again] * (time_s - self._time_s[again]))
        self._changed = keep * self._changed + float(change)
        self._expected = keep * self._expected + float(expected)
        self._compared = keep**2 * self._compared + again.size

    def _scale(self) -> float:
        seen = np.isfinite(self._time_s) & (self._prior > 0)
        energy = float(np.sum(self._values[seen] ** 2))
        count = int(np.count_nonzero(seen))
        return prior_scale(energy, count, self.noise_variance, float(self._prior[seen].sum()))

    def _image(self, time_s: float) -> Array:
        mean = self._values[self._blocks.mean_at].sum() / self.patterns.n_cells
        scale = self._scale()
        if scale == 0:
            return np.full(self.patterns.n_cells, mean)
        aged = (
            np.minimum(self.motion_per_s * (time_s - self._time_s), 2.0) if self.motion_per_s else 0
        )
        seen = np.isfinite(self._time_s)
        ratios = np.where(
            seen, self.noise_variance / scale + aged * self._prior, 1e9 * self._prior.max()
        )
        duals = self._blocks.duals_unequal(np.where(seen, self._values, 0.0), ratios)
        spectrum = prior_spectrum(self.patterns.rows, self.patterns.columns)
        return mean + filtered(self._sensing.adjoint(duals), spectrum)


@dataclass(frozen=True)
class _Turned(Translation):
    """One motion up to a time, another from then on."""

    before: Translation
    after: Translation
    since_s: float

    def displacement(self, time_s: Array) -> Array:
        """See `Translation.displacement`."""
        times, turn_s = np.asarray(time_s), np.array([self.since_s])
        found = self.after.displacement(np.maximum(times, self.since_s))
        is_before = times < self.since_s
        if is_before.any():
            first = self.before.displacement(times[is_before])
            found[is_before] += first - self.before.displacement(turn_s)
        return found
