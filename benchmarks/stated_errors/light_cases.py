"""Cases of light: worlds and systems drawn by a seed, and those made to be hard."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from benchmarks.stated_errors.worlds import WORLDS, Array, Draw, square, thing, world
from twin.scene import Pose, Scene, SceneObject
from twin.system import System, load_system

#: Keys of draws: light and radar have numbers of their own.
_LIGHT = 1
_BLURRED = 1 / 3  # of the emitters
_TOLERANCES = (0.05, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True)
class LightCase:
    """A scene, a system, and the tolerance asked for, as a share of the sensor's noise.

    ``light_over_noise``: of the image, root mean square over its cells; the emitter's power is set
    so, since most systems drawn blindly see nothing, or nothing but light.
    """

    name: str
    scene: Scene
    system: System
    tolerance: float
    light_over_noise: float
    seed: int


def cases(seed: int, count: int, names: Sequence[str] = ()) -> Iterator[LightCase]:
    """Those made to be hard, then ``count`` drawn by a seed, each the same whatever the count.

    ``names``: parts of the names of those wanted; none: all.
    """
    for name, draw, tolerance, key in _listed(count):
        if not names or any(part in name for part in names):
            rng = np.random.default_rng([seed, _LIGHT, key])
            yield _case(name, draw, rng, tolerance or float(rng.choice(_TOLERANCES)))


def names_of_cases(count: int) -> list[str]:
    """Of those that `cases` yields, in their order."""
    return [name for name, *_ in _listed(count)]


def _listed(count: int) -> Iterator[tuple[str, Draw, float | None, int]]:
    """Name, how it is drawn, tolerance, and key of its random numbers, of each case."""
    for i, (draw, tolerance) in enumerate(_HARD):
        yield draw.__name__.replace("_", " "), draw, tolerance, 10**6 + i
    for i in range(count):
        draw = WORLDS[i % len(WORLDS)]
        yield f"{i} {draw.__name__}", draw, None, i


def _case(name: str, draw: Draw, rng: np.random.Generator, tolerance: float) -> LightCase:
    system, scene = _system(rng), draw(rng)
    ratio = float(10 ** rng.uniform(-0.5, 2.0))
    return LightCase(name, scene, system, tolerance, ratio, int(rng.integers(2**31)))


def _system(rng: np.random.Generator) -> System:
    """Any grid, field, lens, detector, converter and sky; a third of the emitters blur."""
    side = int(rng.choice([16, 32, 64]))
    field = float(rng.choice([8.0, 20.0, 40.0, 70.0]))
    blurred = bool(rng.random() < _BLURRED)
    blur_deg = float(rng.uniform(0.2, 1.0)) * field / side
    return load_system("workable").with_(
        {
            "emitter.rows": side,
            "emitter.columns": side,
            "acquisition.n_patterns": side * side,
            "emitter.field_of_view_deg": field,
            "optics.field_of_view_deg": field,
            "optics.f_number": float(rng.choice([0.8, 1.0, 2.0, 4.0])),
            "detector.width_m": float(rng.choice([0.3e-3, 1e-3, 3e-3])),
            "readout.adc_bits": int(rng.integers(12, 21)),
            "acquisition.integration_time_s": float(rng.choice([10e-6, 40e-6, 80e-6])),
            "sky.illuminance_lx": float(10 ** rng.uniform(0, 4.5)),
            **({"emitter.blur_rms_deg": blur_deg} if blurred else {}),
        }
    )


def _wall(reflectance: float, at_m: float = 12.0) -> SceneObject:
    facing = square(np.array([at_m, 0, 1.0]), np.array([-1.0, 0, 0]), 20.0)
    return thing("wall", facing, reflectance)


def tiny_bright_facet(rng: np.random.Generator) -> Scene:
    """6 mm of white at 4 m before a dark wall."""
    at = np.array([4.0, *rng.uniform(-0.2, 0.2, 2)]) + [0, 0, 1.0]
    return world([_wall(0.02), thing("facet", square(at, np.array([-1.0, 0, 0]), 3e-3), 1.0)])


def closed_white_room(rng: np.random.Generator) -> Scene:
    """Nineteen of twenty photons survive each bounce."""
    walls = trimesh.creation.box(rng.uniform([4, 4, 2.5], [7, 7, 4]))
    walls.invert()
    return world([thing("room", walls, 0.95, np.array([1.2, 0.1, 1.2]))])


def grazing_floor(rng: np.random.Generator) -> Scene:
    """Floor alone, seen along it from 5 cm above."""
    floor = square(np.zeros(3), np.array([0, 0, 1.0]), 80.0)
    return world([thing("floor", floor, float(rng.uniform(0.2, 0.8)))], Pose((0.0, 0.0, 0.05)))


def keyhole(rng: np.random.Generator) -> Scene:
    """A white box behind a screen with a hole of 3 cm."""
    y, z = rng.uniform(-0.2, 0.2, 2)
    half = 0.015
    outer = [(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)]
    inner = [(y - half, z - half), (y + half, z - half), (y + half, z + half), (y - half, z + half)]
    points = np.array([[3.0, a, 1.0 + b] for a, b in outer + inner])
    faces = [f for i in range(4) for f in _strip(i, (i + 1) % 4)]
    screen = trimesh.Trimesh(points, faces, process=False)
    inside = trimesh.creation.box([3.0, 5.0, 5.0])
    inside.invert()
    inside = trimesh.Trimesh(inside.vertices, _without_front(inside), process=False)
    behind = thing("box", inside, 0.9, np.array([4.52, 0, 1.0]))
    return world([thing("screen", screen, 0.05), behind])


def _strip(i: int, j: int) -> list[list[int]]:
    return [[i, j, 4 + j], [i, 4 + j, 4 + i]]


def _without_front(box: trimesh.Trimesh) -> Array:
    """Facets of a box but those towards -x."""
    faces: Array = box.faces[box.triangles_center[:, 0] > box.bounds[0, 0] + 1e-6]
    return faces


def two_mirrors(rng: np.random.Generator) -> Scene:
    """Two white walls face each other across a gap that the rig looks into."""
    gap = rng.uniform(0.5, 1.5)
    left, right = (
        thing(f"wall {i}", square(np.array([8.0, s * gap, 1.0]), np.array([0, s, 0.0]), 5.0), 0.97)
        for i, s in enumerate((1.0, -1.0))
    )
    return world([left, right, _wall(0.05, 14.0)])


def thousand_posts(rng: np.random.Generator) -> Scene:
    """A thousand posts of 1 cm before the ground, each 1 to 20 m away."""
    found = [thing("floor", square(np.zeros(3), np.array([0, 0, 1.0]), 60.0), 0.1)]
    for i in range(1000):
        away = 2.0 + 20.0 * np.sqrt(rng.random())
        mesh = trimesh.creation.box([0.01, 0.01, 1.5])
        at = away * np.array([1, rng.uniform(-0.4, 0.4), 0]) + [0, 0, 0.76]
        found.append(thing(f"post {i}", mesh, 0.8, at))
    return world(found)


def strong_beside_weak(rng: np.random.Generator) -> Scene:
    """A white board at 1.5 m beside a dark wall at 40 m."""
    board = square(np.array([1.5, 0.35, 1.0]), np.array([-1.0, 0, 0]), 0.25)
    return world([_wall(float(rng.uniform(0.02, 0.05)), 40.0), thing("board", board, 1.0)])


_HARD: tuple[tuple[Draw, float], ...] = (
    (tiny_bright_facet, 0.1),
    (closed_white_room, 0.2),
    (grazing_floor, 0.1),
    (keyhole, 0.2),
    (two_mirrors, 0.1),
    (thousand_posts, 0.5),
    (strong_beside_weak, 0.2),
)
