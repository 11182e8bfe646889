"""Assembles the self-contained HTML page of charts and tables."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from hardware.formatting import json_text, number, quantity_text, setting_text, si
from twin.camera.evaluation import Evaluation
from twin.camera.intervals import signal_power_interval, sun_power_interval
from twin.camera.view import View
from twin.errors import InputError
from twin.optics.hazards import least_margins
from twin.progress import Stages
from twin.radar.evaluation import RadarEvaluation
from twin.report import camera_charts, charts, decisions, overview, radar_charts
from twin.report.findings import camera_finding
from twin.report.measured import noise_found
from twin.report.radar_findings import radar_finding
from twin.report.radar_summary import radar_summary
from twin.report.scene_model import scene_model
from twin.report.sensor_warnings import warnings_of
from twin.scene import Scene
from twin.system import System

_TEMPLATE = Path(__file__).parent


def write_report(
    scene: Scene,
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
    asked: Mapping[str, Any],
    stages: Stages,
    folder: Path,
) -> None:
    """Write ``report.html`` to ``folder``.

    Without a view and evaluations it is the report of a radar alone. ``asked``: what stands in
    ``run.json``, its seed, command and versions among them.
    """
    import jinja2

    with stages.stage("charts"):
        plots = _charts(scene, view, evaluations, radar)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATE),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    content = {
        "charts": {name: chart for group in plots.values() for name, chart in group.items()},
        "scene": scene_model(scene, evaluations, radar),
        "heat": charts.HEAT,
    }
    page = environment.get_template("report.html.j2").render(
        scene=scene,
        asked=asked,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        findings=[*map(camera_finding, evaluations), *([radar_finding(radar)] if radar else [])],
        evaluations=evaluations,
        columns=_columns(evaluations),
        noises=[(e.system.name, _noises(e)) for e in evaluations],
        plots=plots,
        content=_script_safe(json_text(content)),
        settings=[(d, _settings(d)) for d in _designs(evaluations, radar)],
        assumptions=evaluations[0].capture.assumptions if evaluations else (),
        radar=radar_summary(radar) if radar else None,
        warnings=[f"{name}: {text}" for name, text in warnings_of(scene, evaluations, radar)],
        decisions=decisions.rows(decisions.decisions_of(evaluations, radar)),
        seconds=stages.seconds,
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _charts(
    scene: Scene,
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
) -> dict[str, dict[str, charts.Chart]]:
    """Charts by the section of the page, each with a name of its own."""
    groups: dict[str, list[charts.Chart]] = {
        "plan": [overview.plan_chart(scene, evaluations, radar)]
    }
    if view:
        groups["image"] = overview.image_charts(scene, view, evaluations, radar)
        groups["truth"] = list(camera_charts.truth_charts(evaluations[0]))
        groups["pictures"] = [
            c for e in evaluations for c in camera_charts.reconstruction_charts(e)
        ]
        groups["snr"] = [camera_charts.snr_chart(e) for e in evaluations]
        groups["counts"] = [camera_charts.counts_chart(e) for e in evaluations]
        groups["light"] = list(camera_charts.light_charts(view))
    if radar:
        groups["map"] = [radar_charts.map_chart(radar)]
        if radar.picture:
            groups["track"] = [radar_charts.track_chart(radar.picture)]
        groups["cuts"] = radar_charts.cut_charts(radar)
        groups["micro"] = radar_charts.micro_doppler_charts(radar)
    return {
        group: {f"{group}-{i}": chart for i, chart in enumerate(found)}
        for group, found in groups.items()
    }


def _noises(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Name, electrons and share of the variance of each noise, the largest first."""
    noise = evaluation.capture.noise
    total = noise.total_noise_e or 1.0
    ordered = sorted(noise.noise_e.items(), key=lambda item: -item[1])
    return [(name, f"{number(value)} e-", (value / total) ** 2) for name, value in ordered]


def _script_safe(text: str) -> str:
    """JSON that no end of a script's tag can stand in."""
    return text.replace("<", "\\u003c")


def _designs(evaluations: Sequence[Evaluation], radar: RadarEvaluation | None) -> list[Any]:
    return [*(e.system for e in evaluations), *([radar.radar] if radar else [])]


