"""Echoes round obstacles: what the solver states as their error, and what it is.

The truth of every body are cells of a quarter of the size, of which none is left out, and shadows
followed to 50 dB: the solver itself, finer. Bodies of the yard, the street and of random scenes, in
which boxes and balls stand behind screens; those that stand alone are left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.radar_estimates import scene_of_objects, thing
from benchmarks.timing import Figure
from twin.fidelity import DEFAULT
from twin.radar import RadarDesign, load_radar
from twin.radar.propagation.diffraction.around_edges import screens
from twin.radar.propagation.diffraction.behind_obstacles import Accepted, echoes_behind
from twin.radar.propagation.facets.adaptive_subdivision import WEAKEST
from twin.radar.propagation.facets.convergence import band_of, label_of, summed_by
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.physical_optics import at_antenna, loss_of
from twin.radar.propagation.physical_optics_solver import MOST_SHADOWED
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.solvers import trace
from twin.scene import Scene, load_scene

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_RANDOM = 12  # scenes
_FINE_DB, _FINENESS, _MANY = 50.0, 0.25, 100_000
_NOTHING = 1e-9  # of a body's level
_PERMITTED = 0.01  # of a body's level: a tenth of the tolerance


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
    radar, found = load_radar("hybrid-79"), []
    for name, scene in _scenes():
        for one in compared(name, scene, radar):
            found.append(one)
            what = f"{one.scene}, {one.body}: round obstacles"
            yield f"{what}, of the echo", 100 * one.change, "%"
            yield f"{what}, stated error", 100 * one.stated, "%"
            yield f"{what}, true error", 100 * one.true, "%"
    ratio = np.array([one.true / one.stated for one in found])
    yield "bodies", float(len(found)), ""
    yield "within what is stated", 100 * float(np.mean(ratio <= 1)), "%"
    yield "true error over stated, worst", float(ratio.max()), ""
    yield "stated error over true, median", float(np.median(1 / np.maximum(ratio, 1e-6))), ""


def _scenes() -> Iterator[tuple[str, Scene]]:
    for seed in range(_RANDOM):
        yield f"random {seed}", random_scene(np.random.default_rng(seed))
    for name in ("yard", "street"):
        yield name, load_scene(name)


def compared(name: str, scene: Scene, radar: RadarDesign) -> Iterator[Compared]:
    """Every body of a scene that stands beside or behind anything."""
    found = trace(scene, radar, fidelity=DEFAULT.with_(radar_edges=0, radar_shadowed=0))
    prepared = prepare_scene(scene, radar, found.roles, 0)
    body = _bodies(prepared)
    names = [tuple(prepared.items[i].name for i in np.flatnonzero(body == k)) for k in _each(body)]
    levels = {echo.objects: echo.level_amplitude for echo in found.bodies}
    own = np.array([levels.get(objects, 0.0) for objects in names])
    level = np.maximum(own, WEAKEST * own.max())
    own_db = float(np.clip(-20 * np.log10(DEFAULT.radar_tolerance / 3), 20, 40))
    limit = level / loss_of(radar)
    coarse = Accepted(_PERMITTED * limit, MOST_SHADOWED, 1.0)
    fine = Accepted(_NOTHING * limit, _MANY, _FINENESS)
    echo, stated = _round_obstacles(prepared, radar, body, own_db, coarse)
    truth, _ = _round_obstacles(prepared, radar, body, _FINE_DB, fine)
    for k in np.flatnonzero((own > 0) & (stated > 0)):
        yield Compared(
            name,
            label_of(names[k]),
            float(_rms(truth[k]) / level[k]),
            float(stated[k] / level[k]),
            float(_rms(echo[k] - truth[k]) / level[k]),
        )


def _round_obstacles(
    prepared: PreparedScene,
    radar: RadarDesign,
    body: NDArray[np.int32],
    depth_db: float,
    accepted: Accepted,
) -> tuple[Complex, Array]:
    """Echoes of bodies over the band, (n_bodies, n_frequencies), and the errors stated of them,
    (n_bodies,), both in amplitude.
    """
    obstacles = screens(prepared, depth_db, body)
    assert obstacles is not None

    def gain(directions: Array) -> Array:
        both: Array = radar.antenna.gain(directions @ prepared.axes.T)
        return both

    bodies = np.array(_each(body), dtype=np.int64)
    found = echoes_behind(obstacles, prepared.surface_of_object, bodies, gain, accepted)
    echoes = at_antenna(found.contributions, prepared, radar)
    owner, wave = body[echoes.object], radar.ofdm
    echo = summed_by(owner, len(bodies), echoes, wave.carrier_hz, band_of(wave))
    return echo, found.left_out * loss_of(radar)


def _bodies(prepared: PreparedScene) -> NDArray[np.int32]:
    """Of every object, -1 for what does not scatter."""
    is_body = [role is ScatteringModel.OPTICS for role in prepared.roles]
    rows = np.flatnonzero(is_body)
    body = np.full(len(prepared.items), -1, dtype=np.int32)
    body[rows] = bodies_of([prepared.items[i] for i in rows])
    return body


def _each(body: NDArray[np.int32]) -> list[int]:
    return list(range(int(body.max()) + 1))


def _rms(echo: Complex) -> float:
    return float(np.sqrt(np.mean(np.abs(echo) ** 2)))


def random_scene(rng: np.random.Generator) -> Scene:
    """Two or three boxes and balls, each behind or beside a screen of its own."""
    objects = []
    for i in range(rng.integers(2, 4)):
        center = rng.uniform(5.0, 15.0) * np.array([1.0, rng.uniform(-0.3, 0.3), 0.0])
        center[1] += 3.0 * (i - 1)
        size = rng.uniform(0.1, 0.5)
        mesh = trimesh.creation.icosphere(3, radius=size / 2)
        if rng.random() < 0.5:
            mesh = trimesh.creation.box(size * rng.uniform(0.5, 1.5, 3))
            mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        objects.append(thing(f"body {i}", mesh.vertices + center, mesh.faces))
        wide, high = rng.uniform(0.2, 0.8, 2)
        corners = np.array([[0, 0, -high], [0, wide, -high], [0, wide, high], [0, 0, high]])
        before = center * rng.uniform(0.4, 0.8) + [0, rng.uniform(-0.5, 0.5) * size, 0]
        objects.append(thing(f"screen {i}", corners + before, [[0, 1, 2], [0, 2, 3]]))
    return scene_of_objects(objects)
