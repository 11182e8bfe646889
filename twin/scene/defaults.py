"""Where the rig stands and the sun shines when a bare XML file does not say."""

from collections.abc import Iterable

import numpy as np

from twin.scene.meshes import Mesh
from twin.scene.mitsuba import first_hits
from twin.scene.model import Array, Pose, Sun

_EYE_M = 1.2  # height of the sensors over the ground
_NEAREST_M, _FARTHEST_M = 2.0, 30.0


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


def default_pose(camera: Array | None, meshes: Iterable[Mesh]) -> tuple[Pose, str]:
    """A sensible pose and why it was chosen.

    The XML's own camera where it has one. Otherwise 1.2 m above open ground nearest to the middle
    of the scene, looking at the nearest thing between 2 and 30 m.
    """
    if camera is not None:  # Mitsuba's cameras look along +z, +y is up
        return Pose.from_axes(camera[:3, 3], camera[:3, 2], camera[:3, 1]), "the XML's camera"
    return _from_geometry(list(meshes)), "open ground nearest to the middle, nearest object"


def _from_geometry(meshes: list[Mesh]) -> Pose:
    low = np.min([m.vertices.min(axis=0) for m in meshes], axis=0)
    high = np.max([m.vertices.max(axis=0) for m in meshes], axis=0)
    middle = (low + high) / 2
    triangles = [Mesh(m.vertices - middle, m.faces) for m in meshes]
    eye = _open_ground(triangles, low - middle, high - middle) + [0, 0, _EYE_M]
    yaw = np.radians(np.arange(0, 360, 5.0))
    rays = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    distance = first_hits(triangles, np.tile(eye, (len(yaw), 1)), rays)
    usable = np.where((distance > _NEAREST_M) & (distance < _FARTHEST_M), distance, np.inf)
    best = int(np.argmin(usable)) if np.isfinite(usable).any() else 0
    x, y, z = (float(v) for v in eye + middle)
    return Pose((x, y, z), float(np.degrees(yaw[best])))


def _open_ground(meshes: list[Mesh], low: Array, high: Array) -> Array:
    """Point of a 15 x 15 grid whose first hit from above is lowest, nearest to the middle."""
    x, y = (np.linspace(low[i], high[i], 17)[1:-1] for i in (0, 1))
    points = np.array([(a, b, high[2] + 1.0) for a in x for b in y])
    height = points[:, 2] - first_hits(meshes, points, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
    if not np.isfinite(height).any():
        return np.array([0.0, 0.0, low[2]])
    open_ground = np.flatnonzero(height < height[np.isfinite(height)].min() + 0.5)
    open_ground = open_ground[np.isfinite(height[open_ground])]
    best = open_ground[np.argmin(np.linalg.norm(points[open_ground, :2], axis=1))]
    return np.array([points[best, 0], points[best, 1], height[best]])
