"""Echoes round obstacles: what the solver states as their error, and what it is.

In random scenes, boxes and balls behind a rectangular screen, a fence of many posts, a sheet with
four corners in the air or a flat shape with corners near the line of sight, the truth is
Kirchhoff's field by brute force (`benchmarks.kirchhoff`), at three frequencies; behind two screens,
one behind the other, it is Kirchhoff's double integral (`benchmarks.screens_in_depth`); over a
ground it is his field from the radar and from its image (`benchmarks.kirchhoff_over_ground`), also
behind screens that hide a body on all ways. On the yard and the street it are cells of half the
size, of which none is left out, and shadows followed to 45 dB: the solver itself, finer, which says
less. Bodies that stand alone are left out.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import chain

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from benchmarks.kirchhoff import echo_behind, field_behind, interpolated
from benchmarks.kirchhoff_over_ground import OverGround
from benchmarks.radar_estimates import scene_of_objects, thing
from benchmarks.screens_in_depth import Rectangle, field_around
from benchmarks.timing import Figure
from twin.fidelity import DEFAULT
from twin.radar import RadarDesign, load_radar
from twin.radar.propagation.diffraction.behind_obstacles import Accepted, echoes_behind
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.effects_by_bounds import MOST_SHADOWED
from twin.radar.propagation.facets.convergence import band_of, label_of, summed_by
from twin.radar.propagation.facets.error_budget import WEAKEST
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.physical_optics import at_antenna, followed_everywhere, loss_of
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.radar.synthesis.joined import Resolution
from twin.scene import Scene, SceneObject, load_scene

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Field = Callable[[Array], Complex]

_RANDOM = 24  # scenes
_KINDS = ("layers", "corner", "random", "cross", "jut", "slit")  # of two screens
_OF_A_KIND = 20
_FENCES = 24
_SHEETS = 40
#: Flat shapes with corners, of rectangles.
_SHAPES = {
    "ell": ("#.", "##"),
    "tee": ("###", ".#."),
    "ring": ("###", "#.#", "###"),
    "comb": ("#.#.#", "#####"),
    "slit": ("#.#",),
    "cross": (".#.", "###", ".#."),
}
_OF_A_SHAPE = 10
_FEW = 8  # rectangles in a plane
_OVER_GROUND = 40
_HIDDEN = 40
_FINE_DB, _FINENESS, _MANY = 45.0, 0.5, 30_000
_NOTHING = 1e-9  # of a body's level
_PERMITTED = 0.01  # of a body's level: a tenth of the tolerance
_BETWEEN_M = 2.5e-3  # places between which the field behind a plane is interpolated
_WAVELENGTH_M = speed_of_light / 79e9
_OFFSETS_HZ = np.array([-1.5e9, 0.0, 1.5e9])  # from the carrier


@dataclass(frozen=True)
class Compared:
    """A body's echo round obstacles, relative to its level: how much of it there is, the error that
    is stated, and the true one.
    """

    scene: str
    body: str
    change: float
    stated: float
    true: float


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    radar = load_radar("hybrid-79")

    def by_brute_force(scenes: dict[str, Scene]) -> Iterator[Compared]:
        return chain.from_iterable(
            against_brute_force(name, scene, radar) for name, scene in scenes.items()
        )

    random = [random_scene(np.random.default_rng(seed)) for seed in range(_RANDOM)]
    named = {f"random {seed}": scene for seed, scene in enumerate(random)}
    yield from _told("by brute force", by_brute_force(named))
    named = {f"fence {seed}": behind_fence(seed) for seed in range(_FENCES)}
    yield from _told("by brute force, fences", by_brute_force(named))
    named = {f"sheet {seed}": beside_sheet(seed) for seed in range(_SHEETS)}
    yield from _told("by brute force, sheets", by_brute_force(named))
    named = {
        f"{kind} {seed}": beside_shape(kind, seed)
        for kind in _SHAPES
        for seed in range(_OF_A_SHAPE)
    }
    yield from _told("by brute force, shapes", by_brute_force(named))
    two = {f"{kind} {seed}": kind for kind in _KINDS for seed in range(_OF_A_KIND)}
    named = {name: behind_two_screens(kind, int(name.split()[1])) for name, kind in two.items()}
    yield from _told("by the double integral", by_brute_force(named))
    over = {f"over ground {seed}": OverGround.random(seed) for seed in range(_OVER_GROUND)}
    by_images = chain.from_iterable(
        against_images(name, case, radar) for name, case in over.items()
    )
    yield from _told("by images", by_images)
    hidden = {f"hidden {seed}": OverGround.hidden(seed) for seed in range(_HIDDEN)}
    by_images = chain.from_iterable(
        against_images(name, case, sensitive_radar()) for name, case in hidden.items()
    )
    yield from _told("by images, hidden on all ways", by_images)
    named = {name: load_scene(name) for name in ("street", "yard")}
    finer = chain.from_iterable(
        against_finer_cells(name, scene, radar) for name, scene in named.items()
    )
    yield from _told("by finer cells", finer)


def sensitive_radar() -> RadarDesign:
    """One that hears the faint echoes of hidden bodies, and whose gain is the same towards an edge
    and along the straight way, which the truth takes it at.
    """
    more = {"antenna.gain_dbi": 3.0103, "front_end.transmit_power_w": 40.0}
    return load_radar("hybrid-79").with_(more)


def _told(truth: str, compared: Iterator[Compared]) -> Iterator[Figure]:
    found = []
    for one in compared:
        found.append(one)
        what = f"{one.scene}, {one.body}: round obstacles"
        yield f"{what}, of the echo", 100 * one.change, "%"
        yield f"{what}, stated error", 100 * one.stated, "%"
        yield f"{what}, true error {truth}", 100 * one.true, "%"
    ratio = np.array([one.true / one.stated for one in found])
    yield f"bodies, {truth}", float(len(found)), ""
    yield f"within what is stated, {truth}", 100 * float(np.mean(ratio <= 1)), "%"
    yield f"true error over stated, worst, {truth}", float(ratio.max()), ""
    median = float(np.median(1 / np.maximum(ratio, 1e-6)))
    yield f"stated error over true, median, {truth}", median, ""


@dataclass(frozen=True, eq=False)
class _Solved:
    """A scene with the levels of its bodies, (n_bodies,), 0 of those without an echo of their own,
    and those that errors are relative to.
    """

    prepared: PreparedScene
    radar: RadarDesign
    body: NDArray[np.int32]
    names: list[tuple[str, ...]]
    own: Array
    level: Array

    @staticmethod
    def of(scene: Scene, radar: RadarDesign) -> "_Solved":
        found = trace(scene, radar, fidelity=DEFAULT.with_(radar_edges=0, radar_shadowed=0))
        prepared = prepare_scene(scene, radar, found.roles, 0)
        body = _bodies(prepared)
        names = [
            tuple(prepared.items[i].name for i in np.flatnonzero(body == number))
            for number in range(int(body.max()) + 1)
        ]
        levels = {echo.objects: echo.level_amplitude for echo in found.bodies}
        own = np.array([levels.get(objects, 0.0) for objects in names])
        level = np.maximum(own, WEAKEST * own.max())
        return _Solved(prepared, radar, body, names, own, level)

    def gain(self, directions: Array) -> Array:
        both: Array = self.radar.antenna.gain(directions @ self.prepared.axes.T)
        return both

    def echoes(
        self, everywhere: float, permitted: float, most: int, fineness: float, depth_db: float
    ) -> tuple[Contributions, Array]:
        """Round obstacles, and the errors stated of them, (n_bodies,), in amplitude."""
        obstacles = screens(self.prepared, depth_db, self.body)
        assert obstacles is not None
        limit = permitted * self.level / loss_of(self.radar)
        resolution = Resolution.of(self.radar)
        accepted = Accepted(limit, most, fineness, everywhere, resolution)
        bodies = np.arange(len(self.names))
        surface = self.prepared.surface_of_object
        found = echoes_behind(obstacles, surface, bodies, [], self.gain, accepted)
        echoes = at_antenna(found.contributions, self.prepared, self.radar)
        return echoes, found.left_out * loss_of(self.radar)

    def by_default(self) -> tuple[Contributions, Array]:
        """The same as a user gets it."""
        everywhere, deepest_db = followed_everywhere(DEFAULT), DEFAULT.radar_shadow_db
        return self.echoes(everywhere, _PERMITTED, MOST_SHADOWED, 1.0, deepest_db)

    def over_band(self, echoes: Contributions, frequencies_hz: Array) -> Complex:
        """Of each body, (n_bodies, n_frequencies)."""
        owner, count = self.body[echoes.object], len(self.names)
        return summed_by(owner, count, echoes, self.radar.ofdm.carrier_hz, frequencies_hz)


def against_finer_cells(name: str, scene: Scene, radar: RadarDesign) -> Iterator[Compared]:
    """Every body of a scene that stands beside or behind anything."""
    solved = _Solved.of(scene, radar)
    band = band_of(radar.ofdm)
    told, stated = solved.by_default()
    finer, _ = solved.echoes(0.0, _NOTHING, _MANY, _FINENESS, _FINE_DB)
    echo, truth = (solved.over_band(echoes, band) for echoes in (told, finer))
    for k in np.flatnonzero((solved.own > 0) & (stated > 0)):
        yield Compared(
            name,
            label_of(solved.names[k]),
            float(_rms(truth[k]) / solved.level[k]),
            float(stated[k] / solved.level[k]),
            float(_rms(echo[k] - truth[k]) / solved.level[k]),
        )


def against_brute_force(name: str, scene: Scene, radar: RadarDesign) -> Iterator[Compared]:
    """The body of a random scene, unless its echo comes round the screens alone."""
    solved = _Solved.of(scene, radar)
    body, *obstacles = scene.objects
    k = next(number for number, names in enumerate(solved.names) if names == (body.name,))
    if solved.own[k] == 0:
        return
    told, stated = solved.by_default()
    screens = [corners for item in obstacles for corners in _rectangles(item)]
    is_deep = np.ptp([corners[:, 0] for corners in screens]) > 0
    frequencies_hz = radar.ofdm.carrier_hz + (np.zeros(1) if is_deep else _OFFSETS_HZ)
    echo = solved.over_band(told, frequencies_hz)
    truth = []
    for wavenumber in (2 * np.pi * frequencies_hz / speed_of_light).tolist():
        field_at = (_behind_both if is_deep else _behind_plane)(body, screens, wavenumber)
        wave = echo_behind(body, screens, wavenumber, solved.gain, field_at=field_at)
        truth.append(_over_integral(radar) * (wave.whole - wave.lit))
    yield Compared(
        name,
        body.name,
        float(_rms(np.array(truth)) / solved.level[k]),
        float(stated[k] / solved.level[k]),
        float(_rms(echo[k] - truth) / solved.level[k]),
    )


def against_images(name: str, case: OverGround, radar: RadarDesign) -> Iterator[Compared]:
    """The body behind a screen over a ground, direct and over it; relative to what the solver tells
    by each pair of the radar and its image where no screen stands.
    """
    solver = DEFAULT.with_(radar_edges=0)
    free, behind = (
        trace(scene_of_objects(case.objects[:count]), radar, fidelity=solver) for count in (2, 3)
    )
    told, change, error = next(b for b in behind.bodies if b.objects == (case.body.name,)), 0j, 0j
    carrier_hz = radar.ofdm.carrier_hz
    due = case.echoes(2 * np.pi * carrier_hz / speed_of_light, radar.antenna.gain)
    for pair, echo in due.items():
        of_metal = _by_images(free, case.body.name, pair, carrier_hz) / echo.free
        change += of_metal * (echo.whole - echo.lit)
        error += _by_images(behind, case.body.name, pair, carrier_hz) - of_metal * echo.whole
    level = told.level_amplitude
    yield Compared(
        name, case.body.name, abs(change) / level, told.estimated_error, abs(error) / level
    )


def _by_images(found: Propagation, name: str, pair: tuple[int, int], carrier_hz: float) -> complex:
    """Single reflections at an object by two images of the radar, both ways."""
    echoes = found.contributions
    images = np.sort(np.stack([echoes.source, echoes.receiver]), axis=0)
    own = (echoes.object == found.objects.index(name)) & (echoes.bounces <= 1)
    some = echoes.take(np.flatnonzero(own & (images[0] == pair[0]) & (images[1] == pair[1])))
    return complex(np.sum(some.amplitude * np.exp(-2j * np.pi * (carrier_hz * some.delay_s % 1))))


def _rectangles(item: SceneObject) -> Array:
    """Corners (n, 4, 3) of the rectangles that an obstacle is made of, two faces each."""
    corners = item.vertices_m[item.geometry.faces].reshape(-1, 6, 3)
    return np.asarray(corners[:, [0, 1, 2, 5]])


def _behind_both(body: SceneObject, screens: list[Array], wavenumber: float) -> Field:
    """The field at places on a body, by Kirchhoff's integral over the planes of both."""
    rectangles: list[Rectangle] = [
        (float(s[0, 0]), (s[0, 1], s[2, 1]), (s[0, 2], s[2, 2])) for s in screens
    ]
    return field_around(rectangles, *_around(body), wavenumber)


