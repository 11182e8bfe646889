"""Facets whose reflected rays surely meet nothing: known by a single ray each.

Facets that share a corner reflect there in about the same direction, so rays at every corner would
tell little that the neighbours' own do not.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.facing import Facing, portions
from twin.radar.propagation.facets.meetings import met_by
from twin.radar.propagation.facets.parts import parted
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.one_way.path import TracingContext

Indices = NDArray[np.integer]


def meeting(
    s: TracingContext, scatterers: Scatterers, facets: Facing, spacing_m: float
) -> NDArray[np.intp]:
    """Rows of facets by which something may be seen: a ray that is reflected at the centroid of one
    of their parts of a size meets something, or that of a neighbour or of a neighbour's neighbour,
    lit from the same source. Neighbours share a corner.
    """
    corners, count = _corners(s)

    def own(rows: Indices) -> Indices:
        return corners[facets.face[rows]] + count * facets.source[rows, None].astype(np.int64)

    is_near = np.zeros(count * s.n_sources, dtype=bool)
    for rows in portions(facets.all):
        parts, row = parted(s, facets.taken(rows), spacing_m)
        for some in portions(np.arange(len(parts))):
            part = parts if len(some) == len(parts) else parts.taken(some)
            is_met = met_by(s, scatterers, part, 1).is_valid[0]
            is_near[own(rows[row[some[is_met]]])] = True
    is_nearby = np.zeros_like(is_near)
    for rows in portions(facets.all):
        at = own(rows)
        is_nearby[at[is_near[at].any(axis=1)]] = True
    found = [rows[is_nearby[own(rows)].any(axis=1)] for rows in portions(facets.all)]
    return np.concatenate([np.zeros(0, dtype=np.intp), *found])


def _corners(s: TracingContext) -> tuple[Indices, int]:
    """Numbers of all facets' corners, one for each place of a mesh, (m, 3); how many at most."""
    world = s.world
    found = world.faces.astype(np.int64)
    items = [item for item in world.items if item is not None]
    for item, rows, own in zip(items, world.face_ranges, world.vertex_ranges, strict=True):
        found[rows] = item.geometry.welded_faces + own.start
    return found, len(world.vertices)
