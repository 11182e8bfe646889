"""Which corners of triangles are one, and which triangles meet at an edge.

trimesh does both as well: `merge_vertices`, which rounds to decimal places instead of to a share of
the mesh's size, and `graph.face_adjacency`, which takes twenty times as long.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.read_only import cached_read_only

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Faces = NDArray[np.int32]

_WELDED = 1e-7  # of the mesh's size: corners closer than this are one
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
_MIX_MESH = np.uint64(0xD6E8FEB86659FD93)


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """Edges of some ``faces`` (m, 3), in order of their ends.

    A face has three half-edges: 3 i from its first corner to its second, and so on. ``half_edges``
    (3 m,) are sorted by their edges; ``first`` and ``count`` (e,) are where those of an edge begin
    and how many there are: of an open edge one, of a manifold one two.
    """

    faces: Faces
    half_edges: NDArray[np.int32]
    first: Indices
    count: Indices

    @property
    def along(self) -> NDArray[np.int8]:
        """Whether each half-edge runs from the lower end to the higher, 1, or back, -1; (3 m,)."""
        return np.where(self.faces < np.roll(self.faces, -1, axis=1), 1, -1).astype(np.int8).ravel()

    @property
    def neighbours(self) -> NDArray[np.int32]:
        """Pairs of faces on either side of an edge, (n, 2); edges of one or more than two faces
        have none.
        """
        start = self.first[self.count == 2]
        return np.stack([self.half_edges[start], self.half_edges[start + 1]], axis=1) // 3

    @cached_read_only
    def ends(self) -> Indices:
        """Vertices at the ends of each edge, the lower one first, (e, 2)."""
        face, corner = np.divmod(self.half_edges[self.first], 3)
        ends = np.stack([self.faces[face, corner], self.faces[face, (corner + 1) % 3]], axis=1)
        return np.sort(ends, axis=1).astype(np.int64)

    @cached_read_only
    def edge_of_face(self) -> Indices:
        """Edges of each face, (m, 3)."""
        edge = np.empty(len(self.half_edges), dtype=np.int64)
        edge[self.half_edges] = np.repeat(np.arange(len(self.first)), self.count)
        return edge.reshape(-1, 3)

    def is_open(self) -> NDArray[np.bool_]:
        """Edges (e,) that have no two faces which run along them in opposite senses."""
        if not len(self.first):
            return np.zeros(0, dtype=bool)
        sense = np.add.reduceat(self.along[self.half_edges], self.first, dtype=np.int64)
        found: NDArray[np.bool_] = (self.count != 2) | (sense != 0)
        return found


def edge_table(faces: NDArray[np.integer]) -> EdgeTable:
    """Edges of faces, by the numbers of their corners."""
    heads = np.roll(faces, -1, axis=1)
    keys = np.minimum(faces, heads).astype(np.int64).ravel()
    keys *= int(faces.max(initial=0)) + 1
    keys += np.maximum(faces, heads).ravel()
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    is_first = np.ones(len(keys), dtype=bool)
    is_first[1:] = keys[1:] != keys[:-1]
    first = np.flatnonzero(is_first)
    count = np.diff(first, append=len(keys))
    return EdgeTable(faces.astype(np.int32, copy=False), order.astype(np.int32), first, count)


def connected(pairs: NDArray[np.integer], count: int) -> NDArray[np.int32]:
    """Number of the part that each of ``count`` faces belongs to, by pairs that hang together."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    if not len(pairs):
        return np.arange(count, dtype=np.int32)
    links = csr_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (count, count))
    labels: NDArray[np.int32] = connected_components(links, directed=False)[1]
    return labels


def welded(points: Array, faces: Faces, first_vertex: Indices) -> Faces:
    """Faces of one or more meshes with one vertex for all at the same place.

    ``points`` (n, 3) of all meshes, each about its own middle; the vertices of mesh i begin at
    ``first_vertex[i]``, (n_meshes + 1,). The same array where no two vertices are one.
    """
    mesh_of_point = np.repeat(np.arange(len(first_vertex) - 1), np.diff(first_vertex))
    is_used = np.zeros(len(points), dtype=bool)
    is_used[faces] = True
    x, y, z = np.abs(points).T
    reach = np.where(is_used, np.maximum(np.maximum(x, y), z), 0.0)
    size = np.maximum(np.maximum.reduceat(reach, first_vertex[:-1]), 1e-300)
    step = (_WELDED * size)[mesh_of_point]
    # One number per cell: sorting rows takes twenty times as long. 1e6 cells share one by chance
    # once in 4e7 meshes.
    keys = mesh_of_point.astype(np.uint64) * _MIX_MESH
    for column, mix in zip(points.T, _MIX, strict=True):
        cells = np.where(is_used, np.round(column / step), 0.0).astype(np.int64)
        keys += cells.view(np.uint64) * mix
    ordered = np.sort(keys[is_used])
    if not (ordered[1:] == ordered[:-1]).any():
        return faces
    cell = np.unique(keys, return_inverse=True)[1].reshape(-1)[faces]
    vertex = np.empty(int(cell.max()) + 1, dtype=faces.dtype)
    vertex[cell] = faces  # any of the vertices that are one stands for them: the last
    return vertex[cell]


def doubles(faces: Faces) -> NDArray[np.bool_]:
    """Faces with the same corners as one before them, (m,)."""
    return first_alike(faces) != np.arange(len(faces))


def first_alike(faces: Faces) -> Indices:
    """Of each face the first one with the same corners, itself where there is none before, (m,)."""
    corners = np.sort(faces, axis=1)
    first = np.arange(len(faces))
    # One number for each face's corners: few of different corners share theirs.
    keys = corners.astype(np.uint64) @ _MIX
    ordered = np.sort(keys)
    same = ordered[1:] == ordered[:-1]
    if not same.any():
        return first
    some = np.flatnonzero(np.isin(keys, ordered[1:][same]))
    order = some[np.lexsort(corners[some].T)]  # stable: of equal ones the first comes first
    is_new = np.ones(len(order), dtype=bool)
    is_new[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    first[order] = order[is_new][np.cumsum(is_new) - 1]
    return first
