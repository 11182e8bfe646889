"""The scene set up for one pose of the radar: who is met and mirrors, and what all legs share.

What depends on the meshes alone is kept between calls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.engine import mitsuba
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.images import Image, Sight, images
from twin.radar.propagation.legs import Station, station, with_images
from twin.radar.propagation.materials import surface_of
from twin.radar.propagation.roles import LARGE_BESIDE_OPTICS, Assignment, Role
from twin.radar.propagation.rough import coherent
from twin.radar.propagation.shape import shape_of
from twin.radar.propagation.walls import lets_through, thickness_of, walls
from twin.radar.propagation.world import Flat, Mesher, anchor_of, flats, mesher
from twin.radar.scattering.surface import PEC, TABLE_STEPS, Surface, table
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stage:
    """The scene set up for one pose: objects the rays meet, mirrors, and what all legs share.

    Vectors are relative to ``anchor_m``; ``axes`` are the antenna's in the world. ``originals`` are
    the objects as the scene has them, their large triangles undivided.
    """

    anchor_m: Array
    axes: Array
    place: Array
    wavelength_m: float
    items: tuple[SceneObject, ...]
    originals: tuple[SceneObject, ...]
    roles: tuple[Role, ...]
    world: Mesher
    sight: Sight
    flats: tuple[Flat, ...]
    images: tuple[Image, ...]
    station: Station
    surface_of_object: NDArray[np.uint32]
    assumptions: tuple[str, ...]

    def with_images(self, order: int) -> "Stage":
        """The same with the images of up to so many reflections."""
        found = images(self.sight, self.flats, self.place, order)
        velocities = np.array([item.velocity_m_per_s for item in self.items]).reshape(-1, 3)
        seen = with_images(
            self.station, found, self.flats, velocities, self.surface_of_object, order
        )
        return replace(self, images=tuple(found), station=seen)

    def via(self, image: int) -> tuple[str, ...]:
        """Names of the objects that make an image."""
        patches = self.images[image].patches
        return tuple(self.items[self.flats[p].object].name for p in patches)


def set_stage(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    order: int,
    *,
    is_rough: bool = False,
) -> Stage:
    """Set a scene up for a radar at its pose.

    ``order``: reflections at large surfaces on a leg, at most; ``is_rough``: they lose what
    roughness scatters. Raises InputError where a material has no data at the carrier.
    """
    place_m = scene.rig.position_m + scene.rig.device("radar")[0]
    axes, anchor = scene.rig.device("radar")[1], anchor_of(place_m)
    role_of = {a.name: a.role for a in roles}
    kept = [item for item in scene.objects if role_of[item.name] is not Role.TARGET]
    carrier = radar.ofdm.carrier_hz
    slabs = _slabs(scene, kept, role_of, radar)
    solid = [item for item in kept if item.name not in slabs]
    clear = [item for item in kept if item.name in slabs]
    surfaces, surface_of_object, assumed = _surfaces(
        scene, [*solid, *clear], role_of, carrier, is_rough
    )
    mi, world, place = mitsuba(), mesher(solid, anchor), place_m - anchor
    wavelength = radar.ofdm.wavelength_m
    mirrors, patch_of_face = flats(world, _zones(world, role_of, place, wavelength))
    items, through = [item for item in world.items if item], None
    if clear:
        mesh = mesher(clear, anchor)
        more, labels = flats(mesh, _zones(mesh, role_of, place, wavelength))
        values = [slabs[item.name] for item in clear]
        through = walls(mi, mesh, values, labels + np.uint32(len(mirrors)), carrier)
        mirrors += [replace(f, object=f.object + len(solid), is_wall=True) for f in more]
        items += [item for item in mesh.items if item]
    sight = Sight(mi, world, mi.UInt32(patch_of_face), through)
    return Stage(
        anchor_m=anchor,
        axes=axes,
        place=place,
        wavelength_m=wavelength,
        items=tuple(items),
        originals=(*solid, *clear),
        roles=tuple(role_of[item.name] for item in items),
        world=world,
        sight=sight,
        flats=tuple(mirrors),
        images=(),
        station=station(
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
    ).with_images(order)


def _surfaces(
    scene: Scene,
    items: Sequence[SceneObject],
    role_of: dict[str, Role],
    carrier_hz: float,
    is_rough: bool,
) -> tuple[tuple[tuple[Surface, float], ...], NDArray[np.uint32], tuple[str, ...]]:
    """Different surfaces with their roughness, which one each object has, and what is assumed."""
    known: dict[tuple[Surface, float], int] = {(PEC, 0.0): 0}
    assumed: dict[str, None] = {}
    numbers = np.zeros(len(items), dtype=np.uint32)
    for i, item in enumerate(items):
        if role_of[item.name] is Role.OBSTACLE:
            continue
        surface, why = surface_of(item, scene, carrier_hz)
        relief = scene.materials[item.material].surface
        height = 0.0
        if is_rough and relief is not None and role_of[item.name] is Role.SURFACE:
            height = relief.rms_height_m.value
        numbers[i] = known.setdefault((surface, height), len(known))
        if why:
            assumed[f"radio properties of {item.material}: {why}"] = None
    return tuple(known), numbers, tuple(assumed)


@lru_cache(maxsize=64)
def _rows(surface: Surface, rms_height_m: float, carrier_hz: float) -> Array:
    """Coefficients of reflection, less what a rough surface scatters elsewhere."""
    cosine = np.linspace(0, 1, TABLE_STEPS + 1)
    left = coherent(rms_height_m, cosine, speed_of_light / carrier_hz)
    rows: Array = (table((surface,), carrier_hz)[0] * left[:, None]).ravel()
    return rows


def _table(surfaces: Sequence[tuple[Surface, float]], carrier_hz: float) -> Array:
    return np.concatenate([_rows(surface, rms, carrier_hz) for surface, rms in surfaces])


def _slabs(
    scene: Scene, items: Sequence[SceneObject], role_of: dict[str, Role], radar: RadarDesign
) -> dict[str, tuple[complex, float]]:
    """Large surfaces that the radar sees through: permittivity, and thickness where the mesh is
    open (0 where it shows it itself).
    """
    found = {}
    for item in items:
        if role_of[item.name] is not Role.SURFACE:
            continue
        depth = thickness_of(item, shape_of(item))
        surface = surface_of(item, scene, radar.ofdm.carrier_hz)[0]
        epsilon = surface.layers[0].permittivity if surface.layers else surface.backing
        if depth is None or epsilon is None:
            continue
        if lets_through(epsilon, depth, radar.ofdm.wavelength_m):
            found[item.name] = (epsilon, item.thickness_m or 0.0)
    return found


def _zones(
    world: Mesher, role_of: dict[str, Role], place: Array, wavelength_m: float
) -> dict[int, float]:
    """Of every surface, the side from which a flat patch of it mirrors."""
    return {
        i: LARGE_BESIDE_OPTICS * (wavelength_m * _near(world, i, place)) ** 0.5
        for i, item in enumerate(world.items)
        if item is not None and role_of[item.name] is Role.SURFACE
    }


def _near(world: Mesher, number: int, place: Array) -> float:
    points = world.vertices[world.vertex_ranges[number]]
    low, high = points.min(axis=0) - place, points.max(axis=0) - place
    return max(float(np.linalg.norm(np.clip(0.0, low, high))), 1e-3)
