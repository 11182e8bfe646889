"""Mirror images of the radar in large flat surfaces: where echoes seem to start and to end.

An echo over the ground goes out from the radar's image below it. Sources and receivers are the
radar itself and its images, in sequences of up to a few surfaces; rays tell which of them count.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.walls import Walls
from twin.radar.propagation.world import Flat, Mesher
from twin.transfer import aligned, vector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Image:
    """The radar seen in a sequence of patches, the one nearest to it first.

    ``places`` (m + 1, 3): the radar, and its image after each reflection.
    """

    patches: tuple[int, ...]
    places: Array

    @property
    def place(self) -> Array:
        """Where the image stands."""
        here: Array = self.places[-1]
        return here


def mirrored(point: Array, flat: Flat) -> Array:
    """Mirror image of points (..., 3)."""
    off = (point - flat.point) @ flat.normal
    image: Array = point - 2 * np.multiply.outer(off, flat.normal)
    return image


def images(sight: "Sight", flats: Sequence[Flat], radar: Array, order: int) -> list[Image]:
    """The radar, and its images in all sequences of patches that some ray from it meets."""
    found = [Image((), radar[None])]
    newest = found
    for _ in range(order):
        following = []
        for image in newest:
            for number, flat in enumerate(flats):
                if image.patches and image.patches[-1] == number:
                    continue
                if abs((image.place - flat.point) @ flat.normal) < 1e-6:
                    continue
                if _reached(sight, flats, image, number):
                    places = np.vstack([image.places, mirrored(image.place, flat)])
                    following.append(Image((*image.patches, number), places))
        found = found + following
        newest = following
    return found


@dataclass(frozen=True, eq=False)
class Sight:
    """What rays from patch to patch meet: solid things with the patch of every face, and walls."""

    mi: Any
    world: Mesher
    patch_of_face: Any
    walls: Walls | None

    def sees(self, begin: Array, end: Array, patch: int, of_wall: bool) -> NDArray[np.bool_]:
        """Whether rays from points (n, 3) towards others first meet the patch there.

        A wall stands in the way of no patch but another wall's.
        """
        mi, way = self.mi, end - begin
        length = np.linalg.norm(way, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            direction = np.nan_to_num(way / length[:, None])
        start = begin + direction * 4e-6 * (np.abs(begin).max() + 1)
        reach = mi.Float(aligned((length * (1 - 1e-4)).astype(np.float32)))
        ray = mi.Ray3f(vector(mi, start, "Point3f"), vector(mi, direction, "Vector3f"))
        up_to = mi.Ray3f(ray.o, ray.d, reach, 0.0, [])
        clear = ~self.world.scene.ray_test(up_to)
        mesh, labels = self.world, self.patch_of_face
        if of_wall:
            assert self.walls is not None
            mesh, labels = self.walls.mesh, self.walls.patch_of_face
        hit = mesh.scene.ray_intersect_preliminary(ray)
        met = dr.gather(mi.UInt32, labels, hit.prim_index, hit.is_valid())
        return np.array(clear & hit.is_valid() & (met == patch))


def _reached(sight: Sight, flats: Sequence[Flat], image: Image, number: int) -> bool:
    """Whether any ray by way of the image's patches comes to some point of another patch."""
    at = flats[number].samples
    alive = np.ones(len(at), dtype=bool)
    wanted = number
    # From the far end: each leg aims at the image before, and must meet the patch in between.
    for level in range(len(image.patches), -1, -1):
        towards = image.places[level] - at
        if level == 0:
            begin = np.broadcast_to(image.places[0], at.shape)
        else:
            flat = flats[image.patches[level - 1]]
            slope = towards @ flat.normal
            with np.errstate(divide="ignore", invalid="ignore"):
                t = ((flat.point - at) @ flat.normal) / slope
                begin = at + t[:, None] * towards
            alive &= (t > 0) & (t < 1)
        alive &= sight.sees(begin, at, wanted, flats[wanted].is_wall)
        if not alive.any():
            return False
        at, wanted = begin, image.patches[level - 1] if level else -1
    return True
