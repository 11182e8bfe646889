"""Where a table of physical optics pays: what it costs to fill, to look up and to trace beside."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.constants import speed_of_light

from benchmarks.timing import Figure, timed
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.radar import load_radar
from twin.radar.cross_section.bistatic import scattering_dyadics
from twin.radar.cross_section.table import QUALITY, Table
from twin.radar.propagation.solvers import trace
from twin.radar.scattering.target import MeshTarget
from twin.scene import Scene, load_scene

_NODES = Fidelity().radar_table_nodes


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _interpolation()
    street = load_scene("street")
    for carrier_hz in (79e9, 2.5e9):
        for name, leg_m in (("car", None), ("person", None), ("trihedral of 0.2 m", 0.2)):
            target = _trihedral(leg_m) if leg_m else _of(street, name)
            yield from _table(f"table of {name}, {carrier_hz / 1e9:g} GHz", target, carrier_hz)
    yield from _frames(street)


def _interpolation() -> Iterator[Figure]:
    """Of a plate of 10 wavelengths, between 200 ways around its mirror's direction."""
    carrier_hz, half = 79e9, 5 * speed_of_light / 79e9
    corners = half * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1.0]])
    plate = MeshTarget(Geometry(corners, np.array([[0, 1, 2], [0, 2, 3]])))
    rng = np.random.default_rng(0)
    ways = np.array([-1.0, 0, 0]) + 0.02 * rng.normal(size=(2, 200, 3))
    source, receiver = ways / np.linalg.norm(ways, axis=2, keepdims=True)
    carriers = np.array([carrier_hz])
    direct = scattering_dyadics(plate, source, receiver, carriers, QUALITY)[:, 0]
    peak = (2 * half) ** 2 * carrier_hz / speed_of_light
    for nodes in (2, 4, 8):
        found = Table(plate, carrier_hz, nodes).dyadics(source, receiver)[:, 0]
        error = np.abs(found - direct)[:, 1:, 1:]
        rms = float(np.sqrt(np.mean(np.sum(error**2, axis=(1, 2)) / 2)))
        yield f"table, {nodes} nodes a lobe: rms error of a plate", 100 * rms / peak, "% of peak"


def _of(scene: Scene, name: str) -> MeshTarget:
    item = next(o for o in scene.objects if o.name == name)
    return MeshTarget(Geometry(item.vertices_m, item.geometry.faces))


def _trihedral(leg_m: float) -> MeshTarget:
    return MeshTarget(
        np.vstack([np.zeros(3), -leg_m * np.eye(3)]), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]])
    )


def _table(what: str, target: MeshTarget, carrier_hz: float) -> Iterator[Figure]:
    table = Table(target, carrier_hz, _NODES)
    yield f"{what}: far field from", table.far_m, "m"
    yield f"{what}: nodes of a sphere", float(table.nodes), ""
    # A new direction each time: the next cells of the grid.
    step = 2 * speed_of_light / carrier_hz / table.extent_m
    ahead = iter(np.arange(1000))

    def fill() -> None:
        u = np.array([[-1.0, step * next(ahead), 0.1]])
        table.dyadics(*2 * (u / np.linalg.norm(u),))

    spent = timed(fill, runs=3)
    yield f"{what}: a new way out and back, {table.filled // 4} pairs of nodes", spent, ""
    known = np.tile([[-1.0, 0.0, 0.1]] / np.sqrt(1.01), (1000, 1))
    looked = timed(lambda: table.dyadics(known, known))
    yield f"{what}: look-ups", 1000 / looked.median_s, "1/s"


def _frames(scene: Scene) -> Iterator[Figure]:
    """The street's trihedral at 140 m, everything else declared or silent."""
    radar, paths = load_radar("hybrid-79"), Fidelity(radar="paths")
    tabulated = replace(
        scene,
        objects=tuple(
            replace(o, radar="table") if o.name == "trihedral" else o for o in scene.objects
        ),
    )
    yield "street, paths, all declared", timed(lambda: trace(scene, radar, fidelity=paths)), ""
    yield (
        "street, paths, trihedral from its table",
        timed(lambda: trace(tabulated, radar, fidelity=paths)),
        "",
    )
    yield (
        "street, optics, all meshes",
        timed(lambda: trace(scene, radar, fidelity=Fidelity())),
        "",
    )
