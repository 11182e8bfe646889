"""Whether a point is inside a closed mesh."""

import numpy as np

from twin.scene.model import Array, SceneObject


def encloses(item: SceneObject, point_m: Array) -> bool:
    """By the winding number: solid angles of all triangles, over 4 pi, add up to 1 inside.

    Robust against small holes; an open surface encloses nothing unless it nearly closes. Solid
    angle of a triangle by Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983.
    """
    low, high = item.vertices_m.min(axis=0), item.vertices_m.max(axis=0)
    if not ((low < point_m) & (point_m < high)).all():
        return False
    a, b, c = (item.vertices_m[item.faces[:, i]] - point_m for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return bool(abs(angle.sum()) > 2 * np.pi)
