"""Ways to bodies that edges stand beside, of obstacles or borders of mirrors: which of those over
mirrors or by several reflections are followed round the edges, and what these may change of the
others.
"""

from dataclasses import replace
from time import perf_counter
from typing import NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.body_levels import BodyLevels
from twin.radar.propagation.decisions import Decided, on_edges_beside, on_mirror_borders
from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.beside_ways import MANY_OBSTACLES, levels_beside
from twin.radar.propagation.diffraction.over_mirrors import border_levels, points_of
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.shadowed_facets import some_facets
from twin.radar.propagation.diffraction.views import View
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.physical_optics import followed_by
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.rows import alike, first_rows
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
#: A way out and home, in both directions: the numbers of its body and of both images of the radar.
MirroredWay = tuple[int, int, int]

_WORTH = 3.0  # of what is permitted: echoes by several reflections at bodies of many facets
_MOST_REFLECTIONS = 1  # at mirrors, on ways that are followed round obstacles
#: Share of a body up to which others hide it before what they leave of its echo over mirrors tells
#: how much edges may change.
_MOST_HIDDEN = 0.5
#: Past a mirror's border facets may meet the border's waves, from aside, at right angles, and echo
#: as many times as much as those that are lit.
_PAST = 10.0
_MOST_WAYS = 16  # over mirrors, that are followed: some 0.15 s each
_PLACES = 16  # on a body that is hidden, about, to which waves over edges are looked for


def worth_following(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    lit: Contributions,
    obstacles: Screens | None,
) -> NDArray[np.bool_]:
    """Bodies whose direct echoes by several reflections edges of obstacles may change by more than
    a few times what is permitted, (n_bodies,).
    """
    if not _are_followed(obstacles, fidelity) or fidelity.radar_bounces == 1:
        return np.zeros(len(levels.names), dtype=bool)
    is_direct = (lit.source == 0) & (lit.receiver == 0) & (lit.bounces > 1)
    some = lit.take(np.flatnonzero(is_direct))
    change = levels.rms_of(_changed(prepared, fidelity, levels, some, obstacles), radar)
    return change > _WORTH * levels.permitted * levels.reference


def _are_followed(obstacles: Screens | None, fidelity: Fidelity) -> TypeGuard[Screens]:
    """Whether edges are looked for beside ways at all: in cities they are not."""
    if obstacles is None or fidelity.radar_shadowed == 0:
        return False
    return len(obstacles.items) <= MANY_OBSTACLES


class MirroredWays(NamedTuple):
    """The ``ways`` over mirrors that are followed round obstacles; and what waves over edges may
    add, relative, on others from which bodies are hidden, (n_bodies,).
    """

    ways: tuple[MirroredWay, ...]
    hidden: Array


def mirrored_ways(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    lit: Contributions,
    obstacles: Screens | None,
) -> MirroredWays:
    """Ways to bodies, one of them at least over a mirror, on which edges may change echoes the
    most and too much, ``lit`` ones or those of which others hide the most. In cities none; and none
    over flat sides of obstacles, whose edges `side_echoes` holds.
    """
    hidden = np.zeros(len(levels.names))
    if not _are_followed(obstacles, fidelity) or len(prepared.images) == 1:
        return MirroredWays((), hidden)
    is_few = np.array([len(image.patches) <= _MOST_REFLECTIONS for image in prepared.images])
    few = np.flatnonzero(is_few & ~_over_sides(prepared, obstacles)).tolist()
    changes = _changes_of_lit(prepared, radar, fidelity, levels, lit, obstacles, few)
    unlit: set[MirroredWay] = set()
    for body in range(len(levels.names)):
        members = np.flatnonzero(levels.of_object == body)
        seen = [image for image in few if prepared.worth[image, members].any()]
        found = _hidden_ways(body, obstacles, fidelity, seen)
        unlit |= found.keys()
        changes |= {way: max(c, changes.get(way, 0.0)) for way, c in found.items()}
    worth = [way for way, change in changes.items() if change > levels.permitted]
    worth.sort(key=lambda way: -changes[way])
    for way in unlit.difference(worth[:_MOST_WAYS]):
        hidden[way[0]] = np.hypot(hidden[way[0]], changes[way])
    return MirroredWays(tuple(worth[:_MOST_WAYS]), hidden)


