"""Single paths in the scene of physical optics: mirror images of the radar, and declared points.

The same paths as every other echo's, in float64; Sionna RT's image method is what they are tested
against.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.blocking import first_between
from twin.radar.propagation.diffraction.corners import past_borders
from twin.radar.propagation.diffraction.mirrors import (
    BEFORE_MIRROR,
    border_waves,
    passed_twice,
)
from twin.radar.propagation.diffraction.rims import (
    DiffractedPaths,
    is_strong,
    unsure_m,
)
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.one_way.beside import beside
from twin.radar.propagation.one_way.motion import PointMotion, lengthening, turning
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.one_way.points import PointPaths, between, paths_to_points
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image
from twin.radar.rows import matching_pairs
from twin.radar.scattering.kernel import turned
from twin.radar.synthesis import Contributions
from twin.radar.synthesis.contributions import OWN_IMAGE, POINT
from twin.scene import Target
from twin.transfer import host, vector

Array = NDArray[np.float64]


def mirror_echoes(
    prepared: PreparedScene, obstacles: Screens | None = None, faintest: float = 0.0
) -> tuple[Contributions, dict[str, float]]:
    """Echoes of the radar's own mirror images: amplitude per wavelength, no object; and by how much
    those of mirrors behind edges may be off, of the echo without these; inf where edges are too
    many: what they do is left out.

    Over images of any order: wall, wall and ground, and so on. The image in a right-angled corner
    lies exactly behind the corner, at the border between both sequences of its mirrors: each counts
    half, as does any path at the border of visibility.

    With ``faintest`` above 0, echoes of one mirror hold the waves of its border, down to that share
    of an echo, and what ``obstacles`` do, which are of the scene without large surfaces.
    """
    if prepared.context.n_sources == 1:
        return Contributions.none(), {}
    echoes, share = _whole_mirrors(prepared.context)
    parts, factor = [], share.astype(np.complex128)
    off: dict[str, float] = {}
    for row, image in enumerate(prepared.images[1:] if faintest > 0 else ()):
        if len(image.patches) > 2:
            continue
        if len(image.patches) == 2:
            by_borders = past_borders(prepared, image)
            factor[row] = factor[row] if by_borders is None else by_borders
            continue
        border = border_waves(prepared, image, faintest)
        factor[row] = _lit(border, factor[row])
        flat = prepared.flats[image.patches[0]]
        passed = None if obstacles is None else passed_twice(obstacles, flat)
        if passed is not None:
            is_met, name = _is_met(prepared, image), prepared.items[flat.object].name
            if is_met or len(border.point):
                off[name] = max(passed.off, off.get(name, 0.0))
            if np.isfinite(passed.off):
                factor[row] = passed.factor * is_met
                border = replace(border, amplitude=border.amplitude * passed.factor)
        parts.append(_over_border(echoes.take(np.full(len(border.point), row)), border, prepared))
    some = np.flatnonzero(factor)
    whole = echoes.take(some)
    whole = replace(whole, amplitude=whole.amplitude * factor[some])
    return Contributions.concatenate([whole, *parts]), off


def _lit(border: DiffractedPaths, share: complex) -> complex:
    """Of a mirror's echo what is there without its border's waves: all or nothing next to these."""
    close = np.flatnonzero(np.abs(border.lit_m) <= unsure_m(border.stops[:, 0]))
    return float((border.lit_m[close] > 0).all()) if len(close) else share


def _is_met(prepared: PreparedScene, image: Image) -> bool:
    """Whether the radar's way to itself by one mirror meets it, and no other mirror before, if
    nothing but mirrors is there.
    """
    here = image.places[:1]
    foot = (here + image.place) / 2
    first = first_between(prepared, here, here + BEFORE_MIRROR * (foot - here))
    blocked = first[0] in prepared.flats.object
    return prepared.flats.covers(image.patches[0], foot[0]) and not blocked


def _over_border(
    echoes: Contributions, border: DiffractedPaths, prepared: PreparedScene
) -> Contributions:
    """Waves of a mirror's border, (n,), from its echo as often."""
    towards = border.stops[:, 0] - prepared.images[0].place
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return replace(
        echoes,
        amplitude=echoes.amplitude * border.amplitude,
        delay_s=echoes.delay_s + border.longer_m / speed_of_light,
        departure=towards,
        arrival=towards,
        wavefront=np.full(len(echoes), POINT, dtype=np.uint32),
    )


def _whole_mirrors(context: TracingContext) -> tuple[Contributions, Array]:
    """Echoes of images, (n,), of mirrors without border and with nothing before them, and the share
    of each that is met and clear.
    """
    count = context.n_sources - 1
    source = 1 + np.arange(count)
    here = np.tile(np.array(context.place).ravel(), (count, 1))
    aside = beside(context, source, here)
    places = np.concatenate([here, here + aside, here - aside])
    paths = paths_to_points(context, np.tile(source, 3), places, np.zeros_like(places))
    clear = paths.clear.reshape(3, count)
    share = clear[1:].mean(axis=0)
    # Where the exact path is hidden its field is not traced through walls: one beside it is used.
    exact, nearest = (
        paths.take(source - 1),
        paths.take(clear.argmax(axis=0) * count + source - 1),
    )
    (polarization,) = host(
        [turned(context.vertical, -context.boresight, vector(context.mi, exact.back, "Vector3d"))],
        count,
    )
    amplitude = 1 / (4 * np.pi * exact.length) * np.sum(nearest.field * polarization, axis=1)
    none = np.zeros(count, dtype=np.uint32)
    own, faster, _ = (part[0] for part in context.motions.on_host())
    motion = own - exact.velocity, -exact.back, exact.length
    rate, acceleration = lengthening(*motion, faster - exact.acceleration)
    aside = turning(*motion)
    departing = aside + np.cross(exact.spin, exact.back)
    whole = Contributions(
        amplitude=amplitude,
        delay_s=(exact.length + nearest.extra) / speed_of_light,
        delay_rate=rate / speed_of_light,
        delay_acceleration_per_s=acceleration / speed_of_light,
        departure=exact.departure,
        arrival=exact.back,
        object=none,
        source=exact.source,
        receiver=none,
        departure_per_s=np.einsum("nij,nj->ni", exact.axes, departing),
        arrival_per_s=-aside,
        wavefront=np.where(np.array(context.orders)[1:] == 1, OWN_IMAGE, POINT).astype(np.uint32),
    )
    return whole, share


