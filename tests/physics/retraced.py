"""What was traced of an interval, against the scene traced anew at single slots."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar import RadarDesign
from twin.radar.propagation.facets.convergence import band_of, reference_levels, summed_by
from twin.radar.propagation.interval.instants import weights
from twin.radar.propagation.result import Instant, Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.scene import Scene

Array = NDArray[np.float64]


def errors_by_body(
    scene: Scene,
    radar: RadarDesign,
    found: Propagation,
    fidelity: Fidelity,
    times_s: Array,
) -> dict[str, float]:
    """Root mean square over times and the band of each body's echo less that of a trace of its own,
    over that echo's (at least the level that tolerances are relative to).
    """
    names = [body.objects for body in found.bodies]
    parts = found.instants or (Instant(0.0, found.contributions),)
    share = weights([part.time_s for part in parts], times_s)
    floor = OF_NOISE * noise_amplitude(radar)
    off, exact = [], []
    for k, time in enumerate(times_s.tolist()):
        anew = trace(scene.after(time), radar, fidelity=fidelity, followed_s=0.0)
        exact.append(_by_body(radar, names, anew, anew.contributions))
        blend = sum(
            weight * _by_body(radar, names, found, _followed(part, time))
            for weight, part in zip(share[:, k], parts, strict=True)
            if weight
        )
        off.append(blend - exact[-1])
    level = reference_levels(np.concatenate(exact, axis=1), fidelity.radar_tolerance, floor)
    error = np.sqrt(np.mean(np.abs(np.concatenate(off, axis=1)) ** 2, axis=1)) / level
    return {name[0]: float(one) for name, one in zip(names, error, strict=True)}


def _followed(part: Instant, time_s: float) -> Contributions:
    echoes = part.contributions
    return replace(echoes, delay_s=echoes.delays_at(time_s - part.time_s))


def _by_body(radar, names, found: Propagation, echoes: Contributions) -> NDArray[np.complex128]:
    """Surfaces' echoes of each body."""
    number = {name: i for i, body in enumerate(names) for name in body}
    of_object = np.array([*(number.get(name, -1) for name in found.objects), -1])
    owner = np.full(len(echoes), -1)
    dense = slice(len(found.names), None)
    owner[dense] = of_object[echoes.object[dense]]
    return summed_by(owner, len(names), echoes, radar.ofdm.carrier_hz, band_of(radar.ofdm))
