"""Wavefronts over the antennas: how much shorter ways are for elements beside the middle.

The echo of a point in the distance R reaches an element at p over sqrt(R^2 - 2 R u p + p^2), u the
direction to it. Taken as plane, wavefronts of 79 GHz would be off by a fifth of a cycle at 8 cm
from the middle where R is 5 m. To the antennas' own image in a mirror, the way from one to another
is straight.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.synthesis.contributions import OWN_IMAGE, POINT, Contributions

Array = NDArray[np.float64]

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


def _to_point(distance_m: Array, along_m: Array, element_m: Array) -> Array:
    """Distance of points from the origin less that from an element which lies so far towards them,
    without the difference of large numbers.
    """
    beyond = 2 * distance_m * along_m - element_m @ element_m
    there_m = np.sqrt(np.maximum(distance_m**2 - beyond, 0))
    return np.asarray(beyond / np.maximum(distance_m + there_m, _LEAST_M))
