"""Echoes of a scene by physical optics: surfaces, their sharp edges, and rough ground."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.diffraction.behind_obstacles import (
    Accepted,
    RoundObstacles,
    echoes_behind,
)
from twin.radar.propagation.diffraction.edge_bounds import EdgeBound, edge_bound
from twin.radar.propagation.diffraction.fringes import Sharp, edge_echoes, edges_of
from twin.radar.propagation.diffraction.screens import Screens, screens
from twin.radar.propagation.facets.body_scattering import scattered_by
from twin.radar.propagation.facets.earlier import TracedFrame, setting_of
from twin.radar.propagation.facets.error_budget import bin_m
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.facets.reflections import LEAST_IMAGES, ReflectionChoice
from twin.radar.propagation.facets.scatterers import scatterers
from twin.radar.propagation.facets.validity import still_valid
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.culling import (
    OF_NOISE,
    beam_of,
    image_antennas_of,
    most_gain,
    noise_amplitude,
)
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.surface_clutter import SurfaceClutter, clutter_echoes
from twin.radar.scattering.surface import TABLE_STEPS
from twin.radar.synthesis import Contributions
from twin.scene import Scene
from twin.scene.boxes import boxes_of, distances_m

Array = NDArray[np.float64]

_DEEPEST_DB = 45.0  # of shadows on bodies, one way, wherever it counts
_FOLLOWED = 0.01, 0.1  # amplitude of diffracted waves on bodies, at least and at most
_ONE_PER_WAVELENGTH = 0.1  # radar_tolerance from which on pieces of edges are a wavelength long
_FINEST_PIECES = 8.0  # of edges, per wavelength
_MOST_PIECES = 2_000_000  # of edges that are taken by bounds
_FREQUENCIES = 5, 64  # over the band, at which a body's echo is summed, at least and at most


@dataclass(frozen=True, eq=False)
class Scattered:
    """Contributions of every object that scatters; the ``body`` of every object, -1 for others; the
    estimated error of every body's echo, without losses, and where along the range it is; the
    ``choice`` of reflections, None where they are given; the frame for later ones to reuse, and the
    share of contributions that was reused from an earlier frame.
    """

    contributions: Contributions
    body: NDArray[np.int32]
    error: Array
    by_range: ErrorsByRange
    choice: ReflectionChoice | None = None
    traced: TracedFrame | None = None
    reused_share: float = 0.0


def scattered(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    earlier: TracedFrame | None = None,
    *,
    further_images: Array | None = None,
    keep: bool = False,
    followed_s: float | None = None,
) -> Scattered:
    """Echoes of bodies to within ``fidelity.radar_tolerance``.

    ``further_images`` (n_objects,): as `FurtherPaths.objects`; None where that is not known. Valid
    paths of an ``earlier`` frame are
    reused. ``keep``: whether later frames may reuse this one, which is then traced in full.
    ``followed_s``: as of `solvers.trace`.
    """
    body = _bodies(prepared)
    if not (prepared.worth & (body >= 0)).any():
        traced = TracedFrame(radar, str(fidelity.radar)) if keep else None
        return Scattered(
            Contributions.none(),
            body,
            np.zeros(body.max(initial=-1) + 1),
            ErrorsByRange.none(bin_m(wave_numbers(radar, 0.0))),
            None,
            traced,
        )
    half_s = radar.burst_s / 2 if followed_s is None else followed_s
    bodies = scatterers(prepared, radar.antenna, body, half_s, radar.burst.reach_m)
    parameters = fidelity.radar_tolerance, fidelity.radar_bounces
    by_images = fidelity.radar_images is None
    setting, valid = None, None
    if keep or earlier is not None:
        setting = setting_of(
            prepared, bodies, body, (*parameters[:1], parameters[1] or 0, by_images)
        )
    if earlier is not None and setting is not None and not keep:
        valid = still_valid(prepared.context, bodies, earlier, setting, prepared)
    echoes = scattered_by(
        prepared.context,
        bodies,
        prepared.images,
        wave_numbers(radar, _extent_m(prepared, body)),
        *parameters,
        OF_NOISE * noise_amplitude(radar) / loss_of(radar),
        valid,
        by_images=by_images,
        further_images=None if further_images is None else _most(further_images, body),
        with_footprints=keep,
    )
    traced = TracedFrame(radar, str(fidelity.radar), setting, echoes) if keep else None
    contributions = Contributions.concatenate(echoes.contributions)
    share = echoes.n_reused / max(len(contributions), 1)
    return Scattered(
        contributions, body, echoes.error, echoes.by_range, echoes.choice, traced, share
    )


def _most(objects: Array, body: NDArray[np.int32]) -> Array:
    """Of every body, the most of any of its objects."""
    found = np.zeros(body.max() + 1)
    np.maximum.at(found, body[body >= 0], objects[body >= 0])
    return found


def loss_of(radar: RadarDesign) -> float:
    """Two-way loss of the front end, in amplitude."""
    return float(10 ** (-radar.front_end.losses_db.value / 20))


def wave_numbers(radar: RadarDesign, extent_m: float) -> Array:
    """Wave numbers over the band at which the echoes of bodies are summed, in rad/m.

    Their spacing resolves bodies of an extent in range of c / 2 over the spacing of frequencies, as
    far as the largest number of frequencies allows.
    """
    wave, (least, most) = radar.ofdm, _FREQUENCIES
    count = np.ceil(2 * wave.bandwidth_hz * extent_m / speed_of_light) + 1
    offsets = np.linspace(-0.5, 0.5, int(np.clip(count, least, most))) * wave.bandwidth_hz
    numbers: Array = 2 * np.pi / speed_of_light * (wave.carrier_hz + offsets)
    return numbers


def _extent_m(prepared: PreparedScene, body: NDArray[np.int32]) -> float:
    """Largest extent of a body in range, by the boxes around its objects."""
    box = boxes_of([prepared.originals[i] for i in np.flatnonzero(body >= 0)])
    whose = body[body >= 0]
    middle, half = (
        box.mean(axis=1) - prepared.anchor_m - prepared.place,
        np.diff(box, axis=1)[:, 0] / 2,
    )
    nearest = distances_m(box, prepared.anchor_m + prepared.place)
    farthest = np.linalg.norm(np.abs(middle) + half, axis=1)
    low, high = np.full(whose.max() + 1, np.inf), np.zeros(whose.max() + 1)
    np.minimum.at(low, whose, nearest)
    np.maximum.at(high, whose, farthest)
    return float((high - low).max())


def diffracted(
    prepared: PreparedScene,
    fidelity: Fidelity,
    pairs: Mapping[int, NDArray[np.bool_]] | None = None,
) -> tuple[Contributions, list[str]]:
    """Contributions of the sharp edges of bodies, over all pairs of images with paths to them, and
    remarks on what is assumed or left out. ``pairs``: by number only some bodies, and over which
    pairs each, as `edge_bounds` counts them.
    """
    if fidelity.radar_edges == 0 or ScatteringModel.OPTICS not in prepared.roles:
        return Contributions.none(), []
    of_bodies = _sharp(prepared, _bodies(prepared))
    if pairs is None:
        sharp = list(of_bodies.values())
    else:
        sharp = [of_bodies[body].over(some) for body, some in pairs.items()]
    most = _MOST_PIECES if fidelity.radar_edges is None else fidelity.radar_edges
    pieces = _FINEST_PIECES if fidelity.radar_edges is not None else _pieces(fidelity)
    echoes, longer = edge_echoes(prepared.context, sharp, prepared.wavelength_m, most, pieces)
    eighths = longer * _FINEST_PIECES / pieces if longer > 1 else 1.0
    return echoes, _on_edges(prepared, sharp, eighths)


def _pieces(fidelity: Fidelity) -> float:
    """Per wavelength, of edges that are taken by bounds: their phase is exact at the carrier, so
    that pieces need to be short only for the band and for shadows' borders. In pieces of a
    wavelength the edges of the yard's and the street's bodies are off by 0.1 % of these bodies'
    echoes at most.
    """
    return float(np.clip(_ONE_PER_WAVELENGTH / fidelity.radar_tolerance, 1.0, _FINEST_PIECES))


def edge_bounds(prepared: PreparedScene, radar: RadarDesign) -> dict[int, EdgeBound]:
    """Bounds of the amplitude of the sharp edges of every body, by number, before losses; none of
    bodies to which no path is traced, since their whole echo is below the noise.
    """
    body, beam = _bodies(prepared), beam_of(radar.antenna)
    antennas = image_antennas_of(prepared.images, prepared.flats, prepared.axes[0], beam)
    boxes = boxes_of(prepared.originals) - prepared.anchor_m
    bounds = {}
    for number, sharp in _sharp(prepared, body).items():
        members = np.flatnonzero(body == number)
        box = np.array([[boxes[members, 0].min(axis=0), boxes[members, 1].max(axis=0)]])
        gain = most_gain(beam, antennas.place, antennas.axis, box)[:, 0]
        bounds[number] = edge_bound(sharp, antennas, sharp.images, gain, prepared.wavelength_m)
    return bounds


def behind(
    prepared: PreparedScene,
    radar: RadarDesign,
    obstacles: Screens | None,
    over_mirrors: Sequence[tuple[int, int, int]],
    accepted: Accepted,
) -> RoundObstacles:
    """Echoes of bodies by diffracted paths around others; ``over_mirrors`` as of
    `echoes_behind`.
    """
    body = _bodies(prepared)
    bodies = np.unique(body[prepared.worth.any(axis=0) & (body >= 0)]).astype(np.int64)
    if obstacles is None or not len(bodies):
        none = np.zeros(len(accepted.limit))
        return RoundObstacles(Contributions.none(), none, none, none > 0)

    def gain(directions: Array) -> Array:
        both: Array = radar.antenna.gain(directions @ prepared.axes.T)
        return both

    return echoes_behind(
        obstacles, prepared.surface_of_object, bodies, over_mirrors, gain, accepted
    )


def obstacles_of(prepared: PreparedScene, fidelity: Fidelity) -> Screens | None:
    """What waves go round to bodies; None where no shadows are asked for, or nothing scatters."""
    body = _bodies(prepared)
    if not (body >= 0).any():
        return None
    return screens(prepared, min(fidelity.radar_shadow_db, _DEEPEST_DB), body)


def followed_by(obstacles: Screens, fidelity: Fidelity) -> Screens:
    """Obstacles with the waves alone that are followed to all of a body."""
    return replace(obstacles, faintest=max(obstacles.faintest, followed_everywhere(fidelity)))


def followed_everywhere(fidelity: Fidelity) -> float:
    """Of diffracted waves on bodies, one way, over the straight wave: what is fainter changes less
    than a third of the tolerance of the echo of a body's brightest part in the light.
    """
    return float(np.clip(fidelity.radar_tolerance / 3, *_FOLLOWED))


def _sharp(prepared: PreparedScene, body: NDArray[np.int32]) -> dict[int, Sharp]:
    """The sharp edges of every body to which paths are traced, by its number, over all images from
    which they are.
    """
    rows = np.array(prepared.context.table).reshape(-1, TABLE_STEPS + 1, 4)
    # At normal incidence; a conductor's TE is -1.
    reflection = -(rows[:, -1, 0] + 1j * rows[:, -1, 1])[prepared.surface_of_object]
    edges_of_bodies = {}
    is_traced = prepared.worth.any(axis=0) & (body >= 0)
    for number in np.unique(body[is_traced]).tolist():
        members = np.flatnonzero(body == number)
        images = np.flatnonzero(prepared.worth[:, members].any(axis=1))
        every_pair = np.ones((len(images), len(images)), dtype=bool)
        items = tuple(prepared.originals[i] for i in members)
        edges, owner = edges_of(items, tuple(prepared.anchor_m.tolist()))
        whose: NDArray[np.uint32] = members[owner].astype(np.uint32)
        edges_of_bodies[number] = Sharp(
            edges, whose, reflection[whose], prepared.motions, images, every_pair
        )
    return edges_of_bodies


def _on_edges(prepared: PreparedScene, sharp: Sequence[Sharp], longer: float) -> list[str]:
    remarks = []
    if longer > 1:
        remarks.append(
            f"pieces of sharp edges {longer:.2g} times longer than an eighth of a wavelength: "
            "right in phase at the carrier only, truncated at their middle (fidelity.radar_edges)"
        )
    partly = {
        prepared.items[i].material
        for body in sharp
        for i in np.unique(body.object[np.abs(body.reflection - 1) > 1e-6])
    }
    if partly:
        remarks.append(
            f"edges of {', '.join(sorted(partly))} diffract as a conductor's, times what the "
            "surface reflects at normal incidence"
        )
    non_manifold = sum(body.edges.non_manifold for body in sharp)
    if non_manifold:
        remarks.append(f"{non_manifold} edges of more than two faces diffract nothing")
    return remarks


def surface_clutter(
    scene: Scene, prepared: PreparedScene, rough: Collection[str], fidelity: Fidelity
) -> tuple[Iterator[Contributions], list[str]]:
    """Contributions of the objects that count as ``rough``, by name, part by part as they are asked
    for, and which ones have no gamma or one that is assumed. Where bounds decide, as in rooms, by
    two reflections on a way at most: there are as many paths to each point as pairs of images.
    """
    surfaces, remarks, motions = [], [], prepared.motions
    most = LEAST_IMAGES if fidelity.radar_images is None else fidelity.radar_images
    few = np.array([len(image.patches) <= most for image in prepared.images])
    for number, item in enumerate(prepared.items):
        if item.name not in rough:
            continue
        relief = scene.materials[item.material].surface
        gamma = relief.backscatter_gamma if relief else None
        if gamma is None:
            remarks.append(f"{item.name}: {item.material} has no gamma, it does not scatter")
        elif gamma.value:
            is_slab = number >= len(prepared.world.items) and item.thickness_m is None
            sources = tuple(np.flatnonzero(prepared.worth[:, number] & few).tolist())
            surfaces.append(SurfaceClutter(item, number, gamma.value, is_slab, sources, motions))
            if gamma.assumed:
                remarks.append(f"gamma of {item.material} = {gamma.value:g}: {gamma.assumed}")
    if not surfaces:
        return iter(()), remarks
    echoes = clutter_echoes(
        prepared.context,
        prepared.anchor_m,
        surfaces,
        fidelity.radar_scatterers,
        fidelity.radar_surface_seed,
    )
    return echoes, list(dict.fromkeys(remarks))


def at_antenna(traced: Contributions, prepared: PreparedScene, radar: RadarDesign) -> Contributions:
    """Contributions with the antenna's gains and the front end's losses, and in its axes, as the
    synthesis takes them.
    """
    departure, arrival = traced.departure @ prepared.axes.T, traced.arrival @ prepared.axes.T
    gain = np.sqrt(radar.antenna.gain(departure) * radar.antenna.gain(arrival))
    turning = [traced.departure_per_s, traced.arrival_per_s]
    if (spin := prepared.radar_motion.spin_rad_per_s).any():  # the antenna turns under the wave
        turning[0] = turning[0] - np.cross(spin, traced.departure)
        turning[1] = turning[1] - np.cross(spin, traced.arrival)
    return replace(
        traced,
        amplitude=traced.amplitude * gain * loss_of(radar),
        departure=departure,
        arrival=arrival,
        departure_per_s=turning[0] @ prepared.axes.T,
        arrival_per_s=turning[1] @ prepared.axes.T,
    )


def _bodies(prepared: PreparedScene) -> NDArray[np.int32]:
    """Body of every object, -1 for what does not scatter.

    Objects that touch and move alike are one.
    """
    scattering = [i for i, role in enumerate(prepared.roles) if role is ScatteringModel.OPTICS]
    body = np.full(len(prepared.items), -1, dtype=np.int32)
    body[scattering] = bodies_of([prepared.items[i] for i in scattering])
    return body
