"""Scores of an image against its truth: peak signal-to-noise ratio and structural similarity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.camera.acquisition import Capture
from twin.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """Peak signal-to-noise ratio and structural similarity, peak = the scene's brightest cell."""

    psnr_db: float
    ssim: float

    def __str__(self) -> str:
        return in_words(self.psnr_db, self.ssim, f"{self.psnr_db:.1f} dB", f"{self.ssim:.2f}")


def in_words(psnr_db: float, ssim: float, psnr_text: str, ssim_text: str) -> str:
    """Both, also where one of them has no value."""
    if psnr_db == -np.inf:
        return "no lit cell to compare with"
    psnr = f"PSNR {psnr_text}" if np.isfinite(psnr_db) else "no error"
    return psnr if np.isnan(ssim) else f"{psnr}, SSIM {ssim_text}"


def score(truth: Array, image: Array) -> Score:
    """PSNR and SSIM (Wang 2004, 7 x 7 windows) of an image in the unit of its truth.

    Cells whose truth is NaN are not measured and are left out. Raises InputError for images of
    other shapes.
    """
    level = psnr_db(truth, image)
    if np.isinf(level):
        return Score(level, 1.0 if level > 0 else 0.0)
    return Score(level, similarity(truth, image))


def psnr_db(truth: Array, image: Array) -> float:
    """PSNR alone: infinite without any error, minus infinite without light.

    Raises InputError for images of other shapes.
    """
    if truth.shape != image.shape:
        raise InputError(f"image: shape {image.shape}, the truth has {truth.shape}")
    known = np.isfinite(truth)
    peak = float(truth[known].max(initial=0.0))
    error = float(np.mean((image - truth)[known] ** 2))
    if peak == 0 or error == 0:
        return np.inf if error == 0 else -np.inf
    return float(10 * np.log10(peak**2 / error))


def score_of(capture: Capture, image: Array) -> Score:
    """`score` of an image of a capture, less backscatter, against the light of the scene."""
    truth = capture.measured_scene_e
    return score(truth, image - capture.backscatter_e if image.shape == truth.shape else image)


def similarity(truth: Array, image: Array) -> float:
    """SSIM alone; NaN of images narrower than the smallest window."""
    from skimage.metrics import structural_similarity

    window = _window(truth.shape)
    if window < 3:
        return float("nan")
    known = np.isfinite(truth)
    pair = (np.where(known, pixels, 0.0) for pixels in (truth, image))
    peak = float(truth[known].max(initial=0.0))
    with np.errstate(divide="ignore", invalid="ignore"):  # no light anywhere: NaN
        return float(structural_similarity(*pair, data_range=peak, win_size=window))


def similarities(
    truths: Sequence[Array], images: Sequence[Array], peaks: Sequence[float] | None = None
) -> Array:
    """SSIM of each of several pairs of one shape (rows, columns), in one pass over all of them.

    ``peaks``: of each pair, by default its truth's brightest cell.
    """
    from skimage.metrics import structural_similarity

    shape = truths[0].shape
    window = _window(shape)
    if window < 3:
        return np.full(len(truths), np.nan)
    # One above the other, each over its peak, which leaves SSIM as it is; windows that reach from
    # one to the next are cut off, as those at the borders are in any image.
    if peaks is None:
        peaks = [float(np.nanmax(truth, initial=0.0)) for truth in truths]
    pairs = []
    for truth, image, peak in zip(truths, images, peaks, strict=True):
        known = np.isfinite(truth)
        pairs.append([np.where(known, pixels, 0.0) / (peak or 1.0) for pixels in (truth, image)])
    both = (np.concatenate(stack) for stack in zip(*pairs, strict=True))
    _, places = structural_similarity(*both, data_range=1.0, win_size=window, full=True)
    edge = (window - 1) // 2
    inner = places.reshape(len(truths), *shape)[:, edge:-edge, edge:-edge]
    return np.asarray(inner.mean(axis=(1, 2)))


def _window(shape: tuple[int, ...]) -> int:
    """Side of SSIM's windows in an image."""
    return min(7, *(side - 1 + side % 2 for side in shape))
