"""Where the rig stands and the sun shines when a bare XML file does not say."""

from collections.abc import Iterable

import numpy as np

from twin.geometry import Geometry
from twin.scene.mitsuba import first_hits
from twin.scene.objects import Array, SceneObject
from twin.scene.rig import Pose
from twin.scene.sun import Sun

_EYE_M = 1.2  # height of the sensors over the ground
_NEAREST_M, _FARTHEST_M = 2.0, 30.0  # of what the rig looks at
_ROOM_M = 1.0  # free around the rig


def default_sun(pose: Pose) -> Sun:
    """Full sun, 40 deg high, 50 deg to the right behind the rig, so that what it sees is lit."""
    back_right = pose.rotation.apply([-np.cos(np.radians(50)), -np.sin(np.radians(50)), 0.0])
    up = pose.rotation.apply([0.0, 0.0, 1.0])
    high = np.radians(40)
    direction = np.cos(high) * back_right + np.sin(high) * up
    return Sun(
        azimuth_deg=float(np.degrees(np.arctan2(direction[1], direction[0]))),
        elevation_deg=float(np.degrees(np.arcsin(np.clip(direction[2], -1, 1)))),
        illuminance_lx=100e3,
    )


def default_pose(camera: Array | None, objects: Iterable[SceneObject]) -> tuple[Pose, str]:
    """A sensible pose and why it was chosen.

    The XML's own camera where it has one. Otherwise 1.2 m above the ground nearest to the middle of
    the scene from which something stands between 2 and 30 m and nothing nearer than 1 m; that is
    what it looks at.
    """
    if camera is not None:  # Mitsuba's cameras look along +z, +y is up
        return Pose.from_axes(camera[:3, 3], camera[:3, 2], camera[:3, 1]), "the XML's camera"
    items = list(objects)
    return _from_geometry(items) if items else (Pose((0.0, 0.0, _EYE_M)), "an empty scene")


def _from_geometry(items: list[SceneObject]) -> tuple[Pose, str]:
    low = np.min([item.vertices_m.min(axis=0) for item in items], axis=0)
    high = np.max([item.vertices_m.max(axis=0) for item in items], axis=0)
    middle = (low + high) / 2
    half = (high - low) / 2
    triangles = [Geometry(item.vertices_m - middle, item.geometry.faces) for item in items]
    # From above finds streets and yards; from half height the floor of a closed room.
    for start, where in ((half[2] + 1.0, "open ground"), (0.0, "the floor")):
        for eye in _standing_places(triangles, half, start):
            yaw = _interesting_yaw(triangles, eye)
            if yaw is not None:
                x, y, z = (float(v) for v in eye + middle)
                return Pose((x, y, z), yaw), f"{where} nearest to the middle, nearest object ahead"
    return _outside(middle, half), "nothing to stand on: outside, looking at the scene's broad side"


def _standing_places(meshes: list[Geometry], half: Array, start_z: float) -> Array:
    """Eye points over a 15 x 15 grid of the lowest surfaces seen from ``start_z``, middle first."""
    x, y = (np.linspace(-half[i], half[i], 17)[1:-1] for i in (0, 1))
    points = np.array([(a, b, start_z) for a in x for b in y])
    ground = start_z - first_hits(meshes, points, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
    points[:, 2] = ground + _EYE_M
    lowest = ground[np.isfinite(ground)].min(initial=np.inf)
    usable = np.isfinite(ground) & (ground < lowest + 0.5)
    usable &= points[:, 2] < max(start_z, half[2] + _EYE_M)
    off = np.linalg.norm(points[:, :2], axis=1)
    return points[usable][np.argsort(off[usable], kind="stable")]


def _interesting_yaw(meshes: list[Geometry], eye: Array) -> float | None:
    """Where the nearest thing in sight stands; None with nothing in sight or too little room."""
    yaw = np.radians(np.arange(-175, 181, 5.0))
    rays = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    distance = first_hits(meshes, np.tile(eye, (len(yaw), 1)), rays)
    if distance.min() < _ROOM_M:
        return None
    seen = np.where((distance > _NEAREST_M) & (distance < _FARTHEST_M), distance, np.inf)
    best = int(np.argmin(seen))
    return float(np.degrees(yaw[best])) if np.isfinite(seen[best]) else None


def _outside(middle: Array, half: Array) -> Pose:
    """In front of the scene's broadest side, far enough to have it in a 20 deg field."""
    thin = int(np.argmin(half))
    forward = np.zeros(3)
    forward[thin] = -1.0
    distance = half[thin] + max(_NEAREST_M, np.delete(half, thin).max() / np.tan(np.radians(10)))
    up = np.array([0.0, 0.0, 1.0]) if thin != 2 else np.array([1.0, 0.0, 0.0])
    return Pose.from_axes(middle - distance * forward, forward, up)
