"""The solver of physical optics: all echoes of a scene, paths by name and dense ones."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.accuracy import Decision
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.decisions import (
    on_edges,
    on_faint_bodies,
    on_reflections,
    on_round_obstacles,
)
from twin.radar.propagation.diffraction.behind_obstacles import Accepted
from twin.radar.propagation.diffraction.screens import screens
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.facets.convergence import (
    BodyEcho,
    band_of,
    body_echoes,
    reference_levels,
    spans_by,
    summed_by,
    unconverged,
)
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.facets.reflections import MOST_IMAGES, ReflectionChoice
from twin.radar.propagation.left_out import on_meshes
from twin.radar.propagation.one_way.motion import target_motion
from twin.radar.propagation.physical_optics import (
    Scattered,
    at_antenna,
    behind,
    diffracted,
    edge_bounds,
    followed_everywhere,
    loss_of,
    scattered,
    surface_clutter,
)
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.result import Heard, PathName, Propagation, by_delay
from twin.radar.propagation.roughness import absorbing_surfaces, rough_surfaces, smooth_bodies
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.scene.image_search import MANY_IMAGES
from twin.radar.propagation.scene.scattering_models import (
    Assignment,
    ScatteringModel,
    assign_scattering_models,
    declared_alone,
)
from twin.radar.propagation.scene.silent import silent_objects
from twin.radar.propagation.single_paths import mirror_echoes, point_echoes
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
    prepared, has_more_images = _prepared(scene, radar, roles, fidelity, rough)
    of_bodies = scattered(
        prepared,
        radar,
        fidelity,
        earlier,
        has_more_images=has_more_images,
        keep=keep,
        followed_s=followed_s,
    )
    lit = at_antenna(of_bodies.contributions, prepared, radar)
    round_obstacles = _round_obstacles(
        prepared, radar, fidelity, _levels(prepared, radar, fidelity, of_bodies, lit), lit
    )
    shadowed = at_antenna(round_obstacles.echoes, prepared, radar)
    surfaces = Contributions.concatenate([lit, shadowed])
    levels = _levels(prepared, radar, fidelity, of_bodies, surfaces)
    decisions = [*on_roughness, *_on_faint_bodies(prepared, radar, levels)]
    left_out = np.zeros(len(levels.names))
    for decided, missing in (
        _reflections(levels, fidelity, of_bodies.choice, radar),
        (edges := _edges(prepared, radar, fidelity, levels)).decided,
        round_obstacles.decided_by(levels),
    ):
        decisions += decided
        left_out += missing
    clutter, on_clutter = surface_clutter(scene, prepared, rough, fidelity)
    of_edges = at_antenna(edges.echoes, prepared, radar)
    diffuse = Contributions.concatenate([of_edges, at_antenna(clutter, prepared, radar)])
    diffuse = diffuse.in_proportion_to_wavelength()
    mirrors = _mirrors(prepared, radar, fidelity)
    points = _points(scene, prepared, radar, declared_alone(scene, roles), fidelity)
    names, paths = by_delay(
        [*mirrors[0], *points[0]], Contributions.concatenate([mirrors[1], points[1]])
    )
    unbounded = _unbounded(fidelity, prepared)
    levels = levels.with_edges(of_edges, radar.ofdm)
    bodies = levels.bodies(of_bodies.error * loss_of(radar), left_out, is_bounded=not unbounded)
    every = Contributions.concatenate([paths, diffuse, surfaces])
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
                round_obstacles.n_left_out(levels),
                round_obstacles.too_large,
            ),
            *prepared.assumptions,
            *edges.remarks,
            *on_clutter,
            *smooth_bodies(scene, radar, roles, fidelity),
            *unbounded,
            *round_obstacles.remarks,
            *unconverged(bodies),
        ),
        heard=_heard(every.take(slice(len(names), None)), prepared, radar),
        warnings=(
            *silent_objects(scene, radar, roles),
            *absorbing_surfaces(scene, radar, rough),
        ),
        objects=tuple(item.name for item in prepared.items),
        bodies=bodies,
        decisions=tuple(decisions),
        traced=of_bodies.traced,
        reused_share=of_bodies.reused_share,
    )


def _prepared(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    fidelity: Fidelity,
    rough: Collection[str],
) -> tuple[PreparedScene, NDArray[np.bool_] | None]:
    """With the images that are followed; by bounds also to which objects there are further ones."""
    if fidelity.radar_images is not None:
        return _with_images(scene, radar, roles, fidelity, rough), None
    # One more reflection, to know whether there is any beyond those that are followed.
    prepared = prepare_scene(scene, radar, roles, MOST_IMAGES + 1, rough=rough, many=MANY_IMAGES)
    if prepared.has_more_images and _echo_paths(prepared) <= MOST_ECHO_PATHS / _MORE_BY_TWO:
        further = prepare_scene(scene, radar, roles, MOST_IMAGES, rough=rough)
        if _echo_paths(further) <= MOST_ECHO_PATHS:
            prepared = replace(further, has_more_images=True)
    return prepared.up_to(MOST_IMAGES)


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


@dataclass(frozen=True, eq=False)
class _Levels:
    """Bodies by the ``names`` of their objects, their ``echo`` over the band (n_bodies,
    n_frequencies), the levels that errors are relative to, ``reference`` (n_bodies,), and their
    spans in range and rate.
    """

    names: list[tuple[str, ...]]
    of_object: NDArray[np.int32]
    echo: NDArray[np.complex128]
    reference: Array
    tolerance: float
    floor: float
    spans: Array

    @property
    def permitted(self) -> float:
        """Of each effect that is left out."""
        return OF_TOLERANCE * self.tolerance

    def bodies(self, error: Array, left_out: Array, *, is_bounded: bool) -> tuple[BodyEcho, ...]:
        """With their errors and bounds of what is left out, the latter relative."""
        limits = self.tolerance, self.floor
        return body_echoes(
            self.names, self.echo, error, *limits, left_out, self.spans, is_bounded=is_bounded
        )

    def with_edges(self, edges: Contributions, wave: OfdmWaveform) -> "_Levels":
        """The same with the echoes of ``edges`` for bodies whose surfaces return nothing."""
        silent: NDArray[np.bool_] = ~np.asarray(self.echo.any(axis=1))
        owner = self.of_object[edges.object]
        owner = np.where((owner >= 0) & silent[owner], owner, -1)
        count = len(self.names)
        echo = summed_by(owner, count, edges, wave.carrier_hz, band_of(wave))
        spans = np.where(silent[:, None, None], spans_by(owner, count, edges), self.spans)
        return replace(self, echo=self.echo + echo, spans=spans)


#: Cells of bodies that answer round obstacles' edges, at most.
MOST_SHADOWED = 1000

_NOTHING = 1e-6  # of what is permitted: a number of cells is computed however faint

#: Decisions, and bounds of what is left out of every body's echo, relative as its errors are.
_Decided = tuple[tuple[Decision, ...], Array]


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


def _levels(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    of_bodies: Scattered,
    surfaces: Contributions,
) -> _Levels:
    body, wave = of_bodies.body, radar.ofdm
    count = len(of_bodies.error)
    owner = body[surfaces.object]
    echo = summed_by(owner, count, surfaces, wave.carrier_hz, band_of(wave))
    names = [tuple(prepared.items[i].name for i in np.flatnonzero(body == k)) for k in range(count)]
    tolerance, floor = fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar)
    reference = reference_levels(echo, tolerance, floor)
    spans = spans_by(owner, count, surfaces)
    return _Levels(names, body, echo, reference, tolerance, floor, spans)


@dataclass(frozen=True, eq=False)
class _RoundObstacles:
    """Echoes of bodies round others, without gains; bounds of these and of what is left out of
    them, in amplitude (n_bodies,), bodies too large to be looked at, and the time that they took.
    """

    echoes: Contributions
    bound: Array
    left_out: Array
    too_large: int
    cost_s: float
    is_decided: bool

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is assumed of them."""
        if not len(self.echoes):
            return ()
        return (
            "waves round obstacles' edges are reflected once at bodies, and at no large surface",
        )

    def decided_by(self, levels: _Levels) -> _Decided:
        """What was decided, relative to the levels that errors are relative to."""
        if not self.is_decided:
            return (), np.zeros(len(levels.names))
        bound, left_out = (part / levels.reference for part in (self.bound, self.left_out))
        decisions = on_round_obstacles(levels.names, bound, left_out, levels.permitted, self.cost_s)
        return decisions, left_out

    def n_left_out(self, levels: _Levels) -> int:
        """To how many bodies none is taken since bounds say so."""
        is_taken = self.bound > levels.permitted * levels.reference
        is_left_out = (self.left_out > 0) & ~is_taken
        return int(np.count_nonzero(is_left_out)) if self.is_decided else 0


