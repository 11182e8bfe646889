"""Sionna RT's ways against the twin's own paths: several reflections, a slab, an edge.

What decides which engine finds what: where both know a way, how far they differ in length and
level, and how long they take; and what one of them does not know.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import erfc

from benchmarks.timing import Figure, timed
from twin.engine import mitsuba, sionna
from twin.geometry import Geometry, mitsuba_mesh
from twin.radar import load_radar
from twin.radar.propagation.diffraction.around_edges import all_paths_to_points
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.one_way.points import PointPaths, paths_to_points
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.scene.materials import radio_properties
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.scene import Pose, Rig, Scene, SceneObject, Sun
from twin.scene.materials import load_materials

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_MATERIALS = load_materials(Path("scenes/materials.toml"))
_RADAR = load_radar("hybrid-79")
_CARRIER_HZ = _RADAR.ofdm.carrier_hz
_WAVELENGTH_M = _RADAR.ofdm.wavelength_m
_K = 2 * np.pi / _WAVELENGTH_M
_PANE_M = 0.006
_HEIGHT_M, _DEPTH_M = 0.03, 0.5


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _street()
    yield from _pane()
    yield from _edge()


@lru_cache(maxsize=1)
def _solver() -> Any:
    return sionna().PathSolver()


@dataclass(frozen=True)
class _Peer:
    """Sionna's scene of some meshes, with a transmitter and receivers."""

    scene: Any
    n_receivers: int

    @staticmethod
    def of(items: Sequence[SceneObject], begin: Array, ends: Array, **material: float) -> "_Peer":
        rt = sionna()
        import mitsuba as mi

        scene = rt.load_scene()
        scene.frequency = _CARRIER_HZ
        array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
        scene.tx_array = scene.rx_array = array
        scene.add(rt.Transmitter("radar", begin.tolist()))
        for number, end in enumerate(ends):
            scene.add(rt.Receiver(f"point-{number}", end.tolist()))
        made, meshes = rt.RadioMaterial("material", **material), []
        for number, item in enumerate(items):
            mesh = mitsuba_mesh(mi, item.vertices_m, item.geometry.faces, name=item.name)
            name = f"object-{number}"
            meshes.append(rt.SceneObject(mi_mesh=mesh, name=name, radio_material=made))
        scene.edit(add=meshes)
        return _Peer(scene, len(ends))

    def ways(self, max_depth: int, **kinds: bool) -> list[tuple[Array, Complex]]:
        """Lengths in m and amplitudes of the ways to each receiver."""
        sionna()
        switches = dict.fromkeys(("specular_reflection", "diffuse_reflection", "refraction"), False)
        found = _solver()(
            self.scene,
            max_depth=max_depth,
            los=True,
            samples_per_src=10**5,
            seed=1,
            **switches | kinds,
        )
        shape = (self.n_receivers, -1)
        real, imaginary, late, valid = (
            np.array(x).reshape(shape) for x in (*found.a, found.tau, found.valid)
        )
        return [
            (speed_of_light * late[i][valid[i]].astype(float), (real + 1j * imaginary)[i][valid[i]])
            for i in range(self.n_receivers)
        ]


def _prepared(items: Sequence[SceneObject], begin: Array, order: int) -> PreparedScene:
    x, y, z = begin.tolist()
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((x, y, z)))
    sun = Sun(180.0, 30.0, 0.0)
    scene = Scene("peer", Path("peer"), "", tuple(items), rig, sun, (), materials=_MATERIALS)
    roles = assign_scattering_models(scene, _WAVELENGTH_M, with_optics=True)
    prepared = prepare_scene(scene, _RADAR, roles, order)
    return prepared.with_images(prepared.all_images)  # those that no body is heard by, too


def _received(paths: PointPaths) -> Complex:
    """Amplitude in a vertical antenna, as Sionna has it."""
    upwards = np.array([0, 0, 1.0]) - paths.back * paths.back[:, 2:]
    upwards /= np.linalg.norm(upwards, axis=1, keepdims=True)
    level: Complex = np.sum(paths.field * upwards, axis=1) / (2 * _K * paths.length)
    return level


