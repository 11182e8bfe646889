"""What antennas aside of the radar's origin see otherwise: their own echoes, as a check.

All echoes are traced from the origin, and wavefronts over the antennas are spheres. What hides
what, and which facets are lit by others, is another matter: past a post 5 m away, 5 cm aside, an
antenna sees 3 cm more of what is 8 m away. Of a wide array the scene is therefore traced from its
farthest elements too, and what bodies' echoes differ by there counts in their stated errors.
"""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.decisions import UNIT
from twin.radar.propagation.facets.convergence import of_echo, percent
from twin.radar.propagation.interval.sums import by_body, over_level
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import solver_of, trace
from twin.radar.synthesis.wavefronts import level, nearer_m
from twin.scene import Scene

Array = NDArray[np.float64]

#: Distance of an element, in wavelengths, up to which it is not compared: at 2 the car
#: in the yard, most of which is reflected twice or more, differs by as much as is stated.
_NEAR = 3.0
_ALONE: Mapping[str, object] = {
    "elements": {"transmitters_m": [[0.0, 0.0, 0.0]], "receivers_m": [[0.0, 0.0, 0.0]]}
}


def with_elements_aside(
    scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int, found: Propagation
) -> Propagation:
    """The same with what bodies' echoes differ by at the farthest elements in their stated errors,
    and a warning where that is more than the tolerance.
    """
    places_m = _farthest(radar)
    if not (len(places_m) and found.bodies and solver_of(fidelity).has_tolerance):
        return found
    began_s, distance_m = perf_counter(), float(np.linalg.norm(places_m, axis=1).max())
    differences = []
    for aside_m in places_m:
        there = trace(_seen_from(scene, aside_m), radar.with_(_ALONE), fidelity=fidelity, seed=seed)
        differences.append(_differences(radar, found, there, aside_m))
    off = np.max(differences, axis=0).tolist()
    permitted = fidelity.radar_tolerance
    told = [
        f"the echo of {body.name} by {of_echo(change, body.level_over_echo)}"
        for body, change in zip(found.bodies, off, strict=True)
        if change > permitted
    ]
    remark = (
        f"antennas aside: {1e3 * distance_m:.3g} mm from the origin, where echoes are traced, "
        f"shadows and reflections between surfaces change {', '.join(told)}, which is left out; "
        f"{percent(permitted)} % permitted; the stated errors contain it"
    )
    decision = Decision(
        "radar",
        f"what an antenna {1e3 * distance_m:.3g} mm aside sees otherwise",
        max(off),
        permitted,
        UNIT,
        False,
        perf_counter() - began_s,
        is_told=bool(told),
    )
    bodies = zip(found.bodies, off, strict=True)
    return replace(
        found,
        bodies=tuple(body.off_by(change) for body, change in bodies),
        decisions=(*found.decisions, decision),
        warnings=(*found.warnings, remark) if told else found.warnings,
    )


def _farthest(radar: RadarDesign) -> Array:
    """Places of elements that are the farthest to the left, right, top, bottom, front or back, of
    those that are compared, (n, 3).
    """
    elements_m = np.concatenate([radar.burst.transmitters_m, radar.burst.receivers_m])
    ends = np.concatenate([elements_m.argmin(axis=0), elements_m.argmax(axis=0)])
    some_m = np.unique(elements_m[ends], axis=0)
    is_far = np.linalg.norm(some_m, axis=1) > _NEAR * radar.ofdm.wavelength_m
    return np.asarray(some_m[is_far])


def _differences(
    radar: RadarDesign, found: Propagation, there: Propagation, aside_m: Array
) -> Array:
    """Of each body, what its echo at an element aside, of what was found from the middle, differs
    by from that found there, relative to its level.
    """
    echoes = found.contributions
    nearer_s = nearer_m(echoes, aside_m, aside_m) / C_M_PER_S
    amplitude = echoes.amplitude * level(echoes, aside_m, aside_m, radar.antenna.gain)
    moved = replace(echoes, amplitude=amplitude, delay_s=echoes.delay_s - nearer_s)
    taken = by_body(radar, found.bodies, found, moved, paths=False)[:-1]
    own = by_body(radar, found.bodies, there, there.contributions, paths=False)[:-1]
    levels = np.array([body.level_amplitude for body in found.bodies])
    return over_level(taken - own, levels)


def _seen_from(scene: Scene, aside_m: Array) -> Scene:
    """The scene with the radar moved by a way in its own frame."""
    place = scene.rig.radar
    moved_m = np.asarray(place.position_m) + place.rotation.apply(aside_m)
    moved = replace(place, position_m=tuple(moved_m.tolist()))
    return replace(scene, rig=replace(scene.rig, radar=moved))
