"""Errors of the radar's echoes by body, and convergence of each fidelity level.

The reference of a body is the solver at its finest tolerance. Where the body is small enough, its
direct echo is computed by brute force instead (`twin.trade.sampled`), which also shows errors
common to all tolerances.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar import RadarDesign
from twin.radar.propagation.facets.convergence import band_of, summed_by
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.solvers import seen_by, trace
from twin.scene import Scene
from twin.trade.measurement import BY_SOLVER, BodyError
from twin.trade.sampled import direct_echo, points_of

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


_WEAKEST = 0.01  # of the strongest body: 40 dB
_MOST_POINTS = 20_000_000  # of a body, to be sampled by brute force: some ten seconds


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of a scene with their reference echoes over the band, (n_bodies, n_frequencies).

    ``names``: of the objects of each body; ``is_sampled``: whether its direct echo is computed by
    brute force.
    """

    names: tuple[tuple[str, ...], ...]
    echo: Complex
    is_sampled: tuple[bool, ...]
    finest: float
    frequencies_hz: Array

    @property
    def level(self) -> Array:
        """Root mean square over the band, (n_bodies,)."""
        level: Array = np.sqrt(np.mean(np.abs(self.echo) ** 2, axis=1))
        return level


def reference_bodies(
    scene: Scene, radar: RadarDesign, fidelity: Fidelity, finest: Propagation, seed: int
) -> Bodies:
    """References of all bodies; ``finest`` is the propagation at this, the finest fidelity."""
    scene = seen_by(radar, scene, fidelity)
    names = _names(scene, finest)
    frequencies = band_of(radar.ofdm)
    echo = echoes_by_body(finest, names, radar, frequencies)
    level = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
    prepared = prepare_scene(scene, radar, finest.roles, 0)
    sampled = np.zeros(len(names), dtype=bool)
    numbers = {item.name: i for i, item in enumerate(prepared.items)}
    if prepared.context.walls is None:  # brute force knows no panes
        for i in np.flatnonzero(level >= _WEAKEST * level.max(initial=0.0)):
            members = [numbers[name] for name in names[i]]
            sampled[i] = level[i] > 0 and points_of(prepared, members) <= _MOST_POINTS
    if sampled.any():
        # What comes round obstacles stays in the reference.
        alone = replace(fidelity, radar_bounces=1, radar_images=0, radar_edges=0, radar_shadowed=0)
        direct = trace(scene, radar, fidelity=alone, seed=seed)
        own = echoes_by_body(direct, names, radar, frequencies)
        for i in np.flatnonzero(sampled):
            members = [numbers[name] for name in names[i]]
            echo[i] += direct_echo(scene, prepared, radar, members, frequencies) - own[i]
    return Bodies(names, echo, tuple(sampled.tolist()), fidelity.radar_tolerance, frequencies)


def errors_of(
    bodies: Bodies,
    propagation: Propagation,
    radar: RadarDesign,
    tolerance: float,
    *,
    synthesis: float = 0.0,
) -> tuple[BodyError, ...]:
    """Complex errors, rms over the band, of every body within 40 dB of the strongest.

    A body is converged where its error is at most the tolerance. ``synthesis``: error of the whole
    channel by its synthesis, rms, received over sent.
    """
    echo = echoes_by_body(propagation, bodies.names, radar, bodies.frequencies_hz)
    error = np.sqrt(np.mean(np.abs(echo - bodies.echo) ** 2, axis=1))
    level = bodies.level
    strongest = level.max(initial=0.0)
    order = [i for i in np.argsort(-level) if level[i] >= max(_WEAKEST * strongest, 1e-300)]
    return tuple(
        BodyError(
            body=_label(bodies.names[i]),
            level_db=float(20 * np.log10(level[i] / strongest)),
            error=float(error[i] / level[i]),
            is_converged=bool(error[i] <= tolerance * level[i]),
            reference=(
                "direct echo sampled by brute force"
                if bodies.is_sampled[i]
                else f"{BY_SOLVER} at tolerance {bodies.finest}"
            ),
            synthesis=float(synthesis / level[i]),
        )
        for i in order
    )


def echoes_by_body(
    propagation: Propagation,
    names: tuple[tuple[str, ...], ...],
    radar: RadarDesign,
    frequencies_hz: Array,
) -> Complex:
    """Echoes of surfaces at rest, summed by body, (n_bodies, n_frequencies)."""
    body_of = {name: i for i, members in enumerate(names) for name in members}
    number = np.array([body_of.get(name, -1) for name in propagation.objects], dtype=np.intp)
    surfaces = propagation.surfaces
    body = number[surfaces.object] if len(number) else np.full(len(surfaces), -1)
    return summed_by(body, len(names), surfaces, radar.ofdm.carrier_hz, frequencies_hz)


def _names(scene: Scene, propagation: Propagation) -> tuple[tuple[str, ...], ...]:
    """Objects that scatter, by the body that they are part of."""
    scattering = {a.name for a in propagation.roles if a.role is ScatteringModel.OPTICS}
    items = [item for item in scene.objects if item.name in scattering]
    if not items:
        return ()
    body = bodies_of(items)
    return tuple(
        tuple(items[i].name for i in np.flatnonzero(body == number))
        for number in range(int(body.max()) + 1)
    )


def _label(names: tuple[str, ...]) -> str:
    """Name of a body, after its first object."""
    return names[0] if len(names) == 1 else f"{names[0]} (of {len(names)} objects)"
