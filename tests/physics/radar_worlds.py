"""Small scenes for the radar, shared by its tests."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.radar import load_radar
from twin.radar.propagation.result import Path as RadioPath
from twin.radar.propagation.result import Propagation
from twin.radar.synthesis import Contributions
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, Target
from twin.scene.materials import load_materials
from twin.scene.objects import IN_PLACE

MATERIALS = load_materials(Path(__file__).parents[2] / "scenes" / "materials.toml")
AT_ORIGIN = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
RADAR = load_radar("hybrid-79")
OPTICS = Fidelity(radar="optics")
CARRIER_HZ = 79e9
WAVELENGTH_M = RADAR.ofdm.wavelength_m
#: sqrt(G G) less the losses, on boresight.
GAIN = 100.0 * 10 ** (-6 / 20)

Array = NDArray[np.float64]


def world(*objects: SceneObject, targets: tuple[Target, ...] = (), rig: Rig = AT_ORIGIN) -> Scene:
    sun = Sun(180.0, 30.0, 0.0)
    return Scene("test", Path("test"), "", objects, rig, sun, targets, materials=MATERIALS)


def thing(name: str, vertices, faces, material: str = "metal", **more) -> SceneObject:
    points, corners = np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int32)
    return SceneObject(name, Geometry(points, corners), material, 0.5, **more)


def reshaped(item: SceneObject, vertices_m=None, faces=None) -> SceneObject:
    """The same object with other vertices, in the world, or other faces."""
    vertices = item.vertices_m if vertices_m is None else vertices_m
    geometry = Geometry(vertices, item.geometry.faces if faces is None else faces)
    return replace(item, geometry=geometry, pose=IN_PLACE)


def ball(name: str, center, radius: float = 0.15, level: int = 6, **more) -> SceneObject:
    mesh = trimesh.creation.icosphere(level, radius=radius)
    return thing(name, mesh.vertices + np.asarray(center), mesh.faces, **more)


def quad(name: str, corners, material: str = "metal", **more) -> SceneObject:
    return thing(name, corners, [[0, 1, 2], [0, 2, 3]], material, **more)


def plate(name: str, center, side: float = 0.2, material: str = "metal", **more) -> SceneObject:
    """A square across the x axis."""
    h = side / 2
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]]) + np.asarray(center)
    return quad(name, corners, material, **more)


def ground(z: float, material: str = "metal", **more) -> SceneObject:
    corners = [[-5, -40, z], [75, -40, z], [75, 40, z], [-5, 40, z]]
    return quad("ground", corners, material, **more)


def trihedral(name: str, apex, rcs_m2: float = 10.0, **more) -> SceneObject:
    """Triangular, open towards -x; its cross-section on the axis is 4 pi a^4 / (3 lambda^2)."""
    leg = (3 * WAVELENGTH_M**2 * rcs_m2 / (4 * np.pi)) ** 0.25
    turn = np.radians([90, 210, 330])
    around = np.stack([0 * turn, np.cos(turn), np.sin(turn)], axis=1)
    tips = leg * (np.array([-1, 0, 0]) / np.sqrt(3) + np.sqrt(2 / 3) * around)
    corners = np.vstack([np.zeros(3), tips]) + np.asarray(apex)
    return thing(name, corners, [[0, 1, 2], [0, 2, 3], [0, 3, 1]], **more)


def wave(
    echoes: Contributions, frequency_hz: float = CARRIER_HZ, carrier_hz: float = CARRIER_HZ
) -> complex:
    """Their sum at one frequency, of a radar of that carrier."""
    cycles = frequency_hz * echoes.delay_s % 1.0
    amplitude = echoes.amplitude * (carrier_hz / frequency_hz) ** echoes.falloff
    return complex(np.sum(amplitude * np.exp(-2j * np.pi * cycles)))


def cross_section_db(amplitude: complex, distance_m: float) -> float:
    """By the radar equation, on boresight."""
    scale = (4 * np.pi) ** 1.5 * distance_m**2 / (GAIN * WAVELENGTH_M)
    return float(20 * np.log10(max(abs(amplitude) * scale, 1e-30)))


def paths_of(
    found: Propagation, is_wanted: Callable[[RadioPath], object] = lambda path: True
) -> Contributions:
    """Single paths as contributions, all or some."""
    return found.contributions.take(
        np.array([k for k, path in enumerate(found.paths) if is_wanted(path)], dtype=int)
    )
