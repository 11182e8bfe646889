"""Which object the radar meets as what: reflecting surface, scatterer, target, or mere obstacle.

The image method returns pi d^2 of cross-section from any plane, whatever its size: right only for
surfaces large against the first Fresnel zone sqrt(lambda d). Physical optics is right for any size
from a few wavelengths on, flat or curved, but its cost grows as (size / Fresnel zone)^2. So where
objects scatter by physical optics, images are left to what is flat and very large.

On the rung `paths`, what has no declared cross-section and is no mirror answers from a table of its
far field where that holds, from 2 D^2 / lambda on, where the table is quickly filled, and where it
is no part of something declared. The scene may ask for a table anywhere; where it can't be right is
warned of.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from twin.geometry import Shape, shapes_of
from twin.radar.propagation.meshes.grouping import touching
from twin.scene import Scene, Target
from twin.scene.boxes import boxes_of, distances_m

#: Side of a flat patch over its Fresnel zone from which the image method is taken to hold. At 3
#: the plate's own cross-section 4 pi A^2 / lambda^2 is 25 dB above pi d^2 of an infinite plane:
#: the patch is far larger than what reflects.
LARGE = 3.0
#: The same where physical optics is the alternative. At 10, what it leaves out, the diffraction of
#: the patch's edges, is 30 dB below the mirror image, and physical optics has 1e4 contributions.
LARGE_BESIDE_OPTICS = 10.0
_MOSTLY = 0.5  # share of an object's area in such patches, else the rest of it would be silent
_BENT = 10.0  # radius of curvature over distance: at 10 an image is off by 1 + d / R, 0.8 dB
#: Wavelengths from which physical optics is more than an order of magnitude.
SMALLEST = 3.0
#: Wavelengths up to which a table begins by itself: 20 000 rays a direction, 0.2 s a way at most.
_LARGEST_TABLE = 40.0


class ScatteringModel(StrEnum):
    """What an object is to the radar."""

    SURFACE = "reflects as a large surface"
    OPTICS = "scatters by physical optics"
    TABLE = "answers from a table of physical optics"
    TARGET = "answers with its declared cross-section"
    OBSTACLE = "only casts a shadow"


#: What ``scene.toml`` calls them.
_WANTED = {
    "surface": ScatteringModel.SURFACE,
    "optics": ScatteringModel.OPTICS,
    "table": ScatteringModel.TABLE,
    "declared": ScatteringModel.TARGET,
    "obstacle": ScatteringModel.OBSTACLE,
}


@dataclass(frozen=True)
class Assignment:
    """The role of one object, the ratio that decided it, and whether the scene overrode it."""

    name: str
    role: ScatteringModel
    over_fresnel_zone: float
    declared: bool = False


def assign_scattering_models(
    scene: Scene, wavelength_m: float, *, with_optics: bool = False
) -> list[Assignment]:
    """Role of every object, as the rule of this module has it; ``with_optics`` where meshes scatter
    by physical optics.
    """
    declared = {target.object for target in scene.targets if target.object}
    origin = scene.rig.position_m + scene.rig.device("radar")[0]
    distances = np.maximum(distances_m(boxes_of(scene.objects), origin), wavelength_m)
    part_of_declared = set() if with_optics else _beside(scene, declared)
    assignments = []
    shapes = shapes_of([item.geometry for item in scene.objects])
    for item, shape, distance in zip(scene.objects, shapes, distances.tolist(), strict=True):
        ratio = shape.largest_patch_m2**0.5 / (wavelength_m * distance) ** 0.5
        wanted = _WANTED.get(item.radar or "")
        if wanted is not None and wanted is not (
            ScatteringModel.TABLE if with_optics else ScatteringModel.OPTICS
        ):
            role = wanted
        elif with_optics:
            role = role_by_size(shape, distance, wavelength_m, item.name in declared)
        elif item.name in declared:
            role = ScatteringModel.TARGET
        elif ratio >= LARGE:
            role = ScatteringModel.SURFACE
        else:
            whole = item.name not in part_of_declared
            whole &= _has_table(shape, distance, wavelength_m)
            role = ScatteringModel.TABLE if whole else ScatteringModel.OBSTACLE
        assignments.append(Assignment(item.name, role, ratio, wanted is role))
    return assignments


def declared_alone(scene: Scene, roles: Sequence[Assignment]) -> list[Target]:
    """Targets that answer with their declared cross-section: no mesh of theirs scatters."""
    silent = {a.name for a in roles if a.role is ScatteringModel.TARGET}
    return [t for t in scene.targets if t.object is None or t.object in silent]


def _beside(scene: Scene, declared: set[str]) -> set[str]:
    """Objects that touch one of those declared."""
    if not declared:
        return set()
    names = [item.name for item in scene.objects]
    neighbours = set()
    for i, j in touching(scene.objects).tolist():
        neighbours |= {names[i]} if names[j] in declared else set()
        neighbours |= {names[j]} if names[i] in declared else set()
    return neighbours


def role_by_size(
    shape: Shape, distance_m: float, wavelength_m: float, is_declared: bool = False
) -> ScatteringModel:
    """What an object is by the rule of this module where meshes scatter by physical optics."""
    zone = (wavelength_m * distance_m) ** 0.5
    large_m2 = shape.area_in_patches_m2((LARGE_BESIDE_OPTICS * zone) ** 2)
    is_flat = shape.bend_radius_m >= _BENT * distance_m
    if large_m2 >= _MOSTLY * shape.area_m2 and is_flat:
        return ScatteringModel.SURFACE
    if shape.size_m >= SMALLEST * wavelength_m:
        return ScatteringModel.OPTICS
    return ScatteringModel.TARGET if is_declared else ScatteringModel.OBSTACLE


def _has_table(shape: Shape, distance_m: float, wavelength_m: float) -> bool:
    size = shape.size_m
    is_far = distance_m >= 2 * size**2 / wavelength_m
    return is_far and SMALLEST * wavelength_m <= size <= _LARGEST_TABLE * wavelength_m
