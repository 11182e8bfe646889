"""Light scattered back by the air: the emitter's (backscatter) and the sun's (airlight).

Single scattering only. Light that hits no surface and is scattered more than once is left out; the
sun's is estimated in `twin.optics.lost_airlight`. Light that hits a surface belongs to
`twin.optics.transport`. `twin.optics.reference` contains both, at the cost of a path tracer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.optics.devices import Device
from twin.optics.problem import LightProblem
from twin.optics.weather import Air

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Backscatter:
    """Backscatter of each cell's light, by the nodes of the quadrature.

    ``value`` in 1/m^2 and ``length_m`` of the two-way path, (rows, columns, n) each.
    """

    value: Array
    length_m: Array

    @property
    def light(self) -> Array:
        """Sum of each cell, (rows, columns), in the unit of `transport`: the two add up."""
        return self.value.sum(axis=-1)


def backscatter(
    problem: LightProblem,
    shape: tuple[int, int],
    distance_m: Any,
    *,
    strip: tuple[float, float] = (-1.0, 1.0),
    nodes: int = 24,
    rays: int = 2,
) -> Backscatter:
    """Irradiance on the detector's pupil per radiant intensity of each of the emitter's cells.

    A line integral along each ray to the first surface, of the light that the air scatters towards
    the detector, with two-way extinction, the pupil's cosine and the detector's field.
    ``distance_m`` stands for the surfaces of the scene.

    Parameters
    ----------
    problem
        With air.
    shape
        Rows and columns of cells.
    distance_m
        Along the ray to the first surface, infinite for none: a number, (rows, columns), or that of
        each of a cell's rays, (rows, columns, rays, rays), as `cell_rays` orders them.
    strip
        Part of the detector's square field from left to right, -1 to 1: one column of a sensor.
    nodes
        Of the Gauss-Legendre quadrature along a ray. Relative error of 24 below 1e-9, of 16 below
        1e-6, up to an extinction of 0.3 per m and 1e4 baselines (against adaptive quadrature).
    rays
        Along each side of a cell, for the mean over it: an error of order 1/rays^2, in cells that
        the edge of the detector's field crosses above all. 2: 1e-6 of the whole on 64 x 64 cells.

    Raises
    ------
    InputError
        Without air; and where a ray in the detector's field passes through the detector itself: two
        pinholes at one place have no finite backscatter.
    """
    emitter, detector, air = problem.emitter, problem.detector, _air(problem)
    directions, cosine = cell_rays(emitter, shape, rays)
    distance = np.asarray(distance_m, dtype=np.float64)
    if distance.ndim < 4:
        distance = np.broadcast_to(distance, shape)[..., None, None]
    start, stop = _in_field(emitter.origin_m, directions, detector, strip)
    stop = np.minimum(stop, distance)
    # Nothing is lost beyond 50 attenuation lengths, and infinity has no quadrature.
    stop = np.minimum(stop, start + 50 / max(air.extinction_per_m, 1e-12))
    lit = stop > start
    if emitter.outline == "disc":
        lit &= cosine >= 1 / np.sqrt(1 + emitter.tan_half_field**2)
    value, length = np.zeros((2, *cosine.shape, nodes))
    if air.scattering_per_m:
        value[lit], length[lit] = _along(
            emitter.origin_m, directions[lit], detector, start[lit], stop[lit], air, nodes
        )
    area = (2 * emitter.tan_half_field) ** 2 / (shape[0] * shape[1])
    value *= area * cosine[..., None] ** 3 / rays**2
    return Backscatter(value.reshape(*shape, -1), length.reshape(*shape, -1))


def airlight(
    problem: LightProblem, shape: tuple[int, int], distance_m: Any, *, rays: int = 2
) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by part of the detector's field; (rows,
    columns).

    In the unit of `sunlight`. Of each ray: albedo p(angle) (1 - exp(-extinction x distance)). The
    sun's irradiance is that at the sensor, everywhere: shadows of objects in the air, and the
    extinction of sunlight on its way, are left out. Raises InputError without air or sun.
    """
    camera, air, direction = problem.detector, _air(problem), problem.sun.direction
    directions, cosine = cell_rays(camera, shape, rays)
    distance = np.broadcast_to(np.asarray(distance_m, dtype=np.float64), shape)[..., None, None]
    if not air.scattering_per_m:
        return np.zeros(shape)
    lost = -np.expm1(-air.extinction_per_m * distance)
    # Light travels against the sun's direction, then against the ray.
    radiance = air.phase(directions @ np.asarray(direction)) * lost
    radiance *= air.scattering_per_m / air.extinction_per_m
    if camera.outline == "disc":
        radiance[cosine < 1 / np.sqrt(1 + camera.tan_half_field**2)] = 0
    area = (2 * camera.tan_half_field) ** 2 / (shape[0] * shape[1])
    return area * (radiance * cosine**4).mean(axis=(2, 3))


