"""Figures of scenes of any size: what the set-up takes, and what all echoes take.

The set-up: roles, meshes, bodies, images, those in which the radar sees itself, and the ways worth
tracing. Both the first time, and when one object has moved; from rays to echoes and to detections
of one thread, each scene in a process of its own that ends after a quarter of an hour. In cities of
Sionna RT, one of them with a car, a made one, and a terrain.
`python -m benchmarks.large_scenes munich` measures one scene by default, and with `standard` behind
it under that preset: a city, `munich-car`, `boxes`, `posts`, or the number of points along a side
of the terrain.
"""

import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.stated_errors.radar_cases import hundreds_of_posts
from benchmarks.timing import Figure, timed
from hardware.radar.process import process
from twin.engine import mitsuba, sionna
from twin.fidelity import DEFAULT, PRESETS
from twin.files import scenes_folder
from twin.geometry import Geometry
from twin.radar import load_radar, radar_echo
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.scene.scattering_models import ScatteringModel, assign_scattering_models
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.boxes import boxes_of
from twin.scene.materials import load_materials
from twin.scene.meshes import read_mesh

_LIMIT_S = 900  # of one scene's process, two frames
_CITIES = ("munich", "etoile", "florence", "san_francisco")
_TERRAIN = (708, 2237)  # points along a side: 1e6 and 1e7 triangles
_BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
_SIDES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]],
    dtype=np.int32,
)


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    sionna()  # imported here: it takes seconds, whatever the scene
    mitsuba()
    for name in _CITIES:
        yield from _of(name, load_scene(_bundled(name)))
        yield from _levels(name, name)
    yield from _levels("munich with a car", "munich-car")
    yield from _of("10 000 boxes", many_boxes(10_000))
    yield from _levels("10 000 boxes", "boxes")
    yield from _levels("200 posts", "posts")
    for side in _TERRAIN:
        yield from _apart(f"{2 * (side - 1) ** 2:.2g} triangles", str(side))


def _of(name: str, scene: Scene) -> Iterator[Figure]:
    yield f"{name}: objects", float(len(scene.objects)), ""
    yield f"{name}: triangles", float(scene.triangles), ""
    start = time.perf_counter()
    prepared = _set_up(scene)
    yield f"{name}: set-up, the first time", time.perf_counter() - start, "s"
    moved = iter(_moved(scene, None, 0.1 * step) for step in range(1, 99))
    yield f"{name}: set-up, one object moved", timed(lambda: _set_up(next(moved)), runs=5), ""
    scattering = [
        o
        for o, r in zip(prepared.items, prepared.roles, strict=True)
        if r is ScatteringModel.OPTICS
    ]
    yield f"{name}: objects that scatter", float(len(scattering)), ""
    yield f"{name}: images, with the radar", float(len(prepared.images)), ""
    yield f"{name}: ways worth tracing", float(prepared.worth.sum()), ""


def _set_up(scene: Scene) -> PreparedScene:
    radar = load_radar("hybrid-79")
    prepared = prepare_scene(
        scene, radar, assign_scattering_models(scene, radar.ofdm.wavelength_m, with_optics=True), 1
    )
    items = zip(prepared.items, prepared.roles, strict=True)
    bodies_of([item for item, role in items if role is ScatteringModel.OPTICS])
    prepared.seen_by_itself()
    return prepared


def _moved(scene: Scene, name: str | None, metres: float) -> Scene:
    """One object moved: that of a name, or the smallest."""
    boxes = boxes_of(scene.objects)
    item = scene.objects[int(np.argmin((boxes[:, 1] - boxes[:, 0]).max(axis=1)))]
    item = next((o for o in scene.objects if o.name == name), item)
    there = item.moved([metres, metres, metres])
    return replace(scene, objects=tuple(there if o is item else o for o in scene.objects))


def _bundled(name: str) -> Path:
    spec = importlib.util.find_spec("sionna")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]) / "rt" / "scenes" / name / f"{name}.xml"


def _scene(objects: list[SceneObject]) -> Scene:
    table = load_materials(scenes_folder() / "materials.toml")
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    sun = Sun(180.0, 30.0, 0.0)
    return Scene("bench", Path("bench"), "", tuple(objects), rig, sun, materials=table)


