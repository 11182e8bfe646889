"""How often errors of bodies' echoes stay within what the solver estimates of them.

Random scenes of conductors, each family of its own kind of trouble; the truth is the sum of
`benchmarks.mirrored_currents`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.mirrored_currents import echoes
from benchmarks.timing import Figure
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.radar import RadarDesign, load_radar
from twin.radar.propagation.facets.convergence import band_of
from twin.radar.propagation.facets.error_budget import WEAKEST
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, Scene, SceneObject, Sun
from twin.scene.materials import load_materials
from twin.trade.bodies import echoes_by_body

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Scenes of every family, by tolerance.
_SCENES = {0.3: 20, 0.1: 50, 0.03: 20}
_SPACING_M = 3.8e-3 / 8
_OF_ESTIMATE = 0.2
_CLOSEST = 4


@dataclass(frozen=True)
class Case:
    """A random scene: bodies, how often they reflect, and the ground that they stand over."""

    objects: tuple[SceneObject, ...]
    bounces: int = 1
    ground: SceneObject | None = None


@dataclass(frozen=True)
class Compared:
    """A body's error over its level, its estimate, and the tolerance asked for."""

    family: str
    seed: int
    body: str
    error: float
    estimate: float
    tolerance: float


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    found = [
        case
        for name in FAMILIES
        for seed in range(max(_SCENES.values()))
        for case in compared(name, seed, tuple(t for t, n in _SCENES.items() if seed < n))
    ]
    for tolerance in _SCENES:
        for family in (*FAMILIES, "all"):
            some = [c for c in found if c.tolerance == tolerance and family in (c.family, "all")]
            error = np.array([c.error for c in some])
            ratio = error / np.array([c.estimate for c in some])
            what = f"{family}, {len(some)} bodies at {tolerance:g}"
            yield f"{what}: within the estimate", 100 * float(np.mean(ratio <= 1)), "%"
            yield f"{what}: error over estimate, median", float(np.median(ratio)), ""
            yield f"{what}: the same, 95 % of bodies", float(np.quantile(ratio, 0.95)), ""
            yield f"{what}: the same, largest", float(ratio.max()), ""
            yield f"{what}: beyond the tolerance", 100 * float(np.mean(error > tolerance)), "%"


def compared(
    family: str, seed: int, tolerances: tuple[float, ...] = tuple(_SCENES)
) -> Iterator[Compared]:
    """Every body of a random scene at every tolerance."""
    case, radar = FAMILIES[family](np.random.default_rng(seed)), load_radar("hybrid-79")
    traced = [body for tolerance in tolerances for body in _traced(case, radar, tolerance)]
    truth = _truth(case, radar, traced)
    for body in traced:
        error = float(_rms(body.echo - truth[body.objects].sum(axis=0)) / body.level)
        yield Compared(family, seed, body.name, error, body.estimate, body.tolerance)


@dataclass(frozen=True, eq=False)
class _Traced:
    """A body as the solver traces it: its ``objects`` by index, its ``echo`` over the band, the
    ``level`` that its error is relative to, the ``estimate`` of that, and the tolerance asked for.
    """

    name: str
    objects: list[int]
    echo: Complex
    level: float
    estimate: float
    tolerance: float


def _traced(case: Case, radar: RadarDesign, tolerance: float) -> Iterator[_Traced]:
    fidelity = Fidelity(radar="optics", radar_tolerance=tolerance, radar_bounces=case.bounces)
    propagation = trace(scene_of(case), radar, fidelity=fidelity)
    members = tuple(body.objects for body in propagation.bodies)
    index = {item.name: i for i, item in enumerate(case.objects)}
    found = echoes_by_body(propagation, members, radar, band_of(radar.ofdm))
    level = _rms(found)
    least = OF_NOISE * noise_amplitude(radar) / tolerance
    least = max(least, WEAKEST * float(level.max(initial=0.0)))
    for body, echo, own in zip(propagation.bodies, found, level, strict=True):
        objects = [index[name] for name in body.objects]
        yield _Traced(
            body.name, objects, echo, max(float(own), least), body.estimated_error, tolerance
        )


def _truth(case: Case, radar: RadarDesign, traced: Sequence[_Traced]) -> Complex:
    """Of every object, by points so close that half their spacing changes no body by more than
    `_OF_ESTIMATE` of what is stated of it, or `_CLOSEST` times as close: points miss a border of a
    shadow by up to their spacing.
    """
    frequencies, closer = band_of(radar.ofdm), 1

    def summed() -> Complex:
        return echoes(
            case.objects,
            radar,
            frequencies,
            case.bounces,
            _SPACING_M / closer,
            case.ground,
            least=4 * closer,
        )

    truth = summed()
    while closer < _CLOSEST:
        closer *= 2
        before, truth = truth, summed()
        off = [
            float(_rms((truth - before)[body.objects].sum(axis=0)) / body.level) / body.estimate
            for body in traced
        ]
        if max(off, default=0.0) <= _OF_ESTIMATE:
            break
    return truth


