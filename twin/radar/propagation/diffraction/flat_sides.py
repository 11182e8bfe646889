"""Flat sides of obstacles between two parallel edges, and the field behind them.

Paths over edges take obstacles as black screens: between the front and the rear edge of a box they
know air alone. A side that is nearly along the wave reflects almost all of it. The field behind is
then the double knife edge of both edges, and that of the radar's image in the side times the side's
coefficient, which is about -1 but for a conductor with the field across it: the image's wave passes
the front edge below the side and the rear one above it. Kirchhoff's integral over the planes of
both edges is this with the half-space's propagator between them, by the image.

Left out are the ends of edges, and points beside a side rather than behind it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.geometry.edges import EdgeTable, connected
from twin.radar.propagation.diffraction.knife_edge import double_knife_edge, knife_edge_factor
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.two_edges import ONE_EDGE
from twin.radar.propagation.rows import lengths, phasors
from twin.radar.scattering.surface import TABLE_STEPS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

_GRAZING = 0.2  # sine of the angle between the side and the wave, at most
_SHARP = 0.9  # cosine of the angle between faces of an edge, at most
_FLAT_M = 3e-4  # by which corners of a side are off its plane
_PLANE_M = 1e-3  # by which the radar's image in a mirror is off that in a side


@dataclass(frozen=True, eq=False)
class Side:
    """A flat side between two parallel edges.

    ``edge`` (2, 3): ends of one of the edges, relative to the source; unit vectors ``along`` it,
    ``inwards`` along the wave from the front edge to the rear one, and the outer ``normal``;
    ``front_m`` and ``rear_m``: both edges along ``inwards``; ``item``: number of the object.
    """

    edge: Array
    along: Array
    inwards: Array
    normal: Array
    front_m: float
    rear_m: float
    item: int

    @property
    def height_m(self) -> float:
        """Of the source over the side."""
        return -float(self.edge[0] @ self.normal)


def flat_sides(obstacles: Screens) -> list[Side]:
    """Of all obstacles those along whose sides the radar looks at grazing incidence."""
    source = obstacles.prepared.images[0].place
    found = []
    for number, item in enumerate(obstacles.items):
        outline, table = obstacles.outline(number, source), item.geometry.edges
        points = item.vertices_m - obstacles.prepared.anchor_m - source
        rows = np.flatnonzero(table.count[outline.edge] == 2)
        first = table.first[outline.edge[rows]]
        faces = np.stack([table.half_edges[first], table.half_edges[first + 1]], axis=1) // 3
        normals = _unit_normals(points, table.faces[faces].astype(np.int64))  # (n, 2, 3)
        is_sharp = np.abs(np.einsum("ni,ni->n", normals[:, 0], normals[:, 1])) < _SHARP
        middle = outline.ends[rows].mean(axis=1)
        sine = np.abs(np.einsum("nfi,ni->nf", normals, middle)) / lengths(middle)[:, None]
        for row, which in np.argwhere(is_sharp[:, None] & (sine < _GRAZING)).tolist():
            ends, lit = outline.ends[rows[row]], outline.lit[rows[row]]
            face, normal = int(faces[row, which]), normals[row, which]
            side = _side(points, table, face, normal * np.sign(normal @ lit), ends, number)
            if side is not None and _is_deep(side):
                found.append(side)
    return found


def _unit_normals(points: Array, faces: Indices) -> Array:
    a, b, c = np.moveaxis(points[faces], -2, 0)
    across = np.cross(b - a, c - a)
    normals: Array = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-300)
    return normals


def _side(
    points: Array, table: EdgeTable, face: int, normal: Array, ends: Array, number: int
) -> Side | None:
    """The side that a face is a part of, at an edge of the outline: behind the edge where the
    source is below it, before the edge where it is above; None on the other side.
    """
    middle = ends.mean(axis=0)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    inwards = np.cross(normal, along)
    inwards *= np.sign(inwards @ middle)
    depth_m = (points - middle) @ inwards
    is_seen = normal @ middle < 0
    if is_seen == (depth_m[table.faces[face]].sum() > 0):
        return None
    off_m = np.abs((points - middle) @ normal)[table.faces].max(axis=1)
    flat = np.flatnonzero(off_m < _FLAT_M)
    place = np.full(len(table.faces), -1)
    place[flat] = np.arange(len(flat))
    pairs = place[table.neighbours]
    part = connected(pairs[(pairs >= 0).all(axis=1)], len(flat))
    corners = table.faces[flat[part == part[place[face]]]]
    reach_m, at_m = depth_m[corners], float(middle @ inwards)
    front_m, rear_m = (reach_m.min(), 0.0) if is_seen else (0.0, reach_m.max())
    return Side(ends, along, inwards, normal, at_m + front_m, at_m + rear_m, number)


def _is_deep(side: Side) -> bool:
    """Whether its edges are not one for points far behind."""
    return 0 < side.front_m < (1 - ONE_EDGE) * side.rear_m


def is_mirror(obstacles: Screens, side: Side, body: int) -> bool:
    """Whether the scene has an image of the radar in it that a body is traced from."""
    prepared = obstacles.prepared
    worth = prepared.worth[:, : len(obstacles.body)][:, obstacles.body == body].any(axis=1)
    for number in np.flatnonzero(worth).tolist():
        image = prepared.images[number]
        if len(image.patches) == 1 and prepared.flats[image.patches[0]].object == side.item:
            half = (image.place - prepared.images[0].place) / 2
            if np.linalg.norm(half - (side.edge[0] @ side.normal) * side.normal) < _PLANE_M:
                return True
    return False


def reflection(obstacles: Screens, side: Side, field: Complex) -> complex:
    """Of the side, for a wave with this ``field`` (3,): of the component across the edge's normal
    plane as TE, of the rest as TM.
    """
    prepared = obstacles.prepared
    rows = np.array(prepared.context.table).reshape(-1, TABLE_STEPS + 1, 4)
    row = rows[prepared.surface_of_object[side.item]]
    cosine = abs(side.height_m) / float(np.linalg.norm(side.edge.mean(axis=0)))
    te_re, te_im, tm_re, tm_im = row[round(min(cosine, 1.0) * TABLE_STEPS)].tolist()
    across = abs(np.cross(side.inwards, side.normal) @ field) ** 2 / np.sum(np.abs(field) ** 2)
    return complex(across * complex(te_re, te_im) + (1 - across) * complex(tm_re, tm_im))


def changed_by(
    side: Side, direct: Array, wavenumber: float, coefficient: complex, is_mirror: bool
) -> tuple[Complex, Complex]:
    """What a side adds to the square of the field over the straight wave, (n,), at points at the
    ends of vectors (n, 3) from the source; ``is_mirror``: apart from the specular path by it, which
    is known already to where the side ends. And how much of the square of the field without the
    side is by the wave over both edges.
    """
    change, over_both = np.zeros((2, len(direct)), dtype=np.complex128)
    u, v, along = (direct @ axis for axis in (side.inwards, side.normal, side.along))
    height = side.height_m
    behind = np.flatnonzero(u > side.rear_m)
    at_m = along[behind] * side.rear_m / u[behind]
    first, last = np.sort(side.edge @ side.along)
    some = behind[(at_m > first) & (at_m < last)]
    u, v, along = u[some], v[some] + height, along[some]
    edges_m = np.array([side.front_m, side.rear_m])
    straight = np.sqrt(u**2 + (v - height) ** 2 + along**2)
    mirrored = np.sqrt(u**2 + (v + height) ** 2 + along**2)
    before = np.hypot(edges_m, height)
    after = np.hypot(u[:, None] - edges_m, v[:, None])
    gap = side.rear_m - side.front_m
    once = np.hypot(before + after, along[:, None])
    twice = np.hypot(before[0] + gap + after[:, 1], along)
    a, c = before[0], after[:, 1]
    correlation = np.sqrt(a * c / ((a + gap) * (gap + c)))
    share = edges_m / u[:, None]
    is_over = height + share * (v[:, None] - height) > 0
    is_reflected = -height + share * (v[:, None] + height) > 0
    is_reflected[:, 0] = ~is_reflected[:, 0]
    turn = coefficient * phasors(-(wavenumber * (mirrored - straight)))
    black, both = _field(wavenumber, straight, once, twice, is_over, correlation)
    image = turn * _field(wavenumber, mirrored, once, twice, is_reflected, -correlation)[0]
    specular = np.where(is_mirror & is_reflected.all(axis=1), turn, 0)
    known = specular * (specular + 2 * is_over.all(axis=1))
    change[some], over_both[some] = image * (image + 2 * black) - known, 2 * black * both
    return change, over_both


def _field(
    wavenumber: float, straight: Array, once: Array, twice: Array, is_lit: Flags, correlation: Array
) -> tuple[Complex, Complex]:
    """Behind two edges, over the straight wave, given path lengths (n,), over each edge (n, 2) and
    over both (n,); and of this the wave over both.
    """
    q = np.maximum(wavenumber * (once - straight[:, None]), 0)
    both, alone = double_knife_edge(q, is_lit, correlation)
    single = np.where(is_lit, -1, 1) * knife_edge_factor(q) * phasors(-q)
    both *= phasors(-(wavenumber * (twice - straight)))
    return is_lit.all(axis=1) + np.sum(np.where(alone, single, 0), axis=1) + both, both
