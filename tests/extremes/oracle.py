"""Closed forms in arbitrary precision (mpmath), written from physics and not from the twin."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import mpmath as mp
import numpy as np

mp.mp.dps = 30
C = mp.mpf(299792458)
Q = mp.mpf("1.602176634e-19")
K = mp.mpf("1.380649e-23")


@lru_cache(maxsize=64)
def plane_light(
    distance_m: float, incline_deg: float, field_deg: float, extinction_per_m: float = 0.0
) -> mp.mpf:
    """Irradiance on a pupil per radiant intensity beside it, 1/m^2, from a white plane.

    Square field around an axis that meets the plane, ``distance_m`` away along its normal, at
    ``incline_deg`` to its surface (90: facing). Over the tangents X, Y of the field, with
    s = sin(a) - Y cos(a) and n = 1 + X^2 + Y^2: s / sqrt(n) is the cosine on the plane, h sqrt(n)/s
    the range, 1/sqrt(n) the cosine on the pupil, dX dY / n^1.5 the solid angle; and 1/pi. Air that
    absorbs takes exp(-extinction) of each metre there and back.
    """
    h, a = mp.mpf(distance_m), mp.radians(mp.mpf(incline_deg))
    t = mp.tan(mp.radians(mp.mpf(field_deg) / 2))
    sine, cosine = mp.sin(a), mp.cos(a)

    def light(x: mp.mpf, y: mp.mpf) -> mp.mpf:
        n, s = 1 + x * x + y * y, sine - y * cosine
        return s**3 / n ** mp.mpf("3.5") * mp.exp(-2 * extinction_per_m * h * mp.sqrt(n) / s)

    with mp.workdps(18):
        whole = mp.quad(light, [-t, t], [-t, t])
    return whole / (mp.pi * h * h)


@lru_cache(maxsize=64)
def facing_light(distance_m: float, field_deg: float, radius_m: float) -> mp.mpf:
    """The same from a plane that faces a pupil of this radius: mean irradiance over the pupil.

    Of a point of the plane at distance z and a off the pupil's axis the disc's form factor is
    (1 - (z^2 + a^2 - R^2) / sqrt((z^2 + a^2 + R^2)^2 - 4 R^2 a^2)) / 2, checked against quadrature
    over the disc (`disc_form_factor`); over the field as in `plane_light`.
    """
    z, big = mp.mpf(distance_m), mp.mpf(radius_m) ** 2
    t = mp.tan(mp.radians(mp.mpf(field_deg) / 2))

    def light(x: mp.mpf, y: mp.mpf) -> mp.mpf:
        across = z * z * (x * x + y * y)
        d = z * z + across
        factor = (1 - (d - big) / mp.sqrt((d + big) ** 2 - 4 * big * across)) / 2
        return factor / (1 + x * x + y * y) ** mp.mpf("1.5")

    with mp.workdps(24):
        whole = 4 * mp.quad(light, [0, t], [0, t])
    return whole / (mp.pi * big)


def disc_form_factor(distance_m: float, aside_m: float, radius_m: float) -> float:
    """Form factor of a disc for a point of a plane facing it, by quadrature over the disc."""
    node, weight = np.polynomial.legendre.leggauss(400)
    r, angle = (node[:, None] + 1) / 2 * radius_m, np.pi * (node + 1)
    x, y = aside_m + r * np.cos(angle), r * np.sin(angle)
    kernel = distance_m**2 / (distance_m**2 + x**2 + y**2) ** 2 / np.pi
    return float((weight[:, None] / 2 * radius_m * r * kernel * weight * np.pi).sum())


@lru_cache(maxsize=8)
def field_cos4(field_deg: float) -> mp.mpf:
    """Projected solid angle of a square field on a flat pupil."""
    t = mp.tan(mp.radians(mp.mpf(field_deg) / 2))
    with mp.workdps(18):
        return mp.quad(lambda x, y: (1 + x * x + y * y) ** -2, [-t, t], [-t, t])


def pupil_m2(diameter_m: float, f_number: float, field_deg: float) -> mp.mpf:
    """Effective pupil of a lens that spreads a square field over a disc: etendue
    pi A / (4 N^2 + 1) over the field's area at distance 1.
    """
    area = mp.pi * mp.mpf(diameter_m) ** 2 / 4
    t = mp.tan(mp.radians(mp.mpf(field_deg) / 2))
    return mp.pi * area / (4 * mp.mpf(f_number) ** 2 + 1) / (4 * t * t)


def band_share(peak_m: float, fwhm_m: float, center_m: float, width_m: float) -> mp.mpf:
    """Share of a Gaussian line inside a flat band."""
    sigma = mp.mpf(fwhm_m) / mp.sqrt(8 * mp.log(2))
    low, high = (mp.mpf(center_m) + s * mp.mpf(width_m) / 2 - mp.mpf(peak_m) for s in (-1, 1))
    return (mp.erf(high / sigma / mp.sqrt(2)) - mp.erf(low / sigma / mp.sqrt(2))) / 2


@lru_cache(maxsize=4)
def sun_per_lux(center_m: float, width_m: float) -> mp.mpf:
    """Irradiance of ASTM G-173's direct sun in a band over its illuminance, W/m^2/lx."""
    import colour
    from colour.plotting.datasets import astm_g_173

    sun = astm_g_173.SD_ASTMG173_DIRECT_CIRCUMSOLAR
    eye = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    low, high = ((center_m + s * width_m / 2) * 1e9 for s in (-1, 1))
    inside = [low, *(float(x) for x in sun.wavelengths if low < x < high), high]
    band = [(x, float(np.interp(x, sun.wavelengths, sun.values))) for x in inside]
    sight = [
        (float(x), float(y) * float(np.interp(x, eye.wavelengths, eye.values, 0, 0)))
        for x, y in zip(sun.wavelengths, sun.values, strict=True)
    ]
    return _trapezoid(band) / (683 * _trapezoid(sight))


