"""``summary.json``: every figure of a run with its unit and interval, and what was left out."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import json_text
from hardware.radar import Detection
from twin.accuracy import Decision, Figure, Interval, propagated
from twin.camera.evaluation import Evaluation
from twin.camera.intervals import signal_power_interval, sun_power_interval
from twin.camera.view import View
from twin.errors import InputError
from twin.optics.hazards import least_margins
from twin.radar.detection_count import targets_detected
from twin.radar.evaluation import RadarEvaluation
from twin.radar.intervals import body_level
from twin.radar.micro_doppler import DEEPEST_DB
from twin.report.findings import Finding, camera_finding
from twin.report.measured import emitter_share, noise_found, range_used
from twin.report.radar_findings import radar_finding
from twin.report.radar_summary import budget_figures, noise_found_dbm
from twin.report.sensor_warnings import warnings_of
from twin.scene import Scene

SUMMARY = "summary.json"
_FORMAT, _VERSION = "ugv-twin-summary", 1


def write_summary(
    scene: Scene,
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
    folder: Path,
) -> None:
    """Write `summary` as ``summary.json``."""
    text = json_text(summary(scene, view, evaluations, radar))
    (folder / SUMMARY).write_text(text + "\n", encoding="utf-8")


def summary(
    scene: Scene,
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
) -> dict[str, Any]:
    """Every figure of a run, and every decision of its models.

    Its ``figures`` have ``of`` (system or radar, then object or method), ``name``, ``unit``,
    ``value``, ``standard_error``, ``systematic`` and ``noise`` (see `Interval`), null where nothing
    bounds them; its
    ``decisions`` are effects that were modelled or left out, with the bounds that decided; its
    ``findings`` are the verdicts on the sensors in words; its ``warnings`` have ``of`` (scene,
    system or radar) and ``text``.
    """
    figures = [figure for evaluation in evaluations for figure in camera_figures(evaluation)]
    figures += _at_equal_time(evaluations)
    if view:
        of, name = (evaluations[0].system.name,), "emitter's share of the light in the band"
        figures.append(Figure(of, name, "", Interval(emitter_share(view))))
    decisions: list[Decision] = [d for e in evaluations for d in e.capture.decisions]
    findings = [camera_finding(evaluation) for evaluation in evaluations]
    if radar:
        figures += radar_figures(radar)
        decisions += radar.capture.decisions
        findings.append(radar_finding(radar))
    figures += [figure for finding in findings for figure in finding.figures]
    return {
        "format": _FORMAT,
        "version": _VERSION,
        "figures": [figure.entry() for figure in figures],
        "decisions": [asdict(decision) for decision in decisions],
        "findings": [_said(finding) for finding in findings],
        "warnings": [
            {"of": name, "text": text} for name, text in warnings_of(scene, evaluations, radar)
        ],
    }


def _said(finding: Finding) -> dict[str, Any]:
    return {
        "sensor": finding.sensor,
        "state": finding.state,
        "result": finding.result,
        "answers": dict(finding.answers),
    }


def _at_equal_time(evaluations: Sequence[Evaluation]) -> Iterator[Figure]:
    """Median SNR of all frames within the longest frame time."""
    longest_s = max((e.system.frame_time_s for e in evaluations), default=0.0)
    for evaluation in evaluations:
        if evaluation.verdict.void:
            continue
        frames = longest_s / evaluation.system.frame_time_s
        of, name = (evaluation.system.name,), "SNR per pixel, median, averaged over equal time"
        snr = propagated(lambda s, n=frames: s * n**0.5, evaluation.intervals.snr_median)
        yield Figure(of, name, "", snr)
        yield Figure(of, "frames averaged over equal time", "", Interval(frames))


def camera_figures(evaluation: Evaluation) -> Iterator[Figure]:
    """Figures of a camera's capture and of its reconstructions."""
    capture, system, intervals = evaluation.capture, evaluation.system, evaluation.intervals
    of, noise = (system.name,), capture.noise
    lens, pixel_noise_e = capture.lens, noise.pixel_noise_e(system.patterns)
    of_pixel = pixel_noise_e / noise.total_noise_e if noise.total_noise_e else 0.0
    yield Figure(of, "SNR per pixel, median of the lit cells", "", intervals.snr_median)
    yield Figure(of, "SNR per pixel, best", "", intervals.snr_best)
    yield Figure(of, "share of lit cells above their noise", "", intervals.above_noise_share)
    yield Figure(of, "signal per exposure", "e-", intervals.signal_e)
    yield Figure(of, "sun per exposure", "e-", intervals.background_e)
    yield Figure(of, "dark current per exposure", "e-", Interval(noise.dark_e))
    yield Figure(of, "noise per exposure", "e-", intervals.noise_e)
    yield Figure(of, "noise per pixel", "e-", propagated(lambda e: of_pixel * e, intervals.noise_e))
    yield Figure(of, "signal on the detector, mean", "W", signal_power_interval(capture))
    yield Figure(of, "sun on the detector", "W", sun_power_interval(capture))
    exact = (
        ("frame time", "s", system.frame_time_s),
        ("mean power sent out", "W", system.mean_power_w),
        ("illuminance", "lx", capture.illuminance_lx),
        ("sun in the band", "W/m²", capture.sun_irradiance_w_per_m2),
        ("emitter line inside the filter", "", capture.in_band_fraction),
        ("share of the converter's range that patterns move", "", range_used(evaluation)),
        ("focal length of the detector's lens", "m", lens.focal_length_m),
        ("pupil of the detector's lens", "m", lens.pupil_diameter_m),
    )
    for name, unit, value in exact:
        yield Figure(of, name, unit, Interval(value))
    if np.isfinite((found := noise_found(evaluation)).value):
        yield Figure(of, "noise per exposure as found in the record", "e-", found)
    for name, noise_e in noise.noise_e.items():
        yield Figure((*of, name), "noise per exposure, rms", "e-", Interval(noise_e))
    yield from _eye_safety(evaluation)
    yield from _cell_errors(evaluation)
    yield from _range_errors(evaluation)
    for image, score in zip(evaluation.reconstructions, evaluation.score_intervals, strict=True):
        yield Figure((*of, image.method), "PSNR", "dB", score.psnr_db)
        yield Figure((*of, image.method), "SSIM", "", score.ssim)


