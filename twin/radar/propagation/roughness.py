"""Which objects count as rough: those whose clutter, or whose loss, a bound says counts."""

from collections.abc import Collection, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from hardware.formatting import si
from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.geometry.faces import areas
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.physical_optics import loss_of
from twin.radar.propagation.scene.culling import (
    OF_NOISE,
    beam_of,
    most_gain,
    noise_amplitude,
)
from twin.radar.propagation.scene.scattering_models import Assignment, ScatteringModel
from twin.radar.propagation.surface_clutter import coherent, sampled
from twin.scene import Scene, SceneObject
from twin.scene.boxes import boxes_of, distances_m

Array = NDArray[np.float64]

_POINTS = 2**14  # on each surface
#: Amplitude of what reaches a point directly and over one mirror, out and home, over the direct
#: one's.
_BY_IMAGES = 4.0


def rough_surfaces(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment], fidelity: Fidelity
) -> tuple[frozenset[str], tuple[Decision, ...]]:
    """Names of the objects that lose what they scatter, and scatter it; and, where
    ``fidelity.radar`` is ``auto``, the decisions on them.

    Large surfaces may, and bodies of a material with a gamma: without one the relief of a body is
    taken for part of its shape (`smooth_bodies`). An object counts where its clutter in any range
    cell, as if nothing hid it and over one mirror as well, may exceed a tenth of the noise of a
    cell of the map; or where what it mirrors loses more at normal incidence, where it loses most,
    than is permitted of each effect.
    """
    if fidelity.radar not in ("auto", "rough"):
        return frozenset(), ()
    candidates = {item.name for item in _that_may(scene, roles)}
    if fidelity.radar == "rough":
        return frozenset(candidates), ()
    permitted = OF_TOLERANCE * fidelity.radar_tolerance
    names, decisions = set[str](), list[Decision]()
    for item, bound in zip(scene.objects, _most_clutter(scene, radar).tolist(), strict=True):
        relief, began_s = scene.materials[item.material].surface, perf_counter()
        if item.name not in candidates:
            continue
        if relief is None:  # of which is remarked that it does not scatter
            names.add(item.name)
            continue
        gamma = _gamma(scene, item)
        # Of ten thousand objects most are too far off, or beside the beam, to be sampled.
        clutter = bound * float(np.sqrt(gamma or 0.0))
        if clutter > OF_NOISE:
            clutter = _clutter(scene, radar, item, gamma or 0.0)
        loss = _loss(scene, radar, item)
        is_taken = clutter > OF_NOISE or loss > permitted
        if is_taken:
            names.add(item.name)
        cost_s = perf_counter() - began_s
        decisions += [
            Decision(
                "radar",
                f"clutter of {item.name}",
                clutter,
                OF_NOISE,
                "of a cell's noise",
                is_taken,
                cost_s,
            ),
            Decision(
                "radar",
                f"what {item.name} scatters of what it mirrors",
                loss,
                permitted,
                "of the echo",
                is_taken,
                0.0,
            ),
        ]
    return frozenset(names), tuple(decisions)


def absorbing_surfaces(scene: Scene, radar: RadarDesign, rough: Collection[str]) -> tuple[str, ...]:
    """Warnings of rough surfaces that mirror less than half of the power at normal incidence, and
    scatter nothing of what is missing, since their material has no gamma.
    """
    warned = []
    for item in scene.objects:
        relief = scene.materials[item.material].surface
        if item.name not in rough or relief is None or relief.backscatter_gamma is not None:
            continue
        height_m, left = relief.rms_height_m.value, (1 - _loss(scene, radar, item)) ** 2
        if left < 0.5:
            warned.append(
                f"{item.name} absorbs what its roughness takes from its reflection: "
                f"{item.material} has surface.rms_height_m = {si(height_m, 'm')}, which leaves "
                f"{left:.2g} of the power, and no surface.backscatter_gamma to scatter the rest"
            )
    return tuple(warned)


def smooth_surfaces(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment], fidelity: Fidelity
) -> tuple[str, ...]:
    """A warning, under the model ``optics``, of what it takes for smooth although its relief would
    take more from what it mirrors than `radar_tolerance`: by material, at normal incidence.
    """
    if fidelity.radar != "optics":
        return ()
    names: dict[str, list[str]] = {}
    lost_db: dict[str, float] = {}
    for item in _that_may(scene, roles):
        if (loss := _loss(scene, radar, item)) > fidelity.radar_tolerance:
            names.setdefault(item.material, []).append(item.name)
            lost_db[item.material] = -20 * np.log10(max(1 - loss, 1e-10))
    if not names:
        return ()
    told = [
        f"{of[0]}{f' and {len(of) - 1} more' * (len(of) > 1)} ({material}) by "
        f"{lost_db[material]:.1f} dB"
        for material, of in sorted(names.items())
    ]
    return (
        "fidelity.radar = 'optics' takes surfaces for smooth: their roughness would weaken what "
        f"they mirror at normal incidence, {', '.join(told)}; 'auto' and 'rough' count it",
    )


