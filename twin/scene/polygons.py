"""Polygons of more than three corners, split into triangles that fill them.

Readers split them as fans from the first corner, which is right where every triangle of the fan
turns the polygon's way round. A fan of any other polygon covers what lies outside.
"""

from collections.abc import Callable, Sequence

import numpy as np
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
            if (ears := _ears(corners_m[place])) is None:
                raise InputError(f"{name(number)}: edges of the polygon cross each other")
            made[number] = ears
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


def _ears(corners_m: Array) -> Triangles | None:
    """Ear clipping: corners that nothing else of the polygon reaches into are cut off one by one.
    None where edges cross.

    A polygon that is not plane is split as it looks along its mean normal. Edges may touch, as
    those do that lead to a hole and back.

    G. H. Meisters, "Polygons have ears", American Mathematical Monthly 82, 648 (1975).
    """
    flat = _in_its_plane(corners_m)
    touch = _TOUCH * float(np.ptp(flat, axis=0).max()) ** 2
    if _edges_cross(flat, touch):
        return None
    left, made = list(range(len(flat))), Triangles()
    while len(left) > 2:
        here = next((i for i in range(len(left)) if _is_ear(flat, left, i, touch)), None)
        if here is not None:
            made.append((left[here - 1], left[here], left[(here + 1) % len(left)]))
        else:  # a corner on the line between its neighbours takes no area with it
            here = int(np.argmin(np.abs(_turns(flat[left]))))
            if abs(_turns(flat[left])[here]) > touch:
                return None
        del left[here]
    return made or fan(len(flat))


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


def _turns(flat: Array) -> Array:
    """(k,): twice the area of each corner with its neighbours, positive to the left."""
    return _cross(flat - np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0) - flat)


def _is_ear(flat: Array, left: list[int], here: int, touch: float) -> bool:
    a, b, c = (flat[left[i]] for i in (here - 1, here, (here + 1) % len(left)))
    if _cross(b - a, c - b) <= touch:
        return False
    others = flat[left]
    inside = np.ones(len(others), dtype=np.bool_)
    for one, next_one in ((a, b), (b, c), (c, a)):
        inside &= _cross(next_one - one, others - one) >= -touch
        inside &= ((others - one) ** 2).sum(axis=1) > touch  # the corner itself, or one upon it
    return not inside.any()


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
