"""One picture of both sensors: the camera's image and the plan view, with what the radar finds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from hardware.formatting import number, si
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera.evaluation import Evaluation
from twin.camera.view import View
from twin.radar.evaluation import RadarEvaluation
from twin.report import charts
from twin.report.places import (
    Place,
    half_width_rad,
    in_image,
    places_of,
    radar_frame,
    surfaces_at_detections,
)
from twin.scene import Scene

Array = NDArray[np.float64]

_ARC_POINTS = 25
_MARGIN = 1.15  # of the plan beyond what is in it


def image_charts(
    scene: Scene, view: View, evaluations: Any, radar: RadarEvaluation | None
) -> list[charts.Chart]:
    """The scene's image and each camera's reconstruction, with the radar's detections in them."""
    first = evaluations[0]
    layers = _marks_in_image(scene, first, radar)
    pictures = [("scene at 1550 nm", view.total)]
    pictures += [
        (f"{e.system.name}: {e.verdict.short}", e.reconstructions[0].picture)
        for e in evaluations
        if e.capture.truth.depth_m.shape == e.reconstructions[0].picture.shape
    ]
    return [_image_chart(name, picture, layers, scene, first, radar) for name, picture in pictures]


def _image_chart(
    name: str,
    picture: Array,
    layers: list[dict[str, Any]],
    scene: Scene,
    evaluation: Evaluation,
    radar: RadarEvaluation | None,
) -> charts.Chart:
    overlays = []
    field = (-1.0, 1.0), (1.0, -1.0)
    if radar and radar.detections:
        levels = surfaces_at_detections(scene, evaluation, radar)
        if np.isfinite(levels).any():
            low, high = snr_span(radar)
            words = "true surfaces at a detection's range, colour: its SNR"
            overlays.append(charts.raster(levels, *field, low, high, "dB SNR", name=words))
    return {
        "title": name,
        "equal": True,
        "axes": False,
        "x": charts.axis("", -1, 1),
        "y": charts.axis("", -1, 1),
        "image": charts.raster(grey(picture), *field, 0, 1, "", colours="grey"),
        "overlays": overlays,
        "layers": layers,
    }


def grey(picture: Array) -> Array:
    """From 0 to 1 on a square-root scale up to the 99.5th percentile; NaN stays."""
    top = float(np.nanpercentile(picture, 99.5)) if np.isfinite(picture).any() else 0.0
    if not top > 0:
        return np.zeros_like(picture)
    return np.sqrt(np.clip(picture / top, 0, 1))


def snr_span(radar: RadarEvaluation) -> tuple[float, float]:
    """Least and greatest SNR of the detections, dB."""
    levels = [d.snr_db for d in radar.detections if np.isfinite(d.snr_db)]
    return (min(levels), max(levels)) if levels else (0.0, 1.0)


def _levels(places: list[Place], radar: RadarEvaluation) -> list[float]:
    low, high = snr_span(radar)
    return [(p.detection.snr_db - low) / max(high - low, 1e-9) for p in places]


def _marks_in_image(
    scene: Scene, evaluation: Evaluation, radar: RadarEvaluation | None
) -> list[dict[str, Any]]:
    layers = []
    if scene.targets:
        seen = in_image(scene, evaluation, np.array([t.position_m for t in scene.targets]))
        names = [target.name for target in scene.targets]
        layers.append(
            charts.layer(
                "true target", *seen.T, mark="plus", colour="orange", labels=names, texts=names
            )
        )
    for name, places in _by_direction(scene, radar):
        if radar is None:
            break
        seen = in_image(scene, evaluation, np.array([p.position_m for p in places]))
        layers.append(
            charts.layer(
                name,
                *seen.T,
                mark="ring",
                levels=_levels(places, radar),
                texts=[p.text for p in places],
            )
        )
    return layers


def _by_direction(scene: Scene, radar: RadarEvaluation | None) -> list[tuple[str, list[Place]]]:
    """Detections that have a place, by where their direction comes from."""
    if radar is None:
        return []
    places = [p for p in places_of(scene, radar) if p.position_m is not None]
    kinds = (
        ("detection, direction measured", [p for p in places if p.measured]),
        (
            "detection, range measured, direction of its target",
            [p for p in places if not p.measured],
        ),
    )
    return [(name, found) for name, found in kinds if found]