def _behind_plane(body: SceneObject, screens: list[Array], wavenumber: float) -> Field:
    """Behind screens in one plane, by Babinet's principle."""

    def field(places: Array) -> Complex:
        return 1 - sum((1 - field_behind(s, places, wavenumber) for s in screens), start=0j)

    center, half_m = _around(body)
    across = int(2 * half_m / _BETWEEN_M)
    # Along the posts of a fence, which are many, the field changes slowly.
    return interpolated(
        field, center, half_m, (5, across, 17 if len(screens) > _FEW else max(across, 17))
    )


def _around(body: SceneObject) -> tuple[Array, float]:
    low, high = body.vertices_m.min(axis=0), body.vertices_m.max(axis=0)
    return (low + high) / 2, 0.6 * float(np.linalg.norm(high - low))


@cache
def _over_integral(radar: RadarDesign) -> complex:
    """The solver's echo of a cube over its integral: what the radar's amplitudes are relative
    to.
    """
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    cube = thing("cube", mesh.vertices + [8.0, 0.0, 0.0], mesh.faces)
    solved = _Solved.of(scene_of_objects([cube]), radar)
    fidelity = DEFAULT.with_(radar_edges=0, radar_shadowed=0)
    echoes = trace(scene_of_objects([cube]), radar, fidelity=fidelity).contributions
    carrier_hz = radar.ofdm.carrier_hz
    integral = echo_behind(cube, [], 2 * np.pi * carrier_hz / speed_of_light, solved.gain).whole
    return complex(solved.over_band(echoes, np.array([carrier_hz]))[0, 0] / integral)


