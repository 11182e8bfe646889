"""Bound of what the sharp edges of bodies add to their echoes, without rays.

The cross-section of an edge of length L, met at right angles, is L^2 / pi at most: the coefficients
of its fringe current (Ufimtsev's f1 and g1) are 1 at most, except where the wave goes on nearly
straight ahead. Where the path's slope along the edge is not zero anywhere, only its ends answer.
"""

from dataclasses import dataclass

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


_AT_ONCE = 2**17  # points on edges, of all images: 10 MB


@dataclass(frozen=True, eq=False)
class EdgeBound:
    """Bound of the amplitude of all edges of a body together, out by one image and home by another.

    ``images`` (m,): numbers of those with paths to the body that are worth tracing; ``amplitude``
    (m, m), as if nothing hid the edges and all mirrors were perfect; infinite where there is none.
    """

    images: NDArray[np.intp]
    amplitude: Array

    @property
    def sum(self) -> float:
        """Over all pairs of images."""
        return float(self.amplitude.sum())

    def worth_tracing(self, limit: float) -> tuple[NDArray[np.bool_], float]:
        """Which pairs are traced, (m, m): all but the faintest, which together stay below a limit;
        and their bound.
        """
        order = np.argsort(self.amplitude, axis=None, kind="stable")
        below = np.cumsum(self.amplitude.ravel()[order])
        count = int(np.searchsorted(below, limit, side="right"))
        is_traced = np.ones(self.amplitude.size, dtype=bool)
        is_traced[order[:count]] = False
        both = is_traced.reshape(self.amplitude.shape)
        # A path and the same one reversed are traced together.
        return both | both.T, float(below[count - 1]) if count else 0.0


def edge_bound(
    body: Sharp, antennas: ImageAntennas, images: NDArray[np.intp], gain: Array, wavelength_m: float
) -> EdgeBound:
    """Over all pairs of some ``images``, numbers of ``antennas``.

    ``gain`` (n_images,): bound of the antenna's towards the body.
    """
    edges, count = body.edges, len(images)
    amplitude = np.zeros((count, count))
    rows = max(_AT_ONCE // (len(_ALONG) * max(count, 1)), 1)
    for first in range(0, len(edges.length_m), rows):
        part = slice(first, first + rows)
        some = edges.start_m[part], edges.along[part], edges.length_m[part]
        amplitude += _pair_bounds(*some, antennas.place[images], wavelength_m)
    root = np.sqrt(gain[images])
    weight = root[:, None] * root
    with np.errstate(invalid="ignore"):
        return EdgeBound(images, np.where(weight > 0, amplitude * weight, 0.0))


def _pair_bounds(
    start_m: Array, along: Array, length_m: Array, places: Array, wavelength_m: float
) -> Array:
    """Of isotropic antennas at places (m, 3), (m, m)."""
    k = 2 * np.pi / wavelength_m
    at = start_m[:, None] + (_ALONG * length_m[:, None])[..., None] * along[:, None]
    towards = places[:, None, None] - at
    away_m = np.maximum(np.linalg.norm(towards, axis=3), wavelength_m)  # (m, n, 3 points)
    back = towards / away_m[..., None]
    cosine = np.einsum("mnai,ni->mna", back, along)
    bend = (1 - cosine**2) / away_m
    bounds = np.zeros((len(places), len(places)))
    for i in range(len(places)):
        rest = slice(i, None)
        slope = k * (cosine[i] + cosine[rest])
        least_bend = k * (bend[i] + bend[rest]).min(axis=2)
        in_phase_m = _in_phase_m(length_m, slope, least_bend)
        near_m2 = away_m[i].min(axis=1) * away_m[rest].min(axis=2)
        pair = _LARGEST * wavelength_m / (8 * np.pi**2) * np.sum(in_phase_m / near_m2, axis=1)
        straight = np.einsum("nai,mnai->mna", back[i], back[rest]).min(axis=(1, 2)) < _STRAIGHT_ON
        bounds[i, rest] = bounds[rest, i] = np.where(straight, np.inf, pair)
    return bounds


def _in_phase_m(length_m: Array, slope: Array, bend: Array) -> Array:
    """Bound of the integral of exp(j phase) along edges, (..., n), by the phase's slope at points
    along each, (..., n, 3), in rad/m, which grows steadily, by at least ``bend`` per metre.

    Van der Corput's lemma: 2 over the least slope, or 8 over the root of the least bend.
    """
    least = np.abs(slope).min(axis=-1)
    is_steady = (slope > 0).all(axis=-1) | (slope < 0).all(axis=-1)
    with np.errstate(divide="ignore"):
        steady = np.where(is_steady, 2 / least, 8 / np.sqrt(bend))
    in_phase: Array = np.minimum(length_m, steady + _CUT_OFF * length_m)
    return in_phase
