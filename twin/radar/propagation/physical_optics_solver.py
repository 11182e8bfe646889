"""The solver of physical optics: all echoes of a scene, paths by name and dense ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.body_levels import BodyLevels, body_levels
from twin.radar.propagation.corner_echoes import CornerEchoes, corner_echoes
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.edges_beside_ways import (
    MirroredWays,
    edges_beside,
    mirror_borders,
    mirrored_ways,
    worth_following,
)
from twin.radar.propagation.effects_by_bounds import (
    Edges,
    RoundObstacles,
    corners,
    faint_bodies,
    further_reflections,
    over_two_edges,
    round_obstacles,
    sharp_edges,
)
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.followed_images import with_followed_images
from twin.radar.propagation.left_out import on_meshes
from twin.radar.propagation.named_paths import named_paths
from twin.radar.propagation.physical_optics import (
    Scattered,
    at_antenna,
    loss_of,
    obstacles_of,
    scattered,
    surface_clutter,
)
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.result import Heard, Propagation
from twin.radar.propagation.roughness import (
    absorbing_surfaces,
    rough_surfaces,
    smooth_bodies,
    smooth_surfaces,
)
from twin.radar.propagation.scene.parts import silent_parts
from twin.radar.propagation.scene.parts_in_line import parts_in_line
from twin.radar.propagation.scene.scattering_models import Assignment, assign_scattering_models
from twin.radar.propagation.scene.silent import silent_objects
from twin.radar.propagation.wall_dispersion import dispersion_errors
from twin.radar.synthesis import Contributions
from twin.scene import Scene

Array = NDArray[np.float64]


class _Task(NamedTuple):
    """What is traced: a scene as it was prepared, and by what."""

    scene: Scene
    roles: Sequence[Assignment]
    prepared: PreparedScene
    radar: RadarDesign
    fidelity: Fidelity

    @property
    def traced(self) -> tuple[PreparedScene, RadarDesign, Fidelity]:
        """What most effects are computed from."""
        return self.prepared, self.radar, self.fidelity

    def at_antenna(self, echoes: Contributions) -> Contributions:
        """Echoes with the antenna's gains and the front end's losses."""
        return at_antenna(echoes, self.prepared, self.radar)


class _Surfaces(NamedTuple):
    """Echoes of bodies' surfaces: those by rays, with hard shadows or, by several reflections,
    round obstacles (``of_corners``), which are ``lit`` at the antenna; and what is ``behind``
    obstacles, on direct ways and over mirrors.
    """

    of_bodies: Scattered
    of_corners: CornerEchoes
    lit: Contributions
    obstacles: Screens | None
    mirrored: MirroredWays
    behind: RoundObstacles
    every: Contributions


class _Effects(NamedTuple):
    """What was decided on; what of it is ``left_out`` of every body, in amplitude; sharp edges."""

    decisions: tuple[Decision, ...]
    left_out: Array
    edges: Edges


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
    prepared, further = with_followed_images(scene, radar, roles, fidelity, rough)
    task = _Task(scene, roles, prepared, radar, fidelity)
    further_images = None if further is None else further.objects
    surfaces = _surfaces(task, earlier, further_images, keep=keep, followed_s=followed_s)
    of_bodies = surfaces.of_bodies
    levels = body_levels(*task.traced, of_bodies, surfaces.every)
    effects = _effects(task, surfaces, levels)
    of_edges = task.at_antenna(effects.edges.echoes)
    levels = levels.with_edges(of_edges, radar.ofdm)
    on_two_edges, over_two = over_two_edges(levels, radar, of_edges)
    left_out = np.hypot(effects.left_out / levels.reference, over_two)
    clutter, on_clutter = surface_clutter(scene, prepared, rough, fidelity)
    # In rooms there are millions: as at the antenna alone they are kept, and joined once.
    diffuse = [*(task.at_antenna(part) for part in clutter), of_edges]
    diffuse = [echoes.in_proportion_to_wavelength() for echoes in diffuse]
    named = named_paths(scene, roles, prepared, further, radar, fidelity)
    every = Contributions.concatenate([named.paths, *diffuse, surfaces.every])
    of_facets = every.take(slice(len(every) - len(surfaces.every) - len(of_edges), None))
    profiles = levels.profiles(of_facets, of_bodies.by_range.times(loss_of(radar)), radar.ofdm)
    unbounded = _unbounded(fidelity, prepared)
    return Propagation(
        every,
        named.names,
        roles=tuple(roles),
        assumptions=(
            *_on_meshes(task, surfaces.behind, effects.edges, levels),
            *prepared.assumptions,
            *effects.edges.remarks,
            *on_clutter,
            *smooth_bodies(scene, radar, roles, fidelity),
            *unbounded,
            *surfaces.behind.remarks,
        ),
        heard=_heard(every.take(slice(len(named.names), None)), prepared, radar),
        warnings=(
            *silent_objects(scene, radar, roles),
            *silent_parts(scene, radar),
            *parts_in_line(prepared, of_bodies.body, levels.names, fidelity),
            *absorbing_surfaces(scene, radar, rough),
            *smooth_surfaces(scene, radar, roles, fidelity),
            *named.warnings,
        ),
        objects=tuple(item.name for item in prepared.items),
        bodies=levels.bodies(
            of_bodies.error * loss_of(radar), left_out, profiles, is_bounded=not unbounded
        ),
        decisions=(*on_roughness, *effects.decisions, *on_two_edges),
        traced=of_bodies.traced,
        reused_share=of_bodies.reused_share,
    )


def _surfaces(
    task: _Task,
    earlier: TracedFrame | None,
    further_images: Array | None,
    *,
    keep: bool,
    followed_s: float | None,
) -> _Surfaces:
    """By rays first: how strong they find bodies decides which ways round obstacles count."""
    prepared, radar, fidelity = task.traced
    of_bodies = scattered(
        prepared,
        radar,
        fidelity,
        earlier,
        further_images=further_images,
        keep=keep,
        followed_s=followed_s,
    )
    body, traced = of_bodies.body, of_bodies.contributions
    lit = task.at_antenna(traced)
    by_rays = body_levels(*task.traced, of_bodies, lit)
    obstacles = obstacles_of(prepared, fidelity)
    worth = worth_following(*task.traced, by_rays, lit, obstacles)
    of_corners = corner_echoes(
        task.scene, task.roles, *task.traced, body, traced, worth, obstacles, followed_s
    )
    if len(of_corners.replaced) or len(of_corners.echoes):
        rest = lit.take(np.delete(np.arange(len(lit)), of_corners.replaced))
        lit = Contributions.concatenate([rest, task.at_antenna(of_corners.echoes)])
    hard = body_levels(*task.traced, of_bodies, lit)
    mirrored = mirrored_ways(*task.traced, hard, lit, obstacles)
    behind = round_obstacles(*task.traced, hard, mirrored.ways, obstacles)
    every = Contributions.concatenate([lit, task.at_antenna(behind.echoes)])
    return _Surfaces(of_bodies, of_corners, lit, obstacles, mirrored, behind, every)


def _effects(task: _Task, surfaces: _Surfaces, levels: BodyLevels) -> _Effects:
    """Of all that bounds decide on, and what is left out of bodies' echoes."""
    prepared, radar, fidelity = task.traced
    of_bodies, of_corners = surfaces.of_bodies, surfaces.of_corners
    lit, mirrored, obstacles = surfaces.lit, surfaces.mirrored, surfaces.obstacles
    edges = sharp_edges(*task.traced, levels)
    decisions = [*faint_bodies(prepared, radar, levels)]
    left_out = dispersion_errors(task.scene, prepared, radar, of_bodies.body)
    for decided, missing in (
        further_reflections(levels, fidelity, of_bodies.choice, radar),
        edges.decided,
        surfaces.behind.decided_by(levels),
        corners(of_corners, prepared, radar, levels),
        edges_beside(*task.traced, levels, lit, of_corners.bodies, mirrored, obstacles),
        mirror_borders(*task.traced, levels, lit, mirrored, obstacles),
    ):
        decisions += decided
        left_out = np.hypot(left_out, missing)  # by other paths each, of phases of their own
    return _Effects(tuple(decisions), left_out * levels.reference, edges)


def _on_meshes(
    task: _Task, behind: RoundObstacles, edges: Edges, levels: BodyLevels
) -> tuple[str, ...]:
    return on_meshes(
        task.fidelity,
        len(task.prepared.world.face_ranges),
        len(levels.names),
        edges.n_left_out,
        behind.n_left_out(levels),
        behind.too_large,
    )


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
