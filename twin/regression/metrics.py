"""What is compared: one number per seed, which way is worse, and which loss is none."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection
from twin.camera.score import score
from twin.radar.truth import TrueTarget

Image = NDArray[np.float64]

#: A target that is not found counts as one found at the edge of the gate, in cells.
_GATE_CELLS = 2.0


@dataclass(frozen=True)
class Metric:
    """A figure of merit.

    name, unit
        As it stands in baselines and messages.
    of
        From truth and result of one seed to a number. Truth and result are images in electrons
        (rows, columns) for a camera, the truth NaN in cells that the patterns do not measure; the
        visible `TrueTarget`s and an `RadarResult` for a radar.
    tolerance
        Mean loss that does not matter: rounding, another order of sums. In ``unit``.
    higher_is_better
        Else lower is.
    relative
        The tolerance is a share of the baseline's mean.
    either_way
        A change in either direction is worse: an offset, of which the baseline's is the known one.
    """

    name: str
    unit: str
    of: Callable[[Any, Any], float]
    tolerance: float
    higher_is_better: bool = False
    relative: bool = False
    either_way: bool = False


@dataclass(frozen=True)
class RadarResult:
    """Detections of one record, each with its true target or None, the size of a range cell, and
    how many strong echoes have no detection.
    """

    detections: tuple[Detection, ...]
    matches: tuple[TrueTarget | None, ...]
    range_cell_m: float
    undetected_echoes: int = 0


def psnr_db(truth: Image, image: Image) -> float:
    """Peak signal-to-noise ratio; the peak is the brightest true cell."""
    return score(truth, image).psnr_db


def ssim(truth: Image, image: Image) -> float:
    """Structural similarity (Wang 2004)."""
    return score(truth, image).ssim


def rmse_e(truth: Image, image: Image) -> float:
    """Root mean square error, electrons."""
    return float(np.sqrt(np.mean((image - truth)[np.isfinite(truth)] ** 2)))


def range_error_m(truth: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Range error, rms over the targets; one that is not found counts as two cells off.

    So losing a target never improves it.
    """
    off = _offsets_m(found)
    gate = _GATE_CELLS * found.range_cell_m
    return float(np.sqrt(np.mean([off.get(t.name, gate) ** 2 for t in truth]))) if truth else 0.0


def range_offset_m(truth: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Range less the declared one, mean over the targets; 0 for one that is not found.

    A target is declared at its centre, while its surface answers: so an honest offset is not 0, and
    a bias could bring it nearer. What the baseline has is held, either way.
    """
    return float(sum(_offsets_m(found).values())) / len(truth) if truth else 0.0


def _offsets_m(found: RadarResult) -> dict[str, float]:
    """Range less the declared one, by name of the targets that were found."""
    return {
        target.name: detection.range_m - target.wrapped_range_m
        for detection, target in zip(found.detections, found.matches, strict=True)
        if target is not None
    }


def level_offset_db(truth: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Level over that of the declared cross-section by the radar equation, mean over the targets; 0
    for one that is not found.

    A surface is no point of its cross-section: what the baseline has is held, either way.
    """
    off = [
        10 * np.log10(detection.power_w / target.received_w)
        for detection, target in zip(found.detections, found.matches, strict=True)
        if target is not None and target.received_w > 0
    ]
    return float(sum(off)) / len(truth) if truth else 0.0


def missed(truth: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Visible targets without a detection."""
    seen = {target.name for target in found.matches if target is not None}
    return float(sum(target.name not in seen for target in truth))


def unmatched(_: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Detections that are no declared target: echoes of echoes, clutter, noise."""
    return float(sum(target is None for target in found.matches))


def undetected_echoes(_: tuple[TrueTarget, ...], found: RadarResult) -> float:
    """Strong echoes of the scene without a detection, of walls, of each part of a target and of
    bodies that are none: peaks 20 dB over the noise beside them, see `twin.regression.echoes`.

    So losing them, which lowers `unmatched`, is none the better.
    """
    return float(found.undetected_echoes)


#: Losses below these tolerances are not looked for; all are far below what a picture shows.
CAMERA_METRICS = (
    Metric("psnr_db", "dB", psnr_db, 0.02, higher_is_better=True),
    Metric("ssim", "", ssim, 0.001, higher_is_better=True),
    Metric("rmse_e", "electrons", rmse_e, 0.0025, relative=True),
)
RADAR_METRICS = (
    Metric("range_error_m", "m", range_error_m, 1e-5),
    Metric("range_offset_m", "m", range_offset_m, 1e-4, either_way=True),
    Metric("level_offset_db", "dB", level_offset_db, 0.01, either_way=True),
    Metric("missed", "targets", missed, 0.01),
    Metric("unmatched", "detections", unmatched, 0.01),
    Metric("undetected_echoes", "echoes", undetected_echoes, 0.01),
)
