"""Scattering by the air on the way to a surface and back.

On the forward path, from a device to the first surface, light is traced through all its scatterings
by a random walk (`twin.optics.steps`). On the return path, from a surface to the other device,
both ends are known. There the shape of a path is drawn (its number of scatterings, the shares of
its segments in its length, the angles of scattering), turned at random, and rotated and scaled so
that it ends at the device (`ScatteredPath`). With the weight of that change of variables this is
unbiased for every phase function, and bounded: nothing is divided by the distance from a scattering
to the device. The noise is least where light goes nearly straight on, as in fog; for an asymmetry
of 0 at an optical depth of 1 rare paths weigh hundreds of times the mean.

Unscattered light is not drawn at random where it can be weighted: its weight is exp(-optical
depth), and light scattered once or more has the rest.
"""

from typing import Any, NamedTuple

import drjit as dr

from twin.engine import mitsuba
from twin.optics.weather import Air
from twin.system.environment import BACKWARD_ASYMMETRY


class Medium:
    """Air as opaque values for kernels, so that other air does not recompile them.

    ``orders``: largest order of scattering on a one-way path; light of higher orders is lost. With
    0, scattering is not traced: the forward peak is treated as unscattered
    (`Air.surface_extinction_per_m`), the rest is lost.
    """

    def __init__(self, air: Air, orders: int) -> None:
        mi = mitsuba()
        self.scatters = orders > 0 and air.scattering_per_m > 0
        lost = air.extinction_per_m - air.scattering_per_m
        self.absorption, self.scattering, self.forward, self.backward, self.share = (
            dr.opaque(mi.Float, value)
            for value in (
                lost if self.scatters else air.surface_extinction_per_m,
                air.scattering_per_m,
                air.forward_asymmetry,
                BACKWARD_ASYMMETRY,
                air.backward_share,
            )
        )
        self.orders = dr.opaque(mi.UInt32, orders)

    def unabsorbed(self, length: Any) -> Any:
        """Transmission of a path of this length, of absorption alone."""
        return dr.exp(-self.absorption * length)

    def unscattered(self, length: Any) -> Any:
        """Unscattered share over a path of this length."""
        return dr.exp(-self.scattering * length)

    def free_path(self, rng: Any) -> Any:
        """Length to the next scattering."""
        return -dr.log(1 - rng.next_float32()) / self.scattering

    def free_path_within(self, length: Any, rng: Any) -> Any:
        """The same, given that it is less than ``length``."""
        return -dr.log(1 - rng.next_float32() * (1 - self.unscattered(length))) / self.scattering

    def scatterings(self, length: Any, rng: Any) -> tuple[Any, Any]:
        """A number of scatterings n of 1 or more, and the logarithm of its weight (s l)^n / n! over
        its probability.

        Geometric, with the mean 1 + s l: not Poisson's distribution, in which the high orders are
        too rare to be drawn that long ways bring to light.
        """
        mi = mitsuba()
        depth = self.scattering * length
        ratio = depth / (1 + depth)
        number = 1 + dr.floor(dr.log(1 - rng.next_float32()) / dr.log(ratio))
        log_weight = dr.log(depth) + number * dr.log(1 + depth) - dr.lgamma(number + 1)
        return mi.UInt32(dr.minimum(number, 1e6)), log_weight

    def cosine(self, rng: Any) -> Any:
        """Cosine of a scattering angle, from the phase function of `Air`."""
        g = dr.select(rng.next_float32() < self.share, self.backward, self.forward)
        # Henyey and Greenstein (1941), inverted; without its pole at 0.
        g = dr.select(dr.abs(g) < 1e-3, 1e-3, g)
        base = (1 - g * g) / (1 - g + 2 * g * rng.next_float32())
        return dr.clip((1 + g * g - base * base) / (2 * g), -1, 1)

    def turned(self, direction: Any, rng: Any) -> Any:
        """A direction after one scattering."""
        mi = mitsuba()
        cosine, angle = self.cosine(rng), 2 * dr.pi * rng.next_float32()
        sine = dr.safe_sqrt(1 - cosine * cosine)
        sin_angle, cos_angle = dr.sincos(angle)
        local = mi.Vector3f(sine * cos_angle, sine * sin_angle, cosine)
        return mi.Frame3f(direction).to_world(local)


