"""What echoes of several reflections change by over an interval.

Reflected waves pass over a body as it moves: the border of what one part lights on another moves
along that other part, by a share of the way that either goes. Contributions follow the surface that
answers, so that at this border the phase of a path changes by more than their delays do. Echoes are
therefore traced coarsely, with a few reflections, in the middle of the interval and at its end.

Between two coarse traces alike most of their errors cancel, since facets are divided alike in both:
to 0.04 of the echo over 0.05 ms, where either is off by more. Over half an interval they tell of
bodies of two scenes 0.9 to 1.1 times what the finest traces do where that is more than 0.2 of the
echo, and up to three times where it is less.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import BodyEcho
from twin.radar.propagation.interval.sums import by_body, over_level
from twin.radar.propagation.solvers import trace
from twin.scene import Scene

Array = NDArray[np.float64]

#: Reflections at bodies and tolerance of the traces that are compared. With 2 reflections, or a
#: tolerance of 0.1, they tell the same of the yard's and the crossing's cars to 0.05 of the echo;
#: with a tolerance of 1 they tell changes of 0.1 of posts that hardly change.
_BOUNCES = 3
_TOLERANCE = 0.5


def changes_with_reflections(
    worlds: Mapping[float, Scene],
    radar: RadarDesign,
    fidelity: Fidelity,
    bodies: Sequence[BodyEcho],
    level: Array,
) -> Array:
    """What every body's echo changes by, beyond its delays, over ``level`` (n_bodies,), with
    reflections between bodies; 0 where none are followed. ``worlds``: the scene at times within a
    burst, 0 among them, of which the middle and the last are compared, or the first.
    """
    bounces = min(fidelity.radar_bounces or _BOUNCES, _BOUNCES)
    if bounces < 2 or not bodies:
        return np.zeros(len(bodies))
    coarse = fidelity.with_(
        radar="optics",
        radar_bounces=bounces,
        radar_images=0,
        radar_edges=0,
        radar_shadowed=0,
        radar_tolerance=max(fidelity.radar_tolerance, _TOLERANCE),
    )
    end = max(worlds, key=lambda time: (abs(time), time))
    sums = {}
    for time in (0.0, end):
        there = trace(worlds[time], radar, fidelity=coarse, followed_s=radar.burst_s / 2)
        echoes = there.contributions
        followed = replace(echoes, delay_s=echoes.delays_at(-time))
        sums[time] = by_body(radar, bodies, there, followed, paths=False)[: len(bodies)]
    return over_level(sums[end] - sums[0.0], level)
