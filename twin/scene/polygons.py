"""Polygons of more than three corners, split into triangles that fill them.

Readers split them as fans from the first corner, which is right where every triangle of the fan
turns the polygon's way round. A fan of any other polygon covers what lies outside.
"""

from collections.abc import Callable, Sequence

import numpy as np
from mapbox_earcut import triangulate_float64
from numpy.typing import NDArray

from twin.files import InputError

Array = NDArray[np.float64]
Triangles = list[tuple[int, int, int]]

_AREA = 1e-9  # share of a polygon's area below which a triangle may turn the other way
_TOUCH = 1e-12  # share of the squared extent below which three corners lie on a line


def splits(
    vertices_m: Array, polygons: Sequence[Sequence[int]], name: Callable[[int], str]
) -> dict[int, Triangles]:
    """The triangles of those polygons that a fan would not fill, as positions of their corners.

    Raises InputError, beginning with the ``name`` of a polygon, where its edges cross.
    """
    by_corners: dict[int, list[int]] = {}
    for number, polygon in enumerate(polygons):
        if len(polygon) > 3:
            by_corners.setdefault(len(polygon), []).append(number)
    made: dict[int, Triangles] = {}
    for numbers in by_corners.values():
        corners_m = vertices_m[np.array([polygons[number] for number in numbers])]
        for place in np.flatnonzero(~_are_filled_by_fans(corners_m)):
            number = numbers[place]
            if (triangles := _filling(corners_m[place])) is None:
                raise InputError(f"{name(number)}: edges of the polygon cross each other")
            made[number] = triangles
    return made


def fan(corners: int) -> Triangles:
    """From the first corner to every edge that does not touch it."""
    return [(0, i, i + 1) for i in range(1, corners - 1)]


def _are_filled_by_fans(corners_m: Array) -> NDArray[np.bool_]:
    """(n,): whether all triangles of each fan, ``corners_m`` (n, k, 3), turn as their sum does.

    What is no number, or has no finite area, is left to whoever checks the mesh.
    """
    with np.errstate(all="ignore"):
        arms = corners_m[:, 1:] - corners_m[:, :1]
        turned = np.cross(arms[:, :-1], arms[:, 1:])  # (n, k - 2, 3), as long as twice the areas
        whole = turned.sum(axis=1)
        along = np.einsum("nkc,nc->nk", turned, whole)
        least = -_AREA * np.einsum("nc,nc->n", whole, whole)
    empty = ~turned.any(axis=(1, 2)) | ~np.isfinite(along).all(axis=1)
    return np.asarray(empty | ((along >= least[:, None]).all(axis=1) & whole.any(axis=1)))


def _filling(corners_m: Array) -> Triangles | None:
    """Triangles as earcut cuts them off; None where edges cross or the triangles do not cover the
    area of the polygon, as earcut also splits what is no simple polygon.

    A polygon that is not plane is split as it looks along its mean normal. Edges may touch, as
    those do that lead to a hole and back. Earcut may leave out a corner on the line between its
    neighbours.
    """
    flat = _in_its_plane(corners_m)
    touch = _TOUCH * float(np.ptp(flat, axis=0).max()) ** 2
    if _edges_cross(flat, touch):
        return None
    made = triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32)).reshape(-1, 3)
    triangles = made.tolist() or fan(len(flat))
    a, b, c = np.moveaxis(flat[np.array(triangles)], 1, 0)
    twice_covered = np.abs(_cross(b - a, c - a)).sum()
    twice_whole = abs(_cross(flat, np.roll(flat, -1, axis=0)).sum())
    if abs(twice_covered - twice_whole) > len(flat) * touch:
        return None
    return [(i, j, k) for i, j, k in triangles]


def _in_its_plane(corners_m: Array) -> Array:
    """(k, 2): corners seen along the normal of the polygon, counter-clockwise."""
    from_first = corners_m - corners_m[0]
    normal = np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(axis=0)
    size = np.linalg.norm(normal)
    if size <= _TOUCH * np.ptp(corners_m, axis=0).max() ** 2:  # a bow tie, or no area at all
        axes = np.linalg.svd(from_first - from_first.mean(axis=0), full_matrices=False)[2]
        return np.asarray(from_first @ axes[:2].T)
    normal /= size
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    return np.asarray(from_first @ np.column_stack([u, np.cross(normal, u)]))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _edges_cross(flat: Array, touch: float) -> bool:
    """Whether two edges have a point in common that is an end of neither."""
    ends = np.roll(flat, -1, axis=0)
    for start, end in zip(flat, ends, strict=True):
        sides = [_cross(end - start, points - start) for points in (flat, ends)]
        of_it = [_cross(ends - flat, point - flat) for point in (start, end)]
        apart = [
            (np.minimum(*pair) < -touch) & (np.maximum(*pair) > touch) for pair in (sides, of_it)
        ]
        if (apart[0] & apart[1]).any():
            return True
    return False
