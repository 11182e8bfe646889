"""Intervals of a capture's figures and of its images' scores: what the model's light may be off by,
and how far another draw of the sensor's noise would move them.

The errors of cells are independent, and figures linear in them, but for the SNRs'
(`twin.camera.snr_intervals`) and the peak. By the model scores are off from those of an exact model
and the same noise of the sensor, whose image would follow what changes in the truth, in part. By
noise they scatter as those of other records of the same light do (`twin.camera.noise_draws`).
Electrons are predicted, not read from the record: noise moves none of them, but for the light of an
emitter that fluctuates.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction import Reconstruction
from twin.accuracy import Interval, propagated
from twin.camera.acquisition import Capture
from twin.camera.follows import Follows
from twin.camera.noise_scatter import scatter_of_scores
from twin.camera.score import in_words, psnr_db, similarities, similarity
from twin.camera.snr_intervals import FEW, SEED, normal_draws, snr_interval
from twin.camera.uneven_rounding import pictures_of_other_light

Array = NDArray[np.float64]

#: Draws of whole images, with the factor by which their scatter is to be larger so that 1.96 of it
#: hold 95 % of cases (Student's distribution).
_DRAWS_OF_IMAGES, _VERY_FEW = 8, 1.207
#: Relative step for the slope of SSIM over the image's error.
_STEP = 1e-3
#: Factor by which a draw is that of two errors.
_TWICE = math.sqrt(2)
#: Of the peak, the largest excess that is taken from it.
_MOST = 0.9
#: Cells to a side of blocks whose errors change sign together.
_BLOCK = 4


@dataclass(frozen=True)
class CaptureIntervals:
    """Figures of a capture with their intervals.

    ``snr_median``, ``snr_best``, ``above_noise_share``: as `ImageVerdict` has them. ``signal_e``,
    ``background_e``, ``noise_e``: of one average exposure.
    """

    snr_median: Interval
    snr_best: Interval
    above_noise_share: Interval
    signal_e: Interval
    background_e: Interval
    noise_e: Interval


@dataclass(frozen=True)
class ScoreIntervals:
    """A `Score` with its intervals."""

    psnr_db: Interval
    ssim: Interval

    def __str__(self) -> str:
        return in_words(
            self.psnr_db.value, self.ssim.value, self.psnr_db.text("dB"), str(self.ssim)
        )


def score_intervals(capture: Capture, image: Reconstruction) -> ScoreIntervals:
    """Score of a reconstruction of a capture with its intervals."""
    return ScoreIntervals(psnr_interval(capture, image), ssim_interval(capture, image))


def capture_intervals(capture: Capture) -> CaptureIntervals:
    """Intervals of a capture's figures; of a void record SNRs are NaN."""
    return CaptureIntervals(
        snr_median=snr_interval(capture, "median"),
        snr_best=snr_interval(capture, "best"),
        above_noise_share=snr_interval(capture, "above 1"),
        signal_e=signal_interval(capture),
        background_e=background_interval(capture),
        noise_e=noise_interval(capture),
    )


def signal_interval(capture: Capture) -> Interval:
    """Signal of one average exposure, electrons."""
    error, exposures_w = capture.model_error, capture.signal_w.sum(axis=1)
    fluctuation = capture.noise_draws.fluctuation * float(np.linalg.norm(exposures_w))
    total_w = float(exposures_w.sum())
    by_noise = fluctuation / total_w if total_w else 0.0
    return _relative(capture.noise.signal_e, error.signal, error.signal_systematic, by_noise)


def signal_power_interval(capture: Capture) -> Interval:
    """Mean signal on a detector, W, whose relative errors are those of its electrons."""
    of_electrons, signal_w = signal_interval(capture), float(capture.signal_w.mean())
    if not of_electrons.value:
        return Interval(signal_w)
    return propagated(lambda electrons: signal_w * electrons / of_electrons.value, of_electrons)


def background_interval(capture: Capture) -> Interval:
    """Sun in one exposure, electrons."""
    of_power, error = sun_power_interval(capture), capture.model_error
    each = error.electrons_per_watt
    return Interval(
        capture.noise.background_e, each * of_power.standard_error, each * of_power.systematic
    )