def _eye_safety(evaluation: Evaluation) -> Iterator[Figure]:
    """Least margins to the limits of exposure, where they are known."""
    try:
        margins = least_margins(evaluation.system)
    except InputError:
        return
    for margin in margins:
        if margin is not None:
            of = (evaluation.system.name, margin.name)
            yield Figure(of, "margin to the exposure limit", "", Interval(float(margin.margin)))


def _range_errors(evaluation: Evaluation) -> Iterator[Figure]:
    """Errors of distances, of a system with time of flight."""
    ranges = evaluation.ranges
    if ranges is None or not ranges.sure_share:
        return
    for name, value in (
        ("absolute error of a distance, median", ranges.median_m),
        ("absolute error of a distance, 90 %", ranges.worst_tenth_m),
        ("standard error of a distance as the vehicle gives it, median", ranges.claimed_m),
    ):
        yield Figure((evaluation.system.name,), name, "m", Interval(value, systematic=np.inf))


def _cell_errors(evaluation: Evaluation) -> Iterator[Figure]:
    """What the model's light is off by in the cells: figures of the errors themselves."""
    capture = evaluation.capture
    lit, of = capture.lit, (evaluation.system.name,)
    if not lit.any():
        return
    over_noise = capture.cells_error_e / capture.noise.pixel_noise_e(evaluation.system.patterns)
    over_light = capture.cells_error_e[lit] / capture.scene_e[lit]
    bound = np.broadcast_to(capture.light_systematic_e, lit.shape)[lit]
    for name, value in (
        ("standard error of a cell over its noise, root mean square", _rms(over_noise)),
        ("standard error of a cell over its noise, median", float(np.median(over_noise))),
        ("standard error of a lit cell over its light, median", float(np.median(over_light))),
        (
            "systematic error of a lit cell over its light, median",
            float(np.median(bound / capture.scene_e[lit])),
        ),
    ):
        yield Figure(of, name, "", Interval(value))


