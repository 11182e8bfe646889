"""Echoes of bodies behind flat sides of obstacles, beyond what waves over black edges are.

Each facet's echo changes by what a side adds to the square of the field there (`flat_sides`), to
first order over the band, with the direction and the motion of the straight path: near the plane of
the side, where it matters, the ways differ by little.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.propagation.diffraction.bends import Bends
from twin.radar.propagation.diffraction.blocking import first_hit
from twin.radar.propagation.diffraction.cell_echoes import middle_facets, radiated
from twin.radar.propagation.diffraction.flat_sides import Side, changed_by
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import Facets, in_voxels
from twin.radar.propagation.diffraction.two_way_echoes import Ways, summed
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import paths_to_points
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.rows import lengths, phasors
from twin.radar.scattering.surface import TABLE_STEPS
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SMALL_M, _MOST = 0.005, 2.0e4  # size of facets, and about how many of a body
_OF_SQUARE = 1 / 16  # area of a facet over the square of its size, about, after it was divided
_CELL_M = 0.1
_PLANE_M = 1e-3  # by which the radar's image in a mirror is off that in a side
_COUNTS = 0.02  # of the straight wave, there and back: change of a coarse facet that counts
#: Of what sides change, by which it may be off: their roughness and material, and the reflection at
#: other angles than the radar's. Screens 3 cm apart in place of a side differ by as much.
_UNSURE = 0.5
#: The same in the light where only waves of edges are added.
_UNSURE_EDGES = 1.0
_STEP = 20.0  # rad/m: half of what the wavenumber changes by to the ends of a band of 4 GHz
_APART_M = 0.015  # lengths, more and less than the straight way, that stand for the change over it
_BAND = np.array([-0.02, 0.0, 0.02])  # of the carrier, over which levels are rms


def side_echoes(
    obstacles: Screens,
    facets: Facets,
    body: int,
    surface_of_object: NDArray[np.uint32],
    gain: Callable[[Array], Array],
) -> tuple[Contributions, float, float]:
    """Contributions of a body's facets, without gains; their amplitude, with gains; and by how much
    they may be off.
    """
    parts, power = [Contributions.none()], np.zeros(2)
    for side in obstacles.sides:
        if obstacles.body[side.item] == body or _is_covered(obstacles, side, facets, body):
            continue
        is_known = _is_followed(obstacles, side, body)
        found, beside = _by_side(obstacles, facets, surface_of_object, side, is_known)
        power += _level(found, gain, obstacles.wavenumber) ** 2 * np.array([1 - beside, beside])
        parts.append(found)
    unsure = np.sqrt(power @ np.square([_UNSURE, _UNSURE_EDGES]))
    return Contributions.concatenate(parts), float(np.sqrt(power.sum())), float(unsure)


def _by_side(
    obstacles: Screens,
    facets: Facets,
    surface_of_object: NDArray[np.uint32],
    side: Side,
    is_known: bool,
) -> tuple[Contributions, float]:
    """Contributions, and the share of their power that is waves of edges in the light."""
    k, source = obstacles.wavenumber, obstacles.prepared.images[0].place
    at_most = changed_by(side, facets.middle - source, k, -1.0, is_mirror=is_known)
    near = facets.take(np.abs(at_most) > _COUNTS)
    near = _free(obstacles, near, side)
    if not len(near):
        return Contributions.none(), 0.0
    area_m2 = float(lengths(near.across).sum())
    size = max(_SMALL_M, float(np.sqrt(area_m2 / (_OF_SQUARE * _MOST))))
    near = near.divided(np.full(len(near), size))
    near = in_voxels(near, np.full(int(near.cell.max()) + 1, _CELL_M))
    row = middle_facets(near, source)
    place, off = near.middle[row], (offset_m(near.middle) * near.normal(source))[row]
    straight = paths_to_points(obstacles.prepared.context, 0, place, off, unshadowed=True)
    every = np.arange(len(place))
    none = Bends.none(source, place, k)
    there = straight.take(near.cell)
    current = radiated(obstacles, near, there, there, surface_of_object)
    coefficient = _reflection(obstacles, side, straight.field[0])
    less, mean, more = (
        changed_by(side, near.middle - source, k + step, coefficient, is_mirror=is_known)
        for step in (-_STEP, 0.0, _STEP)
    )
    parts = []
    for length_m in (-_APART_M, _APART_M):
        share = (mean + 1j * (more - less) / (2 * _STEP * length_m)) / 2
        share *= np.exp(1j * k * length_m)
        paths = replace(straight, extra=straight.extra + length_m / 2)  # out, and back
        alone = Ways(every, paths, none, every, every, np.ones(len(place), dtype=complex))
        parts += summed(obstacles, near, current * share, alone)[0]
    square = np.abs(current * mean) ** 2
    beside = square @ side.adds_edge_waves_alone(near.middle - source, is_mirror=is_known)
    return Contributions.concatenate(parts), float(beside / max(square.sum(), 1e-300))


def _is_covered(obstacles: Screens, side: Side, facets: Facets, body: int) -> bool:
    """Whether its edge is within the outline of all that stands close, as where another object
    stands on the side: no wave passes along it.
    """
    source = obstacles.prepared.images[0].place
    reach_m = float(lengths(facets.middle - source).mean())
    return not side.has_edge(obstacles.rim(side.item, source, reach_m, body).ends).any()


def _is_followed(obstacles: Screens, side: Side, body: int) -> bool:
    """Whether the specular path by it is among the body's echoes already: as one reflected at
    another body, or by an image of the radar that the body is traced from.
    """
    prepared = obstacles.prepared
    if (role := prepared.roles[side.item]) is not ScatteringModel.SURFACE:
        return role is ScatteringModel.OPTICS
    worth = prepared.worth[:, : len(obstacles.body)][:, obstacles.body == body].any(axis=1)
    for number in np.flatnonzero(worth).tolist():
        image = prepared.images[number]
        if len(image.patches) == 1 and prepared.flats[image.patches[0]].object == side.item:
            half = (image.place - prepared.images[0].place) / 2
            if np.linalg.norm(half - (side.edge[0] @ side.normal) * side.normal) < _PLANE_M:
                return True
    return False


def _reflection(obstacles: Screens, side: Side, field: Complex) -> complex:
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


def _free(obstacles: Screens, facets: Facets, side: Side) -> Facets:
    """Facets between which and the radar nothing stands but the body of the side."""
    source = obstacles.prepared.images[0].place
    off = offset_m(facets.middle) * facets.normal(source)
    hit = first_hit(obstacles.prepared, facets.middle, off, source)
    own = obstacles.body[side.item]
    is_own = (obstacles.body[np.maximum(hit, 0)] == own) & (own >= 0)
    return facets.take((hit < 0) | (hit == side.item) | is_own)


def _level(echoes: Contributions, gain: Callable[[Array], Array], wavenumber: float) -> float:
    """Amplitude of the sum, rms over a band."""
    wave = echoes.amplitude * gain(echoes.departure)
    cycles = echoes.delay_s * speed_of_light * wavenumber
    sums = [np.sum(wave * phasors(-(cycles * (1 + part) % (2 * np.pi)))) for part in _BAND]
    return float(np.sqrt(np.mean(np.abs(sums) ** 2)))
