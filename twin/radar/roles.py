"""Which object the radar meets as what: reflecting surface, target, or mere obstacle.

The image method returns pi d^2 of cross-section from any plane, whatever its size. That is right
only for surfaces large against the first Fresnel zone sqrt(lambda d), so only they reflect. Objects
of declared targets answer with their cross-section. Everything else casts its shadow and is silent.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from twin.scene import Scene, SceneObject

#: Side of a flat patch over its Fresnel zone from which the image method is taken to hold. At 3
#: the plate's own cross-section 4 pi A^2 / lambda^2 is 25 dB above pi d^2 of an infinite plane:
#: the patch is far larger than what reflects.
LARGE = 3.0


class Role(StrEnum):
    """What an object is to the radar."""

    SURFACE = "reflects as a large surface"
    TARGET = "answers with its declared cross-section"
    OBSTACLE = "only casts a shadow"


@dataclass(frozen=True)
class Assignment:
    """The role of one object and the ratio that decided it."""

    name: str
    role: Role
    over_fresnel_zone: float


def assign_roles(scene: Scene, wavelength_m: float) -> list[Assignment]:
    """Role of every object, as the rule of this module has it."""
    declared = {target.object for target in scene.targets if target.object}
    origin = scene.rig.position_m + scene.rig.device("radar")[0]
    found = []
    for item in scene.objects:
        ratio = _flatness(item, origin, wavelength_m)
        role = Role.SURFACE if ratio >= LARGE else Role.OBSTACLE
        if item.name in declared:
            role = Role.TARGET
        found.append(Assignment(item.name, role, ratio))
    return found


def _flatness(item: SceneObject, origin: np.ndarray, wavelength_m: float) -> float:
    """Side of the object's largest flat patch over the Fresnel zone at its nearest point."""
    import trimesh

    mesh = trimesh.Trimesh(item.vertices_m - origin, item.faces, process=True)
    # Single triangles count as patches too: trimesh's facets join two and more.
    areas = np.append(mesh.facets_area, mesh.area_faces.max(initial=0.0))
    low, high = mesh.bounds
    distance = max(float(np.linalg.norm(np.clip(0.0, low, high))), wavelength_m)
    return float(np.sqrt(areas.max()) / np.sqrt(wavelength_m * distance))
