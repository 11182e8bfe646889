"""What a scene holds, object by object, and what is odd about it."""

from dataclasses import dataclass

import numpy as np

from hardware.formatting import number
from twin.scene.model import Scene
from twin.scene.objects import SceneObject
from twin.scene.texture import Texture


@dataclass(frozen=True)
class ObjectReport:
    """One object: size, distance, material, and remarks on its mesh."""

    name: str
    triangles: int
    size_m: tuple[float, float, float]
    nearest_m: float
    material: str
    reflectance: str
    remarks: tuple[str, ...]


def check_scene(scene: Scene) -> list[ObjectReport]:
    """Look at every object of a scene that loaded; faults were errors before this."""
    return [_report(item, scene) for item in scene.objects]


def _report(item: SceneObject, scene: Scene) -> ObjectReport:
    merged = item.geometry.merged
    low, high = item.box_m
    size = high - low
    outside = np.maximum(0, np.maximum(low - scene.rig.position_m, scene.rig.position_m - high))
    remarks = []
    faces_at_edge = np.bincount(merged.edges_unique_inverse)
    if (faces_at_edge == 1).any():
        remarks.append("open surface")
    elif (faces_at_edge > 2).any():
        remarks.append("edges of more than two faces")
    elif merged.volume < 0:
        remarks.append("normals point inwards")
    if not merged.is_winding_consistent:
        remarks.append("faces wound both ways")
    if max(np.abs(item.box_m - scene.rig.position_m).max(), 0) > 1e4:
        remarks.append("reaches beyond 10 km: float32 rays lose up to 0.3 % of the light")
    if item.motion is not None and item.motion.moves:
        remarks.append(f"moves on {item.parent}" if item.parent else "moves")
    elif any(item.velocity_m_per_s):
        remarks.append(f"moves at {', '.join(map(number, item.velocity_m_per_s))} m/s")
    reflectance = item.reflectance
    return ObjectReport(
        name=item.name,
        triangles=len(item.geometry.faces),
        size_m=(float(size[0]), float(size[1]), float(size[2])),
        nearest_m=float(np.linalg.norm(outside)),
        material=item.material,
        reflectance="texture" if isinstance(reflectance, Texture) else number(reflectance),
        remarks=tuple(remarks),
    )
