"""The sharp edges of a mesh: open ones and wedges, with the faces that meet there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry, connected, doubles, edge_table
from twin.radar.scattering.target import MeshTarget

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ALIKE = 1e-7  # of the mesh's size: coordinates that differ by less count as the same


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

    @staticmethod
    def concatenate(parts: "Sequence[Edges]") -> "Edges":
        """Of several meshes, one after the other; ``face`` as each mesh numbers its own."""

        def all_of(name: str) -> Any:
            return np.concatenate([getattr(part, name) for part in parts])

        first = np.cumsum([0, *(len(part.patches.border) for part in parts)])
        return Edges(
            start_m=all_of("start_m"),
            along=all_of("along"),
            length_m=all_of("length_m"),
            wedge=all_of("wedge"),
            inwards=all_of("inwards"),
            upwards=all_of("upwards"),
            patch=np.concatenate([p.patch + n for p, n in zip(parts, first[:-1], strict=True)]),
            face=all_of("face"),
            patches=Patches.concatenate([part.patches for part in parts]),
            non_manifold=sum(part.non_manifold for part in parts),
            sagitta_m=max(part.sagitta_m for part in parts),
        )


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

    @staticmethod
    def concatenate(parts: "Sequence[Patches]") -> "Patches":
        """One after the other."""
        return Patches(
            np.concatenate([part.normal for part in parts]),
            np.concatenate([part.low for part in parts]),
            np.concatenate([part.high for part in parts]),
            [border for part in parts for border in part.border],
        )

    def reach(self, patch: Indices, origin_m: Array, direction: Array) -> Array:
        """Distance (n,) along a surface, from points on its border inwards, to its other border.

        On a curved surface: to the side of its box, an upper bound.
        """
        distance_m = np.empty(len(patch))
        order = np.argsort(patch, kind="stable")
        starts = np.flatnonzero(np.diff(patch[order], prepend=-1))
        for rows in np.split(order, starts)[1:]:
            which = patch[rows[0]]
            box = _through_box(self.low[which], self.high[which], origin_m[rows], direction[rows])
            distance_m[rows] = box
            if np.isfinite(self.normal[which, 0]):
                border = self.border[which]
                at_once = max(1, 2**21 // len(border))
                for part in np.split(rows, range(at_once, len(rows), at_once)):
                    to_border_m = _to_border(
                        border, self.normal[which], origin_m[part], direction[part]
                    )
                    distance_m[part] = np.minimum(distance_m[part], to_border_m)
        return distance_m


def sharp_edges(target: MeshTarget, sharp_angle_deg: float) -> Edges:
    """Edges where the surface ends, or turns by more than an angle.

    Orientation of the faces doesn't matter; faces that lie twice at the same place count once.
    """
    corners, faces, face_rows = _corners(target.geometry)
    normals = target.geometry.normals[face_rows]
    table = edge_table(faces)
    regular = table.count <= 2
    first, count = table.first[regular], table.count[regular]
    ends = table.ends[regular]
    pairs = (table.half_edges[np.stack([first, first + count - 1], axis=1)] // 3).astype(np.int64)
    is_open = pairs[:, 0] == pairs[:, 1]
    along = corners[ends[:, 1]] - corners[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    along /= length[:, None]
    inwards, height = _into(corners, faces, pairs, ends, along)
    cosine = np.clip(np.sum(inwards[:, 0] * inwards[:, 1], axis=1), -1, 1)
    inside = np.arccos(cosine)  # 0 for an open edge
    turn = np.pi - inside
    sharp = turn > np.radians(sharp_angle_deg)
    patch = connected(pairs[~sharp], len(faces)).astype(np.int64)
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
        face=face_rows[pairs[sharp, 0]],
        patches=_patches(corners, faces, normals, patch, patch[pairs[sharp]], ends),
        non_manifold=int(np.count_nonzero(~regular)),
        sagitta_m=float(bend.max()) if len(bend) else 0.0,
    )


def _corners(geometry: Geometry) -> tuple[Array, Indices, Indices]:
    """Corners (n, 3), faces (m, 3), each once, and which of the mesh's these are, (m,).

    Corners are numbered by their place, so that the order of the mesh's vertices does not matter.
    """
    faces = geometry.welded_faces
    a, b, c = faces.T
    face_rows = np.flatnonzero((a != b) & (b != c) & (c != a) & ~doubles(faces))
    used, index = np.unique(faces[face_rows], return_inverse=True)
    corners = geometry.vertices_m[used]
    cells = np.round(corners / (_ALIKE * geometry.sphere[1]))
    order = np.lexsort(cells.T[::-1])
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    return corners[order], number[index].reshape(-1, 3), face_rows


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
    """Distance from points in a box to where each ray leaves it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.where(direction > 0, high - origin, low - origin) / direction
    distances = np.where(np.abs(direction) < 1e-12, np.inf, distances)
    return np.maximum(distances.min(axis=1), 0)


def _to_border(border: Array, normal: Array, origin: Array, direction: Array) -> Array:
    """Distance along a flat surface to the first of its edges beyond the starting point."""
    start, side = border[:, 0], border[:, 1] - border[:, 0]
    turn = np.cross(side, normal)
    gap = np.sum(start * turn, axis=1) - origin @ turn.T
    speed = direction @ turn.T
    aside = np.cross(normal, direction)
    past = np.sum(origin * aside, axis=1)[:, None] - aside @ start.T
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel: meets nowhere
        distance = gap / speed
        place = past / (aside @ side.T)
    size = np.abs(side).max()
    meets = (distance > 1e-6 * size) & (place > -1e-9) & (place < 1 + 1e-9)
    return np.where(meets, distance, np.inf).min(axis=1)