def plan_chart(scene: Scene, evaluations: Any, radar: RadarEvaluation | None) -> charts.Chart:
    """From above: outlines, true targets with their velocity, fields of view, detections with the
    errors of their ranges and bearings.
    """
    far_m = _farthest(scene, evaluations, radar)
    layers = [_outlines(scene)]
    if evaluations:
        layers.append(_camera_field(scene, evaluations[0], far_m))
    if radar:
        layers += _radar_layers(scene, radar, far_m)
    layers += _targets(scene)
    rig = scene.rig.position_m
    layers.append(
        charts.layer(
            "rig",
            [rig[0]],
            [rig[1]],
            mark="diamond",
            colour="ink",
            texts=[f"rig: {scene.rig.pose}"],
        )
    )
    low, high = _span(scene, layers, far_m)
    return {
        "title": "plan view",
        "equal": True,
        "axes": True,
        "x": charts.axis("x (m)", low[0], high[0]),
        "y": charts.axis("y (m)", low[1], high[1]),
        "layers": layers,
        "scale": list(snr_span(radar)) if radar and radar.detections else None,
        "upright": _upright(scene, high - low),
    }


def _upright(scene: Scene, size: Array) -> dict[str, Any] | None:
    """On a narrow page a plan that is longer along x than across has what is ahead of the rig up:
    the axes' names, and the sign of x ahead.
    """
    if size[0] < 1.3 * size[1]:
        return None
    if scene.rig.device("emitter")[1][0][0] >= 0:
        return {"ahead": "x (m)", "across": "to the right, −y (m)", "sign": 1}
    return {"ahead": "ahead, −x (m)", "across": "to the right, y (m)", "sign": -1}


def _span(scene: Scene, layers: list[dict[str, Any]], far_m: float) -> tuple[Array, Array]:
    """What holds rig, fields and targets, with a margin."""
    rig = scene.rig.position_m[:2]
    points = [rig[None]]
    for layer in layers:
        if layer["mark"] != "line":
            points.append(np.array([layer["x"], layer["y"]], dtype=np.float64).T)
    found = np.concatenate(points)
    found = found[np.isfinite(found).all(axis=1)]
    pad = (_MARGIN - 1) / 2 * far_m
    return found.min(axis=0) - pad, found.max(axis=0) + pad


def _farthest(scene: Scene, evaluations: Any, radar: RadarEvaluation | None) -> float:
    """Of what is to be shown, from the rig."""
    rig = scene.rig.position_m
    found = [float(np.linalg.norm(np.asarray(t.position_m) - rig)) for t in scene.targets]
    if radar:
        found += [d.range_m for d in radar.detections if np.isfinite(d.range_m)]
    if evaluations:
        depth = evaluations[0].capture.truth.depth_m
        found += (
            [float(np.percentile(depth[np.isfinite(depth)], 98))]
            if np.isfinite(depth).any()
            else []
        )
    return max(found, default=10.0)


def _outlines(scene: Scene) -> dict[str, Any]:
    x, y, texts = [], [], []
    for item in scene.objects:
        corners = _hull(item.vertices_m[:, :2])
        x += [*corners[:, 0], corners[0, 0], np.nan]
        y += [*corners[:, 1], corners[0, 1], np.nan]
        low, high = item.box_m
        size = " x ".join(number(v) for v in high - low)
        texts += [f"{item.name}: {item.material}, {size} m"] * (len(corners) + 1) + [""]
    return charts.layer("outline of an object", x, y, colour="soft", texts=texts)