def _over_sides(prepared: PreparedScene, obstacles: Screens) -> NDArray[np.bool_]:
    """Which images, (n_images,), are in flat sides of obstacles along which the radar looks."""
    flats, source = prepared.flats, prepared.images[0].place
    is_side = np.zeros(len(flats), dtype=bool)
    for side in obstacles.sides:
        is_side |= (flats.object == side.item) & side.has_plane(flats.point - source, flats.normal)
    return np.array([is_side[list(image.patches)].any() for image in prepared.images])


def _changes_of_lit(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    lit: Contributions,
    obstacles: Screens,
    few: list[int],
) -> dict[MirroredWay, float]:
    """What waves over edges and borders may change of single reflections at bodies by each pair of
    a ``few`` images, one of them at least in a mirror, relative.
    """
    images = _images_of(lit)
    single = (lit.bounces == 1) & (images[1] > 0) & np.isin(images, few).all(axis=0)
    some, images = lit.take(np.flatnonzero(single)), images[:, single]
    parts = (
        _changed(prepared, fidelity, levels, some, obstacles),
        _changed_by_borders(prepared, levels, some, obstacles),
    )
    changes: dict[MirroredWay, float] = {}
    for one, other in np.unique(images, axis=1).T.tolist():
        by_these = np.flatnonzero((images[0] == one) & (images[1] == other))
        level = np.hypot(*(levels.rms_of(changed.take(by_these), radar) for changed in parts))
        change = level / levels.reference
        changes |= {(body, one, other): float(c) for body, c in enumerate(change)}
    return changes


def _hidden_ways(
    body: int, obstacles: Screens, fidelity: Fidelity, images: list[int]
) -> dict[MirroredWay, float]:
    """Ways to a body that others hide from one image at least, and what waves over edges may add on
    each to direct ones, were the body as strong by either way. Fainter waves than those that are
    followed everywhere count where no image lights it, and past a border that has no others.
    """
    followed = followed_by(obstacles, fidelity)
    seen = {i: _Seen.of(View(followed, i), body) for i in images}
    is_dark = not any(one.is_lit for one in seen.values())
    seen |= {
        i: _Seen.of(View(obstacles, i), body)
        for i, one in seen.items()
        if is_dark or (one.is_past and not one.field)
    }
    direct = max(seen[0].field, obstacles.faintest) if 0 in seen else 1.0
    ways = {}
    for i, j in ((i, j) for i in images for j in images if 0 < j >= i):
        one, other = seen[i], seen[j]
        if not (one.is_lit and other.is_lit):
            change = (1 if i == j else 2) * one.level * other.level * one.field * other.field
            change *= _PAST if one.is_past or other.is_past else 1.0
            ways[body, i, j] = change / direct**2
    return ways