def _bodies(prepared: PreparedScene) -> NDArray[np.int32]:
    """Of every object, -1 for what does not scatter."""
    is_body = [role is ScatteringModel.OPTICS for role in prepared.roles]
    rows = np.flatnonzero(is_body)
    body = np.full(len(prepared.items), -1, dtype=np.int32)
    body[rows] = bodies_of([prepared.items[i] for i in rows])
    return body


def _rms(echo: Complex) -> float:
    return float(np.sqrt(np.mean(np.abs(echo) ** 2)))


def random_scene(rng: np.random.Generator) -> Scene:
    """A box or a ball behind or beside a screen."""
    center = rng.uniform(5.0, 15.0) * np.array([1.0, rng.uniform(-0.3, 0.3), 0.0])
    mesh, size = _random_body(rng)
    wide, high = rng.uniform(0.2, 0.8, 2)
    corners = np.array([[0, 0, -high], [0, wide, -high], [0, wide, high], [0, 0, high]])
    before = center * rng.uniform(0.4, 0.8) + [0, rng.uniform(-0.5, 0.5) * size, 0]
    body = thing("body", mesh.vertices + center, mesh.faces)
    return scene_of_objects([body, thing("screen", corners + before, [[0, 1, 2], [0, 2, 3]])])


def beside_sheet(seed: int) -> Scene:
    """A box or a ball near the way to which a sheet hangs, of 0.3 to 6 radii of the first Fresnel
    zone, all of whose corners may send waves.
    """
    rng = np.random.default_rng([seed, 4])
    mesh, _ = _random_body(rng)
    distance_m, share = rng.uniform(5.0, 15.0), rng.uniform(0.25, 0.85)
    center = distance_m * np.array([1.0, rng.uniform(-0.3, 0.3), 0.0])
    zone_m = np.sqrt(_WAVELENGTH_M * share * (1 - share) * distance_m)
    first = 2 * zone_m * rng.normal(size=2)
    size = zone_m * np.exp(rng.uniform(np.log(0.3), np.log(6.0), 2)) * rng.choice([-1, 1], 2)
    (y, y2), (z, z2) = np.sort([first, first + size], axis=0).T
    corners = share * center + np.array([[0, y, z], [0, y2, z], [0, y2, z2], [0, y, z2]])
    body = thing("body", mesh.vertices + center, mesh.faces)
    return scene_of_objects([body, thing("sheet", corners, [[0, 1, 2], [0, 2, 3]])])