def _thing(name: str, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> SceneObject:
    return SceneObject(name, Geometry(vertices, faces), "concrete", 0.5)


def many_boxes(count: int) -> Scene:
    """Concrete boxes of a few metres, turned at random, on the ground over 1.2 km by 1.2 km; the
    radar looks down at them from 15 m.
    """
    rng = np.random.default_rng(0)
    found = []
    for number in range(count):
        size, turn = rng.gamma(2, 2, 3) + 0.2, rng.uniform(0, 2 * np.pi)
        corners = (_BOX - [0.5, 0.5, 0]) * size
        along = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0]])
        level = corners[:, :2] @ along + [*rng.uniform(-600, 600, 2), 0]
        found.append(_thing(f"box {number}", level + corners * [0, 0, 1], _SIDES.copy()))
    around = np.array([[-700, -700, 0], [700, -700, 0], [700, 700, 0], [-700, 700, 0.0]])
    ground = _thing("ground", around, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    scene = _scene([*found, ground])
    rig = Rig(Pose((0.0, 0.0, 15.0)), radar=Pose((0.0, 0.0, 0.0), pitch_deg=6.0))
    return replace(scene, rig=rig)


def _with_car(scene: Scene) -> Scene:
    """With a car on the ground, 8 m ahead of the radar, which stands 0.9 m above it."""
    mesh = read_mesh(scenes_folder() / "bodies" / "car.ply")
    off, axes = scene.rig.device("radar")
    middle = (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0)) / 2
    middle[2] = mesh.vertices_m[:, 2].min() + 0.9
    place = scene.rig.position_m + off + 8.0 * axes[0]
    car = _thing("car", (mesh.vertices_m - middle) @ axes + place, mesh.faces)
    return replace(scene, objects=(*scene.objects, replace(car, material="metal")))


def _terrain(side: int) -> Scene:
    """One mesh of hills before the radar, and a box."""
    along = np.linspace(-300, 300, side)
    x, y = np.meshgrid(along + 310, along, indexing="ij")
    z = -3 + np.sin(x / 7) * np.cos(y / 9)
    n = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, c, d = n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    hills = _thing("hills", np.stack([x, y, z], axis=-1).reshape(-1, 3), faces)
    return _scene([hills, _thing("box", _BOX + [20, 0, 0], _SIDES)])


def _levels(name: str, scene: str) -> Iterator[Figure]:
    """By default, and under the preset `standard`, which bounds nothing."""
    yield from _apart(name, scene)
    yield from _apart(f"{name}, standard", scene, "standard")


def _apart(name: str, scene: str, level: str = "default") -> Iterator[Figure]:
    """A scene in a process of its own, for its memory."""
    command = [sys.executable, "-m", "benchmarks.large_scenes", scene, level]
    # Libraries of linear algebra wait for their other threads in CPU time.
    one = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=one) as running:
        try:
            printed, _ = running.communicate(timeout=_LIMIT_S)
        except subprocess.TimeoutExpired:
            running.kill()
            printed, _ = running.communicate()
            yield f"{name}: not done, stopped after", float(_LIMIT_S), "s"
    for line in printed.splitlines():
        what, value, unit = json.loads(line)
        yield f"{name}: {what}", value, unit
    if running.returncode > 0:
        yield f"{name}: failed, exit status", float(running.returncode), ""


def _measured(name: str, level: str = "default") -> Iterator[Figure]:
    """Echoes and detections of a scene by one thread; ``level``: a preset, or the default."""
    import resource

    import drjit as dr

    sionna()
    mitsuba()
    dr.set_thread_count(1)
    city, _, car = name.partition("-")
    if city in _CITIES:
        scene = load_scene(_bundled(city))
        scene = _with_car(scene) if car else scene
    else:
        scene = _made(name)
    radar = load_radar("hybrid-79")
    fidelity = {"default": DEFAULT, **PRESETS}[level]
    earlier = None
    for when in ("the first time", "one object moved", "moved on, with what holds of the last"):
        keep = when == "one object moved"
        cpu, wall = time.process_time(), time.perf_counter()
        echo = radar_echo(scene, radar, fidelity=fidelity, earlier=earlier, keep=keep)
        yield f"rays to echoes, {when}, CPU time", time.process_time() - cpu, "s"
        (found,) = echo.bursts
        detections = process(echo.record()).detections
        yield f"rays to detections, {when}, CPU time", time.process_time() - cpu, "s"
        yield f"rays to detections, {when}, wall", time.perf_counter() - wall, "s"
        yield f"contributions, {when}", float(len(found.echoes.delay_s)), ""
        yield f"bodies that answer, {when}", float(len(found.bodies)), ""
        strong = sum(body.level_db > -40 for body in found.bodies)
        yield f"bodies within 40 dB of the strongest, {when}", float(strong), ""
        yield f"detections, {when}", float(len(detections)), ""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        yield f"memory at most, until {when}", peak / 1e9, "GB"
        scene = _moved(scene, "car" if car else None, 0.1)
        earlier = found if keep else None


def _made(name: str) -> Scene:
    if name == "boxes":
        return many_boxes(10_000)
    if name == "posts":  # 200, many in the shadow of others
        wavelength_m = load_radar("hybrid-79").ofdm.wavelength_m
        return hundreds_of_posts(np.random.default_rng(5), wavelength_m)
    return _terrain(int(name))


if __name__ == "__main__":
    for figure in _measured(*sys.argv[1:]):
        print(json.dumps(figure), flush=True)
