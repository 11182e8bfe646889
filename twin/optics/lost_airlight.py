"""Sunlight that hits no surface and is scattered by the air more than once, by a random walk.

It has no limit in air that fills all space, and what is above the sensor is not modelled: the sun's
light is given where it arrives. So the air is taken to lie in a layer over black ground, which ends
`_ABOVE_M` above the sensor, or lower where it would dim the sun by more than e on its way there.
The ground is as far below as the first surface straight down, `_BELOW_M` where there is none.
"""

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.backscatter import cell_rays
from twin.optics.lost_orders import turned
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]

_WALKS = 12_000
_SEGMENTS = 300  # after which a walk is given up
_ABOVE_M, _BELOW_M = 10.0, 1.5


def lost_airlight(
    problem: LightProblem,
    shape: tuple[int, int],
    distance_m: Array,
    *,
    rng: np.random.Generator,
    least_orders: int = 2,
) -> Array:
    """Irradiance on the pupil per irradiance of the sun at the sensor, of light that the air
    scatters ``least_orders`` times or more, by part of the detector's field; (rows, columns).

    In the unit of `airlight`, to 5 to 20 % of the whole; single parts are noisier. Walks start at
    the detector and end on surfaces: those at ``distance_m`` (rows, columns) along each part's ray,
    as an endless wall across. Surfaces cast no shadow on the air.
    """
    air, sun, camera = problem.air, np.asarray(problem.sun.direction), problem.detector
    if air is None or not air.scattering_per_m or sun[2] <= 0:
        return np.zeros(shape)
    directions, cosine = (part.reshape(np.prod(shape), -1) for part in cell_rays(camera, shape, 1))
    times = -(-_WALKS // len(directions))
    part = np.tile(np.arange(len(directions)), times)
    wall_m = (distance_m.ravel() * cosine[:, 0])[part]
    ends_m = -_height_m(problem), min(_ABOVE_M, sun[2] / air.extinction_per_m)
    albedo = air.scattering_per_m / air.extinction_per_m
    light, place, heading = np.zeros(len(directions)), np.zeros((len(part), 3)), directions[part]
    # The first scattering is in front of the surface in every walk, and weighted.
    first = -np.expm1(-air.extinction_per_m * _length(place, heading, wall_m, ends_m, camera.axes))
    weight, within = first, rng.uniform(size=len(part)) * first
    step = -np.log1p(-within) / air.extinction_per_m
    for order in range(1, _SEGMENTS):
        place = place + step[:, None] * heading
        weight = weight * albedo
        if order >= least_orders:
            from_sun = np.exp(air.extinction_per_m * place[:, 2] / sun[2])  # 1 at the sensor
            seen = weight * air.phase(heading @ sun) * from_sun
            light += np.bincount(part, seen, len(light))
        heading = turned(air, heading, rng)
        step = rng.exponential(1 / air.extinction_per_m, len(part))
        goes_on = step < _length(place, heading, wall_m, ends_m, camera.axes)
        if not goes_on.any():
            break
        part = part[goes_on]
        place, heading, weight, wall_m, step = (
            values[goes_on] for values in (place, heading, weight, wall_m, step)
        )
    area = (2 * camera.tan_half_field) ** 2 / len(directions)
    light *= area * cosine[:, 0] ** 4 / times
    if camera.outline == "disc":
        light[cosine[:, 0] < 1 / np.sqrt(1 + camera.tan_half_field**2)] = 0
    return light.reshape(shape)


def _height_m(problem: LightProblem) -> float:
    """Of the sensor above the ground."""
    if problem.scene is None:
        return _BELOW_M
    mi = mitsuba()
    down = mi.Ray3f(mi.Point3f(problem.detector.origin_m.tolist()), mi.Vector3f(0, 0, -1))
    hit = problem.scene.ray_intersect(down)
    return float(hit.t[0]) if hit.is_valid()[0] else _BELOW_M


def _length(
    place: Array, heading: Array, wall_m: Array, ends_m: tuple[float, float], axes: Array
) -> Array:
    """How far walks may go on until they leave the layer, from the lower to the upper of its
    ``ends_m``, or meet the wall.
    """
    ahead, rise = heading @ axes[0], heading[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_wall = np.where(ahead > 0, (wall_m - place @ axes[0]) / ahead, np.inf)
        to_end = np.where(rise > 0, ends_m[1] - place[:, 2], ends_m[0] - place[:, 2]) / rise
    return np.maximum(np.fmin(to_wall, np.where(rise == 0, np.inf, to_end)), 0.0)
