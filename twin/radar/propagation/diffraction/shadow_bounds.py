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

from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.meshes.silhouettes import Outline

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
    sides, is_lit, row = rim.lit @ rim.lit.T, direct @ rim.lit.T > 0, np.arange(len(direct))

    def nearest(of: NDArray[np.bool_]) -> tuple[Indices, NDArray[np.complex128]]:
        among = np.where(of, root_q, np.inf)
        edge = among.argmin(axis=1)
        root = among[row, edge]
        q = np.where(np.isfinite(root), root, 0.0) ** 2
        phase_rad = np.angle(knife_edge_factor(q)) - q
        wave = np.where(is_lit[row, edge], -1, 1) * np.exp(1j * phase_rad)
        return edge, knife_edge_bound(root) * wave

    change = np.zeros(len(direct))
    of = np.ones_like(root_q, dtype=bool)
    for _ in range(2):
        edge, wave = nearest(of)
        change += np.abs(wave + nearest(of & (sides[edge] < -_ALONG))[1])
        of = faces & (np.abs(sides[edge]) <= _ALONG)  # not those that go away from its end
    return change


def _beside(
    rim: Outline, direct: Array, radius: Array, wavenumber: float
) -> tuple[Array, Array, Array, Array, Indices]:
    """Of one obstacle and cells at the ends of vectors (n, 3): ``level``, ``nearest``, ``steepest``
    and ``aside`` of `Cells`, and the row of the nearest edge.
    """
    root_q, grows, angle, _ = _phases(rim, direct, radius, wavenumber)
    closest, row = root_q.argmin(axis=1), np.arange(len(direct))
    nearest = root_q[row, closest]
    # A narrow obstacle lets waves come round both of its sides.
    is_opposite = rim.lit @ rim.lit.T < 0
    other = np.where(is_opposite[closest], root_q, np.inf).min(axis=1)
    level = knife_edge_bound(nearest) + knife_edge_bound(other)
    is_near = np.isfinite(nearest)
    level[~is_near] = 0
    steepest = np.where(is_near, grows[row, closest], 0)
    aside = np.where(is_near, angle[row, closest], 0)
    return level, nearest, steepest, aside, closest


def _phases(
    rim: Outline, direct: Array, radius: Array, wavenumber: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Of one obstacle and cells at the ends of vectors (n, 3): root of the phase q of the path over
    each edge, how that grows across the line of sight, 1/m, the square of the angle between both
    waves over q, and whether that path is shortest between the edge's ends, (n, m).
    """
    first, side = rim.ends[:, 0], rim.ends[:, 1] - rim.ends[:, 0]
    length = np.linalg.norm(side, axis=1)
    along = side / length[:, None]
    straight = np.linalg.norm(direct, axis=1)
    # The shortest path over an edge's line is straight once both planes are turned into one.
    at_source = -np.sum(first * along, axis=1)
    foot = first + at_source[:, None] * along
    off_source = np.linalg.norm(foot, axis=1)
    forward = direct @ along.T
    square = straight[:, None] ** 2 - forward**2 - 2 * direct @ foot.T + off_source**2
    off_place = np.sqrt(np.maximum(square, 0))
    both = np.maximum(off_source + off_place, 1e-300)
    straight_at = at_source + forward * off_source / both
    at = np.clip(straight_at, 0, length)
    a = np.hypot(off_source, at - at_source)
    b = np.maximum(np.hypot(off_place, at - at_source - forward), 1e-9)
    depth = (direct @ first.T + at * forward) / straight[:, None] ** 2
    grows = np.sqrt(wavenumber * a / (2 * b * (a + b)))
    root_q = np.sqrt(np.maximum(wavenumber * (a + b - straight[:, None]), 0))
    root_q = np.maximum(root_q - radius[:, None] * grows, 0)
    slack = (radius / straight)[:, None]
    root_q[(depth < -slack) | (depth > 1 + slack)] = np.inf
    return root_q, grows, 2 * a / (wavenumber * b * (a + b)), at == straight_at
