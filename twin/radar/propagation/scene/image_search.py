"""Search for the radar's images: in all sequences of patches that some ray from it meets."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.scene.culling import Beam, image_antennas_of, shares, worth_tracing
from twin.radar.propagation.scene.images import Image, in_planes
from twin.radar.propagation.scene.mesh_scene import Flats, MeshScene
from twin.radar.propagation.scene.slabs import Walls
from twin.transfer import vector

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAMPLES = 256  # points of a patch that rays are sent to
_FIRST = 16  # every so many of them first: most patches that are seen at all are seen there
_RAYS_AT_ONCE = 2**18  # some 100 MB
#: From the radar and so many images on, no images of more than one reflection are looked for where
#: bounds decide: paths between all pairs of these take minutes, as in a city. In a room of six
#: walls there are 37 of up to two.
MANY_IMAGES = 40
#: Images from which on, likewise, none of more than three reflections are looked for.
FURTHER = 128
_GRAZING = 0.1  # least cosine of incidence by which a mirror's border is looked for farther on
_ASIDE = 1e-3  # of the path's length: how far beside a mirror the return path may pass


@dataclass(frozen=True, eq=False)
class Sight:
    """What rays from patch to patch may meet: opaque objects with the patch of each face, and walls
    that the radar sees through.
    """

    mi: Any
    world: MeshScene
    patch_of_face: Any
    walls: Walls | None

    def sees(
        self, begin: Array, end: Array, patch: Indices, of_wall: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Whether rays from points (n, 3) to others first meet the patch (n,) there.

        Walls are transparent: they hide only the patches of other walls.
        """
        mi, segment = self.mi, end - begin
        length = np.linalg.norm(segment, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            direction = np.nan_to_num(segment / length[:, None])
        off = 4e-6 * (np.abs(begin).max(axis=1) + 1)
        start = begin + off[:, None] * direction
        ray = mi.Ray3f(vector(mi, start, "Point3f"), vector(mi, direction, "Vector3f"))
        first_patch, distance = _first_hits(mi, self.world, self.patch_of_face, ray)
        clear = distance >= ((length - off) * (1 - 1e-4)).astype(np.float32)
        if of_wall.any():
            assert self.walls is not None
            behind = _first_hits(mi, self.walls.mesh, self.walls.patch_of_face, ray)[0]
            first_patch = np.where(of_wall, behind, first_patch)
        seen: NDArray[np.bool_] = clear & (first_patch == patch)
        return seen


def _first_hits(
    mi: Any, mesh: MeshScene, labels: Any, ray: Any
) -> tuple[Indices, NDArray[np.float32]]:
    """Patch that each ray first meets, -1 for none, and the distance there, else infinite."""
    hit = mesh.scene.ray_intersect_preliminary(ray)
    is_hit = hit.is_valid()
    label = mi.Int32(dr.gather(mi.UInt32, labels, hit.prim_index, is_hit))
    label = dr.select(is_hit, label, -1)
    distance = dr.select(is_hit, hit.t, dr.inf)
    dr.eval(label, distance)
    return np.array(label).astype(np.int64), np.array(distance)


@dataclass(frozen=True, eq=False)
class Found:
    """The radar and its ``images``; ``left_out``: bound of the amplitude of all echoes over those
    that receive too little power, relative to the sent wave before losses; ``is_cut_short``:
    whether there were too many to look for those of more than one reflection.
    """

    images: list[Image]
    left_out: float
    is_cut_short: bool


def images(
    sight: Sight,
    flats: Flats,
    radar: Array,
    axis: Array,
    beam: Beam,
    order: int,
    limit: float,
    many: float = np.inf,
) -> Found:
    """The radar, and its images in all sequences of up to ``order`` patches that some ray meets.

    Patches that receive least power are left out while the amplitude of all echoes over them,
    relative to the sent wave before losses, stays below ``limit``. Where there are more than
    ``many`` images of up to two reflections, only those of one are found; of more than three
    reflections none by which there would be more than ``many`` and `FURTHER`.
    """
    images_so_far = [Image((), radar[None])]
    newest, left_out = images_so_far, 0.0
    for done in range(order):
        if done == 1 and len(images_so_far) > many:
            return Found(images_so_far, left_out, True)
        if not newest or not len(flats):
            break
        share = shares(image_antennas_of(newest, flats, axis, beam), flats.box, flats, beam)
        places = np.array([image.place for image in newest])
        off = np.einsum("ni,pi->np", places, flats.normal)
        off -= np.einsum("pi,pi->p", flats.point, flats.normal)
        share[np.abs(off) < 1e-6] = 0  # in the patch's plane, as after a reflection there and back
        for row, image in enumerate(newest):
            share[row, image.patches[-1:]] = 0
        worth = worth_tracing(share, limit / order)
        faint = worth.left_out
        rows, numbers = np.nonzero(worth.is_traced)
        reached = _reached(sight, flats, newest, rows, numbers)
        newest = [
            _reflected(newest[row], number, flats)
            for row, number in zip(rows[reached].tolist(), numbers[reached].tolist(), strict=True)
        ]
        # The third tells to which objects paths by more than two reflections lead.
        most = {1: many, 2: np.inf}.get(done, max(FURTHER, many))
        if len(images_so_far) + len(newest) > most:
            return Found(images_so_far, left_out, True)
        left_out += faint
        images_so_far = images_so_far + newest
    return Found(images_so_far, left_out, False)


def closed(
    images: Sequence[Image], flats: Flats, more_m: float = 0.0, by_two_m: float = 0.0
) -> list[Image]:
    """The radar, and its images of up to twice the order in which it may see itself.

    The path of such an echo is the path of one image up to its middle, and of another one from the
    radar's side; so only sequences of one image's patches and another's reversed are tried. In the
    mirrored world the path is a straight line: it must pass through every patch's window, or close
    beside it. ``more_m``: by how much waves over the border of one mirror alone may be longer;
    ``by_two_m``: over a border of two.
    """
    closure = list(images[:1])
    for longer, shorter in _halves(images):
        first = np.array([image.patches for image in longer], dtype=np.int64)
        last = np.array([image.patches[::-1] for image in shorter], dtype=np.int64)
        last = last.reshape(len(shorter), -1)
        for patches in first:
            sequences = np.hstack([np.tile(patches, (len(last), 1)), last])
            longer_m = {1: more_m, 2: by_two_m}.get(sequences.shape[1], 0.0)
            places, passes = _places(sequences, images[0].place, flats, longer_m)
            closure += [
                Image(tuple(sequences[k].tolist()), places[k]) for k in np.flatnonzero(passes)
            ]
    return closure


def _halves(images: Sequence[Image]) -> list[tuple[list[Image], list[Image]]]:
    """Images of each order, paired with those of the order before and with those of the same."""
    by_order: list[list[Image]] = [
        [image for image in images if len(image.patches) == order]
        for order in range(max(len(image.patches) for image in images) + 1)
    ]
    return [
        (longer, by_order[n])
        for order, longer in enumerate(by_order)
        for n in (order - 1, order)
        if n >= 0 and order and longer and by_order[n]
    ]


def _places(
    sequences: Indices, radar: Array, flats: Flats, more_m: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Images after each reflection, (n, m + 1, 3), and whether the path from the last one to the
    radar passes through all patches, or one longer by ``more_m`` does.
    """
    places = [np.tile(radar, (len(sequences), 1))]
    twice = np.zeros(len(sequences), dtype=bool)
    for level, number in enumerate(sequences.T):
        places.append(in_planes(places[-1], flats.point[number], flats.normal[number]))
        twice |= (number == sequences[:, level - 1]) & (level > 0)
    passes = ~twice
    at, whole = places[0], np.linalg.norm(places[-1] - places[0], axis=1)
    passes &= whole > 0
    zone = np.sqrt(more_m * (2 * whole + more_m)) / 2
    # Past a corner planes are met the other way round.
    slack = np.maximum(_ASIDE, 4 * zone / _GRAZING / np.maximum(whole, 1e-300))
    for level in range(sequences.shape[1], 0, -1):
        number, towards = sequences[:, level - 1], places[level] - at
        normal, point = flats.normal[number], flats.point[number]
        slope = np.sum(towards * normal, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.sum((point - at) * normal, axis=1) / slope
        passes &= (t > -slack) & (t < 1 + slack)
        at = at + np.where(passes, t, 0.0)[:, None] * towards
        # Along a mirror that is met obliquely a zone is longer.
        cosine = np.abs(slope) / np.maximum(np.linalg.norm(towards, axis=1), 1e-300)
        margin = np.maximum(_ASIDE * whole, zone / np.maximum(cosine, _GRAZING))[:, None]
        box = flats.box[number]
        passes &= ((at >= box[:, 0] - margin) & (at <= box[:, 1] + margin)).all(axis=1)
    return np.stack(places, axis=1), passes


def _reflected(image: Image, number: int, flats: Flats) -> Image:
    place = in_planes(image.place, flats.point[number], flats.normal[number])
    return Image((*image.patches, number), np.vstack([image.places, place]))


def _reached(
    sight: Sight, flats: Flats, images: Sequence[Image], rows: Indices, numbers: Indices
) -> NDArray[np.bool_]:
    """Whether any ray over an image's patches reaches a sampled point of another patch, (n,)."""
    places = np.array([image.places for image in images])
    patches = np.array([image.patches for image in images], dtype=np.int64)
    reached = np.zeros(len(rows), dtype=bool)
    is_first = np.arange(_SAMPLES) % _FIRST == _FIRST // 2
    for samples in (np.flatnonzero(is_first), np.flatnonzero(~is_first)):
        left = np.flatnonzero(~reached)
        step = _RAYS_AT_ONCE // _SAMPLES
        for first in range(0, len(left), step):
            some = left[first : first + step]
            at = flats.samples(numbers[some], samples, _SAMPLES)
            sequence = (places[rows[some]], patches[rows[some]], numbers[some])
            reached[some] = _arrive(sight, flats, *sequence, at)
    return reached


def _arrive(
    sight: Sight, flats: Flats, places: Array, patches: Indices, wanted: Indices, points: Array
) -> NDArray[np.bool_]:
    """Whether a ray from the radar over patches (n, m), whose images are ``places`` (n, m + 1, 3),
    reaches any of the points (n, s, 3) of further patches (n,).
    """
    row: Indices = np.repeat(np.arange(len(points)), points.shape[1])
    at: Array = points.reshape(-1, 3)
    wanted = wanted[row]
    # From the far end: each segment aims at the image before, and must first meet its patch.
    for level in range(patches.shape[1], -1, -1):
        begin: Array = places[row, level]
        before = wanted
        if level:
            before = patches[row, level - 1]
            normal, towards = flats.normal[before], begin - at
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.sum((flats.point[before] - at) * normal, axis=1)
                t /= np.sum(towards * normal, axis=1)
            begin = at + np.where((t > 0) & (t < 1), t, np.nan)[:, None] * towards
        alive = np.flatnonzero(~np.isnan(begin).any(axis=1))
        if not len(alive):
            return np.zeros(len(points), dtype=bool)
        begin, wanted = begin[alive], wanted[alive]
        seen = sight.sees(begin, at[alive], wanted, flats.is_wall[wanted])
        row, at, wanted = row[alive][seen], begin[seen], before[alive][seen]
    is_reached = np.zeros(len(points), dtype=bool)
    is_reached[row] = True
    return is_reached