def _round_obstacles(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: _Levels,
    lit: Contributions,
) -> _RoundObstacles:
    """Of all bodies, or by bounds of those whose echo they may change too much."""
    nothing = np.zeros(len(levels.names))
    most = fidelity.radar_shadowed
    if most == 0 or len(prepared.world.face_ranges) < 2 or not len(nothing):
        return _RoundObstacles(Contributions.none(), nothing, nothing, 0, 0.0, most is None)
    began_s, loss = perf_counter(), loss_of(radar)
    accepted = Accepted(
        limit=(1.0 if most is None else _NOTHING) * levels.permitted * levels.reference / loss,
        most=MOST_SHADOWED if most is None else most,
        fineness=float(np.sqrt(fidelity.radar_tolerance / 0.1)),
        faintest=followed_everywhere(fidelity),
    )
    found = behind(prepared, radar, fidelity, accepted)

    def level(echoes: Contributions) -> Array:
        owner, band = levels.of_object[echoes.object], band_of(radar.ofdm)
        echo = summed_by(owner, len(nothing), echoes, radar.ofdm.carrier_hz, band)
        rms: Array = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
        return rms

    # Echoes over mirrors, which are not followed round obstacles, may change by as much as others.
    is_direct = (lit.source == 0) & (lit.receiver == 0)
    changed = level(at_antenna(found.contributions, prepared, radar))
    straight = np.maximum(level(lit.take(np.flatnonzero(is_direct))), 1e-300)
    over_mirrors = level(lit.take(np.flatnonzero(~is_direct)))
    mirrored = np.minimum(changed / straight, 1.0) * over_mirrors
    return _RoundObstacles(
        found.contributions,
        found.bound * loss,
        found.left_out * loss + mirrored,
        int(np.count_nonzero(found.too_large)),
        perf_counter() - began_s,
        most is None,
    )