def sun_power_interval(capture: Capture) -> Interval:
    """Sun on a detector, W."""
    error = capture.model_error
    return Interval(capture.background_w, error.background_w, error.background_systematic_w)


def noise_interval(capture: Capture) -> Interval:
    """Noise of one average exposure, electrons."""
    error = capture.model_error
    return _relative(
        capture.noise.total_noise_e,
        float(np.max(error.noise)),
        float(np.max(error.noise_systematic)),
    )


def psnr_interval(capture: Capture, image: Reconstruction) -> Interval:
    """PSNR of a reconstruction of a capture with its interval.

    With d an error of the truth, of which the image follows all but u, the mean square of the
    image's error e is off by 2 mean(e u) + mean(u^2): the first as random as d, the second always
    upward. The peak is off as the brightest of all cells is, and e as the noise is, which grows
    with light.
    """
    truth, off = capture.measured_scene_e, _off(capture, image)
    known, value = np.isfinite(truth), psnr_db(truth, image.picture - capture.backscatter_e)
    if not np.isfinite(value):
        return Interval(value)
    of_draw, of_bound = _unfollowed(capture, image)
    unfollowed, bound = of_draw[known], np.abs(of_bound[known])
    peak, mean_square, error = _peak(capture), float(np.mean(off[known] ** 2)), off[known]
    change = 2 * float(np.linalg.norm(error * unfollowed)) / error.size
    shift = float(np.mean(unfollowed**2) + np.mean(2 * np.abs(error) * bound + bound**2))
    noise, elsewhere = noise_interval(capture), pictures_of_other_light(capture, image)
    statistical = (
        _in_db(peak.error),
        _in_db(change / mean_square) / 2,
        _in_db(noise.standard_error / noise.value),
    )
    systematic = (
        _in_db(peak.excess) + _in_db(peak.bound),
        _in_db(shift / mean_square) / 2,
        _in_db(noise.systematic / noise.value),
        # In the image as more noise, which exact light would not have.
        10 * math.log10(1 + capture.model_error.scatter**2),
        max((abs(psnr_db(truth, other) - value) for other in elsewhere), default=0.0),
    )
    scatter_db = scatter_of_scores(capture, image).psnr_db
    return Interval(value, float(np.linalg.norm(statistical)), float(sum(systematic)), scatter_db)


def ssim_interval(capture: Capture, image: Reconstruction) -> Interval:
    """SSIM of a reconstruction of a capture with its interval, from draws of the cells' errors, of
    the brightest cell's among them, and of the noise.
    """
    truth, seen = capture.measured_scene_e, image.picture - capture.backscatter_e
    known, value = np.isfinite(truth), similarity(truth, seen)
    if not (np.isfinite(value) and truth[known].max(initial=0.0) > 0):
        return Interval(value)
    # The image's error grows with the noise, and that with the light.
    noise, off = noise_interval(capture), seen - truth
    # One draw and what the image leaves of it; others have blocks of it with the opposite sign.
    draw, (rest, rest_of_bound) = _drawn(capture), _unfollowed(capture, image)
    signs = _image_draws(truth.shape)[1]
    moves = [(by * sign * draw, by * sign * rest) for by in (1.0, _TWICE) for sign in signs]
    bound = capture.light_systematic_e + 0 * truth
    is_bounded = bool(np.isfinite(bound[known]).all() and bound[known].any())
    if is_bounded:
        moves.append((bound, rest_of_bound))
    peak = _peak(capture)
    changes = peak.error, -min(peak.excess, _MOST), peak.bound if is_bounded else 0.0
    peaks = [peak.value * (1 + change) for change in changes]
    more_noise = math.hypot(1, capture.model_error.scatter)
    noisier, much_noisier, brighter, duller, brightest, *drawn = similarities(
        [truth] * 5 + [truth + by for by, _ in moves],
        [
            *(truth + more * off for more in (1 + _STEP, more_noise)),
            *[seen] * 3,
            *(seen + by + left for by, left in moves),
        ],
        [peak.value, peak.value, *peaks, *[peak.value] * len(moves)],
    )
    by_noise = (noisier - value) / _STEP / noise.value
    at_bound = drawn.pop() if is_bounded else np.inf if bound[known].any() else value
    once, twice = np.reshape(drawn, (2, -1))
    statistical = np.linalg.norm(
        [_VERY_FEW * np.std(once, ddof=1), by_noise * noise.standard_error, brighter - value]
    )
    # From the truth with one, two and three errors of the same size to that without any: along a
    # straight line, or a parabola where that leads farther.
    further, still_further = float(once.mean()) - value, float(twice.mean()) - value
    systematic = max(abs(further), abs(3 * further - still_further))
    systematic += abs(by_noise) * noise.systematic + abs(much_noisier - value)
    systematic += abs(at_bound - value) + abs(duller - value) + abs(brightest - value)
    elsewhere = list(pictures_of_other_light(capture, image))
    if elsewhere:
        moved = similarities([truth] * len(elsewhere), elsewhere)
        systematic += float(np.abs(moved - value).max())
    scatter = scatter_of_scores(capture, image).ssim
    return Interval(value, float(statistical), float(systematic), scatter)


