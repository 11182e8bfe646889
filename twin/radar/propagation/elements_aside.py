"""What an antenna aside of the others' middle sees otherwise: its own echoes, as a check.

All echoes are traced from the middle of the antennas, and wavefronts over them are spheres. What
hides what, and which facets are lit by others, is another matter: past a post 5 m away, 5 cm aside,
an antenna sees 3 cm more of what is 8 m away. Of a wide array the scene is therefore traced from
its farthest element too, and what bodies' echoes differ by there counts in their stated errors.
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
from twin.radar.synthesis.wavefronts import nearer_m
from twin.scene import Scene

Array = NDArray[np.float64]

#: Distance of the farthest element, in wavelengths, up to which nothing is compared: at 2 the car
#: in the yard, most of which is reflected twice or more, differs by as much as is stated.
_NEAR = 3.0
_ALONE: Mapping[str, object] = {
    "elements": {"transmitters_m": [[0.0, 0.0, 0.0]], "receivers_m": [[0.0, 0.0, 0.0]]}
}


def with_elements_aside(
    scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int, found: Propagation
) -> Propagation:
    """The same with what bodies' echoes differ by at the farthest element in their stated errors,
    and a warning where that is more than the tolerance.
    """
    elements_m = np.concatenate([radar.burst.transmitters_m, radar.burst.receivers_m])
    aside_m = elements_m[np.argmax(np.linalg.norm(elements_m, axis=1))]
    distance_m = float(np.linalg.norm(aside_m))
    if not solver_of(fidelity).has_tolerance or distance_m <= _NEAR * radar.ofdm.wavelength_m:
        return found
    began_s = perf_counter()
    there = trace(_seen_from(scene, aside_m), radar.with_(_ALONE), fidelity=fidelity, seed=seed)
    off = _differences(radar, found, there, aside_m)
    permitted = fidelity.radar_tolerance
    told = [
        f"the echo of {body.name} by {of_echo(change, body.level_over_echo)}"
        for body, change in zip(found.bodies, off, strict=True)
        if change > permitted
    ]
    remark = (
        f"antennas aside: {1e3 * distance_m:.2g} mm from their middle, where echoes are traced, "
        f"shadows and reflections between surfaces change {', '.join(told)}, which is left out; "
        f"{percent(permitted)} % permitted; the stated errors contain it"
    )
    decision = Decision(
        "radar",
        f"what an antenna {1e3 * distance_m:.2g} mm aside sees otherwise",
        max(off, default=0.0),
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


def _differences(
    radar: RadarDesign, found: Propagation, there: Propagation, aside_m: Array
) -> list[float]:
    """Of each body, what its echo at an element aside, of what was found from the middle, differs
    by from that found there, relative to its level.
    """
    echoes = found.contributions
    nearer_s = nearer_m(echoes, aside_m, aside_m) / C_M_PER_S
    moved = replace(echoes, delay_s=echoes.delay_s - nearer_s)
    taken = by_body(radar, found.bodies, found, moved, paths=False)[:-1]
    own = by_body(radar, found.bodies, there, there.contributions, paths=False)[:-1]
    level = np.array([body.level_amplitude for body in found.bodies])
    return list(over_level(taken - own, level).tolist())


def _seen_from(scene: Scene, aside_m: Array) -> Scene:
    """The scene with the radar moved by a way in its own frame."""
    place = scene.rig.radar
    moved_m = np.asarray(place.position_m) + place.rotation.apply(aside_m)
    moved = replace(place, position_m=tuple(moved_m.tolist()))
    return replace(scene, rig=replace(scene.rig, radar=moved))
