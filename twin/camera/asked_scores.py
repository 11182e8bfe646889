"""Whether scores of an image are as exact as a tolerance asks."""

from collections.abc import Iterator
from dataclasses import replace

from hardware.formatting import number
from twin.accuracy import Interval
from twin.camera.evaluation import Evaluation
from twin.camera.intervals import ScoreIntervals
from twin.fidelity import Tolerance
from twin.warned import CaptureWarning


def asked_of(tolerance: Tolerance, scores: ScoreIntervals) -> Iterator[tuple[str, float, Interval]]:
    """Name, what is asked and interval of each score that is to be exact."""
    for name, limit, figure in (
        ("PSNR in dB", tolerance.psnr_db, scores.psnr_db),
        ("SSIM", tolerance.ssim, scores.ssim),
    ):
        if limit is not None:
            yield name, limit, figure


def warned_of_scores(evaluation: Evaluation, tolerance: Tolerance) -> Evaluation:
    """The same with a warning of each image whose scores are less exact than asked: light was
    chosen for one method, of one system.
    """
    found = tuple(
        CaptureWarning(
            "tolerance",
            f"{image.method}: {name} is known to {number(width, 2)}, {number(limit, 2)} asked: "
            "light was chosen for another image",
        )
        for image, scores in zip(
            evaluation.reconstructions, evaluation.score_intervals, strict=True
        )
        for name, limit, figure in asked_of(tolerance, scores)
        if (width := figure.of_model.half_width) > limit
    )
    if not found:
        return evaluation
    capture = evaluation.capture
    return replace(evaluation, capture=replace(capture, warnings=(*capture.warnings, *found)))