def _hull(points: Array) -> Array:
    """Convex outline of points in a plane; the points' box where they have none."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        low, high = points.min(axis=0), points.max(axis=0)
        return np.array([low, high])


def _camera_field(scene: Scene, evaluation: Evaluation, far_m: float) -> dict[str, Any]:
    offset, axes = scene.rig.device("emitter")
    start = (scene.rig.position_m + offset)[:2]
    half = np.tan(np.radians(evaluation.system.emitter.field_of_view_deg.value / 2))
    edges = [start + far_m * (axes[0] + side * half * axes[1])[:2] for side in (-1, 1)]
    corners = np.array([edges[0], start, edges[1], edges[0]])
    return charts.layer("camera's field", *corners.T, mark="area", colour="blue")


def _radar_layers(scene: Scene, radar: RadarEvaluation, far_m: float) -> list[dict[str, Any]]:
    origin, axes = radar_frame(scene)
    half = half_width_rad(radar.radar)
    angles = np.linspace(-half, half, _ARC_POINTS)
    around = np.cos(angles)[:, None] * axes[0] + np.sin(angles)[:, None] * axes[1]
    rim = np.vstack([origin, origin + far_m * around, origin])
    words = f"radar's beam, half power at ±{number(np.degrees(half))}°"
    layers = [charts.layer(words, rim[:, 0], rim[:, 1], mark="area", colour="green")]
    places = places_of(scene, radar)
    shells = [p for p in places if not p.measured and np.isfinite(p.detection.range_m)]
    if shells:
        x, y, levels, texts = [], [], [], []
        for place, level in zip(shells, _levels(shells, radar), strict=True):
            arc = origin + place.detection.range_m * around
            x += [*arc[:, 0], np.nan]
            y += [*arc[:, 1], np.nan]
            levels += [level] * (len(arc) + 1)
            texts += [place.text] * (len(arc) + 1)
        name = "range of a detection without direction, within the beam"
        layers.append(charts.layer(name, x, y, levels=levels, texts=texts))
    for name, found in _by_direction(scene, radar):
        at = np.array([p.position_m for p in found])
        layers.append(
            charts.layer(
                name,
                at[:, 0],
                at[:, 1],
                mark="ring",
                levels=_levels(found, radar),
                texts=[p.text for p in found],
            )
        )
        layers.append(_error_bars(found, origin))
    return layers


def _error_bars(places: list[Place], origin: Array) -> dict[str, Any]:
    """95 % of the errors that the vehicle states, along range and across it."""
    x, y, texts = [], [], []
    for place in places:
        assert place.position_m is not None
        towards = (place.position_m - origin)[:2]
        towards = towards / max(float(np.linalg.norm(towards)), 1e-12)
        across = np.array([-towards[1], towards[0]])
        found = place.detection
        bearing = found.azimuth_error_rad if place.measured else np.nan
        for way, error in ((towards, found.range_error_m), (across, bearing * found.range_m)):
            if np.isfinite(error):
                ends = place.position_m[:2] + TWO_SIDED_95 * error * np.array([[-1], [1]]) * way
                x += [*ends[:, 0], np.nan]
                y += [*ends[:, 1], np.nan]
                texts += [f"± {si(TWO_SIDED_95 * error, 'm', 2)}"] * 2 + [""]
    return charts.layer("error of a detection, 95 %", x, y, colour="ink", texts=texts)


def _targets(scene: Scene) -> list[dict[str, Any]]:
    if not scene.targets:
        return []
    places = np.array([t.position_m for t in scene.targets])
    names = [t.name for t in scene.targets]
    texts = [
        f"{t.name}: {number(t.rcs_m2)} m², {number(float(np.linalg.norm(t.velocity_m_per_s)))} m/s"
        for t in scene.targets
    ]
    layers = [
        charts.layer(
            "true target",
            places[:, 0],
            places[:, 1],
            mark="plus",
            colour="orange",
            labels=names,
            texts=texts,
        )
    ]
    moving = [t for t in scene.targets if np.any(t.velocity_m_per_s)]
    if moving:
        x, y = [], []
        for target in moving:
            start, step = np.array(target.position_m), np.array(target.velocity_m_per_s)
            x += [start[0], start[0] + step[0], np.nan]
            y += [start[1], start[1] + step[1], np.nan]
        layers.append(charts.layer("its way in 1 s", x, y, colour="orange", dashed=True))
    return layers
