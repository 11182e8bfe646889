"""Whether a point is inside a closed mesh, or in its surface."""

import numpy as np
from numpy.typing import NDArray

from twin.scene.objects import Array, SceneObject

#: A float64 step of a rig 1e9 m from the origin: nearer to a surface no side of it is in front.
_TOUCH_M = 1e-7


def touches(item: SceneObject, point_m: Array) -> bool:
    """Whether a point lies in one of an object's triangles, to a tenth of a micrometre."""
    low, high = item.vertices_m.min(axis=0), item.vertices_m.max(axis=0)
    if not ((low - _TOUCH_M <= point_m) & (point_m <= high + _TOUCH_M)).all():
        return False
    from trimesh.triangles import closest_point

    corners = item.vertices_m[item.geometry.faces] - point_m
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = corners[((low <= _TOUCH_M) & (high >= -_TOUCH_M)).all(axis=1)]
    if not len(near):
        return False
    away = np.linalg.norm(closest_point(near, np.zeros((len(near), 3))), axis=1)
    return bool(away.min() <= _TOUCH_M)


def encloses(item: SceneObject, point_m: Array) -> bool:
    """By the winding number: solid angles of all triangles, over 4 pi, add up to 1 inside.

    Robust against small holes; an open surface encloses nothing unless it nearly closes, and
    triangles that are there twice count once.
    """
    low, high = item.vertices_m.min(axis=0), item.vertices_m.max(axis=0)
    if not ((low < point_m) & (point_m < high)).all():
        return False
    faces = item.geometry.faces
    if _solid_angle(item, faces, point_m) <= 2 * np.pi:
        return False
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return len(once) == len(faces) or _solid_angle(item, faces[once], point_m) > 2 * np.pi


def _solid_angle(item: SceneObject, faces: NDArray[np.integer], point_m: Array) -> float:
    """Of triangles, added up with the sign of the side that is seen: its magnitude. By Van Oosterom
    and Strackee, IEEE Trans. Biomed. Eng. 30, 1983.
    """
    a, b, c = (item.vertices_m[faces[:, i]] - point_m for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(float(angle.sum()))
