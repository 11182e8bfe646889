"""Physical optics by brute force, of conductors of few facets that reflect at each other.

The currents of every facet are summed at fixed points in float64, each with straight lines to the
radar that no other facet may cross. By way of other facets a point is lit from the radar's mirror
image in their planes, where the line from there passes through them; by way of the ground it is
also heard so, in every combination of a way out and a way home. Nothing of the radar's solver is
used: it is compared with this.
"""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar import RadarDesign
from twin.scene import SceneObject

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LEAST = 1e-9  # m: facets whose corners lie nearer to a plane lie in it
_OFF = 1e-8  # m: of the ends of a line nothing so near is in its way


def echoes(
    objects: Sequence[SceneObject],
    radar: RadarDesign,
    frequencies_hz: Array,
    bounces: int,
    spacing_m: float,
    ground: SceneObject | None = None,
    least: int = 3,
) -> Complex:
    """Received over sent wave of every object that is met last, (n_objects, n_frequencies).

    Parameters
    ----------
    objects, ground
        Perfect conductors, in coordinates of the radar: x ahead, z up. The ground only mirrors,
        at the begin and at the end of a way.
    frequencies_hz
        Equally spaced.
    bounces
        Up to which number facets reflect, the last one included.
    spacing_m, least
        Facets are divided so that edges of parts are no longer than this, into so many along each
        edge at least. Each part has three points.
    """
    bodies = [*objects, ground] if ground is not None else [*objects]
    corners = np.concatenate([item.vertices_m[item.geometry.faces] for item in bodies])
    body = np.repeat(np.arange(len(bodies)), [len(item.geometry.faces) for item in bodies])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    own, of_ground = (
        np.flatnonzero(body < len(objects)).tolist(),
        np.flatnonzero(body == len(objects)).tolist(),
    )
    begins: list[tuple[int, ...]] = [(), *((face,) for face in of_ground)]
    gain_dbi = radar.antenna.gain_dbi
    assert gain_dbi is not None
    exponent = 10 ** (gain_dbi.value / 10) / 2 - 1
    k = 2 * np.pi * frequencies_hz / speed_of_light
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.maximum(least, np.ceil(longest / spacing_m)).astype(np.int64)
    low, high = corners.min(axis=1) - _OFF, corners.max(axis=1) + _OFF
    in_plane = (
        np.abs(np.einsum("abi,abci->abc", normal[:, None], corners[None] - corners[:, :1, None]))
        < _LEAST
    ).all(axis=2)
    found = np.zeros((len(objects), len(k)), dtype=np.complex128)
    kernel = _kernel()
    for count in range(bounces):
        for chain in itertools.product(own, repeat=count + 1):
            if any(in_plane[a, b] for a, b in itertools.pairwise(chain)):
                continue
            for begin, end in itertools.product(begins, begins):
                found[body[chain[-1]]] += kernel(
                    corners,
                    normal,
                    low,
                    high,
                    np.array((*begin, *chain[:-1]), dtype=np.int64),
                    np.array(end, dtype=np.int64),
                    chain[-1],
                    pieces[chain[-1]],
                    exponent,
                    k[0],
                    k[1] - k[0],
                    len(k),
                )
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    return -1j * loss / (4 * np.pi) * found


