"""Effects that are taken or left out by bounds of what they add to each body's echo.

Sharp edges, waves round obstacles, further reflections, and bodies to which no path is traced.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.body_levels import BodyLevels
from twin.radar.propagation.corner_echoes import CornerEchoes
from twin.radar.propagation.decisions import (
    Decided,
    on_corners,
    on_edges,
    on_faint_bodies,
    on_reflections,
    on_round_obstacles,
    on_two_edges,
)
from twin.radar.propagation.diffraction.behind_obstacles import Accepted
from twin.radar.propagation.diffraction.screens import Screens
from twin.radar.propagation.edges_beside_ways import MirroredWay
from twin.radar.propagation.facets.reflections import ReflectionChoice
from twin.radar.propagation.physical_optics import (
    at_antenna,
    behind,
    diffracted,
    edge_bounds,
    followed_everywhere,
    loss_of,
)
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.culling import noise_amplitude
from twin.radar.synthesis import Contributions
from twin.radar.synthesis.joined import Resolution

Array = NDArray[np.float64]

#: Cells of bodies that answer round obstacles' edges, at most.
MOST_SHADOWED = 1000
#: Error of echoes by several reflections round obstacles: of what waves change of them, or of what
#: is left of them.
_OF_CORNERS = 0.05
#: Error of the echo of a body's edges, of itself: 0.02 to 0.14 with the field along the edges of
#: prisms of 5 to 30 wavelengths, 0.1 to 0.32 across them (method of moments).
_OF_EDGES = 0.35
_NOTHING = 1e-6  # of what is permitted: a number of cells is computed however faint


@dataclass(frozen=True, eq=False)
class RoundObstacles:
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
            "waves round obstacles' edges are reflected once at bodies, and once at most at large "
            "surfaces on either way",
        )

    def decided_by(self, levels: BodyLevels) -> Decided:
        """What was decided, relative to the levels that errors are relative to."""
        if not self.is_decided:
            return (), np.zeros(len(levels.names))
        bound, left_out = (part / levels.reference for part in (self.bound, self.left_out))
        decisions = on_round_obstacles(levels.names, bound, left_out, levels.permitted, self.cost_s)
        return decisions, left_out

    def n_left_out(self, levels: BodyLevels) -> int:
        """To how many bodies none is taken since bounds say so."""
        is_taken = self.bound > levels.permitted * levels.reference
        is_left_out = (self.left_out > 0) & ~is_taken
        return int(np.count_nonzero(is_left_out)) if self.is_decided else 0


def round_obstacles(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    levels: BodyLevels,
    mirrored: Sequence[MirroredWay],
    obstacles: Screens | None,
) -> RoundObstacles:
    """Of all bodies, or by bounds of those whose echo they may change too much; ``mirrored``: ways
    over mirrors that are followed, too.
    """
    nothing = np.zeros(len(levels.names))
    most = fidelity.radar_shadowed
    if most == 0 or len(prepared.world.face_ranges) < 2 or not len(nothing):
        return RoundObstacles(Contributions.none(), nothing, nothing, 0, 0.0, most is None)
    began_s, loss = perf_counter(), loss_of(radar)
    accepted = Accepted(
        limit=(1.0 if most is None else _NOTHING) * levels.permitted * levels.reference / loss,
        most=MOST_SHADOWED if most is None else most,
        fineness=float(np.sqrt(fidelity.radar_tolerance / 0.1)),
        faintest=followed_everywhere(fidelity),
        resolution=Resolution.of(radar),
    )
    found = behind(prepared, radar, obstacles, mirrored, accepted)
    return RoundObstacles(
        found.contributions,
        found.bound * loss,
        found.left_out * loss,
        int(np.count_nonzero(found.too_large)),
        perf_counter() - began_s,
        most is None,
    )


def corners(
    found: CornerEchoes, prepared: PreparedScene, radar: RadarDesign, levels: BodyLevels
) -> Decided:
    """What waves round obstacles change of echoes by several reflections at a body."""
    alone = replace(found.alone, amplitude=-found.alone.amplitude)
    change = Contributions.concatenate([found.echoes, alone])
    bound, remain = (
        levels.rms_of(at_antenna(echoes, prepared, radar), radar) / levels.reference
        for echoes in (change, found.echoes)
    )
    left_out = _OF_CORNERS * np.minimum(bound, remain)
    left_out += 0.5 * remain * np.sqrt(found.hidden / np.maximum(1 - found.hidden, 1e-3))
    return on_corners(levels.names, bound, found.bodies, levels.permitted, found.cost_s), left_out


def faint_bodies(
    prepared: PreparedScene, radar: RadarDesign, levels: BodyLevels
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


def further_reflections(
    levels: BodyLevels, fidelity: Fidelity, choice: ReflectionChoice | None, radar: RadarDesign
) -> Decided:
    """What was decided on further reflections."""
    if choice is None:
        return (), np.zeros(len(levels.names))
    level = levels.reference / loss_of(radar)
    knobs = {"bounces": fidelity.radar_bounces, "images": fidelity.radar_images}
    kinds = [kind for kind, knob in knobs.items() if knob is None]
    decisions = on_reflections(choice, kinds, levels.names, level, levels.permitted)
    return decisions, choice.left_out.sum / level


def over_two_edges(levels: BodyLevels, radar: RadarDesign, of_edges: Contributions) -> Decided:
    """What waves that are diffracted at two edges of a body, or at a corner, add to those of its
    edges, which is left out.
    """
    left_out = _OF_EDGES * levels.rms_of(of_edges, radar) / levels.reference
    return on_two_edges(levels.names, left_out, levels.permitted), left_out


@dataclass(frozen=True, eq=False)
class Edges:
    """Echoes of sharp edges, remarks on them, what was decided, and of how many bodies none of
    them is taken since bounds say so.
    """

    echoes: Contributions
    remarks: list[str]
    decided: Decided
    n_left_out: int = 0


def sharp_edges(
    prepared: PreparedScene, radar: RadarDesign, fidelity: Fidelity, levels: BodyLevels
) -> Edges:
    """Of all bodies, or by bounds of those to whose echo they may add too much."""
    nothing = np.zeros(len(levels.names))
    if fidelity.radar_edges is not None or not levels.names:
        return Edges(*diffracted(prepared, fidelity), ((), nothing))
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
    return Edges(echoes, remarks, (decisions, left_out), n_left_out)
