"""Bound of what the sharp edges of bodies add to their echoes, without rays.

The cross-section of an edge of length L, met at right angles, is L^2 / pi at most: the coefficients
of its fringe current (Ufimtsev's f1 and g1) are 1 at most, except where the wave goes on nearly
straight ahead. Where the path's slope along the edge is not zero anywhere, only its ends answer.
"""

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.fringes import Sharp
from twin.radar.propagation.scene.culling import ImageAntennas

Array = NDArray[np.float64]

_ALONG = np.array([0.0, 0.5, 1.0])  # of an edge, where the path's slope is computed
#: Coefficient of the fringe current, at most. Of oblique and bistatic paths it exceeds 1.
_LARGEST = 2.0
#: Cosine of the angle between both ways from which on the coefficient is taken to have no bound.
_STRAIGHT_ON = -0.5
#: Share of the current that is cut off at the face's end, of faces deeper than 1.6 wavelengths: it
#: may be in phase where the rest is not.
_CUT_OFF = 1 / 8


def edge_bound(body: Sharp, antennas: ImageAntennas, gain: Array, wavelength_m: float) -> float:
    """Bound of the amplitude of all edges of a body together, over all pairs of images, as if
    nothing hid them and all mirrors were perfect; infinite where there is none.

    ``gain`` (n_images,): bound of the antenna's towards the body.
    """
    edges = body.edges
    if not len(edges.length_m):
        return 0.0
    k = 2 * np.pi / wavelength_m
    along_m = (_ALONG * edges.length_m[:, None])[..., None]
    at = edges.start_m[:, None] + along_m * edges.along[:, None]
    backs, lengths_m = [], []
    for place in antennas.place:
        towards = place - at
        lengths_m.append(np.maximum(np.linalg.norm(towards, axis=2), wavelength_m))
        backs.append(towards / lengths_m[-1][..., None])
    cosines = [np.einsum("nmi,ni->nm", back, edges.along) for back in backs]
    bends = [(1 - c**2) / length for c, length in zip(cosines, lengths_m, strict=True)]
    total = 0.0
    for i, back in enumerate(backs):
        for j in range(i, len(backs)):
            if gain[i] == 0 or gain[j] == 0:
                continue
            if np.sum(back * backs[j], axis=2).min() < _STRAIGHT_ON:
                return np.inf
            slope, bend = k * (cosines[i] + cosines[j]), k * (bends[i] + bends[j]).min(axis=1)
            in_phase_m = _in_phase_m(edges.length_m, slope, bend)
            near_m2 = lengths_m[i].min(axis=1) * lengths_m[j].min(axis=1)
            amplitude = _LARGEST * wavelength_m / (8 * np.pi**2) * np.sum(in_phase_m / near_m2)
            total += (1 if i == j else 2) * np.sqrt(gain[i] * gain[j]) * float(amplitude)
    return total


def _in_phase_m(length_m: Array, slope: Array, bend: Array) -> Array:
    """Bound of the integral of exp(j phase) along edges, (n,), by the phase's slope at points along
    each, (n, m), in rad/m, which grows steadily, by at least ``bend`` (n,) per metre.

    Van der Corput's lemma: 2 over the least slope, or 8 over the root of the least bend.
    """
    least = np.abs(slope).min(axis=1)
    is_steady = (slope > 0).all(axis=1) | (slope < 0).all(axis=1)
    with np.errstate(divide="ignore"):
        steady = np.where(is_steady, 2 / least, 8 / np.sqrt(bend))
    in_phase: Array = np.minimum(length_m, steady + _CUT_OFF * length_m)
    return in_phase