@dataclass(frozen=True)
class TwoWayPath:
    """A path to a declared point and back: the point's number, and the obstacles around which the
    forward and the return path are diffracted, -1 for none.
    """

    target: int
    forward_obstacle: int
    return_obstacle: int


def _meet_edges(context: TracingContext, places: Array) -> NDArray[np.bool_]:
    """Of ways to images over several mirrors whether they are clear where they are, but not on both
    sides, or the reverse, (n_sources, n).
    """
    found = np.zeros((context.n_sources, len(places)), dtype=bool)
    several = np.flatnonzero(np.array(context.orders) > 1)
    source, point = (part.ravel() for part in np.meshgrid(several, np.arange(len(places))))
    if not len(source):
        return found
    here = places[point]
    aside = beside(context, source, here)
    around = np.concatenate([here, here + aside, here - aside])
    paths = paths_to_points(context, np.tile(source, 3), around, np.zeros_like(around))
    clear = paths.clear.reshape(3, -1)
    found[source, point] = clear.any(axis=0) & ~clear.all(axis=0)
    return found


def _beside_edges(
    context: TracingContext, obstacles: Screens | None, source: int, places: Array
) -> Iterator[tuple[PointPaths, NDArray[np.int64]]]:
    """Paths to points (n, 3) over mirrors at an edge of theirs, as to one on either side of each,
    half of each wave; and the numbers of the points.
    """
    aside = beside(context, np.full(len(places), source), places)
    off = np.zeros_like(places)
    length_m = paths_to_points(context, source, places, off, unshadowed=True).length
    for side in (places + aside, places - aside):
        half, at, _ = all_paths_to_points(context, obstacles, source, side, off)
        yield replace(half, field=half.field / 2, length=length_m[at]), at


def _to_points(
    context: TracingContext, obstacles: Screens | None, places: Array
) -> Iterator[tuple[PointPaths, NDArray[np.int64]]]:
    """Paths from each image to points (n, 3), and the number of the point that each leads to.

    A way that meets the edge which two of its mirrors share is at the border between both sequences
    of these: the ways on both sides of it count half each.
    """
    meets_edge = _meet_edges(context, places)
    for source in range(context.n_sources):
        whole, edge = (np.flatnonzero(meets_edge[source] == is_met) for is_met in (False, True))
        if len(whole):
            off = np.zeros((len(whole), 3))
            paths, at, _ = all_paths_to_points(context, obstacles, source, places[whole], off)
            yield paths, whole[at]
        if len(edge):
            for paths, at in _beside_edges(context, obstacles, source, places[edge]):
                yield paths, edge[at]


def point_echoes(
    context: TracingContext,
    targets: Sequence[Target],
    motions: Sequence[PointMotion],
    anchor_m: Array,
    obstacles: Screens | None = None,
) -> tuple[Contributions, list[TwoWayPath]]:
    """Echoes of declared points, which move so, over every pair of images, and around edges of
    obstacles: amplitude per wavelength; ``object`` is the index into the list of paths returned
    beside them.
    """
    places = np.array([t.position_m for t in targets]).reshape(-1, 3) - anchor_m
    velocity = np.array([m.velocity_m_per_s for m in motions]).reshape(-1, 3)
    acceleration = np.array([m.acceleration_m_per_s2 for m in motions]).reshape(-1, 3)
    strength = np.sqrt([t.rcs_m2 for t in targets]) / (4 * np.pi) ** 1.5
    found = _to_points(context, obstacles, places)
    paths = [(path, at) for path, at in found if len(at)]  # most images see none of them
    contributions: list[Contributions] = []
    two_way: list[TwoWayPath] = []
    for forward_path, forward_points in paths:
        for return_path, return_points in paths:
            there, back = matching_pairs(forward_points, return_points)
            if obstacles is not None:
                level = forward_path.level[there] * return_path.level[back]
                strong = is_strong(level, forward_points[there], obstacles.faintest)
                there, back = there[strong], back[strong]
            if not len(there):
                continue
            one, other, at = (
                forward_path.take(there),
                return_path.take(back),
                forward_points[there],
            )
            amplitude = strength[at] * np.sum(one.field * other.field, axis=1)
            number = len(two_way) + np.arange(len(at))
            motion = velocity[at], acceleration[at]
            two_way += [TwoWayPath(*ends) for ends in zip(at, one.over, other.over, strict=True)]
            contributions.append(between(one, other, amplitude, motion, number))
    return Contributions.concatenate(contributions), two_way