def _air(problem: LightProblem) -> Air:
    if problem.air is None:
        raise InputError("air: is not given")
    return problem.air


def cell_rays(device: Device, shape: tuple[int, int], rays: int) -> tuple[Array, Array]:
    """Directions (rows, columns, rays, rays, 3) through the cells, and their cosines to the axis.

    Row 0 is the top, column 0 left, as everywhere.
    """
    middle = (np.arange(rays) + 0.5) / rays
    y, x = (1 - 2 * (np.arange(n)[:, None] + middle) / n for n in shape)
    up = device.tan_half_field * y[:, None, :, None]
    left = device.tan_half_field * x[None, :, None, :]
    up, left = np.broadcast_arrays(up, left)
    cosine = 1 / np.sqrt(1 + up**2 + left**2)
    forward_axis, left_axis, up_axis = device.axes
    towards = forward_axis + left[..., None] * left_axis + up[..., None] * up_axis
    return towards * cosine[..., None], cosine


def _in_field(
    origin: Array, directions: Array, detector: Device, strip: tuple[float, float]
) -> tuple[Array, Array]:
    """Distances along each ray at which the detector's field begins and ends; begin >= end: the ray
    is outside the field.
    """
    offset = detector.axes @ (origin - detector.origin_m)
    slopes = directions @ detector.axes.T
    t = detector.tan_half_field
    if detector.outline == "disc":
        return _in_cone(offset, slopes, t)
    low, high = np.zeros(slopes.shape[:-1]), np.full(slopes.shape[:-1], np.inf)
    # From left (+1) to right (-1), as images run.
    left, right = -t * strip[0], t * strip[1]
    for side in ((right, 1, 0), (left, -1, 0), (t, 0, 1), (t, 0, -1)):
        here, step = offset @ np.array(side), slopes @ np.array(side)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = -here / step
        low = np.where(step > 0, np.maximum(low, crossing), low)
        high = np.where(step < 0, np.minimum(high, crossing), high)
        high = np.where((step == 0) & (here < 0), -np.inf, high)
    return low, high


def _in_cone(offset: Array, slopes: Array, tan: float) -> tuple[Array, Array]:
    """The same for a disc: inside where q(s) = (t forward)^2 - left^2 - up^2 >= 0, ahead."""
    metric = np.array([tan**2, -1.0, -1.0])
    a, b, c = (slopes**2) @ metric, (slopes * offset) @ metric, offset**2 @ metric
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-b - root) / a, (-b + root) / a
    first, last = np.minimum(one, two), np.maximum(one, two)
    # A ray steeper than the cone crosses it once or twice; the cone behind is no field.
    inward = (a > 0) & (slopes[..., 0] > 0)
    low = np.maximum(np.where(inward, last, first), 0)
    high = np.where(inward, np.inf, last)
    middle = np.where(np.isfinite(high), (low + np.minimum(high, 1e300)) / 2, 2 * low + 1)
    ahead = offset[0] + middle * slopes[..., 0] > 0
    seen = ahead & (b * b - a * c >= 0) & ((a < 0) | inward)
    return low, np.where(seen, high, -np.inf)


def _along(
    origin: Array,
    directions: Array,
    detector: Device,
    start: Array,
    stop: Array,
    air: Air,
    nodes: int,
) -> tuple[Array, Array]:
    """The integral along each ray, 1/m^2 per steradian of the emitter, by nodes; and the length of
    the path over each, m: (n, nodes).

    With h the ray's distance from the detector and s = nearest + h sinh(u), ds / r^2 is
    du / (h cosh u): the peak at the detector and the tail behind it are both smooth in u.
    """
    offset = origin - detector.origin_m
    nearest = -directions @ offset
    miss = np.linalg.norm(offset + nearest[:, None] * directions, axis=1)
    least = 1e-9 * max(float(np.linalg.norm(offset)), 1e-100)
    if ((miss <= least) & (start <= nearest) & (nearest <= stop)).any():
        raise InputError(
            "baseline: a ray of the emitter passes through the detector, where backscatter is "
            "infinite"
        )
    miss = np.maximum(miss, least)
    x, weight = np.polynomial.legendre.leggauss(nodes)
    low, high = np.arcsinh((start - nearest) / miss), np.arcsinh((stop - nearest) / miss)
    u = ((low + high) / 2)[:, None] + ((high - low) / 2)[:, None] * x
    s, r = nearest[:, None] + miss[:, None] * np.sinh(u), miss[:, None] * np.cosh(u)
    forward = detector.axes[0]
    pupil = (offset @ forward + s * (directions @ forward)[:, None]) / r
    angle = (s - nearest[:, None]) / r  # minus the cosine between the ray and what goes back
    value = air.phase(-angle) * air.transmission(s + r) * np.maximum(pupil, 0)
    step = weight * ((high - low) / 2)[:, None]
    return air.scattering_per_m * value / r * step, s + r
