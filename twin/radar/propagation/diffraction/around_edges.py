"""Diffracted paths around obstacles to points beside or behind an edge.

The direct wave is there or not (geometrical optics). Every edge of an obstacle's outline adds a
diffracted wave (`knife_edge`): in the shadow it is the whole field, on the lit side a ripple, and
at the shadow's border it makes the field continuous. Each diffracted path has its own length, over
the edge or over an end of it, and rays test that nothing else blocks it. Where the obstacle itself
blocks it, the path takes two edges: one seen from the radar and one seen from the point; where
another obstacle stands behind it, one of each (`two_obstacles`). On a path over mirrors, obstacles
are looked for on every segment: before each mirror and behind the last (`segments`). An only mirror
is an opening through which its image is seen, and its border diffracts as an obstacle's edge does.

Obstacles are opaque and black, as in Kirchhoff's theory. Left out are the effects of their material
and of the angle between their faces (but for flat sides: `flat_sides`), a third edge on a path,
waves over a border and an obstacle's edge in a row, and waves that creep around curved surfaces.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.rims import DiffractedPaths, merged, unsure_m
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.segments import Opening, Segment
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.one_way.points import PointPaths, paths_to_points
from twin.radar.propagation.scene.images import Image
from twin.radar.rows import phasors

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class AllPaths(NamedTuple):
    """Paths to points, the number of the point that each leads to, (n,), and those that are
    diffracted, which are the last ones, as they are seen from the image: in front of mirrors where
    these show them.
    """

    paths: PointPaths
    point: Indices
    diffracted: DiffractedPaths | None

    def over(self, straight: PointPaths) -> NDArray[np.complex128]:
        """Their waves over the straight ones to all points, without what they are longer by."""
        field = straight.field[self.point]
        power = np.sum(np.abs(field) ** 2, axis=1)
        share: NDArray[np.complex128] = np.sum(self.paths.field * field.conj(), axis=1)
        return share / np.where(power > 0, power, 1.0)

    def field(self, straight: PointPaths, wavenumber: float) -> NDArray[np.complex128]:
        """Sum of all waves over the straight one, at each of the points that these lead to."""
        longer_m = self.paths.extra - straight.extra[self.point]
        wave = self.over(straight) * phasors(-(wavenumber * longer_m % (2 * np.pi)))
        total = np.zeros(len(straight.length), dtype=np.complex128)
        np.add.at(total, self.point, wave)
        return total


def all_paths_to_points(
    context: TracingContext,
    obstacles: Screens | None,
    source: int,
    places: Array,
    off: Array,
    own: Indices | None = None,
) -> AllPaths:
    """Every path from an image to points (n, 3), direct ones and those over edges of obstacles.

    Rays start at a distance ``off`` (n, 3) from the points; ``own`` (n,) is the number of the body
    that each belongs to, whose outline is none of its obstacles, or -1.
    """
    direct = paths_to_points(context, source, places, off)
    if obstacles is None:
        seen = np.flatnonzero(direct.clear)
        return AllPaths(direct.take(seen), seen, None)
    unobstructed = paths_to_points(context, source, places, off, unshadowed=True)
    alone = np.full(len(places), -1) if own is None else own
    image = obstacles.prepared.images[source]
    clear, point_paths, diffracted = direct.clear.copy(), [], []
    segments = [
        Segment(obstacles, image, level, places, off) for level in range(len(image.patches) + 1)
    ]
    if obstacles.border(image) is not None:
        segments.append(Opening(obstacles, image, 1, places, off))
    for segment in segments:
        open_paths = list(segment.paths(unobstructed.clear, alone))
        if open_paths:
            paths = DiffractedPaths.concatenate(open_paths)
            _clear_near_edges(clear, paths, segment)
            paths = merged(paths, segment.source, obstacles.wavenumber)
            paths = paths.take(np.abs(paths.amplitude) >= obstacles.faintest)
            point_paths.append(
                _point_paths(obstacles, unobstructed.take(paths.point), paths, segment)
            )
            diffracted.append(segment.shown(paths))
    at = np.flatnonzero(clear)
    return AllPaths(
        PointPaths.concatenate([unobstructed.take(at), *point_paths]),
        np.concatenate([at, *(paths.point for paths in diffracted)]),
        DiffractedPaths.concatenate(diffracted) if diffracted else None,
    )


def _clear_near_edges(clear: NDArray[np.bool_], paths: DiffractedPaths, segment: Segment) -> None:
    """Direct paths so close to an edge that float32 rays may err are clear on its lit side only, or
    on either side of a thin obstacle between two edges.
    """
    close = np.abs(paths.lit_m) <= unsure_m(paths.stops[:, 0])
    clear[paths.point[close]] = True
    dark = np.flatnonzero(close & (paths.lit_m <= 0))
    dark = dark[~segment.pass_thin(paths, dark, np.flatnonzero(close & (paths.lit_m > 0)))]
    clear[paths.point[dark]] = False


def _point_paths(
    obstacles: Screens, unobstructed: PointPaths, paths: DiffractedPaths, segment: Segment
) -> PointPaths:
    """Diffracted paths as `PointPaths`; ``unobstructed``: the direct ones without any obstacle."""
    chain = segment.turns(paths, paths.stops)
    # An edge at a mirror's plane may be behind it by rounding: then as where the rays pass.
    behind = np.flatnonzero(~np.isfinite(chain).all(axis=(0, 2)))
    if len(behind):
        some = paths.take(behind)
        chain[:, behind] = segment.turns(some, some.stops + some.aside)
    last = len(chain) - 2 - segment.mirrors_before
    # Edges move with their obstacle: the path gets shorter as both approach their neighbours.
    ends = (chain[1] - chain[0], chain[-2] - chain[-1])
    pulls = (chain[last - 1] - chain[last - 2], chain[last] - chain[last + 1])
    back, departure, one, other = (_unit(v) for v in (*ends, *pulls))
    rate = np.sum(segment.velocity(paths) * (one + other), axis=1)
    own = obstacles.prepared.radar_motion.velocity_m_per_s
    if own.any():  # which moves along another direction than straight from the point
        seen = np.einsum("nij,nj->ni", unobstructed.axes, back)
        rate -= (departure + seen) @ own
    return replace(
        unobstructed,
        back=back,
        departure=departure,
        extra=unobstructed.extra + paths.longer_m,
        field=unobstructed.field * paths.amplitude[:, None],
        rate=rate,
        clear=np.ones(len(paths.point), dtype=bool),
        over=paths.item,
    )


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    return unit


def is_near_edges(
    obstacles: Screens, image: Image, place: Array, radius_m: float, own: int
) -> bool:
    """Whether any obstacle's edges may diffract a wave to a body within a sphere."""
    one, first = np.ones(1, dtype=bool), np.zeros(1, dtype=np.int64)
    for level in range(len(image.patches) + 1):
        segment = Segment(obstacles, image, level, place[None], np.zeros((1, 3)))
        for item in segment.near_any(one, radius_m):
            is_beside = obstacles.body[item] != own and segment.beside(item, radius_m).any()
            if is_beside and len(segment.rim(item, first, own, radius_m).ends):
                return True
    return False
