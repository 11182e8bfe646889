"""Emitter and detector of a system, mounted on the rig of a scene."""

import math
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.optics.devices import Device
from twin.optics.emission import lobe_exponent
from twin.optics.interreflection import Body
from twin.optics.problem import LightProblem
from twin.optics.radiometry import Collection, cell_centres, collection, near_pupil_m
from twin.optics.weather import air_of_system
from twin.scene import Scene, SceneObject
from twin.scene.enclosure import touches
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System

Array = NDArray[np.float64]

#: Height over longest edge of a face below which it is narrow; how many of them count, of each
#: object, and at how many points.
_NARROW, _MOST_NARROW, _ALONG = 1 / 16, 1000, 63
#: Devices closer together than this count as being at the same position.
_APART_M = 1e-9


def devices(scene: Scene, system: System) -> tuple[Device, Device, Collection]:
    """Emitter and detector mounted on the rig, and the detector's lens."""
    lens = collection(system)
    made, optics = system.emitter, system.optics
    emitter = Device(
        *scene.rig.device("emitter"),
        tan_half_field=_tan(made.field_of_view_deg.value / 2),
        blur_tan=_tan(made.blur_rms_deg.value) if made.blur_rms_deg else 0.0,
        lobe_exponent=lobe_exponent(made.viewing_angle_deg.value)
        if made.viewing_angle_deg
        else 0.0,
        fill_factor=made.fill_factor.value if made.fill_factor else 1.0,
        pitch_m=made.pitch_m.value if made.pitch_m and not made.has_lens else None,
    )
    detector = Device(
        *scene.rig.device("detector"),
        # One that follows the spot is not stopped by the field's border.
        tan_half_field=lens.tan_half_field * (2 if optics.is_scanned else 1),
        outline=lens.outline,
        blur_tan=_tan(optics.blur_rms_deg.value) if optics.blur_rms_deg else 0.0,
        edge_illumination=optics.edge_illumination.value if optics.edge_illumination else 1.0,
        pupil_radius_m=lens.pupil_diameter_m / 2 if optics.focus_m else 0.0,
        focus_m=optics.focus_m.value if optics.focus_m else math.inf,
    )
    return emitter, detector, lens


def light_problem(scene: Scene, system: System, mesh_scene: Any = None) -> LightProblem:
    """Light transport problem of a system in a scene, under the scene's sun, in the system's air;
    ``mesh_scene`` is `mitsuba_scene(scene)`, if already built.
    """
    emitter, detector, _ = devices(scene, system)
    if mesh_scene is None:
        mesh_scene = mitsuba_scene(scene)
    return LightProblem(
        mesh_scene,
        emitter,
        detector,
        scene.sun.direction,
        air_of_system(system),
        cache(partial(_corners, scene)),
        cache(partial(_bodies, scene)),
    )


def _bodies(scene: Scene) -> list[Body]:
    """Meshes relative to the rig; a texture's largest reflectance is taken."""
    return [
        Body(
            item.geometry,
            item.vertices_m - scene.rig.position_m,
            item.reflectance
            if isinstance(item.reflectance, float | int)
            else float(item.reflectance.image.max()),
        )
        for item in scene.objects
    ]


def _corners(scene: Scene) -> tuple[Array, Array]:
    """Positions of all vertices, relative to the rig, and their reflectances, 1 with a texture; and
    points along narrow faces, which may pass between paths far from their corners.
    """
    if not scene.objects:
        return np.zeros((0, 3)), np.zeros(0)
    places, reflectances = [], []
    for item in scene.objects:
        points = np.concatenate([item.vertices_m, _along_narrow_faces(item)])
        known = item.reflectance if isinstance(item.reflectance, float) else 1.0
        places.append(points)
        reflectances.append(np.full(len(points), known))
    return np.concatenate(places) - scene.rig.position_m, np.concatenate(reflectances)


def _along_narrow_faces(item: SceneObject) -> Array:
    """Points (n, 3) on the longest edges of an object's narrow faces, the longest ones first."""
    corners = item.vertices_m[item.geometry.faces]
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    longest, rows = lengths.argmax(axis=1), np.arange(len(corners))
    length = lengths[rows, longest]
    is_narrow = 2 * item.geometry.areas_m2 < _NARROW * length**2
    narrow = np.flatnonzero(is_narrow)
    narrow = narrow[np.argsort(-length[narrow], kind="stable")][:_MOST_NARROW]
    start, edge = corners[narrow, longest[narrow]], edges[narrow, longest[narrow]]
    along = np.linspace(0, 1, _ALONG + 2)[1:-1]
    return np.asarray((start[:, None] + along[:, None] * edge[:, None]).reshape(-1, 3))


def with_near_pupil(problem: LightProblem, system: System, depth_m: Array) -> LightProblem:
    """The problem with the pupil's area in it where a surface in sight is so near that the area
    matters; ``depth_m`` of the image, infinite where there is no surface.
    """
    detector = problem.detector
    radius = near_pupil_m(collection(system), float(depth_m.min(initial=math.inf)))
    if not radius or detector.pupil_radius_m:
        return problem
    return replace(problem, detector=replace(detector, disc_radius_m=radius))


def check_rig(scene: Scene, system: System) -> None:
    """Raise InputError where the light of a rig is undefined: emitter or detector lie in a surface,
    at distance zero; or, in scattering air, the detector lies in the emitter's beam, where the
    backscatter is infinite.
    """
    check_clear(scene)
    if (air := air_of_system(system)) is None or not air.scattering_per_m:
        return
    emitter, detector, _ = devices(scene, system)
    ahead, *across = emitter.axes @ (detector.origin_m - emitter.origin_m)
    beside = max(abs(step) for step in across) > max(emitter.tan_half_field * ahead, _APART_M)
    if ahead < -_APART_M or beside:
        return
    path = Path(scene.path).with_name("scene.toml")
    there, here = (scene.rig.device(name)[0].tolist() for name in ("detector", "emitter"))
    raise InputError(
        f"{path}: rig.detector.offset_m = {there}: the detector is in the emitter's beam "
        f"(rig.emitter.offset_m = {here}), where the backscatter of the air is infinite: with the "
        f"weather of system {system.name!r}, expected a position outside the beam"
    )


def check_clear(scene: Scene) -> None:
    """Raise InputError where emitter or detector lie in a surface: its distance is zero, and its
    light undefined.
    """
    for name in ("emitter", "detector"):
        place = scene.rig.position_m + scene.rig.device(name)[0]
        if blocked := next((item.name for item in scene.objects if touches(item, place)), None):
            raise InputError(
                f"{scene.path}: rig: its {name}, at {place.round(6).tolist()} m, lies in the "
                f"surface of {blocked!r}: move the rig"
            )


def _tan(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg))


def field_points(shape: tuple[int, ...], tan_half_field: float) -> tuple[Array, Array]:
    """Middle of each cell on the plane at distance 1, left and up."""
    # From 0, so that the middle of an odd number is no negative zero.
    up, left = (tan_half_field * (0.0 - cell_centres(n)) for n in shape)
    return np.broadcast_to(left, shape), np.broadcast_to(up[:, None], shape)