@dataclass(frozen=True)
class _Peak:
    """The brightest cell, to which scores refer, electrons.

    Of it, relative: its standard ``error``, its ``excess``, since the brightest of cells with
    errors is brighter than the true one in the mean, and the ``bound`` of what was left out.
    """

    value: float
    error: float
    excess: float
    bound: float


def _peak(capture: Capture) -> _Peak:
    truth = capture.measured_scene_e
    known = np.isfinite(truth)
    value = float(truth[known].max())
    draws, _ = normal_draws(int(known.sum()))
    drawn = (truth[known] + capture.cells_error_e[known] * draws).max(axis=1) / value
    bound = capture.light_systematic_e + 0 * truth
    return _Peak(
        value,
        FEW * float(drawn.std(ddof=1)),
        max(float(drawn.mean()) - 1, 0.0),
        float(bound[np.unravel_index(np.nanargmax(truth), truth.shape)]) / value,
    )


def _signs_of_blocks(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """+1 or -1 by chance, alike in each block of cells: most of what a method smooths over stays
    within one.
    """
    rows, columns = shape
    signs = rng.choice([-1.0, 1.0], (-(-rows // _BLOCK), -(-columns // _BLOCK)))
    return np.asarray(np.kron(signs, np.ones((_BLOCK, _BLOCK)))[:rows, :columns])


def _off(capture: Capture, image: Reconstruction) -> Array:
    """Error of an image without backscatter, NaN where nothing is measured."""
    return np.asarray(image.picture - capture.backscatter_e - capture.measured_scene_e)


def _drawn(capture: Capture) -> Array:
    return np.asarray(capture.cells_error_e * _image_draws(capture.cells_e.shape)[0])


@lru_cache(maxsize=2)
def _unfollowed(capture: Capture, image: Reconstruction) -> tuple[Array, Array]:
    """What the image leaves of the drawn error of its truth, and of its bound; kept for the next
    score of the same image.
    """
    follows, bound = Follows(capture, image), capture.light_systematic_e
    rest, of_exposures = follows.rest(_drawn(capture)), capture.model_error.of_exposures
    if of_exposures is not None:
        # Another draw than that of the truth.
        rest = rest + of_exposures * _image_draws(rest.shape)[0][::-1, ::-1]
    return rest, follows.rest(bound + 0 * capture.measured_scene_e)


@lru_cache(maxsize=8)
def _image_draws(shape: tuple[int, ...]) -> tuple[Array, tuple[Array, ...]]:
    """A normal draw of each cell, (rows, columns), and signs of its blocks for each image."""
    rng = np.random.default_rng(SEED)
    draw = rng.normal(size=shape)
    return draw, tuple(_signs_of_blocks(shape, rng) for _ in range(_DRAWS_OF_IMAGES))


def _relative(
    value: float, statistical: float, systematic: float = 0.0, by_noise: float = 0.0
) -> Interval:
    bound = value * systematic if value else 0.0
    return Interval(value, value * statistical, bound, value * by_noise)


def _in_db(relative: float) -> float:
    """Change of a level by a relative change of amplitude; the larger of both directions."""
    return float(-20 * np.log10(1 - relative)) if relative < 1 else np.inf