def scene_of(case: Case) -> Scene:
    """Seen by a radar at the origin that looks along x."""
    return scene_of_objects(case.objects if case.ground is None else (*case.objects, case.ground))


def scene_of_objects(objects: Sequence[SceneObject]) -> Scene:
    """Seen likewise."""
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    materials = load_materials(Path(__file__).parents[1] / "scenes" / "materials.toml")
    return Scene(
        "random", Path("."), "", tuple(objects), rig, Sun(180.0, 30.0, 0.0), (), materials=materials
    )


def _rms(values: Complex) -> Array:
    found: Array = np.sqrt(np.mean(np.abs(values) ** 2, axis=-1))
    return found


def _turned(rng: np.random.Generator, most_deg: float) -> Array:
    """Rotation by up to so much about each axis."""
    found: Array = Rotation.from_euler("xyz", rng.uniform(-most_deg, most_deg, 3), True).as_matrix()
    return found


def _around(rng: np.random.Generator, distances_m: tuple[float, ...], aside: float) -> Array:
    """A place at one of the distances, up to ``aside`` of it off the axis."""
    distance = rng.choice(distances_m)
    return distance * np.array([1.0, *rng.uniform(-aside, aside, 2)])


def thing(name: str, vertices: Array, faces: object) -> SceneObject:
    geometry = Geometry(vertices, np.array(faces, dtype=np.int32))
    return SceneObject(name, geometry, "metal", 0.5, radar="optics")


def _quad(name: str, corners: Array) -> SceneObject:
    return thing(name, corners, [[0, 1, 2], [0, 2, 3]])


def _square(sides_m: Array) -> Array:
    """Corners (4, 3) of a rectangle across the x axis."""
    signs = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    return signs * np.array([0.0, *sides_m]) / 2


def _plates(rng: np.random.Generator) -> Case:
    """Two or three near one another, which shade and mirror each other."""
    count, center = rng.integers(2, 4), _around(rng, (0.6, 2.0, 8.0, 40.0), 0.15)
    found = []
    for i in range(count):
        square = _square(rng.uniform(0.01, 0.05, 2)) @ _turned(rng, 80).T
        found.append(_quad(f"plate {i}", square + center + rng.uniform(-0.03, 0.03, 3)))
    return Case(tuple(found), bounces=2)


def _dihedral(rng: np.random.Generator) -> Case:
    """Two plates with an edge in common, half of them at right angles."""
    first, second, height = rng.uniform(0.02, 0.06, 3)
    half = np.radians(rng.choice([90.0, rng.uniform(70, 110)])) / 2
    turn, center = _turned(rng, 25), _around(rng, (1.0, 3.0, 10.0, 30.0), 0.2)
    up, found = np.array([0, 0, height]), []
    for name, side, length in (("left", 1, first), ("right", -1, second)):
        end = length * np.array([-np.cos(half), side * np.sin(half), 0])
        found.append(_quad(name, np.array([0 * up, end, end + up, up]) @ turn.T + center))
    return Case(tuple(found), bounces=2)


def _corner(rng: np.random.Generator) -> Case:
    """Three triangles at right angles, with legs of different lengths."""
    around = np.radians([90, 210, 330])
    tips = np.stack([0 * around, np.cos(around), np.sin(around)], axis=1) * np.sqrt(2 / 3)
    tips = (tips - [np.sqrt(1 / 3), 0, 0]) * rng.uniform(0.015, 0.045, 3)[:, None]
    vertices = np.vstack([np.zeros(3), tips]) @ _turned(rng, 25).T
    vertices = vertices + _around(rng, (1.0, 4.0, 20.0), 0.15)
    return Case((thing("corner", vertices, [[0, 1, 2], [0, 2, 3], [0, 3, 1]]),), bounces=3)


