"""Echoes of a scene by physical optics: who scatters, seen from where, and what comes back.

A pure function of scene, radar and knobs; what depends on the meshes alone is kept between calls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.constants import epsilon_0, speed_of_light

from twin.engine import mitsuba
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.edges import Sharp, edge_echoes, edges_of
from twin.radar.propagation.grids import grids, launch
from twin.radar.propagation.images import Image, Sight, images
from twin.radar.propagation.legs import Station, station, with_images
from twin.radar.propagation.materials import radio_properties
from twin.radar.propagation.rays import Rays
from twin.radar.propagation.roles import LARGE_BESIDE_OPTICS, Assignment, Role
from twin.radar.propagation.rough import Rough, coherent, rough_echoes
from twin.radar.propagation.shape import shape_of, together
from twin.radar.propagation.shooting import bodies, shoot
from twin.radar.propagation.walls import lets_through, thickness_of, walls
from twin.radar.propagation.world import Flat, Mesher, anchor_of, flats, mesher
from twin.radar.scattering.surface import PEC, TABLE_STEPS, Layer, Surface, table
from twin.radar.synthesis import Contributions
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]

_CONDUCTOR = 1e5  # S/m: from here on a metal reflects all


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


def scattered(stage: Stage, fidelity: Fidelity) -> tuple[Rays, list[str]]:
    """Contributions of every object that scatters by physical optics; what too few rays cost."""
    body, hulls = _bodies(stage)
    if not hulls:
        return Rays.joined([]), []
    launched = launch(grids(stage.images, hulls), stage.wavelength_m, fidelity.radar_rays)
    velocities = np.array([item.velocity_m_per_s for item in stage.items])
    rays = shoot(
        stage.station,
        bodies(stage.station.mi, body, stage.surface_of_object, velocities),
        launched,
        stage.wavelength_m,
        fidelity.radar_bounces,
    )
    widest = float(launched.thinned.max())
    if widest <= 1:
        return rays, []
    return rays, [
        f"rays up to {widest:.2g} times wider apart than an eighth of a wavelength: echoes of "
        "edges met obliquely fade, outlines are off by a spacing (fidelity.radar_rays)"
    ]


def diffracted(stage: Stage, fidelity: Fidelity) -> tuple[Rays, list[str]]:
    """Contributions of the sharp edges of every such object; what about them is assumed or lost."""
    if not fidelity.radar_edges or Role.OPTICS not in stage.roles:
        return Rays.joined([]), []
    body = _bodies(stage)[0]
    sharp = _sharp(stage, body)
    rays, longer = edge_echoes(stage.station, sharp, stage.wavelength_m, fidelity.radar_edges)
    return rays, _on_edges(stage, sharp, longer)


def _sharp(stage: Stage, body: NDArray[np.int32]) -> list[Sharp]:
    """The sharp edges of every body."""
    rows = np.array(stage.station.table).reshape(-1, TABLE_STEPS + 1, 4)
    # At normal incidence; a conductor's TE is -1.
    reflection = -(rows[:, -1, 0] + 1j * rows[:, -1, 1])[stage.surface_of_object]
    found = []
    for number in range(body.max() + 1):
        members = np.flatnonzero(body == number)
        items = tuple(stage.originals[i] for i in members)
        edges, owner = edges_of(items, tuple(stage.anchor_m.tolist()))
        whose: NDArray[np.uint32] = members[owner].astype(np.uint32)
        velocity = np.array(items[0].velocity_m_per_s)
        found.append(Sharp(edges, whose, reflection[whose], velocity))
    return found


def _on_edges(stage: Stage, sharp: Sequence[Sharp], longer: float) -> list[str]:
    remarks = []
    if longer > 1:
        remarks.append(
            f"pieces of sharp edges {longer:.2g} times longer than an eighth of a wavelength: "
            "right in phase at the carrier only, truncated at their middle (fidelity.radar_edges)"
        )
    partly = {
        stage.items[i].material
        for body in sharp
        for i in np.unique(body.object[np.abs(body.reflection - 1) > 1e-6])
    }
    if partly:
        remarks.append(
            f"edges of {', '.join(sorted(partly))} diffract as a conductor's, times what the "
            "surface reflects at normal incidence"
        )
    crowded = sum(body.edges.crowded for body in sharp)
    if crowded:
        remarks.append(f"{crowded} edges of more than two faces diffract nothing")
    return remarks


def speckle(scene: Scene, stage: Stage, fidelity: Fidelity, seed: int) -> tuple[Rays, list[str]]:
    """Contributions of rough surfaces, and which ones have no gamma or one that is assumed."""
    found, remarks = [], []
    for number, (item, role) in enumerate(zip(stage.items, stage.roles, strict=True)):
        if role is not Role.SURFACE:
            continue
        relief = scene.materials[item.material].surface
        gamma = relief.backscatter_gamma if relief else None
        if gamma is None:
            remarks.append(f"{item.name}: {item.material} has no gamma, it does not scatter")
        elif gamma.value:
            is_slab = number >= len(stage.world.items) and item.thickness_m is None
            found.append(Rough(item, number, gamma.value, is_slab))
            if gamma.assumed:
                remarks.append(f"gamma of {item.material} = {gamma.value:g}: {gamma.assumed}")
    if not found:
        return Rays.joined([]), remarks
    rays = rough_echoes(stage.station, stage.anchor_m, found, fidelity.radar_scatterers, seed)
    return rays, list(dict.fromkeys(remarks))


def contributions_of(rays: Rays, stage: Stage, radar: RadarDesign) -> Contributions:
    """Rays with the antenna's gains and the front end's losses, as the synthesis takes them."""
    departure, arrival = rays.departure @ stage.axes.T, rays.arrival @ stage.axes.T
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    gain = np.sqrt(radar.antenna.gain(departure) * radar.antenna.gain(arrival))
    return Contributions(
        amplitude=rays.amplitude * gain * loss,
        delay_s=rays.length_m / speed_of_light,
        delay_rate=rays.rate_m_per_s / speed_of_light,
        departure=departure,
        arrival=arrival,
    )


def surface_of(item: SceneObject, scene: Scene, carrier_hz: float) -> tuple[Surface, str | None]:
    """What an object's facets are made of at the carrier, and why that is assumed."""
    found = radio_properties(item.material, scene.materials[item.material], carrier_hz)
    permittivity, conductivity, assumed = found
    if conductivity >= _CONDUCTOR:
        return PEC, assumed
    epsilon = permittivity - 1j * conductivity / (2 * np.pi * carrier_hz * epsilon_0)
    if item.thickness_m is None:
        return Surface(backing=epsilon), assumed
    return Surface((Layer(epsilon, item.thickness_m),), backing=1), assumed


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


def _bodies(stage: Stage) -> tuple[NDArray[np.int32], list[Array]]:
    """Body of every object, -1 for what does not scatter, and points around each body.

    Objects that touch and move alike are one: their grids would overlap.
    """
    scattering = [i for i, role in enumerate(stage.roles) if role is Role.OPTICS]
    hulls = {}
    for i in scattering:
        points = stage.items[i].vertices_m - stage.anchor_m
        hulls[i] = points[shape_of(stage.items[i]).hull]
    label = {i: i for i in scattering}
    for n, i in enumerate(scattering):
        for j in scattering[:n]:
            if together(stage.items[i], stage.items[j]):
                old, new = label[i], label[j]
                label = {k: new if v == old else v for k, v in label.items()}
    names = sorted(set(label.values()))
    body = np.full(len(stage.items), -1, dtype=np.int32)
    for i in scattering:
        body[i] = names.index(label[i])
    return body, [np.vstack([hulls[i] for i in scattering if label[i] == name]) for name in names]