def smooth_bodies(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment], fidelity: Fidelity
) -> tuple[str, ...]:
    """What is assumed of bodies whose material has a height and no gamma: they mirror as smooth
    ones, which is told where roughness would take more than a tolerance permits.
    """
    lost = {
        item.material: _loss(scene, radar, item)
        for item, role in _with_roles(scene, roles)
        if role is ScatteringModel.OPTICS and _gamma(scene, item) is None
    }
    permitted = OF_TOLERANCE * fidelity.radar_tolerance
    told = [f"{name} ({loss:.2g})" for name, loss in sorted(lost.items()) if loss > permitted]
    if not told:
        return ()
    return (
        "bodies of a material without gamma mirror as if they were smooth; as rough as their "
        f"rms_height_m their facets would lose, of the amplitude: {', '.join(told)}",
    )


def _that_may(scene: Scene, roles: Sequence[Assignment]) -> list[SceneObject]:
    """Large surfaces, and bodies of a material with a gamma."""
    return [
        item
        for item, role in _with_roles(scene, roles)
        if role is ScatteringModel.SURFACE
        or (role is ScatteringModel.OPTICS and _gamma(scene, item) is not None)
    ]


def _with_roles(
    scene: Scene, roles: Sequence[Assignment]
) -> list[tuple[SceneObject, ScatteringModel]]:
    role_of = {a.name: a.role for a in roles}
    return [(item, role_of[item.name]) for item in scene.objects]


def _gamma(scene: Scene, item: SceneObject) -> float | None:
    relief = scene.materials[item.material].surface
    gamma = relief.backscatter_gamma if relief else None
    return None if gamma is None else gamma.value


def _loss(scene: Scene, radar: RadarDesign, item: SceneObject) -> float:
    """Share of the amplitude that an object's relief takes from what it mirrors at normal
    incidence, where it takes most.
    """
    relief = scene.materials[item.material].surface
    height = relief.rms_height_m.value if relief else 0.0
    return 1 - float(coherent(height, np.ones(1), radar.ofdm.wavelength_m)[0])


def _most_clutter(scene: Scene, radar: RadarDesign) -> Array:
    """Bounds of `_clutter` of all objects at a gamma of 1, (n_objects,), that take no points: all
    of a surface in one cell, at right angles, as near and in as high a gain as any of its box.
    """
    device, axes = scene.rig.device("radar")
    place, boxes = scene.rig.position_m + device, boxes_of(scene.objects)
    distance = np.maximum(distances_m(boxes, place), radar.ofdm.wavelength_m)
    gain = most_gain(beam_of(radar.antenna), place[None], axes[:1], boxes)[0]
    area = np.array([areas(item.vertices_m, item.geometry.faces).sum() for item in scene.objects])
    scale = loss_of(radar) * radar.ofdm.wavelength_m / (4 * np.pi) ** 1.5
    most = scale * gain / distance**2 * np.sqrt(area)
    return np.asarray(_BY_IMAGES * most / noise_amplitude(radar))


def _clutter(scene: Scene, radar: RadarDesign, item: SceneObject, gamma: float) -> float:
    """Bound of the clutter of a surface in a range cell, over the noise of a cell of the map, both
    root mean square: gamma cos(theta) a unit of area, the antenna's gain towards it.
    """
    field = sampled(item, _POINTS, seed=0)
    place, axes = scene.rig.device("radar")
    corners = item.vertices_m[item.geometry.faces[field.face]] - (scene.rig.position_m + place)
    points = np.einsum("nk,nkd->nd", field.weights, corners)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance = np.maximum(np.linalg.norm(points, axis=1), radar.ofdm.wavelength_m)
    towards = points / distance[:, None]
    size = np.maximum(np.linalg.norm(across, axis=1), 1e-300)
    cosine = np.abs(np.sum(towards * across, axis=1)) / size
    gain = radar.antenna.gain(towards @ axes.T)
    scale = loss_of(radar) * radar.ofdm.wavelength_m / (4 * np.pi) ** 1.5
    power = (scale * gain) ** 2 * gamma * cosine * field.area_m2 / distance**4
    cell_m = speed_of_light / (2 * radar.total_bandwidth_hz)
    cell = np.minimum(distance / cell_m, _POINTS).astype(np.int64)
    most = np.bincount(cell, weights=power).max(initial=0.0)
    return float(_BY_IMAGES * np.sqrt(most) / noise_amplitude(radar))
