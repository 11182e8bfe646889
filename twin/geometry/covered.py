"""A mesh divided where others lie upon it, so that each face is covered all over or not at all.

The surface stays what it was: rays meet it as before, and what is known of the mesh as a whole
holds. Covered faces are marked as those are that a mesh lists twice (`Shape.is_double`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.geometry.coplanar import TOUCHING
from twin.geometry.faces import lengths
from twin.geometry.geometry import Geometry

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

#: Pairs of faces that cover each other in part, of one mesh: cutting more takes minutes.
MOST_CUT = 20_000
_SLIVER = 1e-9  # of a face's area: what is less is left out


def covered(geometry: Geometry, face: Indices, covers_m: Array) -> tuple[Geometry, Indices]:
    """The mesh with what some triangles (n, 3, 3) in its frame cover of a ``face`` (n,) each, and
    the face of which each of its faces is a part, in order.

    Raises InputError where that are more than `MOST_CUT` which cover faces in part.
    """
    whole = np.unique(face[_holds(covers_m, geometry.corners_m[face])])
    in_part = np.flatnonzero(~np.isin(face, whole))
    if len(in_part) > MOST_CUT:
        raise InputError(f"{len(in_part)} pairs of faces, expected at most {MOST_CUT}")
    is_covered = geometry.shape.is_double.copy()
    is_covered[whole] = True
    cut = np.unique(face[in_part])
    uncut = np.setdiff1d(np.arange(len(geometry)), cut)
    corners, parent, is_hidden = [], [], []
    for number in cut.tolist():
        own = geometry.vertices_m[geometry.faces[number]]
        pieces, hidden = _divided(own, covers_m[in_part[face[in_part] == number]])
        corners += pieces
        parent += [number] * len(pieces)
        is_hidden += hidden
    added = np.array(corners).reshape(-1, 3)
    first = len(geometry.vertices_m)
    faces = np.concatenate(
        [geometry.faces[uncut], first + np.arange(len(added), dtype=np.int32).reshape(-1, 3)]
    )
    parents = np.concatenate([uncut, np.array(parent, dtype=np.int64)])
    hides = np.concatenate([is_covered[uncut], np.array(is_hidden, dtype=bool)])
    order = np.argsort(parents, kind="stable")
    made = Geometry(np.concatenate([geometry.vertices_m, added]), faces[order])
    parents, shape = parents[order], geometry.shape
    vars(made)["shape"] = replace(
        shape,
        patch_of_face=shape.patch_of_face[parents],
        plane_of_face=shape.plane_of_face[parents],
        outward=shape.outward[parents],
        is_double=hides[order],
    )
    return made, parents


def _holds(covers_m: Array, corners_m: Array) -> Flags:
    """Whether triangles (n, 3, 3) hold others in their plane all over, but for their rims."""
    normal = np.cross(covers_m[:, 1] - covers_m[:, 0], covers_m[:, 2] - covers_m[:, 0])
    size = np.ptp(corners_m, axis=1).max(axis=1)
    holds = np.ones(len(covers_m), dtype=bool)
    for k in range(3):
        begin = covers_m[:, k]
        inwards = np.cross(normal, covers_m[:, (k + 1) % 3] - begin)
        inwards /= np.maximum(lengths(inwards), 1e-300)[:, None]
        depth = np.einsum("nci,ni->nc", corners_m - begin[:, None], inwards)
        holds &= depth.min(axis=1) > -TOUCHING * size
    return holds


def _divided(corners_m: Array, covers_m: Array) -> tuple[list[Array], list[bool]]:
    """A triangle (3, 3) in triangles, and whether each is covered."""
    origin, along = corners_m[0], corners_m[1] - corners_m[0]
    along = along / np.linalg.norm(along)
    across = np.cross(np.cross(along, corners_m[2] - origin), along)
    axes = np.stack([along, across / np.linalg.norm(across)])
    own = (corners_m - origin) @ axes.T
    whole = _area(own)
    bare, hidden = [own], []
    for cover in (covers_m - origin) @ axes.T:
        bare, more = _apart(bare, cover, TOUCHING * min(whole, abs(_area(cover))))
        hidden += more
    triangles, is_hidden = [], []
    for polygons, flag in ((bare, False), (hidden, True)):
        for polygon in polygons:
            for k in range(1, len(polygon) - 1):
                triangle = polygon[[0, k, k + 1]]
                if _area(triangle) > _SLIVER * whole:
                    triangles.append(origin + triangle @ axes)
                    is_hidden.append(flag)
    return triangles, is_hidden


def _apart(
    polygons: Sequence[Array], cover: Array, least: float
) -> tuple[list[Array], list[Array]]:
    """Convex polygons (k, 2), all counter-clockwise, in what is outside a triangle and inside."""
    if _area(cover) < 0:
        cover = cover[::-1]
    outside, inside = [], []
    for polygon in polygons:
        rest, cut = polygon, []
        if (polygon.min(axis=0) < cover.max(axis=0)).all() and (
            polygon.max(axis=0) > cover.min(axis=0)
        ).all():
            for k in range(3):
                rest, off = _halves(rest, cover[k], cover[(k + 1) % 3])
                cut.append(off)
                if len(rest) < 3:
                    break
        if not cut or len(rest) < 3 or _area(rest) < least:
            outside.append(polygon)
            continue
        inside.append(rest)
        outside += [off for off in cut if len(off) >= 3 and _area(off) > 0]
    return outside, inside


def _halves(polygon: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """What of a convex polygon is left of a line, and right of it."""
    along, off = end - begin, polygon - begin
    height = along[0] * off[:, 1] - along[1] * off[:, 0]
    left, right = [], []
    for k, (h, following) in enumerate(zip(height, np.roll(height, -1), strict=True)):
        point, beyond = polygon[k], polygon[(k + 1) % len(polygon)]
        if h >= 0:
            left.append(point)
        if h <= 0:
            right.append(point)
        if h * following < 0:
            cut = point + h / (h - following) * (beyond - point)
            left.append(cut)
            right.append(cut)
    return np.array(left).reshape(-1, 2), np.array(right).reshape(-1, 2)


def _area(polygon: Array) -> float:
    """Signed, of a polygon (k, 2)."""
    x, y = polygon.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