def _street() -> Iterator[Figure]:
    """Sionna's `simple_street_canyon`, all of concrete: it has no brick or marble at 79 GHz."""
    rt = sionna()
    import mitsuba as mi

    items = []
    loaded = rt.load_scene(rt.scene.simple_street_canyon, merge_shapes=False)
    for name, thing in loaded.objects.items():
        parameters = mi.traverse(thing.mi_mesh)
        vertices = np.array(parameters["vertex_positions"], dtype=float).reshape(-1, 3)
        faces = np.array(parameters["faces"], dtype=np.int32).reshape(-1, 3)
        items.append(SceneObject(name, Geometry(vertices, faces), "concrete", 0.5, radar="surface"))
    begin = np.array([-33.0, 4.0, 1.5])
    ends = np.array([[20.0, -3.0, 1.7], [5.0, 1.0, 1.2], [-10.0, -2.0, 1.5]])
    concrete = _MATERIALS["concrete"]
    permittivity, conductivity, _ = radio_properties("concrete", concrete, _CARRIER_HZ)
    peer = _Peer.of(
        items,
        begin,
        ends,
        relative_permittivity=permittivity,
        conductivity=conductivity,
        thickness=10.0,
    )
    for order in (1, 2):

        def ours(order: int = order) -> list[PointPaths]:
            prepared = _prepared(items, begin, order)
            at, off = ends - prepared.anchor_m, np.zeros_like(ends)
            return [
                paths_to_points(prepared.context, i, at, off) for i in range(len(prepared.images))
            ]

        def theirs(order: int = order) -> list[tuple[Array, Complex]]:
            return peer.ways(order, specular_reflection=True)

        paths, ways = ours(), theirs()
        off_m, off_db, count = [], [], 0
        for row, (lengths, amplitudes) in enumerate(ways):
            count += len(lengths)
            for path in (one.take([row]) for one in paths if one.clear[row]):
                nearest = np.abs(lengths - path.length).argmin()
                off_m.append(abs(lengths[nearest] - path.length[0]))
                ratio = abs(amplitudes[nearest] / _received(path)[0])
                off_db.append(abs(20 * np.log10(ratio)))
        name = f"street canyon, up to {order} reflections"
        yield f"{name}: ways found by Sionna RT", float(count), ""
        yield f"{name}: paths compared", float(len(off_m)), ""
        yield f"{name}: largest difference of length", 1e3 * max(off_m), "mm"
        yield f"{name}: largest difference of level", max(off_db), "dB"
        yield f"{name}: Sionna RT", timed(theirs), ""
        yield f"{name}: own paths, the scene prepared anew", timed(ours), ""


def _rectangle(name: str, height: float, material: str, **more: Any) -> SceneObject:
    """6 m ahead of the origin, up to a height above it."""
    corners = [[6, -50, -50], [6, 50, -50], [6, 50, height], [6, -50, height]]
    vertices, faces = np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return SceneObject(name, Geometry(vertices, faces), material, 0.5, **more)


