"""The scene prepared for one pose of the radar: meshes, mirrors, images, and the tracing context.

What depends only on the meshes is cached between calls.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.engine import mitsuba_of_radar
from twin.geometry import shapes_of
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.beside import most_beside_m
from twin.radar.propagation.one_way.context import tracing_context, with_images
from twin.radar.propagation.one_way.motion import PointMotion, RigidMotions, radar_motion
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.culling import (
    OF_NOISE,
    Beam,
    beam_of,
    image_antennas_of,
    noise_amplitude,
    shares,
    worth_tracing,
)
from twin.radar.propagation.scene.image_search import MANY_IMAGES, Sight, closed, images
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.materials import surface_of
from twin.radar.propagation.scene.mesh_scene import Flats, MeshScene, anchor_of, flats, mesher
from twin.radar.propagation.scene.overlaps import echoing_once
from twin.radar.propagation.scene.scattering_models import (
    LARGE,
    LARGE_BESIDE_OPTICS,
    Assignment,
    ScatteringModel,
    declared_alone,
)
from twin.radar.propagation.scene.slabs import lets_through, walls
from twin.radar.propagation.surface_clutter import coherent
from twin.radar.scattering.surface import PEC, TABLE_STEPS, LayeredSurface, table
from twin.scene import Scene, SceneObject, Target
from twin.scene.boxes import boxes_of, distances_m

Array = NDArray[np.float64]

#: Of waves over the border of an only mirror, down to which bodies are looked for past it; in
#: cities none are.
_PAST_BORDERS = 0.03


@dataclass(frozen=True, eq=False)
class FurtherPaths:
    """What paths by more reflections at large surfaces than those of any image lead to: declared
    ``points`` (n_points,), and ``objects`` (n_objects,), to which they are worth tracing: of these
    times as many places of images of the most reflections as of one less, at least 1, else 0.
    """

    objects: Array
    points: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """The scene prepared for one pose: objects for rays, mirrors, images, and the tracing context.

    Vectors are relative to ``anchor_m``; ``axes`` are the antenna's in the world. ``originals`` are
    the objects as the scene has them, undivided. ``images`` are those of
    ``all_images`` over which there is any echo; ``has_more_images``: whether there are others of
    more reflections, too many to look for; ``worth`` (n_images, n_objects): whether paths
    between an image and an object that scatters are traced; ``sees_points`` (n_images, n_points):
    whether a path between an image and a declared point may be; ``motions`` are those of objects,
    by number; ``untraced`` (n_objects,): bound of the echo of each by all paths that are not
    traced, in amplitude before losses.
    """

    anchor_m: Array
    axes: Array
    place: Array
    wavelength_m: float
    items: tuple[SceneObject, ...]
    originals: tuple[SceneObject, ...]
    roles: tuple[ScatteringModel, ...]
    world: MeshScene
    flats: Flats
    all_images: tuple[Image, ...]
    images: tuple[Image, ...]
    has_more_images: bool
    motions: RigidMotions
    radar_motion: PointMotion
    worth: NDArray[np.bool_]
    sees_points: NDArray[np.bool_]
    untraced: Array
    context: TracingContext
    surface_of_object: NDArray[np.uint32]
    assumptions: tuple[str, ...]

    def seen_by_itself(self, more_m: float = 0.0, by_two_m: float = 0.0) -> "PreparedScene":
        """The same with the images in which the radar may see itself, also over the border of one
        mirror, or one of two, by ways that are longer by up to so much.
        """
        return self.with_images(closed(self.all_images, self.flats, more_m, by_two_m))

    def with_images(self, images: Sequence[Image]) -> "PreparedScene":
        """The same with other images."""
        order = max(len(image.patches) for image in images)
        motions = self.radar_motion, self.motions
        seen = with_images(self.context, images, self.flats, motions, self.surface_of_object, order)
        return replace(self, images=tuple(images), context=seen)

    def up_to(self, order: int) -> "tuple[PreparedScene, FurtherPaths]":
        """The same with images of so many reflections at most, and to what paths lead by further
        ones.
        """
        orders = np.array([len(image.patches) for image in self.images])
        some = np.flatnonzero(orders <= order)
        last = orders[some].max()
        before, newest = (self._n_places(np.flatnonzero(orders == n)) for n in (last - 1, last))
        has_more = self.worth[orders > order].any(axis=0) | self.has_more_images
        further = FurtherPaths(
            np.where(has_more, np.maximum(newest / np.maximum(before, 1), 1.0), 0.0),
            np.asarray(self.sees_points[orders > order].any(axis=0)) | self.has_more_images,
        )
        if len(some) == len(orders):
            return self, further
        fewer = replace(
            self.with_images([self.images[k] for k in some]),
            all_images=tuple(i for i in self.all_images if len(i.patches) <= order),
            worth=self.worth[some],
            sees_points=self.sees_points[some],
        )
        return fewer, further

    def _n_places(self, images: NDArray[np.intp]) -> NDArray[np.intp]:
        """At how many places the radar is seen from each object by some images, (n_objects,): walls
        at right angles have several images at one, each for one order of reflections.
        """
        found = np.array([self.images[k].place for k in images]).reshape(-1, 3)
        place = np.unique(np.round(found, 3), axis=0, return_inverse=True)[1].reshape(-1)
        seen = np.zeros((len(found), self.worth.shape[1]), dtype=bool)
        np.logical_or.at(seen, place, self.worth[images])
        return np.asarray(seen.sum(axis=0))

    @property
    def moves(self) -> bool:
        """Whether any object, or the radar, moves now."""
        motions = self.motions
        return bool(
            self.accelerates
            or motions.velocity_m_per_s.any()
            or self.radar_motion.velocity_m_per_s.any()
        )

    @property
    def accelerates(self) -> bool:
        """Whether any object, or the radar, turns or accelerates now."""
        return not (self.radar_motion.is_uniform and self.motions.are_uniform)

    def via(self, image: int) -> tuple[str, ...]:
        """Names of the objects that make an image."""
        patches = self.images[image].patches
        return tuple(self.items[self.flats.object[p]].name for p in patches)


def prepare_scene(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    order: int,
    *,
    rough: Collection[str] = (),
    many: float = np.inf,
) -> PreparedScene:
    """Prepare a scene for a radar at its pose.

    ``order``: reflections at large surfaces on a path, at most, one where there are more than
    ``many`` images; ``rough``: names of those that lose what roughness scatters, and scatter.
    Raises InputError where a material has no data at the carrier.
    """
    place_m = scene.rig.position_m + scene.rig.device("radar")[0]
    axes, anchor = scene.rig.device("radar")[1], anchor_of(place_m)
    role_of = {a.name: a.role for a in roles}
    declared = {a.name for a in roles if a.declared}
    traced_items = [
        item for item in scene.objects if role_of[item.name] is not ScatteringModel.TARGET
    ]
    carrier = radar.ofdm.carrier_hz
    slabs = _slabs(scene, traced_items, role_of, radar)
    solid = [item for item in traced_items if item.name not in slabs]
    clear = [item for item in traced_items if item.name in slabs]
    surfaces, surface_of_object, assumed = _surfaces(
        scene, [*solid, *clear], role_of, carrier, rough
    )
    scatters = [role_of[item.name] is ScatteringModel.OPTICS for item in solid]
    once, remarks = echoing_once(solid, scatters, anchor, place_m)
    mi, world, place = mitsuba_of_radar(), mesher(once, anchor), place_m - anchor
    wavelength = radar.ofdm.wavelength_m
    mirrors, patch_of_face = flats(world, _zones(solid, role_of, declared, place_m, wavelength))
    items, through = [item for item in world.items if item], None
    if clear:
        mesh = mesher(clear, anchor)
        more, labels = flats(mesh, _zones(clear, role_of, declared, place_m, wavelength))
        values = [slabs[item.name] for item in clear]
        through = walls(mi, mesh, values, labels + np.uint32(len(mirrors)), carrier)
        mirrors = mirrors.and_walls(more, len(solid))
        items += [item for item in mesh.items if item]
    sight = Sight(mi, world, mi.UInt32(patch_of_face), through)
    assumed += tuple(remarks)
    limit, beam = _limit(radar), beam_of(radar.antenna)
    # Half of what may be left out is for images, half for paths to objects.
    found = images(sight, mirrors, place, axes[0], beam, order, limit / 2, many)
    if found.is_cut_short and max(len(image.patches) for image in found.images) < 2:
        assumed += (
            f"more than {many:g} images of the radar in large surfaces: none of more than one "
            "reflection is looked for (fidelity.radar_images = 2 does)",
        )
    prepared = PreparedScene(
        anchor_m=anchor,
        axes=axes,
        place=place,
        wavelength_m=wavelength,
        items=tuple(items),
        originals=(*solid, *clear),
        roles=tuple(role_of[item.name] for item in items),
        world=world,
        flats=mirrors,
        all_images=tuple(found.images),
        images=(),
        has_more_images=found.is_cut_short,
        motions=RigidMotions.of(items, anchor),
        radar_motion=radar_motion(scene),
        worth=np.zeros((0, len(items)), dtype=bool),
        sees_points=np.zeros((0, 0), dtype=bool),
        untraced=np.zeros(len(items)),
        context=tracing_context(
            mi,
            world,
            place,
            axes[0],
            axes[2],
            wavelength,
            sight.patch_of_face,
            mi.Float64(_table(surfaces, carrier)),
            through,
        ),
        surface_of_object=surface_of_object,
        assumptions=assumed,
    )
    return _culled(prepared, declared_alone(scene, roles), beam, rough, found.left_out, limit)


def _limit(radar: RadarDesign) -> float:
    """Amplitude that all echoes left out before tracing may have together, before losses."""
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    return OF_NOISE * noise_amplitude(radar) / loss


def _culled(
    prepared: PreparedScene,
    points: Sequence[Target],
    beam: Beam,
    rough: Collection[str],
    faint: float,
    limit: float,
) -> PreparedScene:
    """The prepared scene with the images and paths that are traced."""
    numbers = np.flatnonzero(
        [
            role is ScatteringModel.OPTICS
            or (role is ScatteringModel.SURFACE and item.name in rough)
            for item, role in zip(prepared.items, prepared.roles, strict=True)
        ]
    )
    found, flats, more_m = prepared.all_images, prepared.flats, 0.0
    if len(found) <= MANY_IMAGES:
        # By how much longer the path of the faintest is: its amplitude is 1 / (2 sqrt(pi q)).
        more_m = prepared.wavelength_m / (2 * np.pi) / (4 * np.pi * _PAST_BORDERS**2)
    antennas = image_antennas_of(found, flats, prepared.axes[0], beam, more_m)
    boxes = boxes_of([prepared.items[i] for i in numbers]) - prepared.anchor_m
    share = shares(antennas, boxes, prepared.flats, beam)
    traced = worth_tracing(share, limit / 2)
    # Points cost next to nothing: they are left out only where there is no path to them.
    places = np.array([t.position_m for t in points]).reshape(-1, 3) - prepared.anchor_m
    aside_m = most_beside_m(prepared.wavelength_m, antennas.place, places)[:, None]
    round_points = np.stack([places - aside_m, places + aside_m], axis=1)
    to_points = shares(antennas, round_points, prepared.flats, beam, np.ones(len(points)))
    is_used = np.asarray(np.hstack([traced.is_traced, to_points > 0]).any(axis=1))
    is_used[0] = True  # the radar itself
    worth = np.zeros((int(is_used.sum()), len(prepared.items)), dtype=bool)
    worth[:, numbers] = traced.is_traced[is_used]
    # An echo out by one image and home by another has the geometric mean of both shares at most.
    untraced = np.zeros(len(prepared.items))
    missing = np.sqrt(np.where(traced.is_traced, 0.0, share)).sum(axis=0)
    untraced[numbers] = missing * np.sqrt(share).sum(axis=0) * 2
    assumed = prepared.assumptions
    if (left_out := faint + traced.left_out) > 0:
        level = 20 * np.log10(OF_NOISE * left_out / limit)
        assumed += (
            f"too faint to be traced: {np.count_nonzero(~traced.is_traced & (share > 0))} of "
            f"{np.count_nonzero(share)} paths to objects, and mirrors; all their echoes together "
            f"at most {level:.0f} dB of a cell's noise",
        )
    used_images = [
        image for image, is_kept in zip(prepared.all_images, is_used, strict=True) if is_kept
    ]
    return replace(
        prepared.with_images(used_images),
        worth=worth,
        sees_points=to_points[is_used] > 0,
        untraced=untraced,
        assumptions=assumed,
    )


def _surfaces(
    scene: Scene,
    items: Sequence[SceneObject],
    role_of: dict[str, ScatteringModel],
    carrier_hz: float,
    rough: Collection[str],
) -> tuple[tuple[tuple[LayeredSurface, float], ...], NDArray[np.uint32], tuple[str, ...]]:
    """Different surfaces with their roughness, which one each object has, and what is assumed."""
    number_of: dict[tuple[LayeredSurface, float], int] = {(PEC, 0.0): 0}
    assumed: dict[str, None] = {}
    numbers = np.zeros(len(items), dtype=np.uint32)
    for i, item in enumerate(items):
        if role_of[item.name] is ScatteringModel.OBSTACLE:
            continue
        surface, why = surface_of(item, scene, carrier_hz)
        relief = scene.materials[item.material].surface
        height = 0.0
        if item.name in rough and relief is not None:
            height = relief.rms_height_m.value
        numbers[i] = number_of.setdefault((surface, height), len(number_of))
        if why:
            assumed[f"radio properties of {item.material}: {why}"] = None
    return tuple(number_of), numbers, tuple(assumed)


@lru_cache(maxsize=64)
def _rows(surface: LayeredSurface, rms_height_m: float, carrier_hz: float) -> Array:
    """Coefficients of reflection, less what a rough surface scatters elsewhere."""
    cosine = np.linspace(0, 1, TABLE_STEPS + 1)
    left = coherent(rms_height_m, cosine, speed_of_light / carrier_hz)
    rows: Array = (table((surface,), carrier_hz)[0] * left[:, None]).ravel()
    return rows


def _table(surfaces: Sequence[tuple[LayeredSurface, float]], carrier_hz: float) -> Array:
    return np.concatenate([_rows(surface, rms, carrier_hz) for surface, rms in surfaces])


def _slabs(
    scene: Scene,
    items: Sequence[SceneObject],
    role_of: dict[str, ScatteringModel],
    radar: RadarDesign,
) -> dict[str, tuple[complex, float]]:
    """Large surfaces that the radar sees through: permittivity, and thickness where the mesh is
    open (0 where it shows it itself).
    """
    slabs = {}
    permittivity: dict[str, complex | None] = {}
    large = [item for item in items if role_of[item.name] is ScatteringModel.SURFACE]
    shapes = shapes_of([item.geometry for item in large])
    for item, shape in zip(large, shapes, strict=True):
        if item.material not in permittivity:
            surface = surface_of(replace(item, thickness_m=None), scene, radar.ofdm.carrier_hz)[0]
            permittivity[item.material] = surface.backing
        epsilon = permittivity[item.material]
        depth = shape.thickness_m if item.thickness_m is None else item.thickness_m
        if depth is None or epsilon is None:
            continue
        if lets_through(epsilon, depth, radar.ofdm.wavelength_m):
            slabs[item.name] = (epsilon, item.thickness_m or 0.0)
    return slabs


def _zones(
    items: Sequence[SceneObject],
    role_of: dict[str, ScatteringModel],
    declared: Collection[str],
    place_m: Array,
    wavelength_m: float,
) -> Array:
    """Of every surface, the side from which a flat patch of it mirrors; infinite for others.

    Of one that the scene has declared to be a surface the largest patch does whatever its size, and
    others do from where the image method may be taken to hold at all.
    """
    near = np.maximum(distances_m(boxes_of(items), place_m), 1e-3)
    zones: Array = np.sqrt(wavelength_m * near)
    sides = np.full(len(items), np.inf)
    for i, item in enumerate(items):
        if role_of[item.name] is not ScatteringModel.SURFACE:
            continue
        sides[i] = LARGE_BESIDE_OPTICS * zones[i]
        if item.name in declared:
            largest_m = item.geometry.shape.largest_patch_m2**0.5 * (1 - 1e-9)
            sides[i] = min(LARGE * zones[i], largest_m)
    return sides
