"""How much of a facet's echo diffraction round obstacles may change, without rays.

Over an edge that makes a path longer by the phase q, a wave of amplitude |erfc(sqrt(j q))| / 2
arrives, 1 / (2 sqrt(pi q)) at most (`knife_edge`). A facet in the light answers to it once on the
way out and once on the way home, one in the shadow to both at once alone. The wave comes from
another direction than the straight one, so that facets may reflect it which are not at right angles
to the line of sight.

Bodies are divided into cells, for which the edges are looked for; within a cell q changes by the
cell's size.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hardware.compiled import kernel
from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.meshes.silhouettes import Outline
from twin.radar.rows import phasors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ALONG = 0.5  # cosine between directions across edges, from which on they are of one pair of sides
_MOST_PAIRS = 2**18  # of cells and edges at once: 30 MB


@dataclass(frozen=True, eq=False)
class Cells:
    """Parts of a body, and what edges of other objects do to the waves there, (n_cells,).

    ``level``: of the waves over edges that are followed, over the straight one, at most;
    ``nearest``: root of the least phase q of a path over one of them; ``steepest``: growth of that
    root across the line of sight, 1/m; ``aside``: square of the angle between both waves over q;
    ``across`` (n_cells, 3): unit vector from the straight path to the nearest edge.
    """

    level: Array
    nearest: Array
    steepest: Array
    aside: Array
    across: Array

    def take(self, which: NDArray[np.bool_]) -> "Cells":
        """Only some of them."""
        return Cells(*(getattr(self, f.name)[which] for f in fields(Cells)))


def knife_edge_bound(root_q: Array) -> Array:
    """Of the knife-edge factor, by the root of q."""
    level: Array = 1 / np.maximum(2 * np.sqrt(np.pi) * root_q, 2.0)
    return level


def cells_of(view: View, facets: Facets, body: int) -> Cells:
    """The cells that a body's facets are in, as a view's waves reach them."""
    direct, radius = _spheres(view, facets)
    k, count = view.obstacles.wavenumber, len(radius)
    level, nearest = np.zeros(count), np.full(count, np.inf)
    steepest, aside = np.zeros(count), np.zeros(count)
    across = np.zeros((count, 3))
    deepest = np.sqrt(farthest(view.obstacles.faintest))
    for rim, some in _rims(view, body, direct, radius):
        found = _beside(rim, direct[some], radius[some], k)
        near = found[1] <= deepest
        level[some] += np.where(near, found[0], 0.0)
        is_nearer = near & (found[1] < nearest[some])
        across[some[is_nearer]] = rim.lit[found[4][is_nearer]]
        nearest[some] = np.minimum(nearest[some], np.where(near, found[1], np.inf))
        steepest[some] = np.maximum(steepest[some], np.where(near, found[2], 0.0))
        aside[some] = np.maximum(aside[some], np.where(near, found[3], 0.0))
    return Cells(level, nearest, steepest, aside, across)


def borders_of(view: View, facets: Facets, body: int) -> tuple[Indices, Array]:
    """Borders of shadows within the cells that a body's facets are in: of each the number of its
    cell, in ascending order, and the unit normal (n, 3) of its plane, which a view's place is in.
    """
    direct, radius = _spheres(view, facets)
    cells, normals = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for rim, some in _rims(view, body, direct, radius):
        root_q = _phases(rim, direct[some], radius[some], view.obstacles.wavenumber)[0]
        cell, edge = np.nonzero(root_q == 0)
        cells.append(some[cell])
        normals.append(rim.lit[edge])
    cell = np.concatenate(cells)
    order = np.argsort(cell, kind="stable")
    return cell[order], np.concatenate(normals)[order]


def _spheres(view: View, facets: Facets) -> tuple[Array, Array]:
    """Around cells of facets: vectors (n_cells, 3) from a view to their centers, and radii."""
    middle, cell = facets.middle, facets.cell
    size = np.bincount(cell)
    center = np.stack([np.bincount(cell, row) / size for row in middle.T], axis=1)
    radius = np.zeros(len(size))
    reach = np.linalg.norm(facets.corners - center[cell][:, None], axis=2).max(axis=1)
    np.maximum.at(radius, cell, reach)
    return center - view.place, radius


def _rims(
    view: View, body: int, direct: Array, radius: Array
) -> Iterator[tuple[Outline, NDArray[np.intp]]]:
    """As `View.rims`, for some of the cells at a time."""
    for rim, rows in view.rims(body, direct, radius):
        step = max(_MOST_PAIRS // max(len(rim.ends), 1), 1)
        for first in range(0, len(rows) if len(rim.ends) else 0, step):
            yield rim, rows[first : first + step]


def level_beside(rim: Outline, direct: Array, wavenumber: float) -> Array:
    """Of waves over a rim to the ends of vectors (n, 3) from its source, over the straight wave, at
    most, (n,).
    """
    return _beside(rim, direct, np.zeros(len(direct)), wavenumber)[0]


def change_beside(rim: Outline, direct: Array, wavenumber: float) -> Array:
    """By how much waves over the rim of an obstacle change those to the ends of vectors (n, 3) from
    its source, over the straight ones, about, (n,): over the nearest edge and that on the other
    side of the obstacle, or of its opening, as strong as they may be and with their phases; and
    likewise across these.

    Past both sides of a post waves cancel, and through a slit they add.
    """
    root_q, _, _, faces = _phases(rim, direct, np.zeros(len(direct)), wavenumber)
    edges, roots = _nearest(root_q, faces, rim.lit, -_ALONG)
    q = np.where(np.isfinite(roots), roots, 0.0) ** 2
    factor = knife_edge_factor(q) * phasors(-q)
    sign = np.where(np.einsum("eni,ni->en", rim.lit[edges], direct) > 0, -1, 1)
    nearest, opposite, across, opposite_across = (
        sign * knife_edge_bound(roots) * factor / np.abs(factor)
    )
    change: Array = np.abs(nearest + opposite) + np.abs(across + opposite_across)
    return change


def _beside(
    rim: Outline, direct: Array, radius: Array, wavenumber: float
) -> tuple[Array, Array, Array, Array, Indices]:
    """Of one obstacle and cells at the ends of vectors (n, 3): ``level``, ``nearest``, ``steepest``
    and ``aside`` of `Cells`, and the row of the nearest edge.
    """
    root_q, grows, angle, faces = _phases(rim, direct, radius, wavenumber)
    # A narrow obstacle lets waves come round both of its sides.
    (closest, *_), (nearest, other, *_) = _nearest(root_q, faces, rim.lit, 0.0)
    level = knife_edge_bound(nearest) + knife_edge_bound(other)
    is_near, row = np.isfinite(nearest), np.arange(len(direct))
    level[~is_near] = 0
    steepest = np.where(is_near, grows[row, closest], 0)
    aside = np.where(is_near, angle[row, closest], 0)
    return level, nearest, steepest, aside, closest


def _nearest(
    root_q: Array, faces: NDArray[np.bool_], lit: Array, opposite: float
) -> tuple[Indices, Array]:
    """Rows of edges of the least roots of phases (n, m), and these, (4, n): of all; of those on the
    other side of that one, the cosine between whose directions ``lit`` (m, 3) is below
    ``opposite``; and the same two of those across the first that paths face, not such as go away
    from its end. Where there are none, inf.
    """
    edges, roots = kernel(_nearest_pairs)(root_q, faces, np.ascontiguousarray(lit), opposite)
    return edges, roots


def _nearest_pairs(
    root_q: Array, faces: NDArray[np.bool_], lit: Array, opposite: float
) -> tuple[Indices, Array]:
    count, every = root_q.shape
    edges, roots = np.zeros((4, count), dtype=np.int64), np.full((4, count), np.inf)
    for i in range(count):
        for k in range(4):
            first, nearest = lit[edges[0, i]], lit[edges[2 * (k // 2), i]]
            for j in range(every):
                if root_q[i, j] >= roots[k, i]:
                    continue
                if k >= 2 and (not faces[i, j] or abs(np.sum(first * lit[j])) > _ALONG):
                    continue
                if k % 2 == 1 and np.sum(nearest * lit[j]) >= opposite:
                    continue
                edges[k, i], roots[k, i] = j, root_q[i, j]
    return edges, roots


def _phases(
    rim: Outline, direct: Array, radius: Array, wavenumber: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Of one obstacle and cells at the ends of vectors (n, 3): root of the phase q of the path over
    each edge, how that grows across the line of sight, 1/m, the square of the angle between both
    waves over q, and whether that path is shortest between the edge's ends, (n, m).
    """
    root_q, grows, angle, is_met = kernel(_of_edges)(
        np.ascontiguousarray(rim.ends), np.ascontiguousarray(direct), radius, wavenumber
    )
    return root_q, grows, angle, is_met


