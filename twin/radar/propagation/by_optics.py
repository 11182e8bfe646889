"""The rungs of physical optics: every echo of a scene, as paths by name and as dense echoes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.diffraction.around_edges import screens
from twin.radar.propagation.facets.convergence import (
    BodyEcho,
    band_of,
    body_echoes,
    summed_by,
    unconverged,
)
from twin.radar.propagation.facets.earlier import Traced
from twin.radar.propagation.one_way.rays import Rays
from twin.radar.propagation.physical_optics import (
    behind,
    contributions_of,
    diffracted,
    loss_of,
    scattered,
    surface_clutter,
)
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.result import Heard, Path, Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.scene.scattering_models import assign_scattering_models, declared_alone
from twin.radar.propagation.scene.silent import silent_objects
from twin.radar.propagation.single_paths import mirror_echoes, point_echoes
from twin.radar.synthesis import Contributions
from twin.scene import Scene, Target

Array = NDArray[np.float64]


def echoes(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: Traced | None = None,
    *,
    keep: bool = False,
) -> Propagation:
    """Mirror images, declared points and scattering meshes, all over the same legs; ``earlier`` and
    ``keep`` as of `physical_optics.scattered`.

    Raises InputError where a material has no data at the carrier.
    """
    roles = assign_scattering_models(scene, radar.ofdm.wavelength_m, fidelity.radar)
    declared = declared_alone(scene, roles)
    is_rough = fidelity.radar == "rough"
    stage = prepare_scene(scene, radar, roles, fidelity.radar_images, is_rough=is_rough)
    bodies_echo = scattered(stage, radar, fidelity, earlier, keep=keep)
    body, error = bodies_echo.body, bodies_echo.error
    surfaces = Rays.joined([bodies_echo.rays, behind(stage, fidelity)])
    edges, on_edges = diffracted(stage, fidelity)
    points, on_points = (
        surface_clutter(scene, stage, fidelity, seed) if is_rough else (Rays.joined([]), [])
    )
    diffuse = Rays.joined([edges, points])
    paths = [*_mirrors(stage, radar, fidelity), *_points(stage, radar, declared, fidelity)]
    dense = [contributions_of(rays, stage, radar) for rays in (surfaces, diffuse)]
    bodies = _converged(stage, radar, fidelity, body, error, dense[0], surfaces.object)
    return Propagation(
        paths=tuple(sorted((p for p in paths if p.amplitude), key=lambda p: p.delay_s)),
        roles=tuple(roles),
        assumptions=(*stage.assumptions, *on_edges, *on_points, *unconverged(bodies)),
        surfaces=dense[0],
        diffuse=dense[1],
        heard=_heard(Rays.joined([surfaces, diffuse]), Contributions.joined(dense), stage, radar),
        warnings=silent_objects(scene, radar, roles),
        objects=tuple(item.name for item in stage.items),
        object_of_surface=surfaces.object,
        bodies=bodies,
        traced=bodies_echo.traced,
        kept=bodies_echo.kept,
    )


def _converged(
    stage: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    body: NDArray[np.int32],
    error: Array,
    surfaces: Contributions,
    owner: NDArray[np.uint32],
) -> tuple[BodyEcho, ...]:
    """Levels of bodies and estimates of their errors; ``owner``: object of each echo."""
    count, wave = len(error), radar.ofdm
    echo = summed_by(body[owner], count, surfaces, wave.carrier_hz, band_of(wave))
    return body_echoes(
        [tuple(stage.items[i].name for i in np.flatnonzero(body == k)) for k in range(count)],
        echo,
        error * loss_of(radar),
        fidelity.radar_tolerance,
        OF_NOISE * noise_amplitude(radar),
    )


def _mirrors(stage: PreparedScene, radar: RadarDesign, fidelity: Fidelity) -> list[Path]:
    """The radar's own images: as many reflections as out and back together."""
    if fidelity.radar_images == 0 or len(stage.flats) == 0:
        return []
    further = stage.seen_by_itself()
    return _paths(further, radar, mirror_echoes(further.station), [None], [()])


def _points(
    stage: PreparedScene, radar: RadarDesign, declared: Sequence[Target], fidelity: Fidelity
) -> list[Path]:
    """Declared points; what passes an edge on the way is said to meet its obstacle."""
    if not declared:
        return []
    obstacles = screens(stage, fidelity.radar_shadow_db)
    rays, ways = point_echoes(stage.station, declared, stage.anchor_m, obstacles)

    def over(item: int) -> tuple[str, ...]:
        return (stage.items[item].name,) if item >= 0 else ()

    names = [declared[way.target].name for way in ways]
    met = [
        (*over(way.out_over), name, *over(way.home_over))
        for way, name in zip(ways, names, strict=True)
    ]
    return _paths(stage, radar, rays, names, met)


def _paths(
    stage: PreparedScene,
    radar: RadarDesign,
    rays: Rays,
    targets: Sequence[str | None],
    met: Sequence[tuple[str, ...]],
) -> list[Path]:
    """Rays by name, with gains, losses and wavelength; by the rays' object, their target and what
    they meet between the large surfaces.
    """
    found = contributions_of(rays, stage, radar)
    return [
        Path(
            via=(*stage.via(out), *met[row], *stage.via(home)[::-1]),
            target=targets[row],
            amplitude=complex(found.amplitude[k]) * stage.wavelength_m,
            delay_s=float(found.delay_s[k]),
            delay_rate=float(found.delay_rate[k]),
            delay_acceleration_per_s=float(found.delay_acceleration_per_s[k]),
            departure=_triple(found.departure[k]),
            arrival=_triple(found.arrival[k]),
            departure_per_s=_triple(found.departure_per_s[k]),
            arrival_per_s=_triple(found.arrival_per_s[k]),
        )
        for k, (row, out, home) in enumerate(
            zip(rays.object, rays.source, rays.receiver, strict=True)
        )
    ]


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector
    return float(x), float(y), float(z)


def _heard(
    rays: Rays, dense: Contributions, stage: PreparedScene, radar: RadarDesign
) -> tuple[Heard, ...]:
    cycles = radar.ofdm.carrier_hz * dense.delay_s % 1.0
    wave = dense.amplitude * np.exp(-2j * np.pi * cycles)
    n = len(stage.items)
    count = np.bincount(rays.object, minlength=n)
    total = np.bincount(rays.object, wave.real, n) + 1j * np.bincount(rays.object, wave.imag, n)
    return tuple(
        Heard(item.name, int(count[i]), float(abs(total[i]) ** 2))
        for i, item in enumerate(stage.items)
        if count[i]
    )