@lru_cache(maxsize=1)
def _kernel() -> Any:
    """Compiled at the first call."""
    import numba

    @numba.njit
    def way_through(begin, direction, corners, face):  # type: ignore[no-untyped-def]
        """Distance to a facet along a line; -1 where it passes by."""
        a = corners[face, 0]
        one, other = corners[face, 1] - a, corners[face, 2] - a
        p0 = direction[1] * other[2] - direction[2] * other[1]
        p1 = direction[2] * other[0] - direction[0] * other[2]
        p2 = direction[0] * other[1] - direction[1] * other[0]
        slope = one[0] * p0 + one[1] * p1 + one[2] * p2
        if slope == 0.0:
            return -1.0
        s = begin - a
        u = (s[0] * p0 + s[1] * p1 + s[2] * p2) / slope
        if u < 0 or u > 1:
            return -1.0
        q0 = s[1] * one[2] - s[2] * one[1]
        q1 = s[2] * one[0] - s[0] * one[2]
        q2 = s[0] * one[1] - s[1] * one[0]
        v = (direction[0] * q0 + direction[1] * q1 + direction[2] * q2) / slope
        if v < 0 or u + v > 1:
            return -1.0
        return (other[0] * q0 + other[1] * q1 + other[2] * q2) / slope

    @numba.njit
    def is_free(begin, end, corners, low, high, first, second):  # type: ignore[no-untyped-def]
        """Whether no facet but two crosses a line."""
        direction = end - begin
        length = math.sqrt(direction @ direction)
        direction = direction / length
        for face in range(len(corners)):
            if face in (first, second):
                continue
            beside = False
            for i in range(3):
                if min(begin[i], end[i]) > high[face, i] or max(begin[i], end[i]) < low[face, i]:
                    beside = True
            if beside:
                continue
            there = way_through(begin, direction, corners, face)
            if _OFF < there < length - _OFF:
                return False
        return True

    @numba.njit
    def field(departure):  # type: ignore[no-untyped-def]
        """Of an antenna that looks along x, polarised along z, by Ludwig's third definition."""
        share = departure[2] / max(1 + departure[0], 1e-9)
        found = -share * departure
        found[0] -= share
        found[2] += 1
        return found

    @numba.njit
    def led(corners, normal, low, high, mirrors, images, place, face, exponent):  # type: ignore[no-untyped-def]
        """Gain of the way to a point over mirrors, with its image's direction and field; a gain of
        0 where there is none.
        """
        count = len(mirrors)
        points = np.empty((count + 1, 3))
        points[count] = place
        none = np.zeros(3)
        at = place
        for i in range(count - 1, -1, -1):
            way = images[i + 1] - at
            length = math.sqrt(way @ way)
            reach = way_through(at, way / length, corners, mirrors[i])
            if reach <= 0 or reach > length:
                return 0.0, none, none
            at = at + reach * way / length
            points[i] = at
        begin = images[0]
        for i in range(count + 1):
            last = mirrors[i - 1] if i > 0 else -1
            following = mirrors[i] if i < count else face
            if not is_free(begin, points[i], corners, low, high, last, following):
                return 0.0, none, none
            begin = points[i]
        direction = points[0] - images[0]
        direction = direction / math.sqrt(direction @ direction)
        if direction[0] <= 0:
            return 0.0, none, none
        gain = math.sqrt(2 * (exponent + 1) * direction[0] ** exponent)
        wave = field(direction)
        for i in range(count):
            across = normal[mirrors[i]]
            wave = 2 * (wave @ across) * across - wave
            direction = direction - 2 * (direction @ across) * across
        return gain, direction, wave

    @numba.njit
    def imaged(corners, normal, mirrors):  # type: ignore[no-untyped-def]
        found = np.zeros((len(mirrors) + 1, 3))
        for i in range(len(mirrors)):
            across = normal[mirrors[i]]
            off = (found[i] - corners[mirrors[i], 0]) @ across
            found[i + 1] = found[i] - 2 * off * across
        return found

    @numba.njit
    def summed(  # type: ignore[no-untyped-def]
        corners, normal, low, high, out, home, face, pieces, exponent, lowest, step, count
    ):
        """Integral of a facet's currents at every wave number."""
        found = np.zeros(count, dtype=np.complex128)
        there, back = imaged(corners, normal, out), imaged(corners, normal, home)
        across = normal[face]
        a = corners[face, 0]
        if ((there[-1] - a) @ across) * ((back[-1] - a) @ across) <= 0:
            return found
        one, other = corners[face, 1] - a, corners[face, 2] - a
        area = math.sqrt((one @ one) * (other @ other) - (one @ other) ** 2) / 2
        area /= 3 * pieces * pieces
        at_u = (1 / 6, 2 / 3, 1 / 6)
        at_v = (1 / 6, 1 / 6, 2 / 3)
        for i in range(pieces):
            for j in range(pieces - i):
                for upper in range(2):
                    if upper == 1 and i + j > pieces - 2:
                        continue
                    for node in range(3):
                        if upper == 0:
                            u, v = i + at_u[node], j + at_v[node]
                        else:
                            u, v = i + 1 - at_u[node], j + 1 - at_v[node]
                        place = a + (u / pieces) * one + (v / pieces) * other
                        gain, direction, wave = led(
                            corners, normal, low, high, out, there, place, face, exponent
                        )
                        if gain == 0.0:
                            continue
                        again, _, heard = led(
                            corners, normal, low, high, home, back, place, face, exponent
                        )
                        if again == 0.0:
                            continue
                        side = across if direction @ across < 0 else -across
                        current = (direction @ heard) * (side @ wave)
                        current -= (wave @ heard) * (side @ direction)
                        first, second = place - there[-1], place - back[-1]
                        first_m = math.sqrt(first @ first)
                        second_m = math.sqrt(second @ second)
                        strength = area * gain * again * current / (first_m * second_m)
                        path = first_m + second_m
                        value = strength * complex(
                            math.cos(lowest * path), -math.sin(lowest * path)
                        )
                        turn = complex(math.cos(step * path), -math.sin(step * path))
                        for row in range(count):
                            found[row] += value
                            value *= turn
        return found

    return summed