def beside_shape(kind: str, seed: int) -> Scene:
    """A box, a ball or a plate near the way to which a flat shape hangs, one of whose corners is
    within about a radius of the first Fresnel zone of that way.
    """
    rows = _SHAPES[kind]
    rng = np.random.default_rng([seed, 5, len(kind), ord(kind[0])])
    mesh, size = _random_body(rng)
    if rng.random() < 0.5:
        mesh = trimesh.creation.box((1e-3, *(size * rng.uniform(0.6, 1.4, 2))))
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    distance_m, share = rng.uniform(5.0, 15.0), rng.uniform(0.25, 0.85)
    center = distance_m * np.array([1.0, rng.uniform(-0.3, 0.3), 0.0])
    zone_m = np.sqrt(_WAVELENGTH_M * share * (1 - share) * distance_m)
    lines = []
    for count in (len(rows[0]), len(rows)):
        steps = zone_m * np.exp(rng.uniform(np.log(0.1), np.log(3.0), count))
        line = np.concatenate([[0.0], np.cumsum(steps)])
        lines.append(line - line[rng.integers(count + 1)] + 0.7 * zone_m * rng.normal())
    y, z = (line.ravel() for line in np.meshgrid(*lines))
    corners = share * center + np.stack([0 * y, y, z], axis=1)
    wide, faces = len(lines[0]), []
    for i, row in enumerate(rows):
        for j in np.flatnonzero(np.array(list(row)) == "#"):
            a, b = i * wide + j, (i + 1) * wide + j
            faces += [[a, a + 1, b + 1], [a, b + 1, b]]
    body = thing("body", mesh.vertices + center, mesh.faces)
    return scene_of_objects([body, thing(kind, corners, faces)])