def _of_edges(
    ends: Array, direct: Array, radius: Array, wavenumber: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    root_q, grows, angle = np.empty((3, len(direct), len(ends)))
    is_met = np.empty((len(direct), len(ends)), dtype=np.bool_)
    for j in range(len(ends)):
        first, side = ends[j, 0], ends[j, 1] - ends[j, 0]
        length = np.sqrt(np.sum(side**2))
        along = side / length
        # The shortest path over an edge's line is straight once both planes are turned into one.
        at_source = -np.sum(first * along)
        foot = first + at_source * along
        off_source = np.sqrt(np.sum(foot**2))
        for i in range(len(direct)):
            x, y, z = direct[i]
            forward = x * along[0] + y * along[1] + z * along[2]
            across = x * foot[0] + y * foot[1] + z * foot[2]
            squared = x * x + y * y + z * z
            straight = np.sqrt(squared)
            square = squared - forward * forward - 2 * across + off_source * off_source
            off_place = np.sqrt(max(square, 0.0))
            straight_at = at_source + forward * off_source / max(off_source + off_place, 1e-300)
            at = min(max(straight_at, 0.0), length)
            a = np.sqrt(off_source**2 + (at - at_source) ** 2)
            b = max(np.sqrt(off_place**2 + (at - at_source - forward) ** 2), 1e-9)
            depth = (x * first[0] + y * first[1] + z * first[2] + at * forward) / squared
            grows[i, j] = np.sqrt(wavenumber * a / (2 * b * (a + b)))
            angle[i, j] = 2 * a / (wavenumber * b * (a + b))
            is_met[i, j] = at == straight_at
            root = np.sqrt(max(wavenumber * (a + b - straight), 0.0))
            slack = radius[i] / straight
            is_passed = -slack <= depth <= 1 + slack
            root_q[i, j] = max(root - radius[i] * grows[i, j], 0.0) if is_passed else np.inf
    return root_q, grows, angle, is_met