def _hollow(rng: np.random.Generator) -> Case:
    """Bowl, cup, funnel or half-open box: walls round an opening, with a bottom or not, all of them
    or all but one.
    """
    sides, radius = int(rng.integers(3, 6)), rng.uniform(0.006, 0.015)
    around = 2 * np.pi * np.arange(sides) / sides + rng.uniform(0, 2 * np.pi)
    rim = radius * np.stack([0 * around, np.cos(around), np.sin(around)], axis=1)
    bottom = rim * rng.choice([rng.uniform(0.3, 0.9), 1.0]) + rng.uniform(-0.2, 0.2, 3) * radius
    bottom[:, 0] = radius * rng.uniform(0.4, 1.5)
    walls = np.arange(sides - int(rng.random() < 0.3))
    beside = (walls + 1) % sides
    faces = [
        np.stack([walls, beside, sides + beside], axis=1),
        np.stack([walls, sides + beside, sides + walls], axis=1),
    ]
    if rng.random() < 0.7:
        fan = np.arange(1, sides - 1)
        faces.append(sides + np.stack([0 * fan, fan, fan + 1], axis=1))
    vertices = np.vstack([rim, bottom]) @ _turned(rng, 35).T + _around(rng, (0.7, 1.5, 5.0), 0.15)
    return Case((thing("hollow", vertices, np.vstack(faces)),), bounces=2)


def _box(rng: np.random.Generator) -> Case:
    """A box beside a plate."""
    mesh = trimesh.creation.box(rng.uniform(0.01, 0.04, 3))
    turn, center = _turned(rng, 45), _around(rng, (1.0, 4.0, 20.0), 0.1)
    beside = [rng.uniform(0.0, 0.03), rng.choice([-1, 1]) * rng.uniform(0.03, 0.05)]
    beside.append(rng.uniform(-0.02, 0.02))
    plate = _square(np.full(2, rng.uniform(0.03, 0.06))) @ _turned(rng, 60).T + center + beside
    box = thing("box", mesh.vertices @ turn.T + center, mesh.faces)
    return Case((box, _quad("plate", plate)), bounces=2)


def _ball(rng: np.random.Generator) -> Case:
    """A ball partly in the shadow of a plate."""
    mesh = trimesh.creation.icosphere(2, radius=rng.uniform(0.008, 0.025))
    center = _around(rng, (1.0, 4.0, 20.0), 0.1)
    before = center * rng.uniform(0.6, 0.9) + rng.uniform(-0.02, 0.02, 3)
    plate = _square(rng.uniform(0.01, 0.03, 2)) @ _turned(rng, 40).T + before
    return Case((thing("ball", mesh.vertices + center, mesh.faces), _quad("plate", plate)))


def _near(rng: np.random.Generator) -> Case:
    """A plate no farther away than a few of its sizes, one in four with a bar before it."""
    size = rng.uniform(0.05, 0.3)
    center = size * rng.uniform(0.5, 4) * np.array([1.0, *rng.uniform(-0.3, 0.3, 2)])
    plate = _square(size * rng.uniform(0.3, 1, 2)) @ _turned(rng, 45).T + center
    found = [_quad("plate", plate)]
    if rng.random() < 0.25:
        bar = _square(np.array([0.005, size])) @ _turned(rng, 20).T + 0.6 * center
        found.append(_quad("bar", bar))
    return Case(tuple(found))


def _grounded(rng: np.random.Generator) -> Case:
    """Plates over a ground that mirrors."""
    center, found = np.array([rng.uniform(1.5, 10), 0, 0]), []
    for i in range(2):
        place = center + [rng.uniform(0, 0.5), rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.2)]
        square = _square(rng.uniform(0.02, 0.08, 2)) @ _turned(rng, 80).T
        found.append(_quad(f"plate {i}", square + place))
    plane = np.array([[-5, -40, -0.5], [75, -40, -0.5], [75, 40, -0.5], [-5, 40, -0.5]])
    corners = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    ground = SceneObject("ground", Geometry(plane, corners), "metal", 0.5)
    return Case(tuple(found), ground=ground)


def _needles(rng: np.random.Generator) -> Case:
    """Four triangles of 1 to 60 mm, thin ones among them."""
    center, found = _around(rng, (0.3, 1.0, 5.0, 50.0), 0.15), []
    for i in range(4):
        length = 10 ** rng.uniform(-3, -1.2)
        tip = [0, rng.uniform(-0.5, 1.5) * length, length * 10 ** rng.uniform(-3, 0)]
        corners = np.array([[0, 0, 0], [0, length, 0], tip]) @ _turned(rng, 80).T
        found.append(
            thing(f"needle {i}", corners + center + rng.uniform(-0.02, 0.02, 3), [[0, 1, 2]])
        )
    return Case(tuple(found))


#: Random scenes by name.
FAMILIES: dict[str, Callable[[np.random.Generator], Case]] = {
    "plates": _plates,
    "dihedral": _dihedral,
    "corner": _corner,
    "hollow": _hollow,
    "box": _box,
    "ball": _ball,
    "near": _near,
    "grounded": _grounded,
    "needles": _needles,
}