def _random_body(rng: np.random.Generator) -> tuple[trimesh.Trimesh, float]:
    """A ball or a box, and about how large it is."""
    size = rng.uniform(0.03, 0.09)
    mesh = trimesh.creation.icosphere(4, radius=size / 2)
    if rng.random() < 0.5:
        mesh = trimesh.creation.box(size * rng.uniform(0.5, 1.5, 3))
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    return mesh, size


def behind_fence(seed: int) -> Scene:
    """A box or a ball behind upright posts, evenly spaced or not, of one mesh or of many."""
    rng = np.random.default_rng([seed, 11])
    near, gap = rng.uniform(3.0, 8.0), np.exp(rng.uniform(np.log(0.5), np.log(6.0)))
    count, pitch = int(rng.integers(3, 32)), np.exp(rng.uniform(np.log(0.03), np.log(0.15)))
    wide = pitch * rng.uniform(0.25, 0.7)
    place = (np.arange(count) - (count - 1) / 2 + rng.uniform(-0.5, 0.5)) * pitch
    if rng.random() < 0.5:
        place += rng.uniform(-0.5, 0.5, count) * (pitch - wide)
    low, high = rng.uniform(0.1, 0.5, 2)
    sides = np.array([[-wide, -2 * low], [wide, -2 * low], [wide, 2 * high], [-wide, 2 * high]]) / 2
    corners = np.array([[[near, y + a, b] for a, b in sides] for y in place])
    mesh, _ = _random_body(rng)
    center = [near + gap, rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.08)]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    objects = [thing("body", mesh.vertices + center, mesh.faces)]
    if rng.random() < 0.5:
        every = np.concatenate([faces + 4 * n for n in range(count)])
        objects.append(thing("fence", corners.reshape(-1, 3), every))
    else:
        objects += [thing(f"post {n}", post, faces) for n, post in enumerate(corners)]
    return scene_of_objects(objects)