def _pane() -> Iterator[Figure]:
    """Through 6 mm of glass, against the slab in closed form."""
    item = _rectangle("pane", 50.0, "glass", thickness_m=_PANE_M, radar="surface")
    glass = _MATERIALS["glass"]
    permittivity, conductivity, _ = radio_properties("glass", glass, _CARRIER_HZ)
    begin = np.zeros(3)
    for angle in (0.0, 45.0):
        sine = np.sin(np.radians(angle))
        end = 10 * np.array([[np.cos(np.radians(angle)), sine, 0]])
        end *= 1.0 if angle == 0 else 1.2
        epsilon = permittivity - 60j * _WAVELENGTH_M * conductivity
        q, cosine = np.sqrt(epsilon - sine**2), np.sqrt(1 - sine**2)
        r = (cosine - q) / (cosine + q)
        turn = np.exp(-1j * _K * _PANE_M * q)
        due = (1 - r**2) * turn / (1 - (r * turn) ** 2) * np.exp(1j * _K * _PANE_M * cosine)
        prepared = _prepared([item], begin, 0)
        path = paths_to_points(prepared.context, 0, end - prepared.anchor_m, np.zeros((1, 3)))
        straight = 1 / (2 * _K * path.length[0])
        inside = path.ring.rho[0] * np.exp(-1j * _K * path.ring.lag_m[0])
        ours = _received(path)[0] / straight * np.exp(-1j * _K * path.extra[0]) / (1 - inside)
        peer = _Peer.of(
            [item],
            begin,
            end,
            relative_permittivity=permittivity,
            conductivity=conductivity,
            thickness=_PANE_M,
        )
        lengths, amplitudes = peer.ways(1, refraction=True)[0]
        theirs = np.sum(amplitudes * np.exp(-1j * _K * (lengths - path.length[0]))) / straight
        name = f"pane of glass, 6 mm, at {angle:.0f} degrees"
        for engine, value in (("Sionna RT", theirs), ("own paths", ours)):
            yield f"{name}: error of level by {engine}", _db(value / due), "dB"
            late = -np.angle(value / due) / _K
            yield f"{name}: error of length by {engine}", 1e3 * float(late), "mm +- wavelengths"


def _edge() -> Iterator[Figure]:
    """3 cm behind the edge of a screen and of a box, one way, over free space."""
    begin, end = np.zeros(3), np.array([[10.0, 0.0, 0.0]])
    sheet = _rectangle("sheet", _HEIGHT_M, "metal", radar="obstacle")
    bend = 0.5 * _K * (1 / 6 + 1 / 4) * _HEIGHT_M**2
    yield "3 cm behind an edge: knife edge", _db(erfc(np.sqrt(1j * bend)) / 2), "dB"
    for name, item in (("an edge", sheet), ("a box 0.5 m deep", _thick(sheet))):
        peer = _Peer.of(
            [item], begin, end, relative_permittivity=1.0, conductivity=1e7, thickness=0.1
        )
        prepared = _prepared([item], begin, 0)
        obstacles = screens(prepared, 60.0)

        def theirs(peer: _Peer = peer) -> tuple[Array, Complex]:
            return peer.ways(1, diffraction=True, edge_diffraction=True)[0]

        def ours(prepared: PreparedScene = prepared, obstacles: Any = obstacles) -> PointPaths:
            mitsuba()  # or the other engine's kind of numbers
            at = end - prepared.anchor_m
            off = np.zeros((1, 3))
            return all_paths_to_points(prepared.context, obstacles, 0, at, off).paths

        lengths, amplitudes = theirs()
        level = np.sum(amplitudes * np.exp(-1j * _K * (lengths - 10)))
        paths = ours()
        own = np.sum(_received(paths) * np.exp(-1j * _K * paths.extra))
        yield f"3 cm behind {name}: Sionna RT", _db(2 * _K * 10 * level), "dB"
        yield f"3 cm behind {name}: own paths", _db(2 * _K * 10 * own), "dB"
        yield f"3 cm behind {name}: Sionna RT, time", timed(theirs), ""
        yield f"3 cm behind {name}: own paths, time", timed(ours), ""


def _thick(sheet: SceneObject) -> SceneObject:
    import trimesh

    low, high = sheet.vertices_m.min(axis=0), sheet.vertices_m.max(axis=0)
    mesh = trimesh.creation.box(bounds=[low, high + [_DEPTH_M, 0, 0]])
    faces = mesh.faces.astype(np.int32)
    return SceneObject("box", Geometry(mesh.vertices, faces), "metal", 0.5, radar="obstacle")


def _db(value: complex) -> float:
    return float(20 * np.log10(max(abs(value), 1e-12)))
