"""Cases of the radar: conductors of few facets, and meshes, drawn by a seed; and hard ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.stated_errors.worlds import Array, of_sionna, sionna_scene, square, thing
from twin.radar import RadarDesign, load_radar
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.materials import load_materials
from twin.scene.meshes import read_mesh

_RADAR = 2
_TOLERANCES = (0.05, 0.1, 0.2, 0.5, 1.0)
_SCENES = Path(__file__).parents[2] / "scenes"
#: Of these facets sums of currents take seconds, with reflections at each other.
_CARRIERS_HZ = (10e9, 24e9, 61e9, 77.5e9, 79e9)
_BANDS_HZ = (0.25e9, 1e9, 4e9)
_WIDE_M = 80.0


@dataclass(frozen=True)
class RadarCase:
    """A scene and a radar, and the tolerance of `Tolerance`.

    ``bounces``: of the sums of currents that are the truth, 0 where there are too many facets:
    then the truth is the solver's own at a much finer tolerance, with sampled direct echoes.
    ``ground``: which of the objects only mirrors.
    """

    name: str
    scene: Scene
    radar: RadarDesign
    tolerance: float
    bounces: int = 0
    ground: SceneObject | None = None


@dataclass(frozen=True)
class _Things:
    objects: list[SceneObject]
    bounces: int
    ground: SceneObject | None = None

    @property
    def scene(self) -> Scene:
        """Seen by a radar at the origin that looks along x."""
        objects = [*self.objects, *([self.ground] if self.ground else [])]
        rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
        table = load_materials(_SCENES / "materials.toml")
        sun = Sun(180.0, 30.0, 0.0)
        return Scene("drawn", Path("drawn"), "", tuple(objects), rig, sun, materials=table)


_Draw = Callable[[np.random.Generator, float], _Things | Scene]


def cases(seed: int, count: int, names: Sequence[str] = ()) -> Iterator[RadarCase]:
    """Those made to be hard, then ``count`` drawn by a seed, each the same whatever the count.

    ``names``: parts of the names of those wanted; none: all.
    """
    for name, draw, tolerance, key in _listed(count):
        if not names or any(part in name for part in names):
            rng = np.random.default_rng([seed, _RADAR, key])
            yield _case(name, draw, rng, tolerance or float(rng.choice(_TOLERANCES)))


def names_of_cases(count: int) -> list[str]:
    """Of those that `cases` yields, in their order."""
    return [name for name, *_ in _listed(count)]


def _listed(count: int) -> Iterator[tuple[str, _Draw, float | None, int]]:
    """Name, how it is drawn, tolerance, and key of its random numbers, of each case."""
    for i, (draw, tolerance) in enumerate(_HARD):
        yield draw.__name__.replace("_", " "), draw, tolerance, 10**6 + i
    for i in range(count):
        draw = _DRAWN[i % len(_DRAWN)]
        yield f"{i} {draw.__name__}", draw, None, i


def _case(
    name: str,
    draw: _Draw,
    rng: np.random.Generator,
    tolerance: float,
) -> RadarCase:
    radar = _radar(rng, draw not in _DRAWN_79)
    made = draw(rng, radar.ofdm.wavelength_m)
    if isinstance(made, Scene):
        return RadarCase(name, made, radar, tolerance)
    return RadarCase(name, made.scene, radar, tolerance, made.bounces, made.ground)


def _radar(rng: np.random.Generator, any_carrier: bool) -> RadarDesign:
    """Any carrier (of the bundled meshes' materials only one is known), band, gain and power."""
    carrier = float(rng.choice(_CARRIERS_HZ)) if any_carrier else 79e9
    band, subcarriers = float(rng.choice(_BANDS_HZ)), int(rng.choice([256, 1024, 4096]))
    return load_radar("hybrid-79").with_(
        {
            "waveform.carrier_hz": carrier,
            "waveform.n_subcarriers": subcarriers,
            "waveform.subcarrier_spacing_hz": band / subcarriers,
            "waveform.n_slots": 16,
            "waveform.repeats": 1,
            "waveform.slot_period_s": 1e-3,
            "waveform.prefix_s": subcarriers / band,
            "front_end.transmit_power_w": float(10 ** rng.uniform(-3, -1)),
            "antenna.gain_dbi": float(rng.choice([10.0, 16.0, 20.0, 24.0])),
        }
    )


def _metal(name: str, mesh: trimesh.Trimesh, at: Array | None = None) -> SceneObject:
    return thing(name, mesh, 0.5, at, material="metal", radar="optics")


def _place(rng: np.random.Generator, nearest_m: float = 1.0, farthest_m: float = 60.0) -> Array:
    away = np.exp(rng.uniform(np.log(nearest_m), np.log(farthest_m)))
    found: Array = away * np.array([1.0, *rng.uniform(-0.15, 0.15, 2)])
    return found


def _facing(rng: np.random.Generator, most: float) -> Array:
    return np.array([-1.0, *rng.uniform(-most, most, 2)])


def _tumbled(rng: np.random.Generator, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    return mesh


def scattered_plates(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Squares of 2 to 20 wavelengths far from each other, at any angle."""
    found = []
    for i in range(rng.integers(1, 5)):
        half = wavelength_m * np.exp(rng.uniform(0, np.log(10)))
        found.append(_metal(f"plate {i}", square(_place(rng), _facing(rng, 1.0), half)))
    return _Things(found, 3)


def close_plates(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Three squares within some of their sizes, which shade and light each other."""
    center, found = _place(rng), []
    for i in range(3):
        half = wavelength_m * rng.uniform(1.5, 6)
        at = center + rng.uniform(-8, 8, 3) * wavelength_m
        found.append(_metal(f"plate {i}", square(at, _facing(rng, 1.5), half)))
    return _Things(found, 5)


def block(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """A box alone."""
    mesh = _tumbled(rng, trimesh.creation.box(wavelength_m * rng.uniform(2, 12, 3)))
    return _Things([_metal("block", mesh, _place(rng))], 1)


def prism_and_plate(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """A post of three to five sides before a plate."""
    center = _place(rng)
    mesh = trimesh.creation.cylinder(
        wavelength_m * rng.uniform(1, 3), wavelength_m * rng.uniform(4, 12), int(rng.integers(3, 6))
    )
    behind = center * 1.0 + np.array([wavelength_m * rng.uniform(8, 15), 0, 0])
    plate = square(behind, _facing(rng, 0.6), wavelength_m * rng.uniform(3, 8))
    return _Things([_metal("post", mesh, center), _metal("plate", plate)], 3)


def pyramids(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Two tetrahedra of any shape."""
    found, center = [], _place(rng)
    for i in range(2):
        points = wavelength_m * rng.normal(size=(4, 3)) * 4
        mesh = trimesh.Trimesh(points, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
        at = center + rng.uniform(-10, 10, 3) * wavelength_m
        found.append(_metal(f"pyramid {i}", mesh, at))
    return _Things(found, 3)


def trihedral(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Three triangles at nearly right angles, legs of 5 to 15 wavelengths."""
    legs = wavelength_m * rng.uniform(5, 15, 3)
    tips = legs[:, None] * np.array([[-1.0, 1, 1], [-1, -1, 1], [-1, 0, -2]])
    tips /= np.array([3, 3, 5])[:, None] ** 0.5
    corners = np.vstack([np.zeros(3), tips])
    turned = trimesh.transformations.euler_matrix(*rng.uniform(-0.4, 0.4, 3))[:3, :3]
    mesh = trimesh.Trimesh(corners @ turned.T, [[0, 1, 2], [0, 2, 3], [0, 3, 1]], process=False)
    return _Things([_metal("trihedral", mesh, _place(rng))], 5)


def over_ground(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Two plates over a ground that mirrors, as high as the radar or lower."""
    made = close_plates(rng, wavelength_m)
    low = min(float(o.vertices_m[:, 2].min()) for o in made.objects)
    height = max(-low, 0.0) + rng.uniform(0.1, 1.0)
    floor = square(np.array([0, 0, -height]), np.array([0, 0, 1.0]), _WIDE_M)
    return _Things(made.objects[:2], 5, thing("ground", floor, 0.5, material="metal"))


def small_ball(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """A sphere of 80 to 1280 facets, alone or with one behind it."""
    found = []
    for i in range(rng.integers(1, 3)):
        mesh = trimesh.creation.icosphere(int(rng.integers(1, 4)), wavelength_m * rng.uniform(2, 8))
        found.append(_metal(f"ball {i}", mesh, _place(rng, 1.0, 15.0)))
    return _Things(found, 0).scene


def meshes(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """Person or wheels on asphalt."""
    body = read_mesh(_SCENES / "bodies" / str(rng.choice(["person.ply", "car_wheels.ply"])))
    mesh = trimesh.Trimesh(body.vertices_m, body.faces, process=False)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0, 6.3), [0, 0, 1]))
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2] - 1.0 + 1e-3])
    at = rng.uniform(6, 20) * np.array([1.0, rng.uniform(-0.2, 0.2), 0])
    floor = square(np.array([0, 0, -1.0]), np.array([0, 0, 1.0]), _WIDE_M)
    floor = thing("ground", floor, 0.14, material="asphalt")
    body = thing("body", mesh, 0.5, at, material="metal", radar="optics")
    return _Things([body, floor], 0).scene


def sionna(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """A ball in one of Sionna RT's small scenes, whose walls only mirror."""
    return _with_ball(rng, of_sionna(rng), wavelength_m)


def _with_ball(rng: np.random.Generator, scene: Scene, wavelength_m: float) -> Scene:
    """The scene with a ball before the radar."""
    turned = scene.rig.pose.rotation
    at = turned.apply([rng.uniform(1.2, 2.5), *rng.uniform(-0.3, 0.3, 2)]) + scene.rig.position_m
    mesh = trimesh.creation.icosphere(2, wavelength_m * rng.uniform(3, 10))
    ball = _metal("ball", mesh, at)
    materials = {**scene.materials, **load_materials(_SCENES / "materials.toml")}
    return replace(scene, objects=(*scene.objects, ball), materials=materials)


def part_of_munich(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """Houses of Munich's centre within some 60 m, and a ball."""
    whole = load_scene(sionna_scene("munich"))
    place = whole.rig.position_m + [0, 0, 0.5]
    near = [
        o
        for o in whole.objects
        if np.linalg.norm(np.clip(place, *o.box_m) - place) < 60 or o.name.endswith("ground")
    ]
    x, y, z = place.tolist()
    yaw = whole.rig.pose.yaw_deg + float(rng.uniform(-90, 90))
    scene = Scene(
        "munich", whole.path, "", tuple(near), whole.rig, whole.sun, materials=whole.materials
    )
    return _with_ball(rng, scene.at(Pose((x, y, z), yaw)), wavelength_m)


def strong_beside_weak(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """A large plate that faces the radar, and a triangle of two wavelengths beside it."""
    away = np.array([rng.uniform(8, 20), 0, 0])
    large = square(away, np.array([-1.0, 0, 0]), 20 * wavelength_m)
    small = wavelength_m * np.array([[0, 0, 0], [0, 2, 0], [0.5, 0.3, 2.0]])
    beside = away + np.array([-2.0, 35 * wavelength_m, 0])
    tip = trimesh.Trimesh(small + beside, [[0, 1, 2]], process=False)
    return _Things([_metal("large", large), _metal("small", tip)], 3)


def two_mirrors(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Two parallel plates, between which waves go to and fro."""
    away, gap = rng.uniform(3, 10), wavelength_m * rng.uniform(5, 9)
    turn = np.array([-0.5, 1.0, 0]) / np.hypot(0.5, 1.0)
    center = np.array([away, 0, 0])
    return _Things(
        [
            _metal(f"plate {i}", square(center + s * gap * turn / 2, turn, 6 * wavelength_m))
            for i, s in enumerate((-1, 1))
        ],
        6,
    )


def keyhole(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """A plate behind a screen with a square hole of four wavelengths."""
    away = rng.uniform(2, 6)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    flat = np.vstack([12 * wavelength_m * signs, 2 * wavelength_m * signs])
    points = np.column_stack([np.full(8, away), flat])
    points[:, 0] += 0.3 * points[:, 1]  # turned, so that it does not flash
    faces = [f for i in range(4) for j in [(i + 1) % 4] for f in ([i, j, 4 + j], [i, 4 + j, 4 + i])]
    screen = trimesh.Trimesh(points, faces, process=False)
    behind = np.array([away * 1.2, 0, 0])
    plate = square(behind, np.array([-1.0, 0.02, 0.03]), 4 * wavelength_m)
    return _Things([_metal("screen", screen), _metal("plate", plate)], 3)


def grazing_floor(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """A plate far away over a mirroring ground right below the radar."""
    floor = square(np.array([0, 0, -0.2]), np.array([0, 0, 1.0]), _WIDE_M)
    at = np.array([rng.uniform(15, 40), 0, 0.0])
    plate = square(at, np.array([-1.0, 0.01, 0.02]), min(15 * wavelength_m, 0.15))
    return _Things([_metal("plate", plate)], 1, thing("ground", floor, 0.5, material="metal"))


def closed_room(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """A ball in Sionna RT's metal box."""
    place = Pose((-4.0, 0.4, 1.3), float(rng.uniform(-20, 20)))
    return _with_ball(rng, load_scene(sionna_scene("box"), place), wavelength_m)


def hundreds_of_posts(rng: np.random.Generator, wavelength_m: float) -> Scene:
    """Square posts of three wavelengths, many of them in the shadow of others."""
    found = []
    for i in range(200):
        mesh = trimesh.creation.box(wavelength_m * np.array([3, 3, 30]))
        mesh.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0, 3), [0, 0, 1]))
        away = rng.uniform(3, 20)
        found.append(_metal(f"post {i}", mesh, away * np.array([1, rng.uniform(-0.4, 0.4), 0])))
    return _Things(found, 0).scene


def tiny_facing_facet(rng: np.random.Generator, wavelength_m: float) -> _Things:
    """Four wavelengths that face the radar among plates that mirror it away."""
    away = np.array([rng.uniform(3, 9), 0, 0])
    found = [_metal("facet", square(away, np.array([-1.0, 0, 0]), 2 * wavelength_m))]
    for i, side in enumerate((-1, 1)):
        at = away + np.array([0.05, side * 15 * wavelength_m, 0])
        found.append(_metal(f"plate {i}", square(at, _facing(rng, 1.0), 10 * wavelength_m)))
    return _Things(found, 3)


_DRAWN: tuple[_Draw, ...] = (
    scattered_plates,
    close_plates,
    block,
    prism_and_plate,
    pyramids,
    trihedral,
    over_ground,
    small_ball,
    meshes,
    sionna,
)
_DRAWN_79 = (meshes, sionna, part_of_munich, closed_room)
_HARD: tuple[tuple[_Draw, float], ...] = (
    (strong_beside_weak, 0.2),
    (two_mirrors, 0.2),
    (keyhole, 0.2),
    (grazing_floor, 0.1),
    (closed_room, 0.5),
    (hundreds_of_posts, 0.5),
    (tiny_facing_facet, 0.1),
    (part_of_munich, 0.5),
)