class _Shape(NamedTuple):
    """A path of length 1 as it is drawn: directions of its first and last segment, its end, whether
    it is scattered no more often than is followed; and the exponent of its weight.
    """

    first: Any
    last: Any
    end: Any
    complete: Any
    order: Any
    log_weight: Any


class ScatteredPath:
    """A random path from a point to another, in direction ``towards`` at ``distance``, scattered
    once or more on the way.

    With n scatterings, segments that are the shares l of the length, and the path of length 1
    ending at the distance e from its start, the light of all paths over that of clear air is the
    integral of (s d)^n exp(-s d / e) / e^(n + 1) over l, over the phase function of every
    scattering, and over rotations about the line between both points; s: scattering coefficient, d:
    distance. Solid angles cancel the square of each segment's length, and leave d^2.

    ``first``, ``last``: directions of leaving and arriving. ``weight``: light over that of clear
    air, without the emission in ``first``, and without absorption over the distance. ``detour``: m
    longer than the distance.
    """

    def __init__(self, medium: Medium, towards: Any, distance: Any, rng: Any, active: Any) -> None:
        mi = mitsuba()
        self._medium, self._distance, self._rng = medium, distance, mi.PCG32(rng)
        shape = _drawn(medium, distance, rng, mi.Bool(active), None)
        reach = dr.maximum(dr.norm(shape.end), 1e-6)
        self._from, self._to = mi.Frame3f(dr.normalize(shape.end)), mi.Frame3f(towards)
        self._scale = distance * dr.rcp(reach)
        self.detour = self._scale - distance
        self.first, self.last = self._placed(shape.first), self._placed(shape.last)
        # Of high orders either factor is beyond float32, their product is not.
        exponent = shape.log_weight - (mi.Float(shape.order) + 1) * dr.log(reach)
        exponent -= medium.scattering * self._scale + medium.absorption * self.detour
        self.weight = dr.select(shape.complete, dr.exp(exponent), 0)

    def is_clear(self, scene: Any, start: Any, active: Any) -> Any:
        """Whether no surface lies between ``start`` and the other end."""
        mi = mitsuba()

        def passes(place: Any, direction: Any, length: Any, wanted: Any) -> Any:
            ray = mi.Ray3f(start + self._scale * self._placed(place), self._placed(direction))
            ray.maxt = self._scale * length
            return ~scene.ray_test(ray, mi.Bool(False), wanted)

        # The same numbers draw the same shape again.
        rng = mi.PCG32(self._rng)
        return _drawn(self._medium, self._distance, rng, mi.Bool(active), passes).complete

    def _placed(self, vector: Any) -> Any:
        """A vector of the shape, rotated to where the path is."""
        return self._to.to_world(self._from.to_local(vector))


@dr.syntax
def _drawn(medium: Medium, distance: Any, rng: Any, active: Any, passes: Any) -> _Shape:
    """A path of length 1 from the origin, for air of that thickness; complete where it ``passes``
    on every segment, if given.
    """
    mi = mitsuba()
    order, log_weight = medium.scatterings(distance, rng)
    active &= order <= medium.orders
    sample = mi.Point2f(rng.next_float32(), rng.next_float32())
    direction = mi.warp.square_to_uniform_sphere(sample)
    first, end = mi.Vector3f(direction), mi.Vector3f(0)
    left, rest = mi.UInt32(order), mi.Float(1)
    while active & (left > 0):
        # The least of as many uniform places on the rest of the length as there are scatterings.
        length = rest * (1 - dr.power(1 - rng.next_float32(), dr.rcp(mi.Float(left))))
        if dr.hint(passes is not None, mode="scalar"):
            active &= passes(end, direction, length, active)
        end += length * direction
        direction = medium.turned(direction, rng)
        rest -= length
        left -= 1
    if dr.hint(passes is not None, mode="scalar"):
        active &= passes(end, direction, rest, active)
    end += rest * direction
    return _Shape(first, direction, end, active, order, log_weight)