def _on_faint_bodies(
    prepared: PreparedScene, radar: RadarDesign, levels: _Levels
) -> tuple[Decision, ...]:
    """Bodies to which no path is traced."""
    of_body = levels.of_object
    scatters = of_body >= 0
    is_traced = np.zeros(len(levels.names), dtype=bool)
    is_traced[of_body[scatters & prepared.worth.any(axis=0)]] = True
    bound = np.zeros(len(is_traced))
    np.add.at(bound, of_body[scatters], prepared.untraced[scatters])
    left_out = np.flatnonzero(~is_traced)
    names = [levels.names[k] for k in left_out]
    return on_faint_bodies(names, bound[left_out] * loss_of(radar), noise_amplitude(radar))


def _reflections(
    levels: _Levels, fidelity: Fidelity, choice: ReflectionChoice | None, radar: RadarDesign
) -> _Decided:
    """What was decided on further reflections."""
    if choice is None:
        return (), np.zeros(len(levels.names))
    level = levels.reference / loss_of(radar)
    knobs = {"bounces": fidelity.radar_bounces, "images": fidelity.radar_images}
    kinds = [kind for kind, knob in knobs.items() if knob is None]
    decisions = on_reflections(choice, kinds, levels.names, level, levels.permitted)
    return decisions, choice.left_out.sum / level


@dataclass(frozen=True, eq=False)
class _Edges:
    """Echoes of sharp edges, remarks on them, what was decided, and of how many bodies none of
    them is taken since bounds say so.
    """

    echoes: Contributions
    remarks: list[str]
    decided: _Decided
    n_left_out: int = 0


def _edges(
    prepared: PreparedScene, radar: RadarDesign, fidelity: Fidelity, levels: _Levels
) -> _Edges:
    """Of all bodies, or by bounds of those to whose echo they may add too much."""
    nothing = np.zeros(len(levels.names))
    if fidelity.radar_edges is not None or not levels.names:
        return _Edges(*diffracted(prepared, fidelity), ((), nothing))
    began_s = perf_counter()
    # What counts as an error, in amplitude before losses.
    limit = levels.permitted * levels.reference / loss_of(radar)
    bound, left_out, pairs = nothing.copy(), nothing.copy(), {}
    for body, of_body in edge_bounds(prepared, radar).items():
        bound[body], left_out[body] = of_body.sum, of_body.sum
        if of_body.sum > limit[body]:
            pairs[body], left_out[body] = of_body.worth_tracing(limit[body])
    echoes, remarks = diffracted(prepared, fidelity, pairs)
    cost_s = perf_counter() - began_s
    bound, left_out = (part / limit * levels.permitted for part in (bound, left_out))
    is_taken, has_edges = bound > levels.permitted, bound > 0
    decisions = on_edges(
        [name for name, has in zip(levels.names, has_edges, strict=True) if has],
        bound[has_edges],
        is_taken[has_edges],
        levels.permitted,
        cost_s,
    )
    n_left_out = int(np.count_nonzero(has_edges & ~is_taken))
    return _Edges(echoes, remarks, (decisions, left_out), n_left_out)


def _mirrors(
    prepared: PreparedScene, radar: RadarDesign, fidelity: Fidelity
) -> tuple[list[PathName], Contributions]:
    """The radar's own images: as many reflections as out and back together."""
    if fidelity.radar_images == 0 or len(prepared.flats) == 0:
        return [], Contributions.none()
    further = prepared.seen_by_itself()
    return _paths(further, radar, mirror_echoes(further.context), [None], [()])


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
