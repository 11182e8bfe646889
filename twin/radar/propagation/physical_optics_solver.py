"""The solver of physical optics: all echoes of a scene, paths by name and dense ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.decisions import on_reflections
from twin.radar.propagation.diffraction.around_edges import screens
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.facets.convergence import (
    BodyEcho,
    band_of,
    body_echoes,
    reference_levels,
    summed_by,
    unconverged,
)
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.facets.reflections import MOST_IMAGES
from twin.radar.propagation.physical_optics import (
    Scattered,
    at_antenna,
    behind,
    diffracted,
    loss_of,
    scattered,
    surface_clutter,
)
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.result import Heard, PathName, Propagation, by_delay
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.scene.scattering_models import assign_scattering_models, declared_alone
from twin.radar.propagation.scene.silent import silent_objects
from twin.radar.propagation.single_paths import mirror_echoes, point_echoes
from twin.radar.synthesis import Contributions
from twin.scene import Scene, Target


def echoes(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: TracedFrame | None = None,
    *,
    keep: bool = False,
) -> Propagation:
    """Mirror images, declared points and scattering meshes, by the same one-way paths;
    ``earlier`` and ``keep`` as of `physical_optics.scattered`.

    Raises InputError where a material has no data at the carrier.
    """
    is_rough = fidelity.radar == "rough"
    roles = assign_scattering_models(scene, radar.ofdm.wavelength_m, with_optics=True)
    images = MOST_IMAGES if fidelity.radar_images is None else fidelity.radar_images
    prepared = prepare_scene(scene, radar, roles, images, is_rough=is_rough)
    of_bodies = scattered(prepared, radar, fidelity, earlier, keep=keep)
    traced = Contributions.concatenate([of_bodies.contributions, behind(prepared, fidelity)])
    surfaces = at_antenna(traced, prepared, radar)
    edges, on_edges = diffracted(prepared, fidelity)
    clutter, on_clutter = Contributions.none(), list[str]()
    if is_rough:
        clutter, on_clutter = surface_clutter(scene, prepared, fidelity, seed)
    diffuse = at_antenna(Contributions.concatenate([edges, clutter]), prepared, radar)
    diffuse = diffuse.in_proportion_to_wavelength()
    mirrors = _mirrors(prepared, radar, fidelity)
    points = _points(prepared, radar, declared_alone(scene, roles), fidelity)
    names, paths = by_delay(
        [*mirrors[0], *points[0]], Contributions.concatenate([mirrors[1], points[1]])
    )
    bodies, decisions = _converged(prepared, radar, fidelity, of_bodies, surfaces)
    return Propagation(
        Contributions.concatenate([paths, diffuse, surfaces]),
        names,
        roles=tuple(roles),
        assumptions=(*prepared.assumptions, *on_edges, *on_clutter, *unconverged(bodies)),
        heard=_heard(Contributions.concatenate([surfaces, diffuse]), prepared, radar),
        warnings=silent_objects(scene, radar, roles),
        objects=tuple(item.name for item in prepared.items),
        bodies=bodies,
        decisions=decisions,
        traced=of_bodies.traced,
        reused_share=of_bodies.reused_share,
    )


def _converged(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    of_bodies: Scattered,
    surfaces: Contributions,
) -> tuple[tuple[BodyEcho, ...], tuple[Decision, ...]]:
    """Levels of bodies and estimates of their errors, and what was decided of each."""
    body, error, wave = of_bodies.body, of_bodies.error, radar.ofdm
    count = len(error)
    echo = summed_by(body[surfaces.object], count, surfaces, wave.carrier_hz, band_of(wave))
    names = [tuple(prepared.items[i].name for i in np.flatnonzero(body == k)) for k in range(count)]
    tolerance, floor = fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar)
    decisions: tuple[Decision, ...] = ()
    left_out = np.zeros(count)
    if of_bodies.choice is not None:
        level = reference_levels(echo, tolerance, floor) / loss_of(radar)
        knobs = {"bounces": fidelity.radar_bounces, "images": fidelity.radar_images}
        kinds = [kind for kind, knob in knobs.items() if knob is None]
        permitted = OF_TOLERANCE * tolerance
        decisions = on_reflections(of_bodies.choice, kinds, names, level, permitted)
        bounds = of_bodies.choice.left_out
        left_out = (bounds.bounces + bounds.images) / level
    bodies = body_echoes(names, echo, error * loss_of(radar), tolerance, floor, left_out)
    return bodies, decisions


def _mirrors(
    prepared: PreparedScene, radar: RadarDesign, fidelity: Fidelity
) -> tuple[list[PathName], Contributions]:
    """The radar's own images: as many reflections as out and back together."""
    if fidelity.radar_images == 0 or len(prepared.flats) == 0:
        return [], Contributions.none()
    further = prepared.seen_by_itself()
    return _paths(further, radar, mirror_echoes(further.context), [None], [()])


def _points(
    prepared: PreparedScene, radar: RadarDesign, declared: Sequence[Target], fidelity: Fidelity
) -> tuple[list[PathName], Contributions]:
    """Echoes of declared points; a path around an edge names the obstacle."""
    if not declared:
        return [], Contributions.none()
    obstacles = screens(prepared, fidelity.radar_shadow_db)
    echoes, two_way = point_echoes(prepared.context, declared, prepared.anchor_m, obstacles)

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
