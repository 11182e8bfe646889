"""The largest error of light, over the noise, at which scores of an image are as exact as asked."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hardware.formatting import number
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera import Capture, capture
from twin.camera.asked_scores import asked_of
from twin.camera.evaluation import evaluate
from twin.camera.intervals import ScoreIntervals
from twin.errors import InputError, check_kind, check_seed
from twin.fidelity import DEFAULT_SHARE, Fidelity, Tolerance
from twin.scene import Scene, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

#: Knobs that such a tolerance chooses, or leaves without effect.
_OF_LIGHT = frozenset(
    ("light_tolerance", "light_tolerance_relative", "samples", "indirect_samples", "max_depth")
)
#: Shares of the noise, the largest and least that are tried.
_MOST, _LEAST = 2.0, 1e-3
#: Of the share that the last error asks for if errors fall with it, what is tried next; and the
#: least and largest steps.
_CAUTION, _STEPS = 0.8, (0.1, 0.7)


@dataclass(frozen=True)
class ScoredFidelity:
    """Knobs by which scores are as exact as asked: light to ``noise_share`` of the sensor's noise;
    ``scores``: of the last image, and ``method``, by which it was made; ``tried``: shares in turn;
    ``warnings``: where another light, rounded otherwise, moves the scores of one frame by more.
    """

    fidelity: Fidelity
    noise_share: float
    scores: ScoreIntervals
    method: str
    tried: tuple[float, ...]
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        scores = (
            f"{name} to {number(interval.of_model.half_width, 2)}{unit}"
            for name, interval, unit in (
                ("PSNR", self.scores.psnr_db, " dB"),
                ("SSIM", self.scores.ssim, ""),
            )
        )
        shares = ", ".join(map(number, self.tried))
        return (
            f"light to {number(self.noise_share)} of the noise has {' and '.join(scores)} "
            f"({self.method}; shares tried: {shares})"
        )


def fidelity_for_scores(
    scene: str | Path | Scene,
    tolerance: Tolerance,
    *,
    system: str | Path | System = "workable",
    seed: int = 0,
    bandwidth_hz: float | None = None,
    fixed: Mapping[str, Any] | None = None,
) -> ScoredFidelity:
    """Knobs for a tolerance of PSNR or SSIM: the largest of some shares of the noise, from 2 down,
    at which the model's part of the intervals of the best bundled reconstruction is within it.

    It holds in the mean over draws of the noise. Frames are captured with ``seed`` until one is
    exact enough, each with a share that the one before asks for; the last takes most of the time.
    ``tolerance.noise_share`` is that of the radar; where it is less than the default, light is no
    coarser either. ``bandwidth_hz``: of a radar, as `Tolerance.knobs` takes it. ``fixed``: knobs
    by name, which have these values whatever else is chosen.

    Raises InputError where no score is asked for, for a distance without a radar, for knobs that
    fix the light, for a void record and an image without that score, and where a thousandth of the
    noise is not enough, or no light is: what was left out has no bound.
    """
    check_kind("tolerance", tolerance, Tolerance, "twin.Tolerance")
    check_seed(seed)
    check_kind("fixed", fixed or {}, Mapping, "knobs by name")
    if not tolerance.of_scores:
        raise InputError(f"tolerance: {tolerance}: expected one of PSNR or SSIM")
    if tolerance.distance_m is not None and bandwidth_hz is None:
        tolerance.check_sensors(camera=True, radar=False)
    if given := _OF_LIGHT & set(fixed or {}):
        raise InputError(f"{min(given)}: is given, and would follow from {tolerance}")
    world = scene if isinstance(scene, Scene) else load_scene(scene)
    sensor, rendered = load_system(system), mitsuba_scene(world)
    usual = replace(tolerance, psnr_db=None, ssim=None)
    is_less = tolerance.noise_share < DEFAULT_SHARE
    share, tried = tolerance.noise_share if is_less else _MOST, list[float]()
    while True:
        knobs = _with_light(usual.knobs(bandwidth_hz), share).with_(dict(fixed or {}))
        taken = capture(world, sensor, seed=seed, fidelity=knobs, mesh_scene=rendered)
        if taken.void:
            raise InputError(f"tolerance: {tolerance}: {taken.verdict}")
        found = evaluate(sensor, taken)
        tried.append(share)
        scores, method = found.score_intervals[0], found.reconstructions[0].method
        over = float(np.max(list(_over(tolerance, scores))))
        if math.isnan(over):
            raise InputError(f"tolerance: {tolerance}: this image has no such score: {scores}")
        if over <= 1:
            warnings = tuple(_of_rounding(tolerance, scores, taken))
            return ScoredFidelity(knobs, share, scores, method, tuple(tried), warnings)
        if math.isinf(over) or share <= _LEAST:
            parts = "; ".join(
                f"{name} ± {number(figure.of_model.half_width, 2)} by the model, of which "
                f"{number(figure.systematic, 2)} are bounds of what is left out"
                for name, _, figure in asked_of(tolerance, scores)
            )
            raise InputError(
                f"tolerance: {tolerance}: cannot be promised: at {share:.2g} of the noise "
                f"{method} has {parts}"
            )
        least, most = _STEPS
        share = max(share * min(max(_CAUTION / over, least), most), _LEAST)


def _with_light(knobs: Fidelity, share: float) -> Fidelity:
    """The knobs with light to a share of the noise, and what moves within a frame to half of it."""
    light = Tolerance(share).knobs()
    return replace(
        knobs, light_tolerance=light.light_tolerance, motion_tolerance=light.motion_tolerance
    )


def _of_rounding(tolerance: Tolerance, scores: ScoreIntervals, taken: Capture) -> Iterator[str]:
    """Where counts of a little other light, which are rounded otherwise, move a score of one frame
    by more than asked. Of noise whose part r of the variance is drawn anew squares correlate by
    (1 - r)^2.
    """
    noise = taken.noise
    anew = (noise.noise_e["quantisation"] / noise.total_noise_e) ** 2
    for name, limit, figure in asked_of(tolerance, scores):
        moved = TWO_SIDED_95 * figure.noise * math.sqrt(2 * (1 - (1 - anew) ** 2))
        if moved > limit:
            yield (
                f"{name} is as exact as asked in the mean over draws of the noise; that of one "
                f"frame moves by ± {number(moved, 2)} with light, as its counts are rounded "
                "otherwise"
            )


def _over(tolerance: Tolerance, scores: ScoreIntervals) -> Iterator[float]:
    """The model's part of each score's interval over what is asked; NaN of no score."""
    for _, limit, figure in asked_of(tolerance, scores):
        yield figure.of_model.half_width / limit if not math.isnan(figure.value) else math.nan