def radar_figures(evaluation: RadarEvaluation) -> Iterator[Figure]:
    """Figures of a radar's map, targets, bodies and detections."""
    capture, wave, of = evaluation.capture, evaluation.waveform, (evaluation.radar.name,)
    for name, value, unit in (
        ("carrier", wave.carrier_hz, "Hz"),
        ("bandwidth", wave.bandwidth_hz, "Hz"),
        ("range cell", wave.range_cell_m, "m"),
        ("unambiguous range", wave.max_range_m, "m"),
        ("range-rate cell", wave.velocity_cell_m_per_s, "m/s"),
        ("unambiguous range rate", wave.max_velocity_m_per_s, "m/s"),
    ):
        yield Figure(of, name, unit, Interval(value))
    for name, figure, unit in budget_figures(evaluation):
        yield Figure(of, name, unit, figure)
    yield Figure(of, "targets detected", "", targets_detected(evaluation))
    for target in capture.truth:
        whose = (*of, "true", target.name)
        yield Figure(whose, "cross-section", "m²", Interval(target.rcs_m2))
        yield Figure(whose, "range", "m", Interval(target.range_m))
        yield Figure(whose, "range rate", "m/s", Interval(target.range_rate_m_per_s))
        received = 10 * np.log10(max(target.received_w, 1e-300) * 1e3)
        yield Figure(whose, "level by the radar equation", "dBm", Interval(float(received)))
    for body in capture.propagation.bodies:
        level = body_level(body)
        whose = (*of, "body", body.name)
        yield Figure(whose, "level over the strongest body", "dB", level)
        error = body.estimated_error * body.level_over_echo
        yield Figure(whose, "stated error over its own echo", "", Interval(error))
    for role in capture.propagation.roles:
        ratio = Interval(float(role.over_fresnel_zone))
        yield Figure(
            (*of, "object", role.name), "largest flat side over the Fresnel zone", "", ratio
        )
    yield from _detected(evaluation)
    for moving in evaluation.micro_doppler:
        # Of an edge of a spectrum nothing is told below its cells.
        heard, cell = moving.heard_m_per_s, float(np.diff(moving.seen.range_rate_m_per_s).max())
        if moving.depth_db < DEEPEST_DB:  # it ends in the noise, wherever its rates do
            cell = float("inf")
        for name, value, systematic in (
            ("least range rate of its parts", moving.least_m_per_s, 0.0),
            ("greatest range rate of its parts", moving.greatest_m_per_s, 0.0),
            ("least range rate heard", heard[0], cell),
            ("greatest range rate heard", heard[1], cell),
        ):
            figure = Interval(value, systematic=systematic)
            yield Figure((*of, "micro-Doppler", moving.name), name, "m/s", figure)
    for seen in evaluation.picture.seen if evaluation.picture else ():
        for name, value, unit in (
            ("down-range in the image", seen.down_range_m, "m"),
            ("cross-range in the image", seen.cross_range_m, "m"),
            ("distance from its place in the image", seen.off_m, "m"),
            ("cross-section in the image", seen.rcs_m2, "m²"),
        ):
            # Of a sum over many bursts nothing tells the error.
            figure = Interval(value, systematic=float("inf"))
            yield Figure((*of, "image", seen.name), name, unit, figure)


def _snr(detection: Detection, level_dbm: Interval, evaluation: RadarEvaluation) -> Interval:
    """Of an echo over the map's noise; both scatter."""
    noise = np.hypot(level_dbm.noise, noise_found_dbm(evaluation).noise)
    return replace(level_dbm, value=detection.snr_db, noise=float(noise))


def _detected(evaluation: RadarEvaluation) -> Iterator[Figure]:
    rows = zip(
        evaluation.detections,
        evaluation.intervals,
        evaluation.matches,
        evaluation.further,
        strict=True,
    )
    for number, (detection, model, target, part) in enumerate(rows):
        other = f"part of {part.name}" if part else "other"
        of = (evaluation.radar.name, f"detection {number}", target.name if target else other)
        yield Figure(of, "range", "m", model.range_m)
        yield Figure(of, "range rate", "m/s", model.range_rate_m_per_s)
        yield Figure(of, "level", "dBm", model.level_dbm)
        yield Figure(of, "SNR", "dB", _snr(detection, model.level_dbm, evaluation))
        if target:
            true = 10 * np.log10(max(target.received_w, 1e-300) * 1e3)
            for name, found, value, unit in (
                ("range less the true one", model.range_m, target.wrapped_range_m, "m"),
                (
                    "range rate less the true one",
                    model.range_rate_m_per_s,
                    target.range_rate_m_per_s,
                    "m/s",
                ),
                ("level less the radar equation's", model.level_dbm, true, "dB"),
            ):
                yield Figure(of, name, unit, replace(found, value=found.value - value))
        for name, angle in (("azimuth", model.azimuth_rad), ("elevation", model.elevation_rad)):
            if not np.isnan(angle.value):
                yield Figure(of, name, "rad", angle)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
