"""The sharp edges of a mesh: open ones and wedges, with the faces that meet there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from twin.radar.scattering.target import Target

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_WELDED = 1e-7  # of the mesh's size: corners closer than this are one


@dataclass(frozen=True, eq=False)
class Edges:
    """Sharp edges with a face on either side; an open edge has the same face on both.

    ``start_m`` and ``along`` (n, 3), ``length_m`` (n,); ``wedge`` (n,) is N, the angle of the space
    around the edge over pi: 2 for an open edge, 1.5 for a box. ``inwards`` and ``upwards`` (n, 2,
    3): on each face, across the edge into the face, and off the face away from the wedge. ``patch``
    (n, 2) is the smooth surface that the face belongs to, ``face`` (n,) one of the faces as the
    mesh numbers them. ``non_manifold`` counts edges of more than two faces, which are left out;
    ``sagitta_m`` is the farthest that facets lie off the smooth surface that they stand for.
    """

    start_m: Array
    along: Array
    length_m: Array
    wedge: Array
    inwards: Array
    upwards: Array
    patch: Indices
    face: Indices
    patches: "Patches"
    non_manifold: int
    sagitta_m: float


@dataclass(frozen=True, eq=False)
class Patches:
    """Smooth surfaces, each bounded by sharp edges.

    ``normal`` (p, 3) where it is flat, else NaN; ``low`` and ``high`` (p, 3) of its box; ``border``
    per surface the ends of its edges (b, 2, 3).
    """

    normal: Array
    low: Array
    high: Array
    border: list[Array]

    def reach(self, patch: Indices, origin_m: Array, direction: Array) -> Array:
        """Way (n,) along a surface, from points on its border inwards, to its other border.

        On a curved surface: to the side of its box, an upper bound.
        """
        found = np.empty(len(patch))
        order = np.argsort(patch, kind="stable")
        starts = np.flatnonzero(np.diff(patch[order], prepend=-1))
        for rows in np.split(order, starts)[1:]:
            which = patch[rows[0]]
            box = _through_box(self.low[which], self.high[which], origin_m[rows], direction[rows])
            found[rows] = box
            if np.isfinite(self.normal[which, 0]):
                border = self.border[which]
                at_once = max(1, 2**21 // len(border))
                for part in np.split(rows, range(at_once, len(rows), at_once)):
                    way = _to_border(border, self.normal[which], origin_m[part], direction[part])
                    found[part] = np.minimum(found[part], way)
        return found


def sharp_edges(target: Target, sharp_angle_deg: float) -> Edges:
    """Edges where the surface ends, or turns by more than an angle.

    Orientation of the faces doesn't matter; faces that lie twice at the same place count once.
    """
    corners, faces, normals, kept = _welded(target)
    ends, pairs, non_manifold = _adjacency(faces)
    is_open = pairs[:, 0] == pairs[:, 1]
    along = corners[ends[:, 1]] - corners[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    along /= length[:, None]
    inwards, height = _into(corners, faces, pairs, ends, along)
    cosine = np.clip(np.sum(inwards[:, 0] * inwards[:, 1], axis=1), -1, 1)
    inside = np.arccos(cosine)  # 0 for an open edge
    turn = np.pi - inside
    sharp = turn > np.radians(sharp_angle_deg)
    patch = _connected(pairs[~sharp], len(faces))
    bend = (height.mean(axis=1) * turn / 8)[~sharp]
    ends, along, inwards = ends[sharp], along[sharp], inwards[sharp]
    return Edges(
        start_m=corners[ends[:, 0]],
        along=along,
        length_m=length[sharp],
        wedge=2 - inside[sharp] / np.pi,
        inwards=inwards,
        upwards=_upwards(inwards, along, is_open[sharp]),
        patch=patch[pairs[sharp]],
        face=kept[pairs[sharp, 0]],
        patches=_patches(corners, faces, normals, patch, patch[pairs[sharp]], ends),
        non_manifold=non_manifold,
        sagitta_m=float(bend.max()) if len(bend) else 0.0,
    )


def _welded(target: Target) -> tuple[Array, Indices, Array, Indices]:
    """Corners, faces and normals with equal corners made one, each face once, and its number."""
    _, radius = target.geometry.sphere
    cells = np.round(target.geometry.vertices_m / (_WELDED * radius)).astype(np.int64)
    # One number per cell: unique rows of three would sort ten times as long.
    low = cells.min(axis=0)
    span = [int(n) + 1 for n in np.ptp(cells, axis=0)]
    if span[0] * span[1] * span[2] < 2**62:
        keys = ((cells[:, 0] - low[0]) * span[1] + cells[:, 1] - low[1]) * span[2]
        _, first, index = np.unique(
            keys + cells[:, 2] - low[2], return_index=True, return_inverse=True
        )
    else:
        _, first, index = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[target.geometry.faces].astype(np.int64)
    corners = np.sort(faces, axis=1)
    solid = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    _, kept = np.unique(corners[solid], axis=0, return_index=True)
    kept = np.flatnonzero(solid)[np.sort(kept)]
    return target.geometry.vertices_m[first], faces[kept], target.geometry.normals[kept], kept


def _adjacency(faces: Indices) -> tuple[Indices, Indices, int]:
    """Ends of every edge (n, 2), its two faces (n, 2; twice the same where it is open), and how
    many edges were left out because more than two faces meet there.
    """
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    _, start, count = np.unique(keys[order], return_index=True, return_counts=True)
    start, count, non_manifold = start[count <= 2], count[count <= 2], int(np.sum(count > 2))
    first, second = order[start], order[start + count - 1]
    return ends[first], np.stack([first, second], axis=1) // 3, non_manifold


def _into(
    corners: Array, faces: Indices, pairs: Indices, ends: Indices, along: Array
) -> tuple[Array, Array]:
    """Unit vectors (n, 2, 3) from each edge across into its faces, and their heights (n, 2)."""
    third = faces[pairs].sum(axis=2) - ends.sum(axis=1)[:, None]
    across = corners[third] - corners[ends[:, :1]]
    across -= np.sum(across * along[:, None], axis=2, keepdims=True) * along[:, None]
    height = np.linalg.norm(across, axis=2)
    return across / height[:, :, None], height


def _upwards(inwards: Array, along: Array, is_open: NDArray[np.bool_]) -> Array:
    """Off each face, away from the other one; off either side of the face of an open edge."""
    side = np.cross(along, inwards[:, 0])
    open_up = np.stack([side, -side], axis=1)
    lean = np.sum(inwards[:, 0] * inwards[:, 1], axis=1)[:, None, None]
    up = lean * inwards - inwards[:, ::-1]
    size = np.linalg.norm(up, axis=2, keepdims=True)
    return np.where(is_open[:, None, None], open_up, up / np.maximum(size, 1e-300))


def _connected(pairs: Indices, count: int) -> Indices:
    """Number of the surface that each of ``count`` faces belongs to."""
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels: Indices = connected_components(links, directed=False)[1]
    return labels


def _patches(
    corners: Array, faces: Indices, normals: Array, label: Indices, patch: Indices, ends: Indices
) -> Patches:
    """The surfaces that have a border, by the label of their faces; the others stay empty."""
    count = int(label.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for i in range(3):
        np.minimum.at(low, label, corners[faces[:, i]])
        np.maximum.at(high, label, corners[faces[:, i]])
    normal = np.empty((count, 3))
    normal[label] = normals
    off = np.abs(np.sum(normal[label] * normals, axis=1)) < 1 - 1e-9
    normal[label[off]] = np.nan
    # Each edge borders the surfaces on both of its sides; an open one borders its own once.
    owner = np.concatenate([patch[:, 0], patch[patch[:, 0] != patch[:, 1], 1]])
    edge = np.concatenate([np.arange(len(ends)), np.flatnonzero(patch[:, 0] != patch[:, 1])])
    order = np.argsort(owner, kind="stable")
    split = np.searchsorted(owner[order], np.arange(1, count))
    border = [corners[ends[rows]] for rows in np.split(edge[order], split)]
    return Patches(normal, low, high, border)


def _through_box(low: Array, high: Array, origin: Array, direction: Array) -> Array:
    """Way from points in a box to where each leaves it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.where(direction > 0, high - origin, low - origin) / direction
    ways = np.where(np.abs(direction) < 1e-12, np.inf, ways)
    return np.maximum(ways.min(axis=1), 0)


def _to_border(border: Array, normal: Array, origin: Array, direction: Array) -> Array:
    """Way along a flat surface to the first of its edges that is not where the way starts."""
    start, side = border[:, 0], border[:, 1] - border[:, 0]
    turn = np.cross(side, normal)
    gap = np.sum(start * turn, axis=1) - origin @ turn.T
    speed = direction @ turn.T
    aside = np.cross(normal, direction)
    past = np.sum(origin * aside, axis=1)[:, None] - aside @ start.T
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel: meets nowhere
        way = gap / speed
        place = past / (aside @ side.T)
    size = np.abs(side).max()
    meets = (way > 1e-6 * size) & (place > -1e-9) & (place < 1 + 1e-9)
    return np.where(meets, way, np.inf).min(axis=1)
