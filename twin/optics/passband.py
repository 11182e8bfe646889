"""Emitter's line and sunlight behind the filter at each angle of the field."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.optics.solar_irradiance import sun_in_band
from twin.optics.spectra import in_band_fraction
from twin.system import Emitter, Filter, Sky, System
from twin.system.curves import curves

Array = NDArray[np.float64]

_KNOTS = 65  # angles at which spectra are integrated, at first; between them it is linear
#: Between these angles the passband is off by less than this of its largest value, unless they are
#: this many halvings apart: 1e-3 deg over a field of 20 deg, a step's width for a line of 1 pm.
_OFF, _HALVINGS = 1e-4, 8


@dataclass(frozen=True, eq=False)
class Passband:
    """Share of the emitter's line and irradiance of the sun behind the filter, by field angle.

    ``angles_deg`` (n,) ascending from 0; ``emitter`` (n,); ``sun_w_per_m2`` (n,), on the plane
    normal to the sun.
    """

    angles_deg: Array
    emitter: Array
    sun_w_per_m2: Array
    illuminance_lx: float

    def emitter_at(self, angle_deg: Array) -> Array:
        """Share of the emitter's line at field angles."""
        return np.interp(angle_deg, self.angles_deg, self.emitter)

    def sun_at(self, angle_deg: Array) -> Array:
        """Irradiance of the sun at field angles, W/m^2."""
        return np.interp(angle_deg, self.angles_deg, self.sun_w_per_m2)


def passband(system: System, sky: Sky, share: float = 1.0) -> Passband:
    """Integrate a system's spectra over its filter, with a share of the sky's sun.

    In front of the lens the angle of incidence on the filter is that of the field. Behind the lens
    every point of the field illuminates the filter with the same cone, up to sin = 1 / (2 N) as for
    a lens without coma; the mean over its solid angle is taken.
    """
    optics = system.optics
    half_field_deg = optics.field_of_view_deg.value / 2
    content = curves(system.emitter.spectrum_csv, system.filter.transmission_csv)
    f_number = optics.f_number.value
    whole = _passband_of(system.emitter, system.filter, sky, f_number, half_field_deg, content)
    if share == 1:
        return whole
    return replace(
        whole,
        sun_w_per_m2=share * whole.sun_w_per_m2,
        illuminance_lx=share * whole.illuminance_lx,
    )


def mean_over_field(
    system: System, value_at: Callable[[Any], Any], angles_deg: Array, weights: Array
) -> Any:
    """Mean of what the filter passes, over angles of the field with weights, as `Passband` has it.

    ``value_at``: of an angle of incidence on the filter, degrees. Fields of the system may hold
    arrays that broadcast.
    """
    band, optics = system.filter, system.optics
    if band.effective_index is None:
        return value_at(0.0)
    if _is_behind_lens(band):
        angles, shares = _cone_deg(optics.f_number.value)
    else:
        angles = _field_deg(optics.field_of_view_deg.value / 2)
        hats = (np.interp(angles_deg, angles, hat) for hat in np.eye(len(angles)))
        shares = np.array([np.sum(weights * hat) for hat in hats]) / np.sum(weights)
    return sum(
        share * value_at(angle) for angle, share in zip(angles, shares, strict=True) if share
    )


def _is_behind_lens(band: Filter) -> bool:
    return band.place is not None and band.place.value == "behind lens"


def _cone_deg(f_number: Any) -> tuple[Any, Array]:
    """Angles of the cone behind a lens, the first axis, and the share of its etendue at each:
    uniform in sin^2.
    """
    widest = 1 / np.sqrt(4 * f_number**2 + 1)
    node, weight = np.polynomial.legendre.leggauss(_KNOTS)
    return np.degrees(np.arcsin(np.multiply.outer(np.sqrt((node + 1) / 2), widest))), weight / 2


def _field_deg(half_field_deg: float) -> Array:
    """Angles from the axis to the corner of the field."""
    corner = math.sqrt(2) * math.tan(math.radians(half_field_deg))
    return np.linspace(0, math.degrees(math.atan(corner)), _KNOTS)


@lru_cache(maxsize=256)
def _passband_of(
    emitter: Emitter,
    band: Filter,
    sky: Sky,
    f_number: float,
    half_field_deg: float,
    content: tuple[bytes, ...],
) -> Passband:
    """``content`` of the curves serves the cache's key only: a file may change under its name."""
    normal = sun_in_band(sky, band)
    if band.effective_index is None:
        share = in_band_fraction(emitter, band)
        sun = np.array([normal.irradiance_w_per_m2])
        return Passband(np.zeros(1), np.array([share]), sun, normal.illuminance_lx)
    if _is_behind_lens(band):
        angles, shares = _cone_deg(f_number)
        share, sun_w = (float(shares @ values) for values in _at(emitter, band, sky, angles))
        return Passband(np.zeros(1), np.array([share]), np.array([sun_w]), normal.illuminance_lx)
    angles = _field_deg(half_field_deg)
    angles, values = _refined(lambda deg: _at(emitter, band, sky, deg), angles)
    return Passband(angles, values[0], values[1], normal.illuminance_lx)


def _at(emitter: Emitter, band: Filter, sky: Sky, angles_deg: Array) -> Array:
    """Share of the line and irradiance of the sun, (2, n)."""
    shares = [in_band_fraction(emitter, band, a) for a in angles_deg]
    suns = [sun_in_band(sky, band, a).irradiance_w_per_m2 for a in angles_deg]
    return np.array([shares, suns])


def _refined(values_at: Callable[[Array], Array], angles: Array) -> tuple[Array, Array]:
    """Angles and values (n_values, n), with more angles where straight lines between them are
    off: the edge of the band for a narrow line lies within a thousandth of a degree.
    """
    values = values_at(angles)
    most = np.maximum(values.max(axis=1, keepdims=True), np.finfo(float).tiny)
    rough = np.arange(1, len(angles))
    for _ in range(_HALVINGS):
        middles = (angles[rough - 1] + angles[rough]) / 2
        found = values_at(middles)
        off = np.abs(found - (values[:, rough - 1] + values[:, rough]) / 2) / most
        is_off = (off > _OFF).any(axis=0)
        if not is_off.any():
            break
        angles = np.insert(angles, rough[is_off], middles[is_off])
        values = np.insert(values, rough[is_off], found[:, is_off], axis=1)
        inserted = np.flatnonzero(np.isin(angles, middles[is_off]))
        rough = np.union1d(inserted, inserted + 1)
    return angles, values
