"""Facets whose reflected rays may hit another surface, by one reflected ray for each facet.

Facets that share a corner reflect there in about the same direction, so rays at every corner would
add little to those of the neighbours.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.front_facets import FrontFacets, portions
from twin.radar.propagation.facets.ray_hits import reflected_ray_hits
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.uniform_subdivision import subdivided
from twin.radar.propagation.one_way.path import TracingContext

Indices = NDArray[np.integer]


def reflection_candidates(
    context: TracingContext, scatterers: Scatterers, facets: FrontFacets, spacing_m: float
) -> NDArray[np.intp]:
    """Rows of facets whose reflected rays may hit a surface.

    These are facets of which the ray reflected at the centroid of any of their parts hits a
    surface, and their neighbours and the neighbours of these, lit from the same source. Neighbours
    share a corner.
    """
    corners, count = _corners(context)

    def own(rows: Indices) -> Indices:
        return corners[facets.face[rows]] + count * facets.source[rows, None].astype(np.int64)

    is_near = np.zeros(count * context.n_sources, dtype=bool)
    for rows in portions(facets.all):
        parts, row = subdivided(context, facets.take(rows), spacing_m)
        for some in portions(np.arange(len(parts))):
            part = parts if len(some) == len(parts) else parts.take(some)
            is_met = reflected_ray_hits(context, scatterers, part, 1).is_valid[0]
            is_near[own(rows[row[some[is_met]]])] = True
    is_nearby = np.zeros_like(is_near)
    for rows in portions(facets.all):
        at = own(rows)
        is_nearby[at[is_near[at].any(axis=1)]] = True
    candidates = [rows[is_nearby[own(rows)].any(axis=1)] for rows in portions(facets.all)]
    return np.concatenate([np.zeros(0, dtype=np.intp), *candidates])


def _corners(context: TracingContext) -> tuple[Indices, int]:
    """Numbers of all facets' corners, (m, 3), one for each place of a mesh; and their count."""
    world = context.world
    corners = world.faces.astype(np.int64)
    items = [item for item in world.items if item is not None]
    for item, rows, own in zip(items, world.face_ranges, world.vertex_ranges, strict=True):
        corners[rows] = item.geometry.welded_faces + own.start
    return corners, len(world.vertices)