def _trapezoid(points: list[tuple[float, float]]) -> mp.mpf:
    pairs = pairwise(points)
    return mp.fsum((mp.mpf(b[0]) - a[0]) * (mp.mpf(a[1]) + b[1]) / 2 for a, b in pairs)


def fog_per_m(visibility_m: float, wavelength_m: float) -> mp.mpf:
    """Extinction by fog after Kim, McArthur and Korevaar (2001): 3.91 / V, the same at all
    wavelengths where one sees less than 500 m.
    """
    assert visibility_m < 500
    return mp.mpf("3.91") / mp.mpf(visibility_m)


def rain_light_per_m(rate_mm_per_h: float) -> mp.mpf:
    """Extinction of light by rain, ITU-R P.1814: 1.076 R^0.67 dB/km."""
    return mp.mpf("1.076") * mp.mpf(rate_mm_per_h) ** mp.mpf("0.67") * mp.log(10) / 10000


def dry_snow_light_per_m(rate_mm_per_h: float, wavelength_m: float) -> mp.mpf:
    """Extinction of light by dry snow, ITU-R P.1814: a S^1.38 dB/km, a = 5.42e-5 nm + 5.4958776."""
    a = mp.mpf("5.42e-5") * mp.mpf(wavelength_m) * 10**9 + mp.mpf("5.4958776")
    return a * mp.mpf(rate_mm_per_h) ** mp.mpf("1.38") * mp.log(10) / 10000


def rain_radio_db_per_m(rate_mm_per_h: float, carrier_hz: float) -> mp.mpf:
    """Attenuation of a vertically polarised wave on a level path by rain, ITU-R P.838-3."""
    k = _p838(
        carrier_hz,
        (-3.80595, -3.44965, -0.39902, 0.50167),
        (0.56934, -0.22911, 0.73042, 1.07319),
        (0.81061, 0.51059, 0.11899, 0.27195),
        (-0.16398, 0.63297),
    )
    alpha = _p838(
        carrier_hz,
        (-0.07771, 0.56727, -0.20238, -48.2991, 48.5833),
        (2.33840, 0.95545, 1.14520, 0.791669, 0.791459),
        (-0.76284, 0.54039, 0.26809, 0.116226, 0.116479),
        (-0.053739, 0.83433),
    )
    return mp.mpf(10) ** k * mp.mpf(rate_mm_per_h) ** alpha / 1000


def _p838(
    carrier_hz: float,
    a: Sequence[float],
    b: Sequence[float],
    c: Sequence[float],
    line: tuple[float, float],
) -> mp.mpf:
    """Sum of Gaussians over the logarithm of the frequency in GHz, and a line."""
    x = mp.log10(mp.mpf(carrier_hz) / 10**9)
    bells = mp.fsum(p * mp.exp(-(((x - q) / r) ** 2)) for p, q, r in zip(a, b, c, strict=True))
    return bells + line[0] * x + line[1]


def relative(found: float, exact: mp.mpf) -> float:
    """Relative error; the absolute value where the oracle says zero, NaN as infinite."""
    if not np.isfinite(found):
        return float("inf")
    off = abs(mp.mpf(float(found)) - exact)
    return float(off / abs(exact)) if exact else float(off)
