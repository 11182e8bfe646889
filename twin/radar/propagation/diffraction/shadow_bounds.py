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
from twin.radar.propagation.meshes.silhouettes import Lines, Outline
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
        cell, edge = kernel(_at_borders, _of_edge, _cosine)(
            rim.lines, direct[some], radius[some], view.obstacles.wavenumber
        )
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
    edges, roots, _, _ = _nearest(rim, direct, np.zeros(len(direct)), wavenumber, -_ALONG, 4)
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
    (closest, _), (nearest, other), grows, angle = _nearest(rim, direct, radius, wavenumber, 0.0, 2)
    # A narrow obstacle lets waves come round both of its sides.
    level = knife_edge_bound(nearest) + knife_edge_bound(other)
    level[np.isinf(nearest)] = 0
    return level, nearest, grows, angle, closest


def _nearest(
    rim: Outline, direct: Array, radius: Array, wavenumber: float, opposite: float, kinds: int
) -> tuple[Indices, Array, Array, Array]:
    """Of one obstacle and cells at the ends of vectors (n, 3): rows of edges, over which paths have
    the least roots of phases q, and these, (``kinds``, n): of all; of those on the other side of
    that one, the cosine between whose directions is below ``opposite``; and the same two of those
    across the first that paths face, not such as go away from its end. Where there are none, inf.

    And how the first root grows across the line of sight, 1/m, and the square of the angle between
    both waves over q, (n,); 0 where there is none.
    """
    lit, direct = (np.ascontiguousarray(x) for x in (rim.lit, direct))
    edges, roots, grows, angle = kernel(_nearest_edges, _of_edge, _of_cell, _cosine)(
        rim.lines, lit, direct, radius, wavenumber, opposite, kinds
    )
    return edges, roots, grows, angle


def _nearest_edges(
    lines: Lines,
    lit: Array,
    direct: Array,
    radius: Array,
    wavenumber: float,
    opposite: float,
    kinds: int,
) -> tuple[Indices, Array, Array, Array]:
    count, every = len(direct), len(lit)
    edges, roots = np.zeros((kinds, count), dtype=np.int64), np.full((kinds, count), np.inf)
    grows, angle = np.zeros((2, count))
    root_q, faces = np.empty(every), np.empty(every, dtype=np.bool_)
    for i in range(count):
        for j in range(every):
            root_q[j], _, _, faces[j] = _of_edge(lines, j, direct[i], radius[i], wavenumber)
        _of_cell(root_q, faces, lit, opposite, edges[:, i], roots[:, i])
        if roots[0, i] < np.inf:
            closest = _of_edge(lines, edges[0, i], direct[i], radius[i], wavenumber)
            grows[i], angle[i] = closest[1], closest[2]
    return edges, roots, grows, angle


def _of_cell(
    root_q: Array,
    faces: NDArray[np.bool_],
    lit: Array,
    opposite: float,
    edges: Indices,
    roots: Array,
) -> None:
    """The nearest edges and their roots, of each kind, by those of all, (m,)."""
    for k in range(len(edges)):
        first, nearest = lit[edges[0]], lit[edges[2 * (k // 2)]]
        for j in range(len(lit)):
            if root_q[j] >= roots[k]:
                continue
            if k >= 2 and (not faces[j] or abs(_cosine(first, lit[j])) > _ALONG):
                continue
            if k % 2 == 1 and _cosine(nearest, lit[j]) >= opposite:
                continue
            edges[k], roots[k] = j, root_q[j]


def _at_borders(
    lines: Lines, direct: Array, radius: Array, wavenumber: float
) -> tuple[Indices, Indices]:
    """Cells and edges whose shadows' borders go through these."""
    cell, edge = [0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(len(direct)):
        for j in range(len(lines.foot)):
            if _of_edge(lines, j, direct[i], radius[i], wavenumber)[0] == 0:
                cell.append(i)
                edge.append(j)
    return np.array(cell), np.array(edge)


def _cosine(one: Array, other: Array) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _of_edge(
    lines: Lines, j: int, direct: Array, radius: float, wavenumber: float
) -> tuple[float, float, float, bool]:
    """Of a cell at the end of a vector (3,): root of the phase q of the path over an edge, inf for
    none, how that grows across the line of sight, 1/m, the square of the angle between both waves
    over q, and whether that path is shortest between the edge's ends.
    """
    forward = _cosine(direct, lines.along[j])
    across, squared = _cosine(direct, lines.foot[j]), _cosine(direct, direct)
    straight, at_source, off_source = np.sqrt(squared), lines.at_m[j], lines.off_m[j]
    # The shortest path over an edge's line is straight once both planes are turned into one.
    square = squared - forward * forward - 2 * across + off_source * off_source
    off_place = np.sqrt(max(square, 0.0))
    straight_at = at_source + forward * off_source / max(off_source + off_place, 1e-300)
    at = min(max(straight_at, 0.0), lines.length_m[j])
    is_met, onwards = at == straight_at, at - at_source
    depth, slack = (across + onwards * forward) / squared, radius / straight
    if depth < -slack or depth > 1 + slack:
        return np.inf, 0.0, 0.0, is_met
    a = np.sqrt(off_source**2 + onwards**2)
    b = max(np.sqrt(off_place**2 + (onwards - forward) ** 2), 1e-9)
    grows = np.sqrt(wavenumber * a / (2 * b * (a + b)))
    root = np.sqrt(max(wavenumber * (a + b - straight), 0.0))
    return max(root - radius * grows, 0.0), grows, 2 * a / (wavenumber * b * (a + b)), is_met
