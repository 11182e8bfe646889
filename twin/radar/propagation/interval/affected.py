"""Bodies whose direct echoes may change within an interval: those that move against the radar, and
those on whose way something moves.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.convergence import BodyEcho
from twin.radar.propagation.scene.scattering_models import Assignment, ScatteringModel
from twin.scene import Scene, SceneObject
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]

_MARGIN_M = 1e-2  # around boxes, for errors of float32 rays


def ways_m(scene: Scene, half_s: float) -> dict[str, float]:
    """By the names of objects that move against the radar, the farthest that they do from the
    middle of an interval to its ends.
    """
    first, last = (float(time) for time in np.clip([-half_s, half_s], *scene.span_s))
    mount = np.asarray(scene.rig.radar.position_m, float)
    rig = scene.rig.course.path_bound_m(mount, 0.0, first, last)
    ways = {}
    for item in scene.objects:
        if not (item.moves or scene.rig.moves) or not len(item.geometry.faces):
            continue
        low, high = item.geometry.vertices_m.min(axis=0), item.geometry.vertices_m.max(axis=0)
        radius = float(np.linalg.norm(high - low)) / 2
        own = item.course.path_bound_m((low + high) / 2, radius, first, last)
        ways[item.name] = rig + own
    return ways


def affected_alone(
    scene: Scene, half_s: float, roles: Sequence[Assignment], bodies: Sequence[BodyEcho]
) -> Scene:
    """The scene in which all other objects only cast shadows; of a body all objects answer, or
    none does.
    """
    return with_silent(scene, unaffected(scene, ways_m(scene, half_s), roles, bodies))


def unaffected(
    scene: Scene,
    ways: Mapping[str, float],
    roles: Sequence[Assignment],
    bodies: Sequence[BodyEcho],
) -> set[str]:
    """Names of objects that answer and that nothing changes; of a body all objects may change, or
    none does. ``ways`` as of `ways_m`.
    """
    affected = _affected(scene, ways)
    for body in bodies:
        if affected.intersection(body.objects):
            affected |= set(body.objects)
    return {one.name for one in roles if one.role is ScatteringModel.OPTICS} - affected


def with_silent(scene: Scene, silent: Collection[str]) -> Scene:
    """The scene in which some objects, by name, only cast shadows."""
    return replace(
        scene,
        objects=tuple(
            replace(item, radar="obstacle") if item.name in silent else item
            for item in scene.objects
        ),
    )


def _affected(scene: Scene, ways: Mapping[str, float]) -> set[str]:
    """Names of objects that move, or that something may hide where it moves."""
    moving = [item for item in scene.objects if item.name in ways]
    others = [item for item in scene.objects if item.name not in ways and len(item.geometry.faces)]
    if not moving:
        return set()
    reach_m = np.array([ways[item.name] for item in moving])[:, None] + _MARGIN_M
    boxes = boxes_of(moving) + np.stack([-reach_m, reach_m], axis=1)
    radar = scene.rig.position_m + scene.rig.device("radar")[0]
    return set(ways) | {item.name for item in others if _is_behind(item, boxes, radar)}


def _is_behind(item: SceneObject, boxes: Array, radar: Array) -> bool:
    """Whether a way from the radar to any face may cross any of some boxes (n, 2, 3): the way to
    its centroid crosses the box with a margin of the face's own radius.
    """
    corners = item.vertices_m[item.geometry.faces]
    center = corners.mean(axis=1)
    radius = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)[:, None]
    way = center - radar
    safe = np.where(way == 0, 1e-300, way)
    for low, high in boxes:
        ends = np.stack([low - radius - radar, high + radius - radar]) / safe
        first, last = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        if ((first <= last) & (first <= 1) & (last >= 0)).any():
            return True
    return False
