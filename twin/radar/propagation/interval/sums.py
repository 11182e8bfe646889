"""Echoes of bodies summed over the band, of which those of two instants are compared."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import BodyEcho, band_of, summed_by
from twin.radar.propagation.result import Propagation
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]


def by_body(
    radar: RadarDesign,
    bodies: Sequence[BodyEcho],
    found: Propagation,
    echoes: Contributions,
    *,
    paths: bool = True,
) -> NDArray[np.complex128]:
    """Echoes summed by body in the order of ``bodies``, all others the last; so are single paths,
    or they count for none.
    """
    body_of = {name: number for number, body in enumerate(bodies) for name in body.objects}
    count = len(bodies) + 1
    of_object = np.array([body_of.get(name, count - 1) for name in found.objects], dtype=np.int64)
    owner = np.full(len(echoes), count - 1)
    dense = slice(len(found.names), None)
    if not paths:
        owner[: len(found.names)] = -1
    if len(of_object):
        owner[dense] = of_object[echoes.object[dense]]
    wave = radar.ofdm
    return summed_by(owner, count, echoes, wave.carrier_hz, band_of(wave))


def over_level(echo: NDArray[np.complex128], level: Array) -> Array:
    """Root mean square of echoes (n_bodies, n_frequencies) over levels (n_bodies,)."""
    return np.asarray(np.sqrt(np.mean(np.abs(echo) ** 2, axis=1)) / np.maximum(level, 1e-300))
