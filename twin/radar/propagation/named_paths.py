"""Single paths by name: the radar's own images in mirrors, and declared points, direct and over
mirrors and edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.diffraction.corners import longest_m
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.screens import Screens, screens
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.one_way.motion import target_motion
from twin.radar.propagation.physical_optics import at_antenna, followed_everywhere
from twin.radar.propagation.prepared_scene import FurtherPaths, PreparedScene, prepare_scene
from twin.radar.propagation.result import PathName, by_delay
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.scattering_models import (
    Assignment,
    ScatteringModel,
    declared_alone,
)
from twin.radar.propagation.single_paths import mirror_echoes, point_echoes
from twin.radar.synthesis import Contributions
from twin.scene import Scene, Target

_UNSURE_MIRROR = 0.1  # of a mirror's free echo: error by edges before it that is warned of


@dataclass(frozen=True, eq=False)
class NamedPaths:
    """Paths at the antenna with their names, the nearest first, and what is warned of them."""

    names: tuple[PathName, ...]
    paths: Contributions
    warnings: tuple[str, ...]


def named_paths(
    scene: Scene,
    roles: Sequence[Assignment],
    prepared: PreparedScene,
    further: FurtherPaths | None,
    radar: RadarDesign,
    fidelity: Fidelity,
) -> NamedPaths:
    """Of mirrors and declared points; ``further``: to what there are more images than these."""
    mirrors = _mirrors(scene, roles, prepared, radar, fidelity)
    declared = declared_alone(scene, roles)
    points = _points(scene, prepared, radar, declared, fidelity)
    has_more = np.zeros(len(declared), dtype=bool) if further is None else further.points
    names, paths = by_delay(
        [*mirrors[0], *points[0]], Contributions.concatenate([mirrors[1], points[1]])
    )
    warnings = *mirrors[2], *_missed_images(declared, has_more, points, prepared)
    return NamedPaths(names, paths, warnings)


def _mirrors(
    scene: Scene,
    roles: Sequence[Assignment],
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
) -> tuple[list[PathName], Contributions, tuple[str, ...]]:
    """The radar's own images: as many reflections as out and back together; and a warning."""
    if fidelity.radar_images == 0 or len(prepared.flats) == 0:
        return [], Contributions.none(), ()
    if fidelity.radar_shadow_db <= 0:
        further = prepared.seen_by_itself()
        return *_paths(further, radar, mirror_echoes(further)[0], [None], [()]), ()
    faintest = followed_everywhere(fidelity)
    wavenumber = 2 * np.pi / prepared.wavelength_m
    longer_m = farthest(faintest) / wavenumber, longest_m(prepared.wavelength_m)
    further = _heard_mirrors(prepared.seen_by_itself(*longer_m), radar)
    obstacles = _before_mirrors(scene, radar, roles, fidelity)
    traced, off = mirror_echoes(further, obstacles, faintest)
    return *_paths(further, radar, traced, [None], [()]), _behind_edges(off)


def _behind_edges(off: dict[str, float]) -> tuple[str, ...]:
    """Warnings of mirrors' echoes that edges before them leave uncertain, of the free echo."""
    unknown = [name for name, error in off.items() if np.isinf(error)]
    told: tuple[str, ...] = ()
    if unknown:
        told = (
            f"the specular echo of {', '.join(unknown)} may be wholly present or missing: more "
            "edges stand near its ray than are computed; its level is not to be relied on",
        )
    return told + tuple(
        f"the specular echo of {name} may be off by {error:.2g} of what it were without the edges "
        "before it: they are many, or stand far aside"
        for name, error in off.items()
        if _UNSURE_MIRROR < error < np.inf
    )


def _heard_mirrors(prepared: PreparedScene, radar: RadarDesign) -> PreparedScene:
    """Without images in single mirrors towards which the antenna has no gain, as in the ground."""

    def is_heard(image: Image) -> bool:
        towards = image.place - image.places[0]
        towards = towards / max(float(np.linalg.norm(towards)), 1e-300)
        return bool(radar.antenna.gain(towards[None] @ prepared.axes.T)[0] > 0)

    return prepared.with_images([i for i in prepared.images if len(i.patches) != 1 or is_heard(i)])


def _before_mirrors(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment], fidelity: Fidelity
) -> Screens | None:
    """What may stand before mirrors: all else, if there is any, in a scene of its own."""
    away = {a.name for a in roles if a.role in (ScatteringModel.SURFACE, ScatteringModel.TARGET)}
    objects = tuple(item for item in scene.objects if item.name not in away)
    if not objects:
        return None
    alone = prepare_scene(replace(scene, objects=objects), radar, roles, 0)
    return screens(alone, fidelity.radar_shadow_db)


def _points(
    scene: Scene,
    prepared: PreparedScene,
    radar: RadarDesign,
    declared: Sequence[Target],
    fidelity: Fidelity,
) -> tuple[list[PathName], Contributions]:
    """Echoes of declared points; a path around an edge names the obstacle."""
    if not declared:
        return [], Contributions.none()
    obstacles = screens(prepared, fidelity.radar_shadow_db)
    motions = [target_motion(scene, target) for target in declared]
    echoes, two_way = point_echoes(
        prepared.context, declared, motions, prepared.anchor_m, obstacles
    )

    def over(item: int) -> tuple[str, ...]:
        return (prepared.items[item].name,) if item >= 0 else ()

    names = [declared[path.target].name for path in two_way]
    objects_on_path = [
        (*over(path.forward_obstacle), name, *over(path.return_obstacle))
        for path, name in zip(two_way, names, strict=True)
    ]
    return _paths(prepared, radar, echoes, names, objects_on_path)


def _missed_images(
    declared: Sequence[Target],
    has_more: NDArray[np.bool_],
    points: tuple[Sequence[PathName], Contributions],
    prepared: PreparedScene,
) -> tuple[str, ...]:
    """Warnings of declared points to which there are paths by more reflections than are followed;
    what they add is bounded as of bodies, by what those of the last ones are together.
    """
    names, paths = points
    order = np.array([len(image.patches) for image in prepared.images])
    of_path = np.maximum(order[paths.source], order[paths.receiver])
    told = []
    for number in np.flatnonzero(has_more).tolist():
        target = declared[number].name
        mine = np.array([name.target == target for name in names], dtype=bool)
        every = np.abs(paths.amplitude[mine])
        last = every[of_path[mine] == order.max()].sum() / max(np.linalg.norm(every), 1e-300)
        if last > OF_TOLERANCE:
            told.append(
                f"{target}: reflections at large surfaces beyond {order.max()} are "
                f"not followed; they may add {100 * last:.0f} % of its echo"
            )
    return tuple(told)


def _paths(
    prepared: PreparedScene,
    radar: RadarDesign,
    traced: Contributions,
    targets: Sequence[str | None],
    objects_on_path: Sequence[tuple[str, ...]],
) -> tuple[list[PathName], Contributions]:
    """Paths with their names, by their ``object`` the target and what they meet between the large
    surfaces; ``traced`` per wavelength.
    """
    ends = zip(traced.object, traced.source, traced.receiver, strict=True)
    names = [
        PathName(
            (*prepared.via(source), *objects_on_path[row], *prepared.via(receiver)[::-1]),
            targets[row],
        )
        for row, source, receiver in ends
    ]
    paths = at_antenna(traced, prepared, radar)
    return names, replace(paths, amplitude=paths.amplitude * prepared.wavelength_m)