def behind_two_screens(kind: str, seed: int) -> Scene:
    """A box or a ball behind or beside two upright screens, 0.3 to 5 m apart: with a ``slit``
    between them as the radar sees them, one that is a ``jut`` beyond the other's edge, ``layers``,
    one ``cross`` to the other or with a ``corner`` near the other's edge, or ``random`` ones.
    """
    rng = np.random.default_rng([seed, 7, len(kind), ord(kind[0])])
    gap = np.exp(rng.uniform(np.log(0.3), np.log(5.0)))
    near = rng.uniform(3.0, 8.0)
    end, farther = near + gap + rng.uniform(2.0, 6.0), (near + gap) / near
    edge, wide, beyond = rng.uniform(-0.04, 0.04), rng.uniform(0.1, 0.3, 2), rng.uniform(2e-3, 0.05)
    high = [(-rng.uniform(0.1, 0.4), rng.uniform(0.1, 0.4)) for _ in range(2)]
    y, z = [(edge - wide[0], edge), (edge - wide[1], edge + beyond)], high
    if kind == "slit":
        y[1] = (edge + beyond, edge + beyond + wide[1])
    elif kind == "layers":
        y[1] = (edge - wide[0] + beyond / 5, edge - beyond / 5)
    elif kind == "cross":
        y[1], z[1] = (-0.4, 0.4), ((edge - 0.05) / farther, (edge + 0.05) / farther)
    elif kind == "corner":
        z[1] = (rng.uniform(-0.05, 0.05) / farther, rng.uniform(0.1, 0.4) / farther)
    elif kind == "random":
        middle, half = rng.uniform(-0.1, 0.1, 4), rng.uniform(0.02, 0.2, 4)
        y, z = (
            [(m - h, m + h) for m, h in zip(middle[i::2], half[i::2], strict=True)] for i in (0, 1)
        )
    mesh, _ = _random_body(rng)
    center = [end, edge * end / near + rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.08)]
    objects = [thing("body", mesh.vertices + center, mesh.faces)]
    for number, scale in enumerate((1.0, farther)):
        sides = [(i, j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        corners = [[near * scale, y[number][i] * scale, z[number][j] * scale] for i, j in sides]
        objects.append(thing(f"screen {number}", np.array(corners), [[0, 1, 2], [0, 2, 3]]))
    return scene_of_objects(objects)