def _settings(design: Any) -> list[tuple[str, str, Any]]:
    """Name, value in words, and the value with its source."""
    return [(name, setting_text(name, value.value), value) for name, value in design.values()]


def _columns(evaluations: Sequence[Evaluation]) -> list[dict[str, str]]:
    """Key figures of each system, by name; those of several at equal frame time too."""
    columns = [_summary(evaluation) for evaluation in evaluations]
    longest_s = max((e.system.frame_time_s for e in evaluations), default=0.0)
    for column, evaluation in zip(columns, evaluations, strict=True):
        frames = longest_s / evaluation.system.frame_time_s
        snr = evaluation.verdict.snr_median * math.sqrt(frames)
        found = "none" if evaluation.verdict.void else f"{number(snr)}, {number(frames)} averaged"
        column[f"median SNR of all frames in {si(longest_s, 's')}"] = found
    return columns


def _safety(system: System) -> str:
    """Least margin to the exposure limits of the eye."""
    try:
        normal, fault = least_margins(system)
    except InputError as error:
        return str(error)
    if math.isinf(normal.margin):
        return "no light is sent out"
    told = f"margin {number(normal.margin)} ({normal.name}; {normal.clause})"
    return told if fault is None else f"{told}; {number(fault.margin)} ({fault.name})"


def _summary(evaluation: Evaluation) -> dict[str, str]:
    """Key figures of one system, by name."""
    capture, system = evaluation.capture, evaluation.system
    lens, noise, patterns = capture.lens, capture.noise, system.patterns
    verdict = evaluation.verdict
    found = noise_found(evaluation)
    rendering = capture.cells_error_e / noise.pixel_noise_e(patterns)
    intervals = evaluation.intervals
    images = zip(evaluation.reconstructions, evaluation.score_intervals, strict=True)
    named = [f"{image.method}: {score}" for image, score in images]
    return {
        "system": system.name,
        "what it is": system.description,
        "patterns": f"{patterns.count} of {patterns.columns} x {patterns.rows}, {patterns.mode}"
        + (", one cell at a time" if system.is_raster else "")
        + (f", own ({patterns.digest[:8]})" if patterns.digest else ""),
        "frame time": f"{si(system.frame_time_s, 's')} "
        f"({number(1 / system.frame_time_s)} frames/s)",
        "mean power sent out": si(system.mean_power_w, "W"),
        "eye safety": _safety(system),
        "distances, absolute error": str(evaluation.ranges or "none: no time of flight"),
        "sun in the band": f"{number(capture.sun_irradiance_w_per_m2, 4)} W/m² "
        f"at {quantity_text(capture.illuminance_lx, 'lx')}",
        "emitter line inside the filter": f"{capture.in_band_fraction:.1%}",
        "detector lens": f"focal length {si(lens.focal_length_m, 'm')}, "
        f"pupil {si(lens.pupil_diameter_m, 'm')}, "
        f"field {number(system.optics.field_of_view_deg.value, 4)}° {lens.outline}",
        "signal on the detector, mean": signal_power_interval(capture).text("W"),
        "sun on the detector": sun_power_interval(capture).text("W"),
        "electrons per exposure": f"signal {intervals.signal_e}, sun {intervals.background_e}, "
        f"dark {number(noise.dark_e)}",
        "noise per exposure": f"{intervals.noise_e} e- predicted, "
        + (
            f"{found} e- found in the record"
            if np.isfinite(found.value)
            else "not told by the record"
        ),
        "noise per pixel": f"{number(float(noise.pixel_noise_e(patterns)))} e-",
        "verdict": str(verdict),
        "best pixel": "none" if verdict.void else f"SNR {intervals.snr_best}",
        "pixels above their noise": "none" if verdict.void else f"{intervals.above_noise_share}",
        "Monte-Carlo error of the twin over sensor noise": "median "
        f"{number(float(np.median(rendering)), 2)}, "
        f"root mean square {number(float(np.sqrt(np.mean(rendering**2))), 2)}",
        "reconstructions": "no image" if verdict.void else "; ".join(named),
    }
