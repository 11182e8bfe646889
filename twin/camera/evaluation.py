"""Image quality: scores of reconstructions of one capture against its noise-free truth.

The truth is the light of the scene. Backscatter in fog is neither truth nor noise: its expectation,
which the twin knows, is subtracted from the image before scoring. A score thus falls with the
attenuation by the fog and with the noise of its backscatter, but does not depend on the mean
backscatter itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.reconstruction import (
    METHODS,
    Method,
    Reconstruction,
    fits_in_memory,
    method_of,
    reconstruct,
)
from hardware.reconstruction.registry import Solve
from twin.camera.acquisition import Capture
from twin.camera.verdict import ImageVerdict
from twin.errors import InputError
from twin.system import System

#: Methods of every evaluation: the plain inverse and the vehicle's default.
SHOWN = ("zero-fill", "lmmse")
#: Of a user's own patterns, which zero-fill cannot invert.
SHOWN_OF_OWN = ("least-squares", "lmmse")


@dataclass(frozen=True)
class Score:
    """Peak signal-to-noise ratio and structural similarity, peak = the scene's brightest cell."""

    psnr_db: float
    ssim: float

    def __str__(self) -> str:
        """In words, also where one of them has no value."""
        if self.psnr_db == -np.inf:
            return "no lit cell to compare with"
        psnr = f"PSNR {self.psnr_db:.1f} dB" if np.isfinite(self.psnr_db) else "no error"
        return psnr if np.isnan(self.ssim) else f"{psnr}, SSIM {self.ssim:.2f}"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One system's capture with its reconstructions, best first, and their scores."""

    system: System
    capture: Capture
    reconstructions: tuple[Reconstruction, ...]
    scores: tuple[Score, ...]

    @property
    def verdict(self) -> ImageVerdict:
        """Quality of an image of the record."""
        return self.capture.verdict

    @property
    def best(self) -> str:
        """The best reconstruction with its score, in words; of a void record there is none."""
        if self.verdict.void:
            return "no image"
        return f"{self.reconstructions[0].method}: {self.scores[0]}"

    def __str__(self) -> str:
        """The result in one line, as the command prints it."""
        return f"{self.system.name}: {self.verdict}; {self.best}"


def evaluate(
    system: System,
    capture: Capture,
    reconstructions: list[Reconstruction] | None = None,
    *,
    method: str | Method | Solve | None = None,
) -> Evaluation:
    """Score reconstructions of a capture, by default those of `SHOWN` that fit in memory, and that
    by ``method``, a bundled one or a user's own, see `hardware.reconstruct`.

    Raises InputError for a reconstruction on another grid than the capture's.

    >>> from twin.camera.acquisition import capture
    >>> from twin.fidelity import PRESETS
    >>> from twin.scene import load_scene
    >>> from twin.system import load_system
    >>> system = load_system("workable").with_({"acquisition.n_patterns": 1024})
    >>> taken = capture(load_scene("table1"), system, seed=1, fidelity=PRESETS["draft"])
    >>> found = evaluate(system, taken, method=lambda values, noise_variance, sensing: (
    ...     sensing.adjoint(values) / sensing.n_cells
    ... ))
    >>> sorted(image.method.split("-")[0] for image in found.reconstructions)
    ['lambda', 'lmmse', 'zero']
    >>> found.verdict.void
    False
    """
    record = capture.record
    bundled = SHOWN if isinstance(record.patterns, PatternSet) else SHOWN_OF_OWN
    shown = [METHODS[name] for name in bundled if fits_in_memory(name, record.patterns)]
    if method is not None and (own := method_of(method)) not in shown:
        shown.append(own)
    images = reconstructions or [reconstruct(record, solve) for solve in shown]
    scored = [(image, score_of(capture, image.picture)) for image in images]
    scored.sort(key=lambda pair: -pair[1].psnr_db)
    return Evaluation(system, capture, tuple(i for i, _ in scored), tuple(s for _, s in scored))


def score_of(capture: Capture, image: NDArray[np.float64]) -> Score:
    """`score` of an image of a capture, less backscatter, against the light of the scene."""
    truth = capture.measured_scene_e
    return score(truth, image - capture.backscatter_e if image.shape == truth.shape else image)


def score(truth: NDArray[np.float64], image: NDArray[np.float64]) -> Score:
    """PSNR and SSIM (Wang 2004, 7 x 7 windows) of an image in the unit of its truth.

    Cells whose truth is NaN are not measured and are left out.
    """
    from skimage.metrics import structural_similarity

    if truth.shape != image.shape:
        raise InputError(f"image: shape {image.shape}, the truth has {truth.shape}")
    known = np.isfinite(truth)
    peak = float(truth[known].max(initial=0.0))
    error = float(np.mean((image - truth)[known] ** 2))
    if peak == 0 or error == 0:
        return Score(np.inf if error == 0 else -np.inf, 1.0 if error == 0 else 0.0)
    window = min(7, *(side - 1 + side % 2 for side in truth.shape))
    similar = np.nan  # undefined on images narrower than the smallest window
    if window >= 3:
        pair = (np.where(known, pixels, 0.0) for pixels in (truth, image))
        similar = structural_similarity(*pair, data_range=peak, win_size=window)
    return Score(float(10 * np.log10(peak**2 / error)), float(similar))
