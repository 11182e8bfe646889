"""What a mirror's border, and what stands before it, do to the radar's own echo in the mirror.

The echo of one mirror is a wave that passes two screens on its straight way to the radar's image:
what stands before the mirror, and the image of that. Kirchhoff's integral over the plane between
them, the mirror's, is that of the square of the wave that arrives there round the obstacles: by
reciprocity it goes home as it came. The mirror's own border is an opening in that plane, whose rim
adds edge waves as that of an obstacle does.

Left out are waves that run to and fro between an obstacle and the mirror, how the factor of
obstacles changes over the band, and how obstacles and the border act together: their factors are
multiplied.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from twin.radar.propagation.diffraction.around_edges import all_paths_to_points, is_near_edges
from twin.radar.propagation.diffraction.blocking import NOTHING, first_between
from twin.radar.propagation.diffraction.mirror_borders import RIGHT, border, on_plane
from twin.radar.propagation.diffraction.rims import DiffractedPaths, beside_corners, rim_paths
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.diffraction.segments import Segment
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image, in_plane, mirrored
from twin.radar.propagation.scene.mesh_scene import Flat, Flats
from twin.radar.rows import lengths

Array = NDArray[np.float64]

#: Of the way to a mirror: where rays end before it, and behind its border.
BEFORE_MIRROR, _BEYOND = 1 - 1e-4, 1 + 1e-4
#: Of the distance to a mirror: from which on obstacles cast soft shadows on it; and the least share
#: of the spacing where these are sharper.
_FAR_OFF, _FINEST = 0.3, 0.3
_BEHIND = 1 + 3e-5  # of the way to the mirror: where the integral is, so that labels stand before
#: Points of the integral and edges near its paths, in pairs: 10 us each, so that some seconds are
#: the limit.
_MOST_PAIRS = 2**19
_SAME = 1e-3  # wavelengths between images that are one
_ALL = 2**30  # a number that no body has: points of one group, whose obstacles are all


@dataclass(frozen=True)
class _Grid:
    """Points of the integral, in radii of the first Fresnel zone on the mirror: how far it goes,
    over how much it fades out, and their spacing.
    """

    reach: float
    fade: float
    spacing: float

    def points(self, finer: float) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Places from the foot, (n,) each, with a spacing of this share; and every second one."""
        farthest = self.reach + 3 * self.fade
        spacing = self.spacing * finer
        half = int(farthest / spacing)
        i, j = (part.ravel() for part in np.mgrid[-half : half + 1, -half : half + 1])
        u, v = i * spacing, j * spacing
        some = np.hypot(u, v) <= farthest
        return u[some], v[some], ((i + j) % 2 == 0)[some]

    def weight(self, u: Array, v: Array, share: float = 1.0) -> Array:
        """Of places (n,), where it goes only a share as far."""
        weight: Array = erfc((np.hypot(u, v) / share - self.reach) / self.fade)
        return weight


#: From the finest on, which is 1e-4 off where obstacles stand no nearer to the mirror than three
#: tenths of its distance, to the coarsest, where edges are too many for all others.
_GRIDS = tuple(
    _Grid(*row) for row in ((3, 0.6, 0.1), (2.6, 0.6, 0.125), (2.2, 0.55, 0.16), (1.5, 0.5, 0.25))
)
#: Shares of the reach, and over what the integral changes by with these at most, its error: the
#: waves of fences come from far aside.
_SHORTER, _SURE = (0.7, 0.85), 3.0


class Passed(NamedTuple):
    """The radar's echo in an infinite mirror behind obstacles over that without them, and by how
    much it may be ``off``; inf where edges are too many, and it is not known at all.
    """

    factor: complex
    off: float


def border_waves(prepared: PreparedScene, image: Image, faintest: float) -> DiffractedPaths:
    """Waves from the border of an image's only mirror, over the mirror's echo.

    Where another surface goes on beside it, as at a seam or above the ground, the border is none;
    where another mirror does at an angle or with a step, both end there.
    """
    (number,) = image.patches
    here, wavenumber = image.places[0], 2 * np.pi / prepared.wavelength_m
    rim = border(prepared, number, image.place)
    places = beside_corners(rim, image.place, here[None], wavenumber)
    paths = rim_paths(rim, image.place, places, wavenumber, faintest)
    flat = prepared.flats[number]
    inside, outside = (
        on_plane(flat, here, paths.stops[:, 0] + s * paths.aside[:, 0]) for s in (1, -1)
    )
    begin = np.broadcast_to(here, inside.shape)
    is_free = first_between(prepared, begin, here + BEFORE_MIRROR * (inside - here)) == NOTHING
    met = first_between(prepared, begin, here + _BEYOND * (outside - here))
    for row in np.flatnonzero(met != NOTHING):
        beside = _first_met(prepared.flats, int(met[row]), here, outside[row])
        is_free[row] &= beside is not None and _ends_beside(prepared, image, beside)
    return paths.take(is_free & (np.abs(paths.amplitude) >= faintest))


