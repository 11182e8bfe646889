"""Obstacles before a point, and its echo over what it is without them."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    paths_of,
    quad,
    thing,
    wave,
    world,
)
from twin.fidelity import Fidelity
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject, Target

DEEP = OPTICS.with_(radar_shadow_db=60.0)
K = 2 * np.pi / WAVELENGTH_M
#: Of a screen 6 m off and a target 10 m off: phase over height squared.
BEND = K / 2 * (1 / 6 + 1 / 4)

Array = NDArray[np.float64]


def point(place=(10.0, 0.0, 0.0), **more) -> Target:
    return Target("point", place, more.get("velocity", (0.0, 0.0, 0.0)), 1.0, "test")


def rectangle(name: str, y: tuple[float, float], z: tuple[float, float], x: float = 6.0, **more):
    corners = [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]]
    return quad(name, corners, radar="obstacle", **more)


def screen(height: float, **more) -> SceneObject:
    """Half a plane 6 m off, up to a height over the line of sight."""
    return rectangle("screen", (-50, 50), (-50, height), **more)


def box(low, high, **more) -> SceneObject:
    mesh = trimesh.creation.box(bounds=[low, high])
    return thing("box", mesh.vertices, mesh.faces, radar="obstacle", **more)


def found(*objects: SceneObject, at: Target | None = None, fidelity: Fidelity = DEEP, **more):
    scene = world(*objects, targets=(at or point(),), **more)
    return paths_of(trace(scene, RADAR, fidelity=fidelity))


def echo(*objects: SceneObject, frequency_hz: float = CARRIER_HZ, **more) -> complex:
    """Of a point target, over what it is without the obstacles."""
    at = more.get("at")
    with_them = wave(found(*objects, **more), frequency_hz)
    return with_them / wave(found(at=at), frequency_hz)


def pattern(height: float, distance: float = 6.0) -> float:
    """The antenna's gain towards an edge over that on boresight, amplitude there and back."""
    way = np.array([[distance, 0, height], [1, 0, 0]])
    gain = RADAR.antenna.gain(way / np.linalg.norm(way, axis=1, keepdims=True))
    return float(gain[0] / gain[1])


def decibels(value: complex) -> float:
    return float(20 * np.log10(max(abs(value), 1e-12)))
