"""The scene in three dimensions, small enough for the page: meshes of 16 bits, beams, detections.

Meshes of many triangles are made coarser by merging vertices within cells of a grid, whose side
grows until the scene's triangles fit; coordinates are steps of a 65535th of an object's box.
"""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from twin.camera.evaluation import Evaluation
from twin.radar.evaluation import RadarEvaluation
from twin.report import charts
from twin.report.overview import snr_span
from twin.report.places import half_width_rad, places_of, radar_frame
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

_MOST_TRIANGLES = 60_000
_RIM_POINTS = 48  # of a beam's circle


def scene_model(scene: Scene, evaluations: Any, radar: RadarEvaluation | None) -> dict[str, Any]:
    """Objects, rig, beams, targets and detections, in metres, z up."""
    rig = scene.rig.position_m
    far_m = _farthest(scene, radar)
    content: dict[str, Any] = {
        "objects": _objects(scene),
        "rig": {
            "position": charts.numbers(rig),
            "axes": charts.numbers(scene.rig.device("emitter")[1]),
        },
        "far": far_m,
        "camera": _field(scene, evaluations[0], far_m) if evaluations else None,
        "beam": None,
        "targets": [
            {
                "name": t.name,
                "position": charts.numbers(t.position_m),
                "velocity": charts.numbers(t.velocity_m_per_s),
            }
            for t in scene.targets
        ],
        "detections": [],
    }
    if radar:
        low, high = snr_span(radar)
        content["beam"] = _beam(scene, radar, far_m)
        content["detections"] = [
            {
                "position": charts.numbers(p.position_m),
                "level": (p.detection.snr_db - low) / max(high - low, 1e-9),
                "label": p.label,
                "text": p.text,
            }
            for p in places_of(scene, radar)
            if p.position_m is not None
        ]
        content["shells"] = [
            {
                "range": float(p.detection.range_m),
                "level": (p.detection.snr_db - low) / max(high - low, 1e-9),
            }
            for p in places_of(scene, radar)
            if not p.measured and np.isfinite(p.detection.range_m)
        ]
    return content


def _farthest(scene: Scene, radar: RadarEvaluation | None) -> float:
    rig = scene.rig.position_m
    found = [float(np.linalg.norm(np.asarray(t.position_m) - rig)) for t in scene.targets]
    if radar:
        found += [d.range_m for d in radar.detections if np.isfinite(d.range_m)]
    if not found:
        found = [
            float(np.linalg.norm((item.box_m - rig).clip(-50, 50).mean(axis=0)))
            for item in scene.objects
        ]
    return float(f"{max(found, default=10.0):.4g}")


def _objects(scene: Scene) -> list[dict[str, Any]]:
    """Each object's mesh, coarser by its share of all triangles where they are too many."""
    share = min(1.0, _MOST_TRIANGLES / max(scene.triangles, 1))
    return [_object(item, share) for item in scene.objects if len(item.geometry.faces)]


def _object(item: SceneObject, share: float) -> dict[str, Any]:
    vertices, faces = item.vertices_m, item.geometry.faces.astype(np.int64)
    if share < 1:
        vertices, faces = coarser(vertices, faces, max(12, int(share * len(faces))))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    steps = np.round((vertices - low) / span * 65535).astype("<u2")
    kind = "<u2" if len(vertices) <= 65536 else "<u4"
    reflectance = item.reflectance
    grey = reflectance if isinstance(reflectance, float | int) else float(reflectance.image.mean())
    return {
        "name": item.name,
        "low": charts.numbers(low),
        "span": charts.numbers(span),
        "vertices": base64.b64encode(steps.tobytes()).decode(),
        "faces": base64.b64encode(faces.astype(kind).tobytes()).decode(),
        "wide": kind == "<u4",
        "reflectance": float(f"{grey:.3g}"),
        "text": f"{item.name}: {item.material}, reflectance {number(grey, 2)}",
    }


def coarser(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """A mesh of at most that many faces, or of one cell of the grid, by merging vertices."""
    box = float(np.ptp(vertices, axis=0).max()) or 1.0
    for cells in (512, 256, 128, 96, 64, 48, 32, 24, 16, 12, 8, 6, 4, 2, 1):
        keys = np.floor((vertices - vertices.min(axis=0)) / box * cells).astype(np.int64)
        _, where, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        merged = group.ravel()[faces]
        solid = (
            (merged[:, 0] != merged[:, 1])
            & (merged[:, 1] != merged[:, 2])
            & (merged[:, 2] != merged[:, 0])
        )
        merged = merged[solid]
        _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
        merged = merged[np.sort(first)]
        if len(merged) <= most:
            break
    return vertices[where], merged


def _field(scene: Scene, evaluation: Evaluation, far_m: float) -> list[float | None]:
    """Corners of the camera's field: its apex, then four at the far end, (5, 3)."""
    offset, axes = scene.rig.device("emitter")
    apex = scene.rig.position_m + offset
    half = np.tan(np.radians(evaluation.system.emitter.field_of_view_deg.value / 2))
    corners = [
        apex + far_m * (axes[0] + half * (y * axes[1] + z * axes[2]))
        for y, z in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    return charts.numbers([apex, *corners])


def _beam(scene: Scene, radar: RadarEvaluation, far_m: float) -> dict[str, Any]:
    """Apex, unit directions of the half-power rim, and how far it is drawn."""
    origin, axes = radar_frame(scene)
    across, up = half_width_rad(radar.radar), half_width_rad(radar.radar, across=False)
    turn = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)
    y, z = np.tan(min(across, 1.5)) * np.cos(turn), np.tan(min(up, 1.5)) * np.sin(turn)
    rim = np.stack([np.ones_like(turn), y, z], axis=-1)
    rim = rim / np.linalg.norm(rim, axis=1, keepdims=True) @ axes
    return {"apex": charts.numbers(origin), "rim": charts.numbers(rim), "far": far_m}