def _ends_beside(prepared: PreparedScene, image: Image, number: int) -> bool:
    """Whether a mirror ends where another one, by its number, goes on beside it: one with an image
    of its own, at no right angle. In a right corner the waves of both borders and of the echo by
    both cancel.
    """
    own, other = prepared.flats[image.patches[0]], prepared.flats[number]
    apart_m = np.linalg.norm(mirrored(image.places[0], other) - image.place)
    is_right = abs(own.normal @ other.normal) < RIGHT
    return bool(apart_m > _SAME * prepared.wavelength_m and not is_right)


def _first_met(flats: Flats, item: int, begin: Array, end: Array) -> int | None:
    """The patch of an object that a way first meets, by its number, if any."""
    met, way = [], end - begin
    for number in map(int, np.flatnonzero(flats.object == item)):
        flat = flats[number]
        height, slope = (flat.point - begin) @ flat.normal, way @ flat.normal
        share = height / slope if slope else np.inf
        if 0 < share < _BEYOND and flats.covers(number, begin + share * way):
            met.append((share, number))
    return min(met)[1] if met else None


def passed_twice(obstacles: Screens, flat: Flat) -> Passed | None:
    """The radar's echo in an infinite mirror behind obstacles; None where no edge of theirs is
    near.

    ``obstacles`` are those of a scene without large surfaces.
    """
    prepared = obstacles.prepared
    alone = prepared.images[0]
    here, wavenumber = alone.place, obstacles.wavenumber
    foot = here + _BEHIND * (mirrored(here, flat) - here) / 2
    distance_m = float(np.linalg.norm(foot - here))
    zone_m = np.sqrt(np.pi * distance_m / wavenumber)
    if not is_near_edges(obstacles, alone, foot, zone_m, _ALL):
        return None
    off = np.abs((obstacles.boxes - flat.point) @ flat.normal).min()
    finer = float(np.clip(np.sqrt(off / distance_m / _FAR_OFF), _FINEST, 1))
    axes = [axis[0] for axis in in_plane(flat.normal[None])]
    for grid in _GRIDS:
        u, v, is_second = grid.points(finer)
        if len(u) * _edges(obstacles, foot, grid.reach * zone_m) <= _MOST_PAIRS:
            places = np.multiply.outer(u, axes[0]) + np.multiply.outer(v, axes[1])
            places = foot + zone_m * places
            wave = np.exp(-2j * wavenumber * (lengths(places - here) - distance_m))
            once = _arriving(obstacles, places)
            factor, *shorter = (
                _mean(once**2, grid.weight(u, v, share) * wave) for share in (1.0, *_SHORTER)
            )
            fewer = _mean(once**2, grid.weight(u, v) * wave * is_second)
            changes = [abs(other - factor) for other in (*shorter, fewer)]
            return Passed(factor, _SURE * max(changes))
    return Passed(0.0, np.inf)


def _mean(values: NDArray[np.complex128], weight: NDArray[np.complex128]) -> complex:
    return complex((weight * values).sum() / weight.sum())


def _edges(obstacles: Screens, foot: Array, radius_m: float) -> int:
    """How many edges of obstacles are near paths to within a sphere."""
    segment = Segment(obstacles, obstacles.prepared.images[0], 0, foot[None], np.zeros((1, 3)))
    items = segment.near_any(np.ones(1, dtype=bool), radius_m)
    first = np.zeros(1, dtype=np.int64)
    return sum(len(segment.rim(item, first, _ALL, radius_m).ends) for item in items)


def _arriving(obstacles: Screens, places: Array) -> NDArray[np.complex128]:
    """The wave at points (n, 3), straight and round obstacles, over that without them."""
    still = np.zeros_like(places)
    group = np.full(len(places), _ALL)
    found = all_paths_to_points(obstacles.prepared.context, obstacles, 0, places, still, group)
    wave = np.zeros(len(places), dtype=np.complex128)
    if (bent := found.diffracted) is None:
        wave[found.point] = 1
        return wave
    wave[found.point[: len(found.point) - len(bent.point)]] = 1
    turn = np.exp(-1j * obstacles.wavenumber * bent.longer_m)
    np.add.at(wave, bent.point, bent.amplitude * turn)
    return wave
