"""Wavefronts over the antennas: how much shorter ways are for elements beside the radar's origin,
and how much stronger echoes.

The echo of a point in the distance R reaches an element at p over sqrt(R^2 - 2 R u p + p^2), u the
direction to it. Taken as plane, wavefronts of 79 GHz would be off by a fifth of a cycle at 8 cm
from the middle where R is 5 m. To the antennas' own image in a mirror, the way from one to another
is straight.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.synthesis.contributions import OWN_IMAGE, POINT, Contributions

Array = NDArray[np.float64]
#: Power gain towards unit vectors (n, 3).
Gain = Callable[[Array], Array]

#: Least length that is divided by.
_LEAST_M = 1e-12


def nearer_m(echoes: Contributions, sender_m: Array, listener_m: Array) -> Array:
    """By how much the ways of echoes are shorter from one element to another, at (3,) each, than
    from the antennas' origin to itself, (n,).
    """
    out, back = echoes.departure @ sender_m, echoes.arrival @ listener_m
    length_m = C_M_PER_S * echoes.delay_s
    found = out + back
    some = np.flatnonzero(echoes.wavefront == POINT)
    half_m = length_m[some] / 2
    found[some] = _to_point(half_m, out[some], sender_m) + _to_point(half_m, back[some], listener_m)
    some = np.flatnonzero(echoes.wavefront == OWN_IMAGE)
    between = sender_m - listener_m
    across2 = between @ between - np.square(echoes.departure[some] @ between)
    along_m = length_m[some] - found[some]
    found[some] -= across2 / np.maximum(along_m + np.sqrt(along_m**2 + across2), _LEAST_M)
    return found


def level(echoes: Contributions, sender_m: Array, listener_m: Array, gain: Gain) -> Array:
    """Amplitude of echoes from one element to another over that from the antennas' origin to
    itself, (n,): by the length of each way and the antenna's gain along it. The gain towards the
    antennas' own image is the origin's.
    """
    length_m, found = C_M_PER_S * echoes.delay_s, np.ones(len(echoes))
    some = np.flatnonzero(echoes.wavefront == POINT)
    for way, element_m in ((echoes.departure, sender_m), (echoes.arrival, listener_m)):
        if element_m.any():
            found[some] *= _level_of_point(length_m[some] / 2, way[some], element_m, gain)
    some = np.flatnonzero(echoes.wavefront == OWN_IMAGE)
    shorter_m = nearer_m(echoes.take(some), sender_m, listener_m)
    found[some] = length_m[some] / np.maximum(length_m[some] - shorter_m, _LEAST_M)
    return found


def _level_of_point(distance_m: Array, way: Array, element_m: Array, gain: Gain) -> Array:
    """Of one way, to or from points in directions ``way`` (n, 3) and so far from the origin; 1 for
    those that have no direction.
    """
    size = np.linalg.norm(way, axis=1, keepdims=True)  # directions of other times are longer
    way = way / np.maximum(size, _LEAST_M)
    from_element = distance_m[:, None] * way - element_m
    there_m = np.maximum(np.linalg.norm(from_element, axis=1), _LEAST_M)
    before, after = gain(way), gain(from_element / there_m[:, None])
    ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
    return np.where(size[:, 0] > 0, distance_m / there_m * np.sqrt(ratio), 1.0)


def _to_point(distance_m: Array, along_m: Array, element_m: Array) -> Array:
    """Distance of points from the origin less that from an element which lies so far towards them,
    without the difference of large numbers.
    """
    beyond = 2 * distance_m * along_m - element_m @ element_m
    there_m = np.sqrt(np.maximum(distance_m**2 - beyond, 0))
    return np.asarray(beyond / np.maximum(distance_m + there_m, _LEAST_M))
