"""Worlds of many bodies, what is set up of them, and which meshes are measured."""

from dataclasses import replace

import numpy as np
import trimesh

from tests.physics.radar_worlds import (
    RADAR,
    WAVELENGTH_M,
    ground,
    plate,
    quad,
    thing,
    world,
)
from twin.geometry import shape
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.scene import Scene, SceneObject

BOX = trimesh.creation.box(extents=(1, 1, 1))


def block(name: str, center, size, **more) -> SceneObject:
    return thing(name, BOX.vertices * np.asarray(size) + np.asarray(center), BOX.faces, **more)


def staged(scene: Scene, order: int = 1) -> PreparedScene:
    return prepare_scene(
        scene, RADAR, assign_scattering_models(scene, WAVELENGTH_M, with_optics=True), order
    )


def scattered_blocks(rng: np.random.Generator, count: int) -> list[SceneObject]:
    """Sizes over three decades, some side by side, some moving alike."""
    side = 1.5 * count ** (1 / 2)
    return [
        block(
            f"b{i}",
            rng.uniform(0, side, 3) * (1, 1, 0.1),
            10 ** rng.uniform(-2, 1, 3),
            velocity_m_per_s=(float(rng.integers(2)), 0.0, 0.0),
        )
        for i in range(count)
    ]


def counted(monkeypatch) -> list[int]:
    """Numbers of the meshes that are measured from now on."""
    measured: list[int] = []
    measure = shape._measured

    def counting(geometries):
        measured.extend(id(geometry) for geometry in geometries)
        return measure(geometries)

    monkeypatch.setattr(shape, "_measured", counting)
    return measured


def street(rng: np.random.Generator, houses: int) -> Scene:
    """Walls along a street, each standing a little back or forth."""
    walls = []
    for i in range(houses):
        for side in (-1, 1):
            x, y = 8.0 * i, side * rng.uniform(5, 8)
            corners = [[x, y, -1], [x + 7, y, -1], [x + 7, y, 9], [x, y, 9]]
            walls.append(quad(f"w{i}{side}", corners))
    ends = [plate("end", (8.0 * houses + 2, 0, 0), 30.0), ground(-1.0)]
    return world(*walls, *ends)


def town(count: int) -> Scene:
    """Boxes at random between the houses of a street, whose walls mirror the radar."""
    rng = np.random.default_rng(6)
    low, high = (4, -4.5, -0.7), (190, 4.5, 1.5)
    boxes = [
        block(f"b{i}", rng.uniform(low, high), rng.uniform(0.05, 0.3, 3), radar="optics")
        for i in range(count)
    ]
    houses = street(rng, 24)
    return replace(houses, objects=(*houses.objects, *boxes))
