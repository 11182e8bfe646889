"""What the borders of two mirrors let pass of the radar's own echo by both, as in a corner.

Seen from the radar its image is straight ahead, and each mirror an opening on the way, the first
one where the other shows it. An edge near the way is a half plane that it may pass, and so is the
line in which the planes of both meet, where either hides what goes on behind it. Of edges in one
direction at about one place, as of two walls that meet or nearly meet, those count between which
least is open: by Fresnel's integral from one to the other. Factors of other directions and places
are multiplied, as those of a rectangular aperture are.

Left out is how the factor changes over the band.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.blocking import NOTHING, first_between
from twin.radar.propagation.diffraction.knife_edge import knife_edge_factor
from twin.radar.propagation.diffraction.mirror_borders import border
from twin.radar.propagation.diffraction.mirrors import BEFORE_MIRROR
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image, mirrored
from twin.radar.rows import dots, lengths

Array = NDArray[np.float64]

#: Radii of the first Fresnel zone to which edges count: their waves are 0.08 of the echo there.
_REACH = 2.0
#: Likewise, how far beside an edge it is tried whether a way goes over both mirrors.
_BESIDE = 0.05
_FAINTEST = 0.05  # over an echo: what is fainter is left out
#: Of the whole way: edges that are less far from each other along it are at one place.
_TOGETHER = 0.1
_ALIKE = 0.98  # cosine between directions that are one
_PARALLEL = 1e-3  # sine of an angle: planes, and a line and a way, that do not meet
_SHORT_M = 0.1  # ways between mirrors on which nothing stands


class _Edges(NamedTuple):
    """Half planes that a way may pass, (n, ...): unit vectors into them across the way (n, 3),
    where they begin along these, in radii of the Fresnel zone from the way, and how far from the
    image.
    """

    into: Array
    begin: Array
    depth_m: Array


def longest_m(wavelength_m: float) -> float:
    """By how much a way over the farthest edge that counts is longer."""
    return _REACH**2 * wavelength_m / 2


def past_borders(prepared: PreparedScene, image: Image) -> complex | None:
    """What is there of the echo of an image by two mirrors; None where no border is near."""
    first, last = (_edges(prepared, image, level) for level in (0, 1))
    if first is None or last is None:
        return 0.0
    corner = _corner(prepared, image)
    edges = _joined(first, last, corner)
    if not len(edges.begin):
        return None
    factor, aside = complex(1.0), np.zeros(3)
    whole_m = float(np.linalg.norm(image.places[0] - image.place))
    rest = np.arange(len(edges.begin))
    while len(rest):
        along = edges.into[rest] @ edges.into[rest[0]]
        near = np.abs(edges.depth_m[rest] - edges.depth_m[rest[0]]) < _TOGETHER * whole_m
        alike = near & (np.abs(along) > _ALIKE)
        begin, is_same = edges.begin[rest], along > 0
        low = begin[alike & is_same].max()
        high = -begin[alike & ~is_same].max(initial=-np.inf)
        if low >= high:
            return 0.0
        factor *= _open_beyond(low) - _open_beyond(high)
        margin = min(_BESIDE, (high - low) / 2)
        aside = aside + np.clip(0.0, low + margin, high - margin) * edges.into[rest[0]]
        rest = rest[~alike]
    shading = _joined(first, corner), _joined(last, corner)
    if abs(factor) < _FAINTEST or not _is_reflected(prepared, image, shading, aside):
        return 0.0
    return factor


def _joined(*edges: _Edges) -> _Edges:
    return _Edges(*(np.concatenate(rows) for rows in zip(*edges, strict=True)))


def _open_beyond(edge: float) -> complex:
    """The share of a wave that passes beyond an edge, in radii of the first Fresnel zone."""
    if np.isinf(edge):
        return 0.0
    phase = np.pi * edge**2
    wave = complex(knife_edge_factor(np.array([max(phase, 1e-12)]))[0] * np.exp(-1j * phase))
    return wave if edge > 0 else 1 - wave


def _edges(prepared: PreparedScene, image: Image, level: int) -> _Edges | None:
    """Of one mirror those that are near the way; None where the way goes far past it."""
    number = image.patches[level]
    rim = border(prepared, number, image.place, image.patches[level + 1 :])
    way = image.places[0] - image.place
    whole_m = float(np.linalg.norm(way))
    ahead = way / whole_m
    depth, off = _split(rim.ends, ahead)
    side = off[:, 1] - off[:, 0]
    share = -dots(off[:, 0], side) / np.maximum(dots(side, side), 1e-300)
    share = np.clip(share, 0.0, 1.0)
    nearest, depth = off[:, 0] + share[:, None] * side, depth[:, 0] + share * np.diff(depth)[:, 0]
    zone = _zone_m(prepared, depth, whole_m)
    some = np.flatnonzero(lengths(nearest) < _REACH * zone)
    if not len(some) and not prepared.flats.covers(number, _feet(prepared, image)[level][0]):
        return None
    into = _split(rim.lit[some], ahead)[1]
    into /= np.maximum(lengths(into), 1e-300)[:, None]
    return _Edges(into, dots(nearest[some], into) / zone[some], depth[some])


def _corner(prepared: PreparedScene, image: Image) -> _Edges:
    """The line in which the planes of both mirrors meet, if it is near the way."""
    nothing = _Edges(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    first, last = (prepared.flats[patch] for patch in image.patches)
    along = np.cross(first.normal, last.normal)
    if np.linalg.norm(along) < _PARALLEL:
        return nothing
    rows = np.stack([first.normal, last.normal, along])
    heights = [first.point @ first.normal, last.point @ last.normal, image.place @ along]
    place = np.linalg.solve(rows, heights) - image.place
    way = image.places[0] - image.place
    whole_m = float(np.linalg.norm(way))
    ahead = way / whole_m
    side = _split(along, ahead)[1]
    square = float(side @ side)
    if square < _PARALLEL**2:
        return nothing
    place = place - (_split(place, ahead)[1] @ side) / square * along
    depth, off = _split(place[None], ahead)
    zone = _zone_m(prepared, depth, whole_m)
    if np.linalg.norm(off) >= _REACH * zone[0]:
        return nothing
    into = np.cross(ahead, side / np.sqrt(square))[None]
    beside = image.place + depth[:, None] * ahead + off + _BESIDE * zone[:, None] * into
    (on_last,) = _on_mirror(prepared, image, 1, beside)
    before = ((image.places[0] - first.point) @ first.normal) * (
        (on_last - first.point) @ first.normal
    )
    into = into if before > 0 else -into
    return _Edges(into, dots(off, into) / zone, depth)


def _split(vectors: Array, ahead: Array) -> tuple[Array, Array]:
    """How far vectors (..., 3) go along a direction, and across it."""
    along = vectors @ ahead
    return along, vectors - along[..., None] * ahead


def _zone_m(prepared: PreparedScene, depth_m: Array, whole_m: float) -> Array:
    """Radius of the first Fresnel zone at depths along a way; 0 before and behind it."""
    product = np.maximum(depth_m * (whole_m - depth_m), 0.0)
    return np.asarray(np.sqrt(prepared.wavelength_m * product / whole_m))


def _on_mirror(prepared: PreparedScene, image: Image, level: int, places: Array) -> Array:
    """Where ways by places (n, 3) beside an opening, as the radar sees them, meet the mirror."""
    flat, origin = prepared.flats[image.patches[level]], image.places[0]
    if level == 0:  # seen in the other mirror, with the radar's first image as the origin
        places, origin = mirrored(places, prepared.flats[image.patches[1]]), image.places[1]
    ways = places - origin
    share = ((flat.point - origin) @ flat.normal) / (ways @ flat.normal)
    return np.asarray(origin + share[:, None] * ways)


def _is_reflected(
    prepared: PreparedScene, image: Image, edges: tuple[_Edges, _Edges], aside: Array
) -> bool:
    """Whether a way so far aside of the straight one, in radii of the Fresnel zone, goes over both
    mirrors, which face each other and the radar, and nothing stands before it. It is as far aside
    where the edge is by which a mirror or the corner shades most, and at the foot of one without
    edges.
    """
    here, through = image.places[0], []
    whole_m = float(np.linalg.norm(here - image.place))
    for level, (of_mirror, (_, back_m)) in enumerate(
        zip(edges, _feet(prepared, image), strict=True)
    ):
        depth = np.array([whole_m - back_m])
        if len(of_mirror.begin):
            depth = of_mirror.depth_m[[of_mirror.begin.argmax()]]
        place = image.place + depth[:, None] / whole_m * (here - image.place)
        place = place + _zone_m(prepared, depth, whole_m)[:, None] * aside
        through.append(_on_mirror(prepared, image, level, place)[0])
    flats = [prepared.flats[patch] for patch in image.patches]
    for flat, other in zip(flats, through[::-1], strict=True):
        if ((here - flat.point) @ flat.normal) * ((other - flat.point) @ flat.normal) < 0:
            return False
    first, last = through
    ends = np.stack([here, here, first]), np.stack([first, last, last])
    some = lengths(ends[1] - ends[0]) > _SHORT_M
    begin, way = ends[0][some], (ends[1] - ends[0])[some]
    met = first_between(prepared, begin + (1 - BEFORE_MIRROR) * way, begin + BEFORE_MIRROR * way)
    return bool((met == NOTHING).all())


def _feet(prepared: PreparedScene, image: Image) -> list[tuple[Array, float]]:
    """Where the straight way meets each mirror's plane, and how far back from the radar; the first
    mirror first.
    """
    at, back_m, found = image.places[0], 0.0, []
    for level in (1, 0):
        flat, towards = prepared.flats[image.patches[level]], image.places[level + 1] - at
        share = float((flat.point - at) @ flat.normal / (towards @ flat.normal))
        at, back_m = at + share * towards, back_m + share * float(np.linalg.norm(towards))
        found.append((at, back_m))
    return found[::-1]
