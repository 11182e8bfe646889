"""Sionna RT's scene, the radar at its origin: meshes, materials, targets, and paths among them."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import sionna
from twin.geometry import mitsuba_mesh
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import radar_motion
from twin.radar.propagation.scene.materials import radio_properties
from twin.radar.propagation.scene.scattering_models import ScatteringModel, assign_scattering_models
from twin.radar.propagation.sionna.raw import RawPath
from twin.radar.propagation.tabulated import Tabulated, assumptions, tabulated, warning
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]

_AIR = "opaque air"
_SAMPLES = 100_000  # rays that look for surfaces; the image method then is exact
_BUFFER = 10_000
#: A half space: deep enough that nothing comes back from the far side of a lossy wall.
_THICKNESS_M = 10.0


# Solvers keep no state, and making one decorates functions anew: once per process.


@lru_cache(maxsize=1)
def _path_solver() -> Any:
    return sionna().PathSolver(deterministic=True)


@lru_cache(maxsize=1)
def _target_solver() -> Any:
    sionna()
    from sionna.rt.rcs import RCSSolver

    return RCSSolver(deterministic=True)


class RadioWorld:
    """Sionna's scene with the radar at its origin, and what its numbers of objects stand for."""

    def __init__(self, scene: Scene, radar: RadarDesign, table_nodes: int) -> None:
        self.radar = radar
        self.offset, self.axes = scene.rig.device("radar")
        self.origin = scene.rig.position_m + self.offset
        self.motion = radar_motion(scene)
        self.roles = assign_scattering_models(scene, radar.ofdm.wavelength_m)
        self.surfaces = {a.name for a in self.roles if a.role is ScatteringModel.SURFACE}
        self.assumptions: list[str] = []
        self.warnings: list[str] = []
        self.objects = {item.name: item for item in scene.objects}
        self.tables = self._tables(scene, table_nodes)
        replaced = {thing.point.name for thing in self.tables}
        declared = [t for t in scene.targets if t.object not in replaced]
        # Sionna's paths count them in this order.
        self.targets_met = [*declared, *(thing.point for thing in self.tables)]
        self.n_declared = len(declared)
        self.scene = scene
        rt = sionna()
        self.world = rt.load_scene()
        self.world.frequency = radar.ofdm.carrier_hz
        array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
        self.world.tx_array = self.world.rx_array = array
        self.world.add(rt.Transmitter("transmitter", [0.0, 0.0, 0.0]))
        self.world.add(rt.Receiver("receiver", [0.0, 0.0, 0.0]))
        meshes = self._add_meshes(scene)
        self._add_targets()
        self.meshes_met = {int(mesh.object_id): self.objects[name] for name, mesh in meshes.items()}

    def _tables(self, scene: Scene, nodes: int) -> list[Tabulated]:
        tables = [
            tabulated(scene, self.objects[a.name], self.radar, nodes)
            for a in self.roles
            if a.role is ScatteringModel.TABLE
        ]
        for thing in tables:
            item = self.objects[thing.point.name]
            distance = float(np.linalg.norm(np.asarray(thing.point.position_m) - self.origin))
            self.warnings += filter(None, [warning(thing, distance)])
            self.assumptions += assumptions(thing, item.material, self.radar)
        return tables

    def _add_meshes(self, scene: Scene) -> dict[str, Any]:
        """Surfaces with their material; obstacles as air that is opaque and reflects nothing."""
        rt = sionna()
        made: dict[str, Any] = {}
        meshes: dict[str, Any] = {}
        for assigned in self.roles:
            if assigned.role in (ScatteringModel.TARGET, ScatteringModel.TABLE):
                continue
            item = self.objects[assigned.name]
            key = item.material if assigned.role is ScatteringModel.SURFACE else _AIR
            if key not in made:
                made[key] = rt.RadioMaterial(f"material-{len(made)}", **self._material(key, scene))
            mesh = rt.SceneObject(
                mi_mesh=_mesh(item, self.origin),
                name=f"object-{len(meshes)}",  # Sionna edits names of its own accord
                radio_material=made[key],
            )
            meshes[item.name] = mesh
        if meshes:
            self.world.edit(add=list(meshes.values()))
        return meshes

    def _material(self, name: str, scene: Scene) -> dict[str, float]:
        if name == _AIR:
            return {"relative_permittivity": 1.0, "conductivity": 0.0}
        carrier = self.radar.ofdm.carrier_hz
        permittivity, conductivity, assumed = radio_properties(name, scene.materials[name], carrier)
        if assumed:
            self.assumptions.append(f"radio properties of {name}: {assumed}")
        return {
            "relative_permittivity": permittivity,
            "conductivity": conductivity,
            "thickness": _THICKNESS_M,
        }

    def _add_targets(self) -> None:
        """Declared targets and those of tables, in their order."""
        from sionna.rt.rcs import (
            ConstantCPM,
            ConstantRCS,
            ConstantRCSSensingTarget,
            ScatteringModel,
            SensingTarget,
        )

        for number, target in enumerate(self.targets_met):
            name = f"target-{number}"
            place = np.asarray(target.position_m) - self.origin
            if target.object is None:
                size = dict.fromkeys(("length", "width", "height"), 0.05)
                thing = ConstantRCSSensingTarget(
                    name, sigma=target.rcs_m2, position=place.tolist(), **size
                )
            else:
                item = self.objects[target.object]
                # A scattering point is given relative to the middle of its mesh's box.
                middle = (item.vertices_m.min(axis=0) + item.vertices_m.max(axis=0)) / 2
                model = ScatteringModel(
                    (place - middle + self.origin).tolist(),
                    rcs=ConstantRCS(target.rcs_m2),
                    cpm=ConstantCPM(),
                )
                mesh = _mesh(item, self.origin)
                thing = SensingTarget(name=name, scattering_model=model, mi_mesh=mesh)
            self.world.add(thing)

    def surface_paths(self, max_depth: int, seed: int) -> list[RawPath]:
        """Mirror images of the radar in large surfaces."""
        if not self.surfaces:
            return []
        solved = _path_solver()(
            self.world,
            max_depth=max_depth,
            max_num_paths_per_src=_BUFFER,
            samples_per_src=_SAMPLES,
            los=False,
            specular_reflection=True,
            diffuse_reflection=False,
            refraction=False,
            seed=seed,
        )
        return list(RawPath.unpack(solved))

    def target_paths(self, max_depth: int, seed: int) -> list[RawPath]:
        """Ways to every target and back, directly and over surfaces."""
        if not self.targets_met:
            return []
        solved = _target_solver()(
            self.world,
            max_depth=max_depth,
            samples_per_sp=_SAMPLES,
            buffer_size_per_sp=_BUFFER,
            refraction=False,
            seed=seed,
        )
        return list(RawPath.unpack(solved))


def _mesh(item: SceneObject, origin: Array) -> Any:
    """Sionna's copy of a mesh, relative to the radar."""
    import mitsuba as mi

    return mitsuba_mesh(mi, item.vertices_m - origin, item.geometry.faces, name=item.name)
