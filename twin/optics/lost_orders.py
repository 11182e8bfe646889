"""Light that the air scatters more often than is followed, by a random walk before a wall.

No path that is traced knows of it, and its orders fall slower than any power: in thick air that
scatters to all sides each is nearly as bright as the one before. So the same air is walked through
in NumPy, to all orders, before an endless wall across at the distance of the surfaces.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.optics.weather import Air
from twin.system.environment import BACKWARD_ASYMMETRY

Array = NDArray[np.float64]

_WALKS = 12_000
_SEGMENTS = 300  # after which a walk is given up
_AWAY = 6.0  # distances of the wall, beyond which light no longer comes to what is seen
_BOUNCES = 8
_MOST_LOST = 1e9  # of the light that is followed: where no walk has so few orders, it says nothing
#: Optical depth per order that is followed, less the forward peak, below which less than 0.1 % is
#: lost; and the share of the depth that counts however far forward the air scatters.
_THIN, _LEAST = 1 / 24, 1 / 6
#: Bounds of rings on the wall, in distances; the first ones are within a field of 20 degrees.
_RINGS = np.concatenate([np.linspace(0, 0.3, 7), np.geomspace(0.4, _AWAY, 14)])


@dataclass(frozen=True, eq=False)
class _Hits:
    """Light on the rings of the wall: of all orders, and of paths that are followed throughout."""

    all: Array
    followed: Array


def lost_orders_share(
    air: Air,
    distance_m: float,
    tan_half_field: float,
    reflectance: float,
    orders: int,
    *,
    rng: np.random.Generator,
) -> float:
    """Light that is scattered more than ``orders`` times on the way to a surface or back, over the
    light of surfaces that is followed.

    By walks from an emitter and from a detector in one place with a field ``tan_half_field``, which
    meet on a wall of that reflectance; it scatters by 4 % of itself at an optical depth of 3. 0
    where less than 0.1 % is lost.
    """
    depth = air.scattering_per_m * distance_m
    aside = max(1 - air.asymmetry**2, _LEAST)
    if not orders or depth * aside <= _THIN * orders:
        return 0.0
    there = _walk(air, distance_m, tan_half_field, reflectance, _BOUNCES, orders, rng)
    back = _walk(air, distance_m, tan_half_field, reflectance, 1, orders, rng)
    areas = np.diff(_RINGS**2)
    followed = float(np.sum(there.followed * back.followed / areas))
    every = float(np.sum(there.all * back.all / areas))
    return min(every / followed - 1, _MOST_LOST) if followed else _MOST_LOST


def _walk(
    air: Air,
    distance_m: float,
    tangent: float,
    reflectance: float,
    bounces: int,
    orders: int,
    rng: np.random.Generator,
) -> _Hits:
    """Lengths in distances of the wall, which is at x = 1."""
    free = 1 / (air.scattering_per_m * distance_m)
    absorbed = (air.extinction_per_m - air.scattering_per_m) * distance_m
    aside = rng.uniform(-tangent, tangent, (_WALKS, 2))
    heading = np.column_stack([np.ones(_WALKS), aside])
    length = np.linalg.norm(heading, axis=1)
    heading, weight = heading / length[:, None], length**-3
    place = np.zeros_like(heading)
    order, bounced = np.zeros((2, _WALKS), dtype=int)
    followed = np.ones(_WALKS, dtype=bool)
    found = _Hits(*np.zeros((2, len(_RINGS) - 1)))
    for _ in range(_SEGMENTS):
        step = rng.exponential(free, len(place))
        toward = np.maximum(heading[:, 0], 1e-12)
        to_wall = np.where(heading[:, 0] > 0, (1 - place[:, 0]) / toward, np.inf)
        meets = to_wall <= step
        step = np.where(meets, to_wall, step)
        place = place + step[:, None] * heading
        place[meets, 0] = 1.0
        weight = weight * np.exp(-absorbed * step)
        followed &= ~meets | (order <= orders)
        radius = np.hypot(place[:, 1], place[:, 2])
        for light, counts in ((found.all, meets), (found.followed, meets & followed)):
            light += np.histogram(radius[counts], _RINGS, weights=weight[counts])[0]
        order = np.where(meets, 0, order + 1)
        bounced = bounced + meets
        weight = weight * np.where(meets, reflectance, 1.0)
        heading = np.where(meets[:, None], _reflected(len(place), rng), turned(air, heading, rng))
        goes_on = (bounced < bounces) & (radius < _AWAY) & (place[:, 0] > -_AWAY) & (weight > 1e-6)
        if not goes_on.any():
            break
        place, heading, weight, order, bounced, followed = (
            part[goes_on] for part in (place, heading, weight, order, bounced, followed)
        )
    return found


def _reflected(n: int, rng: np.random.Generator) -> Array:
    """Directions (n, 3) from a white wall at x = 1, by the cosine to its normal."""
    square, angle = rng.uniform(size=n), rng.uniform(0, 2 * np.pi, n)
    across = np.sqrt(1 - square)
    return np.column_stack([-np.sqrt(square), across * np.cos(angle), across * np.sin(angle)])


def turned(air: Air, heading: Array, rng: np.random.Generator) -> Array:
    """Directions (n, 3) after one scattering by the air's phase function."""
    n = len(heading)
    backward = rng.uniform(size=n) < air.backward_share
    g = np.where(backward, BACKWARD_ASYMMETRY, air.forward_asymmetry)
    g = np.where(np.abs(g) < 1e-3, 1e-3, g)  # the inversion has a pole at 0
    base = (1 - g * g) / (1 - g + 2 * g * rng.uniform(size=n))
    cosine = np.clip((1 + g * g - base * base) / (2 * g), -1, 1)
    sine, angle = np.sqrt(1 - cosine**2), rng.uniform(0, 2 * np.pi, n)
    least = np.eye(3)[np.argmin(np.abs(heading), axis=1)]
    first = np.cross(heading, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(heading, first)
    around = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return np.asarray(cosine[:, None] * heading + sine[:, None] * around)
