"""Sunlight that reaches the detector straight from the sun, where the sun is in its field."""

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import point
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]


def direct_sunlight(problem: LightProblem, shape: tuple[int, int]) -> Array:
    """Irradiance on the pupil per irradiance of the sun, by part of the detector's field (rows,
    columns): all of it in the part in which the sun's middle is, or none.

    The sun is taken as a point: at the edge of the field or of a surface, half a degree of it,
    all of its light is there or none. What the air takes of it is not: the sun's illuminance is
    that where the rig stands. Of parts at times of their own the first direction is taken.
    """
    found = np.zeros(shape)
    if problem.sun_direction is None:
        return found
    towards = np.reshape(problem.sun_direction, (-1, 3))[0]
    detector = problem.detector
    ahead, *across = detector.axes @ towards
    if ahead <= 0:
        return found
    left, up = np.array(across) / (ahead * detector.tan_half_field)
    outside = np.hypot(left, up) if detector.outline == "disc" else max(abs(left), abs(up))
    if outside > 1 or _is_hidden(problem, towards):
        return found
    row, column = (min(int((1 - x) / 2 * n), n - 1) for x, n in zip((up, left), shape, strict=True))
    found[row, column] = ahead * detector.edge_illumination ** (left**2 + up**2)
    return found


def _is_hidden(problem: LightProblem, direction: Array) -> bool:
    """Whether a surface is between the detector and the sun."""
    mi = mitsuba()
    towards = mi.Vector3f(*(float(x) for x in direction))
    ray = mi.Ray3f(point(problem.detector.origin_m), towards)
    return bool(np.array(problem.scene.ray_test(ray))[0])
