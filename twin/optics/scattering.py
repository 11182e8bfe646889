"""Scattering by the air on the way to a surface and back.

On the forward path, from a device to the first surface, light is traced through all its scatterings
by a random walk (`twin.optics.steps`). On the return path, from a surface to the other device,
both ends are known. There a scattering by the angle a at the fraction x of the path, counted from
the surface, shifts the apparent direction by x tan(a), and the shifts of several scatterings add
up. This is exact for one scattering by a small angle. In fog, with a field of 20 degrees, the total
from a wall facing the device agrees with a full random walk within 0.5 % up to an optical depth of
0.8. Levels along a wall slanted by 60 degrees, and the contrast of single bright cells, agree
within 3 % there; a wall seen between nearer posts, at an optical depth of 1.2, is 5 % too bright.
Light deflected by more than 90 degrees on the return path is lost.

Unscattered light is not drawn at random where it can be weighted: its weight is exp(-optical
depth), and light scattered once or more has the rest.
"""

from typing import Any

import drjit as dr

from twin.engine import mitsuba
from twin.optics.weather import BACKWARD_ASYMMETRY, Air


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

    def cosine(self, rng: Any) -> Any:
        """Cosine of a scattering angle, from the phase function of `Air`."""
        g = dr.select(rng.next_float32() < self.share, self.backward, self.forward)
        # Henyey and Greenstein (1941), inverted; without its pole at 0.
        g = dr.select(dr.abs(g) < 1e-3, 1e-3, g)
        base = (1 - g * g) / (1 - g + 2 * g * rng.next_float32())
        return dr.clip((1 + g * g - base * base) / (2 * g), -1, 1)


@dr.syntax
def scattering_offset(mi: Any, medium: Any, length: Any, rng: Any) -> tuple[Any, Any, Any]:
    """Shift of the apparent origin of light, on the plane at distance 1, after a path of ``length``
    on which it is scattered once or more; and whether it arrives.
    """
    shift, arrives, order = mi.Vector2f(0), mi.Bool(True), mi.UInt32(0)
    t = medium.free_path_within(length, rng)
    while (t < length) & (order < medium.orders):
        cosine, angle = medium.cosine(rng), 2 * dr.pi * rng.next_float32()
        arrives &= cosine > 0
        tangent = dr.safe_sqrt(1 - cosine * cosine) / dr.maximum(cosine, 1e-3)
        sin_angle, cos_angle = dr.sincos(angle)
        shift += t / length * tangent * mi.Vector2f(cos_angle, sin_angle)
        order += 1
        t += medium.free_path(rng)
    return shift.x, shift.y, arrives & (t >= length)
