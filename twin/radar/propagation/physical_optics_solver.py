"""The solver of physical optics: all echoes of a scene, paths by name and dense ones."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.body_levels import body_levels
from twin.radar.propagation.corner_echoes import corner_echoes
from twin.radar.propagation.diffraction.corners import longest_m
from twin.radar.propagation.diffraction.rims import farthest
from twin.radar.propagation.diffraction.screens import Screens, screens
from twin.radar.propagation.edges_beside_ways import (
    edges_beside,
    mirror_borders,
    mirrored_ways,
    worth_following,
)
from twin.radar.propagation.effects_by_bounds import (
    corners,
    faint_bodies,
    further_reflections,
    over_two_edges,
    round_obstacles,
    sharp_edges,
)
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.facets.reflections import LEAST_IMAGES, MOST_IMAGES
from twin.radar.propagation.left_out import on_meshes
from twin.radar.propagation.one_way.motion import target_motion
from twin.radar.propagation.physical_optics import (
    at_antenna,
    followed_everywhere,
    loss_of,
    obstacles_of,
    scattered,
    surface_clutter,
)
from twin.radar.propagation.prepared_scene import FurtherPaths, PreparedScene, prepare_scene
from twin.radar.propagation.result import Heard, PathName, Propagation, by_delay
from twin.radar.propagation.roughness import (
    absorbing_surfaces,
    rough_surfaces,
    smooth_bodies,
    smooth_surfaces,
)
from twin.radar.propagation.scene.image_search import FURTHER, MANY_IMAGES
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.parts import silent_parts
from twin.radar.propagation.scene.parts_in_line import parts_in_line
from twin.radar.propagation.scene.scattering_models import (
    Assignment,
    ScatteringModel,
    assign_scattering_models,
    declared_alone,
)
from twin.radar.propagation.scene.silent import silent_objects
from twin.radar.propagation.single_paths import mirror_echoes, point_echoes
from twin.radar.propagation.wall_dispersion import dispersion_errors
from twin.radar.synthesis import Contributions
from twin.scene import Scene, Target

Array = NDArray[np.float64]

#: Where there are more than `MANY_IMAGES`: paths of facets' echoes by pairs of images, up to which
#: two reflections are followed; some 8 us each, one after the other.
MOST_ECHO_PATHS = 2**20
#: Where the number of reflections is given instead, before they are refused: 7e6 of two reflections
#: in the middle of Munich take 30 s and 1.6 GB; there are 3e7 of three.
#: Where bounds decide on all else, up to six reflections at bodies and edges among it, they are not
#: done after eight minutes: then `MOST_ECHO_PATHS` is the limit.
MOST_PATHS_BY_HAND = 2**24
#: Paths of facets' echoes up to which three reflections are followed, by which a corner of a room
#: returns what comes past a body, and up to which more are.
_THIRD_PATHS, _FURTHER_PATHS = 2**18, 2**16
_UNSURE_MIRROR = 0.1  # of a mirror's free echo: error by edges before it that is warned of
_MORE_BY_TWO = 8  # times as many by up to two reflections as by one, or more


def echoes(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: TracedFrame | None = None,
    *,
    keep: bool = False,
    followed_s: float | None = None,
) -> Propagation:
    """Mirror images, declared points and scattering meshes, by the same one-way paths;
    ``earlier``, ``keep`` and ``followed_s`` as of `physical_optics.scattered`.

    Raises InputError where a material has no data at the carrier.
    """
    roles = assign_scattering_models(scene, radar.ofdm.wavelength_m, with_optics=True)
    rough, on_roughness = rough_surfaces(scene, radar, roles, fidelity)
    prepared, further = _prepared(scene, radar, roles, fidelity, rough)
    of_bodies = scattered(
        prepared,
        radar,
        fidelity,
        earlier,
        further_images=None if further is None else further.objects,
        keep=keep,
        followed_s=followed_s,
    )
    body, traced = of_bodies.body, of_bodies.contributions
    lit = at_antenna(traced, prepared, radar)
    by_rays = body_levels(prepared, radar, fidelity, of_bodies, lit)
    obstacles = obstacles_of(prepared, fidelity)
    worth = worth_following(prepared, radar, fidelity, by_rays, lit, obstacles)
    of_corners = corner_echoes(
        scene, roles, prepared, radar, fidelity, body, traced, worth, obstacles, followed_s
    )
    if len(of_corners.replaced) or len(of_corners.echoes):
        rest = lit.take(np.delete(np.arange(len(lit)), of_corners.replaced))
        lit = Contributions.concatenate([rest, at_antenna(of_corners.echoes, prepared, radar)])
    hard = body_levels(prepared, radar, fidelity, of_bodies, lit)
    mirrored = mirrored_ways(prepared, radar, fidelity, hard, lit, obstacles)
    behind = round_obstacles(prepared, radar, fidelity, hard, mirrored.ways, obstacles)
    shadowed = at_antenna(behind.echoes, prepared, radar)
    surfaces = Contributions.concatenate([lit, shadowed])
    levels = body_levels(prepared, radar, fidelity, of_bodies, surfaces)
    decisions = [*on_roughness, *faint_bodies(prepared, radar, levels)]
    left_out = dispersion_errors(scene, prepared, radar, of_bodies.body)
    for decided, missing in (
        further_reflections(levels, fidelity, of_bodies.choice, radar),
        (edges := sharp_edges(prepared, radar, fidelity, levels)).decided,
        behind.decided_by(levels),
        corners(of_corners, prepared, radar, levels),
        edges_beside(
            prepared, radar, fidelity, levels, lit, of_corners.bodies, mirrored, obstacles
        ),
        mirror_borders(prepared, radar, fidelity, levels, lit, mirrored, obstacles),
    ):
        decisions += decided
        left_out = np.hypot(left_out, missing)  # by other paths each, of phases of their own
    of_edges = at_antenna(edges.echoes, prepared, radar)
    clutter, on_clutter = surface_clutter(scene, prepared, rough, fidelity)
    # In rooms there are millions: as at the antenna alone they are kept, and joined once.
    diffuse = [*(at_antenna(part, prepared, radar) for part in clutter), of_edges]
    diffuse = [echoes.in_proportion_to_wavelength() for echoes in diffuse]
    mirrors = _mirrors(scene, roles, prepared, radar, fidelity)
    declared = declared_alone(scene, roles)
    points = _points(scene, prepared, radar, declared, fidelity)
    has_more = np.zeros(len(declared), dtype=bool) if further is None else further.points
    missed = _missed_images(declared, has_more, points, prepared)
    names, paths = by_delay(
        [*mirrors[0], *points[0]], Contributions.concatenate([mirrors[1], points[1]])
    )
    unbounded = _unbounded(fidelity, prepared)
    left_out *= levels.reference
    levels = levels.with_edges(of_edges, radar.ofdm)
    of_two_edges, missing = over_two_edges(levels, radar, of_edges)
    left_out = np.hypot(left_out / levels.reference, missing)
    loss = loss_of(radar)
    every = Contributions.concatenate([paths, *diffuse, surfaces])
    of_facets = every.take(slice(len(every) - len(surfaces) - len(of_edges), None))
    profiles = levels.profiles(of_facets, of_bodies.by_range.times(loss), radar.ofdm)
    bodies = levels.bodies(of_bodies.error * loss, left_out, profiles, is_bounded=not unbounded)
    return Propagation(
        every,
        names,
        roles=tuple(roles),
        assumptions=(
            *on_meshes(
                fidelity,
                len(prepared.world.face_ranges),
                len(levels.names),
                edges.n_left_out,
                behind.n_left_out(levels),
                behind.too_large,
            ),
            *prepared.assumptions,
            *edges.remarks,
            *on_clutter,
            *smooth_bodies(scene, radar, roles, fidelity),
            *unbounded,
            *behind.remarks,
        ),
        heard=_heard(every.take(slice(len(names), None)), prepared, radar),
        warnings=(
            *silent_objects(scene, radar, roles),
            *silent_parts(scene, radar),
            *parts_in_line(prepared, body, levels.names, fidelity),
            *absorbing_surfaces(scene, radar, rough),
            *smooth_surfaces(scene, radar, roles, fidelity),
            *mirrors[2],
            *missed,
        ),
        objects=tuple(item.name for item in prepared.items),
        bodies=bodies,
        decisions=(*decisions, *of_two_edges),
        traced=of_bodies.traced,
        reused_share=of_bodies.reused_share,
    )


def _prepared(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    fidelity: Fidelity,
    rough: Collection[str],
) -> tuple[PreparedScene, FurtherPaths | None]:
    """With the images that are followed; by bounds also to what there are further ones."""
    if fidelity.radar_images is not None:
        return _with_images(scene, radar, roles, fidelity, rough), None
    # One more reflection, to know whether there is any beyond those that are followed.
    prepared = prepare_scene(scene, radar, roles, MOST_IMAGES + 1, rough=rough, many=MANY_IMAGES)
    orders = [len(image.patches) for image in prepared.images]
    if prepared.has_more_images and max(orders) < LEAST_IMAGES:
        if _echo_paths(prepared) <= MOST_ECHO_PATHS / _MORE_BY_TWO:
            further = prepare_scene(scene, radar, roles, LEAST_IMAGES, rough=rough)
            if _echo_paths(further) <= MOST_ECHO_PATHS:
                prepared = replace(further, has_more_images=True)
        return prepared.up_to(LEAST_IMAGES)
    # Between mirrors that face each other a flat body may glint in any image.
    for order in range(min(MOST_IMAGES, max(orders)), LEAST_IMAGES, -1):
        fewer, beyond = prepared.up_to(order)
        limit = _THIRD_PATHS if order == LEAST_IMAGES + 1 else _FURTHER_PATHS
        if len(fewer.images) <= FURTHER and _echo_paths(fewer) <= limit:
            return fewer, beyond
    return prepared.up_to(LEAST_IMAGES)


def _with_images(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    fidelity: Fidelity,
    rough: Collection[str],
) -> PreparedScene:
    """With all images of as many reflections as are given.

    Raises InputError where echoes over pairs of them take too many paths, before these are traced;
    of more than two reflections before images of still more are looked for.
    """
    most, others = fidelity.radar_images or 0, ("bounces", "edges", "shadowed")
    by_bounds = None in (getattr(fidelity, f"radar_{knob}") for knob in others)
    limit = MOST_ECHO_PATHS if by_bounds else MOST_PATHS_BY_HAND
    for order in range(min(most, 2), most + 1):
        prepared = prepare_scene(scene, radar, roles, order, rough=rough)
        if order > 1 and (paths := _echo_paths(prepared)) > limit:
            images = len(prepared.all_images) - 1
            raise InputError(
                f"fidelity.radar_images = {most}: {images} images of the radar by up to {order} "
                f"reflections at large surfaces, and {paths / 1e6:.3g} million paths to facets "
                f"over pairs of them, expected at most {limit / 1e6:.3g} million: set "
                f"fidelity.radar_images = {order - 1}, or leave it to a tolerance "
                "(fidelity.tolerance), which follows as many as count and bounds the rest"
            )
    return prepared


def _echo_paths(prepared: PreparedScene) -> int:
    """Pairs of images over which the facets of bodies are lit and seen, those of all facets
    together, as if none faced away.
    """
    images = prepared.worth.sum(axis=0)
    faces = np.array([len(item.geometry.faces) for item in prepared.items], dtype=np.int64)
    is_body = np.array([role is ScatteringModel.OPTICS for role in prepared.roles], dtype=bool)
    return int((faces * images * (images + 1) // 2)[is_body].sum())


def _unbounded(fidelity: Fidelity, prepared: PreparedScene) -> tuple[str, ...]:
    """What fixed knobs leave out, without a bound."""
    left_out = {
        f"more than {fidelity.radar_bounces} bounces": fidelity.radar_bounces,
        f"images beyond order {fidelity.radar_images}": (
            fidelity.radar_images if len(prepared.flats) else None
        ),
        "sharp edges": None if fidelity.radar_edges else fidelity.radar_edges,
        "waves round obstacles": fidelity.radar_shadowed,
    }
    told = [effect for effect, fixed in left_out.items() if fixed is not None]
    if not told:
        return ()
    return (f"stated errors do not hold what {', '.join(told)} add: a tolerance bounds it",)


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


def _heard(echoes: Contributions, prepared: PreparedScene, radar: RadarDesign) -> tuple[Heard, ...]:
    cycles = radar.ofdm.carrier_hz * echoes.delay_s % 1.0
    wave = echoes.amplitude * np.exp(-2j * np.pi * cycles)
    n, owner = len(prepared.items), echoes.object
    count = np.bincount(owner, minlength=n)
    total = np.bincount(owner, wave.real, n) + 1j * np.bincount(owner, wave.imag, n)
    return tuple(
        Heard(item.name, int(count[i]), float(abs(total[i]) ** 2))
        for i, item in enumerate(prepared.items)
        if count[i]
    )
