"""What the borders of two mirrors let pass of the radar's own echo by both, as in a corner.

Seen from the radar its image is straight ahead, and each mirror an opening on the way, the first
one where the other shows it. The rim of an opening adds edge waves, by Kirchhoff's integral.
Openings that end at one place, as two walls do that meet or nearly meet, are one: that which lets
less pass counts, and the factors of others are multiplied.

Left out are how the factor changes over the band, and corners of meshes that pass through each
other, where no edge is: there a path is whole or not at all.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import unsure_m
from twin.radar.propagation.diffraction.mirrors import border
from twin.radar.propagation.diffraction.rims import DiffractedPaths, rim_paths
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.rows import lengths
from twin.radar.propagation.scene.images import Image

Array = NDArray[np.float64]

#: Over an echo: the faintest edge wave that counts.
FAINTEST = 0.1
#: Of the first Fresnel zone's radius: openings whose rims are closer together end at one place.
_TOGETHER = 0.5


class Passed(NamedTuple):
    """What openings let pass of an echo, and a place ``beside`` the radar (3,) whose way to the
    same image is clear of their borders.
    """

    factor: complex
    beside: Array


def past_borders(prepared: PreparedScene, image: Image) -> Passed | None:
    """Of the echo of an image by two mirrors; None where no border is near."""
    here, wavenumber = image.places[0], 2 * np.pi / prepared.wavelength_m
    openings = []
    for number, foot, behind in _openings(prepared, image):
        rim = border(prepared, number, image.place, behind)
        waves = rim_paths(rim, image.place, here[None], wavenumber, FAINTEST)
        if len(waves.point):
            is_met = _is_met(waves, prepared.flats.covers(number, foot))
            turn = np.exp(-1j * wavenumber * waves.longer_m)
            factor = complex(is_met + (waves.amplitude * turn).sum())
            openings.append((factor, waves))
    if not openings:
        return None
    openings.sort(key=lambda opening: abs(opening[0]))
    counted: list[tuple[complex, DiffractedPaths]] = []
    for factor, waves in openings:
        if all(_are_apart(waves, other, image, wavenumber) for _, other in counted):
            counted.append((factor, waves))
    factors = np.prod([factor for factor, _ in counted])
    return Passed(
        complex(factors), _beside(DiffractedPaths.concatenate([w for _, w in counted]), image)
    )


def _openings(prepared: PreparedScene, image: Image) -> Iterator[tuple[int, Array, list[int]]]:
    """Of each mirror, the nearest on the way back from the radar first: its number, where its plane
    is met, and the mirrors in which the radar sees it, the last one the nearest.
    """
    flats, at = prepared.flats, image.places[0]
    for level in range(len(image.patches), 0, -1):
        number, towards = image.patches[level - 1], image.places[level] - at
        flat = flats[number]
        at = at + (flat.point - at) @ flat.normal / (towards @ flat.normal) * towards
        yield number, at, list(image.patches[level:])


def _is_met(waves: DiffractedPaths, is_inside: bool) -> bool:
    """Whether the straight way passes an opening: next to an edge, if it is on its lit side."""
    close = np.abs(waves.lit_m) <= unsure_m(waves.stops[:, 0])
    return bool((waves.lit_m[close] > 0).all()) if close.any() else is_inside


def _are_apart(
    waves: DiffractedPaths, others: DiffractedPaths, image: Image, wavenumber: float
) -> bool:
    """Whether the nearest edges of two openings are at different places on the way."""
    place, other = (w.stops[w.longer_m.argmin(), 0] for w in (waves, others))
    ways = [float(np.linalg.norm(place - end)) for end in (image.place, image.places[0])]
    zone_m = np.sqrt(2 * np.pi / wavenumber * ways[0] * ways[1] / sum(ways))
    return bool(np.linalg.norm(place - other) > _TOGETHER * zone_m)


def _beside(waves: DiffractedPaths, image: Image) -> Array:
    """So far aside of the radar that the way to the image passes all edges on their lit sides;
    those that it is farthest behind are taken first.
    """
    here, place = image.places[0], waves.stops[:, 0]
    behind = unsure_m(place) - waves.lit_m
    into_light = waves.aside[:, 0] / lengths(waves.aside[:, 0])[:, None]
    whole, so_far = np.linalg.norm(here - image.place), lengths(place - image.place)
    moved = np.zeros(3)
    for row in np.argsort(-behind)[: np.count_nonzero(behind > 0)]:
        missing = 2 * behind[row] * whole / so_far[row] - moved @ into_light[row]
        moved += max(missing, 0.0) * into_light[row]
    return np.asarray(here + moved)
