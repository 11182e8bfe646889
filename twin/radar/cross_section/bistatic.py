"""Far field of a mesh by physical optics, from any direction into any other: many at once.

A facet radiates only to where it is seen: the shadow that a target casts forwards, which physical
optics has as a wave of its own, is left out.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.cross_section.aspects import Aspects
from twin.radar.cross_section.optics import Quality, dyadic
from twin.radar.scattering.target import MeshTarget

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def scattering_dyadics(
    target: MeshTarget, source: Array, receiver: Array, frequency_hz: Array, quality: Quality
) -> Complex:
    """What turns the incident field at the target's origin into the scattered one.

    Parameters
    ----------
    source, receiver : (n, 3)
        Unit vectors from the target to where the wave comes from, and to where it is received.
    frequency_hz : (f,)
        Materials answer as at the first.

    Returns
    -------
    (n, f, 3, 3)
        Dyadics D in metres: an incident E gives D E exp(-j k r) / r at a distance r, so with unit
        polarisations the bistatic cross-section is 4 pi |e_r . D e_i|^2.
    """
    sent, received = _transverse(source), _transverse(receiver)
    aspects = Aspects(source, receiver, np.full(len(source), np.inf), sent, received)
    dyadics = dyadic(target, aspects, frequency_hz, quality).amplitude
    return np.einsum("nfpq,nqx,npy->nfxy", dyadics, received, sent)


def _transverse(direction: Array) -> Array:
    """Two unit vectors across each direction, (n, 2, 3)."""
    least = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)
