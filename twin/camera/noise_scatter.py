"""How far another draw of the sensor's noise moves what is made of a record.

The same light is measured some times more, and the same method makes an image of each record. The
standard deviation of so few scores is itself uncertain, by some 13 %, so that of PSNR is at least
what the spectrum of the images' noise makes of it, if that is Gaussian and the same everywhere: the
sum of squares of noise n with spectrum P about a fixed error b has the variance of 2 sum b n, told
by the draws, and 2 sum P^2 (P unitary). Noise of methods that smooth is not Gaussian: what the
spectrum makes of it counts as far as so many draws allow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction import Reconstruction
from hardware.records import SpiRecord
from twin.camera.acquisition import Capture
from twin.camera.follows import Follows
from twin.camera.noise_draws import N_DRAWS
from twin.camera.score import psnr_db, similarities

Array = NDArray[np.float64]

#: Factor by which the scatter of `N_DRAWS` draws and the record itself is to be larger so that 1.96
#: of it hold 95 % of cases (Student's distribution).
_FEW = 1.039
#: Of a standard deviation so widened, the most that is within the 95 % interval of what so many
#: draws tell (chi-squared distribution).
_MOST = 1.273


@dataclass(frozen=True, eq=False)
class ScatterOfScores:
    """Standard deviations over draws of the noise, each computed where it is asked for.

    ``truth`` (rows, columns), and the images ``seen`` (n_draws, rows, columns), none without noise.
    """

    truth: Array
    seen: Array

    @property
    def psnr_db(self) -> float:
        """Of the PSNR."""
        if not len(self.seen):
            return 0.0
        levels_db = [psnr_db(self.truth, each) for each in self.seen]
        by_draws = _scatter(levels_db)
        by_spectrum = _scatter_by_spectrum_db(np.nan_to_num(self.seen - self.truth))
        return max(by_draws, min(by_spectrum, _MOST * by_draws))

    @property
    def ssim(self) -> float:
        """Of the SSIM."""
        if not len(self.seen):
            return 0.0
        return _scatter(similarities([self.truth] * len(self.seen), list(self.seen)))


def scatter_over_noise(
    capture: Capture, here: float, of_record: Callable[[SpiRecord], float]
) -> float:
    """Standard deviation of a figure of a record, which is ``here`` of the capture's own."""
    others = [of_record(record) for record in capture.noise_draws.records]
    return _scatter([here, *others]) if others else 0.0


@lru_cache(maxsize=2)
def scatter_of_scores(capture: Capture, image: Reconstruction) -> ScatterOfScores:
    """Of an image of a capture; kept for the next score of the same image.

    Of methods that are not asked again, slow ones and a user's own: as if all of the image's error
    were noise, a random field with the spectrum that it has.
    """
    truth, backscatter_e = capture.measured_scene_e, capture.backscatter_e
    if not capture.noise_draws.has_noise:
        return ScatterOfScores(truth, np.empty((0, *truth.shape)))
    own, follows = image.picture - backscatter_e, Follows(capture, image)
    if follows.is_known:
        measured = capture.noise_draws.measured
        seen = np.stack([own, *(follows.picture(each) - backscatter_e for each in measured)])
    else:
        fields = _fields_like(own - truth, capture.noise_draws.seed)
        seen = np.stack([own, *(truth + field for field in fields)])
    return ScatterOfScores(truth, seen)


def _scatter(drawn: Sequence[float] | Array) -> float:
    return _FEW * float(np.std(np.asarray(drawn), ddof=1)) if np.isfinite(drawn).all() else np.inf


def _scatter_by_spectrum_db(errors: Array) -> float:
    """Of the level of the mean square of errors (n_draws, rows, columns)."""
    n_draws, n_cells = len(errors), errors[0].size
    fixed = errors.mean(axis=0)
    beside_fixed = 2 * np.sum(fixed * errors, axis=(1, 2))
    spectrum = np.var(np.fft.fft2(errors, norm="ortho"), axis=0, ddof=1)
    # The square of a variance that is estimated itself is larger by this.
    squares = np.sum(spectrum**2) / (1 + 1 / (n_draws - 1))
    variance = (2 * squares + np.var(beside_fixed, ddof=1)) / n_cells**2
    mean_square = float(np.mean(errors**2))
    return float(10 / np.log(10) * np.sqrt(variance) / mean_square) if mean_square else 0.0


def _fields_like(error: Array, seed: int) -> Array:
    """Random fields (N_DRAWS, rows, columns) with the power spectrum of an error."""
    amplitude = np.abs(np.fft.fft2(np.nan_to_num(error), norm="ortho"))
    white = np.random.default_rng(seed).standard_normal((N_DRAWS, *error.shape))
    return np.asarray(np.fft.ifft2(np.fft.fft2(white) * amplitude).real)