class _Seen(NamedTuple):
    """A body as an image sees it: whether it is lit for the most part; if it is not, the field of
    the waves over edges there, over the straight one, rms; the level of what mirrors reflect; and
    whether a part is past the border of the image's only mirror: such a body counts as dark, since
    that part may be the one that glints.
    """

    is_lit: bool
    field: float
    level: float
    is_past: bool = False

    @staticmethod
    def of(view: View, body: int) -> "_Seen":
        """By some of its facets."""
        facets, is_lit = some_facets(view, body)
        if not len(facets):
            return _Seen(True, 0.0, 0.0)
        level = float(np.mean(view.reflected(facets.middle)))
        off = offset_m(facets.middle) * facets.normal(view.place)
        past = view.goes_past_mirror(facets.middle[~is_lit], off[~is_lit], body)
        if np.mean(is_lit) >= 1 - _MOST_HIDDEN and not past:
            return _Seen(True, 1.0, level)
        step = max(1, len(facets) // _PLACES)
        places, off = facets.middle[::step], off[::step]
        own, context = np.full(len(places), body), view.obstacles.prepared.context
        found = all_paths_to_points(context, view.obstacles, view.number, places, off, own)
        field = found.field(view.straight(places, off), view.obstacles.wavenumber)
        return _Seen(False, float(np.sqrt(np.mean(np.abs(field) ** 2))), level, past)


def edges_beside(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    lit: Contributions,
    followed: NDArray[np.bool_],
    mirrored: MirroredWays,
    obstacles: Screens | None,
) -> Decided:
    """What edges of obstacles may change of echoes that are not followed round these: by single
    reflections over mirrors on other than ``mirrored`` ways, and by several at bodies over mirrors,
    and at other bodies than the ``followed`` ones, (n_bodies,).
    """
    nothing = np.zeros(len(levels.names))
    if fidelity.radar_shadowed is not None or obstacles is None:
        return (), nothing
    is_direct = _images_of(lit)[1] == 0
    is_followed = _are_mirrored(prepared, levels, lit, mirrored) | (
        is_direct & ((lit.bounces == 1) | followed[levels.of_object[lit.object]])
    )
    if is_followed.all() and not mirrored.hidden.any():
        return (), nothing
    began_s = perf_counter()
    some = lit.take(np.flatnonzero(~is_followed))
    changed = _changed(prepared, fidelity, levels, some, obstacles)
    left_out = np.hypot(levels.rms_of(changed, radar) / levels.reference, mirrored.hidden)
    cost_s = perf_counter() - began_s
    return on_edges_beside(levels.names, left_out, levels.permitted, cost_s), left_out


def mirror_borders(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    lit: Contributions,
    mirrored: MirroredWays,
    obstacles: Screens | None,
) -> Decided:
    """What waves over the borders of mirrors may change of echoes over these on other than
    ``mirrored`` ways, which is left out.
    """
    nothing = np.zeros(len(levels.names))
    is_left_out = (_images_of(lit)[1] > 0) & ~_are_mirrored(prepared, levels, lit, mirrored)
    if fidelity.radar_shadowed is not None or not is_left_out.any():
        return (), nothing
    began_s = perf_counter()
    some = lit.take(np.flatnonzero(is_left_out))
    changed = _changed_by_borders(prepared, levels, some, obstacles)
    left_out = levels.rms_of(changed, radar) / levels.reference
    cost_s = perf_counter() - began_s
    return on_mirror_borders(levels.names, left_out, levels.permitted, cost_s), left_out


def _are_mirrored(
    prepared: PreparedScene, levels: BodyLevels, lit: Contributions, mirrored: MirroredWays
) -> NDArray[np.bool_]:
    """Which echoes are single reflections by ways over mirrors that are followed, (n,)."""
    sizes = len(levels.names), len(prepared.images), len(prepared.images)
    own = levels.of_object[lit.object], *_images_of(lit)
    ways = tuple(np.array(mirrored.ways, dtype=np.int64).reshape(-1, 3).T)
    number, some = (np.ravel_multi_index(way, sizes) for way in (own, ways))
    return np.asarray(np.isin(number, some) & (lit.bounces == 1))


def _images_of(echoes: Contributions) -> Indices:
    """Numbers of the radar's images of both ways, the lower ones first, (2, n)."""
    ends = np.stack([echoes.source, echoes.receiver]).astype(np.int64)
    return np.sort(ends, axis=0)


def _changed(
    prepared: PreparedScene,
    fidelity: Fidelity,
    levels: BodyLevels,
    some: Contributions,
    obstacles: Screens,
) -> Contributions:
    """What waves over edges of obstacles may change of some echoes."""
    followed = followed_by(obstacles, fidelity)
    body = levels.of_object[some.object]
    ends = np.concatenate([some.source, some.receiver]).astype(np.int64)
    both = np.tile(body, 2)
    number = alike([both, ends])
    first = first_rows(number)
    pairs = zip(both[first].tolist(), ends[first].tolist(), strict=True)
    points = {
        one: points_of(prepared, np.flatnonzero(levels.of_object == one))
        for one in np.unique(body).tolist()
    }
    waves = levels_beside(followed, list(pairs), points)
    out, back = waves[number.reshape(2, -1)]
    return replace(some, amplitude=some.amplitude * ((1 + out) * (1 + back) - 1))


def _changed_by_borders(
    prepared: PreparedScene,
    levels: BodyLevels,
    some: Contributions,
    obstacles: Screens | None,
) -> Contributions:
    """What waves over the borders of mirrors may change of some echoes, but for those of flat sides
    of obstacles, which `side_echoes` holds.
    """
    images = np.unique(np.concatenate([some.source, some.receiver]))
    if obstacles is not None:
        images = images[~_over_sides(prepared, obstacles)[images]]
    waves = border_levels(prepared, levels.of_object, len(levels.names), images)
    body = levels.of_object[some.object]
    changed = (1 + waves[body, some.source]) * (1 + waves[body, some.receiver]) - 1
    return replace(some, amplitude=some.amplitude * changed)
