"""Echoes of bodies by several reflections at them, as of corner reflectors, round obstacles.

What a corner reflector returns leaves it beside where it came in. So its echo is traced as if
nothing stood before it, and every part of that times the field over the straight wave, direct and
over the edges of obstacles, at the place where the path meets the body first and at that where it
leaves it last: T(in) T(out). These replace echoes with hard shadows. It holds as far as waves over
edges, which come a little from aside, go the same way within the body as straight ones.

Bodies of many facets are not traced again: the echoes that are there with hard shadows are taken,
and what is missing for the share that is hidden is in the stated error. Echoes of one reflection
are found elsewhere (`diffraction.behind_obstacles`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.diffraction.around_edges import is_near_edges
from twin.radar.propagation.diffraction.beside_ways import MANY_OBSTACLES
from twin.radar.propagation.diffraction.blocking import distances_to
from twin.radar.propagation.diffraction.passed_waves import BIN_M, PassedWaves, waves_past
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import some_facets
from twin.radar.propagation.diffraction.two_way_echoes import sums
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.physical_optics import followed_by, scattered
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.scene.scattering_models import Assignment
from twin.radar.rows import alike, first_rows, matching_pairs, phasors
from twin.radar.synthesis import Contributions
from twin.scene import Scene
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Facets of bodies that are traced once more, alone, and of those of which others hide a part; how
#: many of them, the nearest ones; and paths of other bodies that are followed.
MOST_FACES, MOST_FACES_HIDDEN, MOST_ALONE, MOST_PATHS = 2000, 10_000, 16, 2**18
_LEAST_HIDDEN = 0.02  # share of a body
_LATER_S = 1e-11  # than the last echo of a body: 3 mm
_SAME_M = 1e-6  # places closer than that are one
_RATE_M_PER_S = 0.02  # of lengths, by which echoes that are joined differ at most
_FAINT = 0.5  # of the faintest wave that is followed: pairs of waves
_AT_ONCE = 2**19  # pairs of waves: 100 MB


class CornerEchoes(NamedTuple):
    """Echoes without gains and losses; the same as if nothing stood before the bodies, ``alone``;
    traced echoes that they replace, by number; the ``bodies`` that are followed, (n_bodies,); of
    those that are not traced again the share that is ``hidden``; and the time that they took.
    """

    echoes: Contributions
    alone: Contributions
    replaced: Indices
    bodies: NDArray[np.bool_]
    hidden: Array
    cost_s: float


def corner_echoes(
    scene: Scene,
    roles: Sequence[Assignment],
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    body: NDArray[np.int32],
    traced: Contributions,
    worth: NDArray[np.bool_],
    obstacles: Screens | None,
    followed_s: float | None,
) -> CornerEchoes:
    """Of bodies that edges of others stand before, or near the way to.

    ``body``: of every object, -1 for none; ``traced``: echoes with hard shadows; ``worth``: which
    of the bodies of many facets are followed, (n_bodies,); ``followed_s``: as of `solvers.trace`.
    """
    began_s = perf_counter()
    if obstacles is not None and len(obstacles.items) > MANY_OBSTACLES:
        obstacles = None
    obstacles = obstacles and followed_by(obstacles, fidelity)
    faces = _concave_faces(prepared, body)
    is_followed, hidden = np.zeros(len(faces), dtype=bool), np.zeros(len(faces))
    parts, alone = [Contributions.none()], [Contributions.none()]
    is_direct = (traced.bounces > 1) & (traced.source == 0) & (traced.receiver == 0)
    rows = np.flatnonzero(is_direct)
    owner = body[traced.object[rows]]
    is_own = (owner >= 0) & (body[prepared.world.object_of_face[traced.first[rows]]] == owner)
    rows, owner = rows[is_own], owner[is_own]
    replaced, n_alone = [rows[:0]], 0
    if obstacles is not None and fidelity.radar_bounces != 1 and fidelity.radar_shadowed != 0:
        for number in _near_edges(prepared, obstacles, body):
            own = rows[owner == number]
            may_be_alone = faces[number] <= MOST_FACES_HIDDEN and n_alone < MOST_ALONE
            if not (may_be_alone or worth[number]):
                continue
            _, is_lit = some_facets(View(obstacles, 0), number)
            share = float(np.mean(~is_lit)) if len(is_lit) else 0.0
            if may_be_alone and (faces[number] <= MOST_FACES or share > _LEAST_HIDDEN):
                n_alone += 1
                found = _alone(scene, roles, prepared, radar, fidelity, body, number, followed_s)
                # Longer than any of its own are those by way of other bodies.
                own = own[traced.delay_s[own] <= found.echoes.delay_s.max(initial=0.0) + _LATER_S]
            elif worth[number] and len(own) <= MOST_PATHS:
                found, hidden[number] = _Alone.of(prepared, traced.take(own)), share
            else:
                continue
            is_followed[number] = True
            replaced.append(own)
            if len(found.echoes):
                alone.append(found.echoes)
                parts.append(_passing(obstacles, found, number))
    return CornerEchoes(
        Contributions.concatenate(parts),
        Contributions.concatenate(alone),
        np.concatenate(replaced),
        is_followed,
        hidden,
        perf_counter() - began_s,
    )


def _concave_faces(prepared: PreparedScene, body: NDArray[np.int32]) -> Array:
    """Facets of bodies that may reflect to one another, and that the radar may see directly,
    (n_bodies,); inf of others.
    """
    count = int(body.max(initial=-1)) + 1
    faces, parts = np.zeros((2, count), dtype=np.int64)
    for number in np.flatnonzero((body >= 0) & prepared.worth[0]).tolist():
        geometry = prepared.items[number].geometry
        faces[body[number]] += len(geometry.faces)
        parts[body[number]] += 1 if geometry.shape.is_convex else 2
    return np.where(parts > 1, faces, np.inf)


def _near_edges(
    prepared: PreparedScene, obstacles: Screens, body: NDArray[np.int32]
) -> Iterator[int]:
    """Bodies that the radar may see directly, and to which waves over edges may lead, the nearest
    first.
    """
    numbers = np.unique(body[(body >= 0) & prepared.worth[0]])
    boxes = [
        boxes_of([prepared.originals[item] for item in np.flatnonzero(body == number)])
        for number in numbers
    ]
    ends = np.array([(box[:, 0].min(axis=0), box[:, 1].max(axis=0)) for box in boxes])
    ends = ends.reshape(-1, 2, 3) - prepared.anchor_m
    middles, radii_m = ends.mean(axis=1), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2
    for row in np.argsort(np.linalg.norm(middles - prepared.images[0].place, axis=1)):
        number, middle, radius_m = int(numbers[row]), middles[row], float(radii_m[row])
        if is_near_edges(obstacles, prepared.images[0], middle, radius_m, number):
            yield number


class _Alone(NamedTuple):
    """Echoes of a body as if nothing stood before it, and the places, relative to the anchor, where
    their paths meet it first and leave it last, (2, n, 3).
    """

    echoes: Contributions
    places: Array

    @staticmethod
    def of(prepared: PreparedScene, echoes: Contributions) -> "_Alone":
        """Of direct echoes of a scene."""
        here, half_m = prepared.images[0].place, echoes.delay_s * speed_of_light / 2
        places = []
        for direction in (echoes.departure, echoes.arrival):
            distance_m = distances_to(prepared, here, direction)
            distance_m = np.where(np.isfinite(distance_m), distance_m, half_m)
            places.append(here + distance_m[:, None] * direction)
        return _Alone(echoes, np.stack(places))


def _alone(
    scene: Scene,
    roles: Sequence[Assignment],
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    of_object: NDArray[np.int32],
    body: int,
    followed_s: float | None,
) -> _Alone:
    """Of several reflections, with the walls that the radar sees through."""
    walls = prepared.originals[len(prepared.world.face_ranges) :]
    members = [prepared.items[item] for item in np.flatnonzero(of_object == body)]
    names = {item.name for item in (*members, *walls)}
    alone = prepare_scene(
        replace(scene, objects=tuple(item for item in scene.objects if item.name in names)),
        radar,
        [role for role in roles if role.name in names],
        0,
    )
    found = scattered(alone, radar, fidelity, followed_s=followed_s).contributions
    found = found.take(np.flatnonzero(found.bounces > 1))
    number = {item.name: row for row, item in enumerate(prepared.items)}
    whole = np.array([number[item.name] for item in alone.items], dtype=np.uint32)
    places = _Alone.of(alone, found).places
    return _Alone(replace(found, object=whole[found.object]), places)


def _passing(obstacles: Screens, alone: _Alone, body: int) -> Contributions:
    """The same echoes by all ways, direct ones and over edges, to the places and back; those
    between the same cells, and of nearly one length and rate, as one.
    """
    every = alone.places.reshape(-1, 3)
    number = alike(list(np.round(every / _SAME_M).astype(np.int64).T))
    row = first_rows(number)
    passed, ends = waves_past(obstacles, every[row], body), number.reshape(2, -1)
    strongest = np.abs(passed.wave).max(axis=1)
    place, _ = legs = np.nonzero(
        np.abs(passed.wave) >= _FAINT * obstacles.faintest * strongest[:, None]
    )
    cells = passed.cell[ends]
    order = np.lexsort(cells)
    many = np.prod(np.bincount(place, minlength=len(row))[ends[:, order]], axis=0)
    portions = np.flatnonzero(np.diff(np.cumsum(many) // _AT_ONCE)) + 1
    parts = []
    for some in np.split(order, portions):
        echo, out = matching_pairs(ends[0, some], place)
        pair, back = matching_pairs(ends[1, some[echo]], place)
        parts.append(
            _joined(obstacles, alone.echoes, passed, legs, some[echo[pair]], out[pair], back)
        )
    return Contributions.concatenate(parts)


def _joined(
    obstacles: Screens,
    echoes: Contributions,
    passed: PassedWaves,
    legs: tuple[Indices, ...],
    echo: Indices,
    out: Indices,
    back: Indices,
) -> Contributions:
    """Pairs of waves ``out`` and ``back``, by the numbers of their ``legs``, for some echoes, (n,);
    each is divided between the two lengths beside its own, as in `waves_past`.
    """
    wave, faster = passed.wave[legs], passed.rate_m_per_s[legs]
    both = wave[out] * wave[back]
    strongest = np.abs(passed.wave).max(axis=1)[legs[0]]
    strong = np.abs(both) >= _FAINT * obstacles.faintest * strongest[out] * strongest[back]
    echo, out, back, both = echo[strong], out[strong], back[strong], both[strong]
    place, bins = legs
    length_m = echoes.delay_s[echo] * speed_of_light + BIN_M * (bins[out] + bins[back])
    rate = echoes.delay_rate[echo] + (faster[out] + faster[back]) / speed_of_light
    alike = passed.cell[place[out]]
    steps_of_rate = rate * (speed_of_light / _RATE_M_PER_S)
    for values in (passed.cell[place[back]], echoes.falloff[echo], steps_of_rate):
        steps = np.round(values).astype(np.int64)
        alike = alike * (int(np.ptp(steps)) + 1) + steps - steps.min()
    alike = np.unique(alike, return_inverse=True)[1]
    lower = np.floor(length_m / BIN_M).astype(np.int64)
    upper = length_m / BIN_M - lower
    keys, share = np.concatenate([lower, lower + 1]), np.concatenate([1 - upper, upper])
    row, first = np.tile(np.arange(len(echo)), 2), int(lower.min())
    turn = phasors(obstacles.wavenumber * (keys * BIN_M - length_m[row]))
    number = alike[row] * (int(keys.max()) - first + 1) + keys - first
    _, least, owner = np.unique(number, return_index=True, return_inverse=True)
    amplitude = (echoes.amplitude[echo] * both)[row] * share * turn
    one = row[least]
    return replace(
        echoes.take(echo[one]),
        amplitude=sums(owner.reshape(-1), amplitude, len(least)),
        delay_s=keys[least] * BIN_M / speed_of_light,
        delay_rate=rate[one],
        departure=passed.departure[place[out[one]]],
        arrival=passed.departure[place[back[one]]],
    )
