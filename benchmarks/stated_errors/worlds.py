"""Worlds drawn at random: objects before a rig that looks along x, 1 m above the ground."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.geometry import Geometry
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.materials import load_materials
from twin.scene.meshes import read_mesh

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator], Scene]

_SCENES = Path(__file__).parents[2] / "scenes"
_HEIGHT_M = 1.0  # of the rig
_BODIES = ("car.ply", "person.ply", "car_wheels.ply")


def world(objects: list[SceneObject], pose: Pose | None = None, sun_lx: float = 1e4) -> Scene:
    """A scene of these objects; the rig stands where its pose says."""
    return Scene(
        "drawn",
        Path("drawn"),
        "",
        tuple(objects),
        Rig(pose or Pose((0.0, 0.0, _HEIGHT_M))),
        Sun(150.0, 35.0, sun_lx),
        materials=load_materials(_SCENES / "materials.toml"),
    )


def thing(name: str, mesh: trimesh.Trimesh, reflectance: float, at: Array | None = None, **more):  # type: ignore[no-untyped-def]
    """An object of a mesh, moved to a place; ``more``: as `SceneObject` has it."""
    vertices = np.array(mesh.vertices, dtype=np.float64) + (0.0 if at is None else at)
    geometry = Geometry(vertices, np.array(mesh.faces, dtype=np.int32))
    return SceneObject(name, geometry, more.pop("material", "concrete"), reflectance, **more)


def square(center: Array, normal: Array, half_m: float) -> trimesh.Trimesh:
    """A square around a place, facing along a normal."""
    across = np.cross(normal, [0.0, 0.0, 1.0])
    if np.linalg.norm(across) < 1e-6:
        across = np.array([0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, normal) / np.linalg.norm(normal)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_m
    corners = center + signs[:, :1] * across + signs[:, 1:] * up
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def ground(rng: np.random.Generator, half_m: float = 60.0) -> SceneObject:
    """Level ground of any reflectance."""
    flat = square(np.zeros(3), np.array([0.0, 0.0, 1.0]), half_m)
    return thing("ground", flat, float(rng.uniform(0.03, 0.6)))


def _ahead(rng: np.random.Generator, nearest_m: float = 2.5, farthest_m: float = 25.0) -> Array:
    """A place on the ground within some 25 deg of the x axis."""
    distance = np.exp(rng.uniform(np.log(nearest_m), np.log(farthest_m)))
    return distance * np.array([1.0, rng.uniform(-0.4, 0.4), 0.0])


def _reflectance(rng: np.random.Generator) -> float:
    return float(rng.choice([0.02, 0.05, 0.1, 0.3, 0.5, 0.8, 0.95]))


def boxes(rng: np.random.Generator) -> Scene:
    """Boxes of 0.1 to 4 m, turned at random, on the ground."""
    found = [ground(rng)]
    for i in range(rng.integers(2, 15)):
        mesh = trimesh.creation.box(np.exp(rng.uniform(np.log(0.1), np.log(4), 3)))
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        mesh.apply_translation([0, 0, -mesh.bounds[0, 2] + 1e-3])
        at = _ahead(rng, 5.0)
        found.append(thing(f"box {i}", mesh, _reflectance(rng), at))
    return world(found)


def spheres(rng: np.random.Generator) -> Scene:
    """Spheres of 20 to 1280 facets, some hanging, before a wall or nothing."""
    found = [ground(rng)]
    for i in range(rng.integers(1, 9)):
        mesh = trimesh.creation.icosphere(int(rng.integers(0, 4)), rng.uniform(0.1, 1.2))
        at = _ahead(rng, 4.0) + [0, 0, rng.uniform(0.0, 3.0)]
        found.append(thing(f"sphere {i}", mesh, _reflectance(rng), at))
    if rng.random() < 0.5:
        wall = square(np.array([26.0, 0, 0]), np.array([-1.0, rng.uniform(-1, 1), 0]), 20.0)
        found.append(thing("wall", wall, _reflectance(rng)))
    return world(found)


def cylinders(rng: np.random.Generator) -> Scene:
    """Upright and fallen cylinders, thin posts among them."""
    found = [ground(rng)]
    for i in range(rng.integers(3, 30)):
        radius = np.exp(rng.uniform(np.log(0.01), np.log(0.6)))
        mesh = trimesh.creation.cylinder(radius, rng.uniform(0.5, 4), int(rng.integers(5, 40)))
        if rng.random() < 0.3:
            mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
        mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
        found.append(thing(f"cylinder {i}", mesh, _reflectance(rng), _ahead(rng, 3.0)))
    return world(found)


def terrain(rng: np.random.Generator) -> Scene:
    """Hills of 200 to 20 000 triangles, steep ones among them."""
    side = int(rng.integers(10, 100))
    x, y = np.meshgrid(np.linspace(1, 40, side), np.linspace(-20, 20, side), indexing="ij")
    z = np.zeros_like(x)
    for _ in range(6):
        k, phase = rng.normal(size=2) * rng.uniform(0.1, 1.0), rng.uniform(0, 6.3)
        z += rng.uniform(0.05, 0.4) * np.sin(k[0] * x + k[1] * y + phase)
    z += rng.uniform(0, 0.15) * (x - 1) - z.max(initial=0.0, where=x < 4) - 0.1
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = (index[i : side - 1 + i, j : side - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    faces = np.vstack([np.column_stack([a, c, d]), np.column_stack([a, d, b])])
    mesh = trimesh.Trimesh(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces, process=False)
    return world([thing("hills", mesh, _reflectance(rng), material="grass")])


def room(rng: np.random.Generator) -> Scene:
    """A closed room with furniture; the rig stands in it."""
    size = rng.uniform([4, 3, 2.2], [14, 9, 5])
    walls = trimesh.creation.box(size)
    walls.invert()
    white = float(rng.uniform(0.1, 0.9))
    found = [thing("room", walls, white, np.array([size[0] / 2 - 0.7, 0, size[2] / 2]))]
    for i in range(rng.integers(0, 6)):
        extent = rng.uniform(0.2, 1.0, 3)
        at = [rng.uniform(2.2, size[0] - 1.5), rng.uniform(-0.35, 0.35) * size[1], extent[2] / 2]
        mesh = trimesh.creation.box(extent)
        mesh.apply_transform(
            trimesh.transformations.rotation_matrix(rng.uniform(0, 3.1), [0, 0, 1])
        )
        found.append(thing(f"box {i}", mesh, _reflectance(rng), np.array(at) + [0, 0, 1e-3]))
    return world(found)


def corner(rng: np.random.Generator) -> Scene:
    """A concave corner of three squares that fills the view, bright or dark."""
    leg, away = rng.uniform(0.5, 4.0), rng.uniform(3.0, 12.0)
    turn = Rotation.from_euler("zyx", rng.uniform(-20, 20, 3), True).as_matrix()
    u = np.array([[-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 0.0, -2.0]])
    u /= np.linalg.norm(u, axis=1)[:, None]
    tip = np.array([away, 0, _HEIGHT_M])
    found = []
    for i in range(3):
        one, other = leg * turn @ u[i], leg * turn @ u[(i + 1) % 3]
        corners = tip + np.array([0 * one, one, one + other, other])
        mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
        found.append(thing(f"side {i}", mesh, _reflectance(rng)))
    return world(found)


def imported(rng: np.random.Generator) -> Scene:
    """Car, person or wheels of the bundled meshes, turned, at any distance."""
    found = [ground(rng)]
    for i in range(rng.integers(1, 4)):
        body = read_mesh(_SCENES / "bodies" / str(rng.choice(_BODIES)))
        mesh = trimesh.Trimesh(body.vertices_m, body.faces, process=False)
        mesh.apply_transform(
            trimesh.transformations.rotation_matrix(rng.uniform(0, 6.3), [0, 0, 1])
        )
        mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
        at = _ahead(rng, 6.0, 30.0) + [0, 0, 1e-3]
        found.append(thing(f"body {i}", mesh, _reflectance(rng), at))
    return world(found)


def sionna_scene(name: str) -> Path:
    """One of the scenes that Sionna RT comes with."""
    spec = importlib.util.find_spec("sionna")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]) / "rt" / "scenes" / name / f"{name}.xml"


#: Of Sionna RT, each with a place from which something of it is seen, and the yaw there.
_SIONNA: tuple[tuple[str, tuple[float, float, float], float], ...] = (
    ("simple_street_canyon_with_cars", (-30.0, 0.0, 1.5), 0.0),
    ("box", (-3.0, -2.0, 1.3), 30.0),
    ("box_one_screen", (-4.0, 0.5, 1.3), 0.0),
    ("floor_wall", (-1.6, -0.6, 1.0), 15.0),
    ("simple_wedge", (-6.0, -8.0, 1.0), -20.0),
    ("triple_reflector", (-12.0, 0.0, 4.0), 0.0),
)


def of_sionna(rng: np.random.Generator) -> Scene:
    """One of Sionna RT's scenes, seen from near the place that shows something of it."""
    name, place, yaw = _SIONNA[int(rng.integers(len(_SIONNA)))]
    x, y, z = (np.array(place) + rng.uniform(-0.3, 0.3, 3)).tolist()
    return load_scene(sionna_scene(name), Pose((x, y, z), yaw + float(rng.uniform(-10, 10))))


def bundled(rng: np.random.Generator) -> Scene:
    """The street or the test chart of the bundled scenes, from another place."""
    scene = load_scene(str(rng.choice(["street", "fig3a", "yard"])))
    x, y, z = scene.rig.position_m + rng.uniform([-1, -1, 0], [1, 1, 1])
    yaw = scene.rig.pose.yaw_deg + float(rng.uniform(-15, 15))
    return scene.at(Pose((float(x), float(y), float(z)), yaw))


#: Worlds for light, in the order in which numbers of cases go through them.
WORLDS: tuple[Draw, ...] = (
    boxes,
    spheres,
    cylinders,
    terrain,
    room,
    corner,
    imported,
    of_sionna,
    bundled,
)
