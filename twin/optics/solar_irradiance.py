"""Irradiance of the sun in the filter's band, by illuminance or by the sun's elevation."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.optics.spectra import angle_shift
from twin.scene.clear_sky import clear_sun, direct_sun, spectrum_lx
from twin.system import Filter, Sky
from twin.system.curves import read_transmission

Array = NDArray[np.float64]

#: Share of a curve's peak below which it blocks.
_PASSES = 1e-2

#: Declared with every result that depends on it.
SUN_ASSUMPTION = (
    "sun: the direct spectrum of ASTM G-173 (1.5 air masses) scaled to the illuminance, or that of "
    "a clear sky at the sun's elevation; one directional source, no light from the sky itself"
)


@dataclass(frozen=True)
class SunInBand:
    """Sun on the plane normal to it: illuminance, and irradiance behind the filter's shape."""

    illuminance_lx: float
    irradiance_w_per_m2: float


def sun_in_band(sky: Sky, band: Filter, angle_deg: Any = 0.0) -> SunInBand:
    """Illuminance and band irradiance of a sky, on the plane normal to the sun, for an angle of
    incidence on the filter. Illuminance and flat band may hold arrays that broadcast.
    """
    if sky.sun_elevation_deg is not None:
        nm, spectrum = clear_sun(sky.sun_elevation_deg.value)
        return SunInBand(spectrum_lx(spectrum), _filtered_integral(nm, spectrum, band, angle_deg))
    assert sky.illuminance_lx is not None  # a Sky has one of the two
    lux = sky.illuminance_lx.value
    nm, spectrum = direct_sun()
    irradiance = _filtered_integral(nm, spectrum, band, angle_deg)
    return SunInBand(lux, irradiance * lux / spectrum_lx(spectrum))


def sun_band_irradiance(illuminance_lx: float, center_wavelength_m: float, width_m: float) -> float:
    """Irradiance of the sun in a flat band, W/m^2, on the plane that receives ``illuminance_lx``.

    ASTM G-173-03 (direct and circumsolar, 1.5 air masses) integrated over ``center +/- width / 2``
    and scaled by its luminous flux, 683 lm/W x integral of E V (the intent of the paper's Eq. 1,
    which as printed weights the band itself by V(1550 nm) = 0). Light that comes from one direction
    is direct light: the standard's global tilt holds the sky's blue light too, and 9 % less at
    1550 nm per lux.

    Raises InputError for a band outside the table.
    """
    nm, spectrum = direct_sun()
    low, high = ((center_wavelength_m + side * width_m / 2) * 1e9 for side in (-1, 1))
    if low < nm[0] or high > nm[-1]:
        raise InputError(f"band {low:g} to {high:g} nm is outside the solar spectrum's table")
    return _integral(nm, spectrum, low, high) * illuminance_lx / spectrum_lx(spectrum)


def _filtered_integral(nm: Array, spectrum: Array, band: Filter, angle_deg: float) -> float:
    """Integral of a spectrum over the filter's shape."""
    shift = angle_shift(band, angle_deg)
    if band.transmission_csv is None:
        center, half = band.center_wavelength_m.value * 1e9, band.width_m.value * 1e9 / 2
        _check_table(nm, "filter", (center - half) * shift, (center + half) * shift)
        return _integral(nm, spectrum, (center - half) * shift, (center + half) * shift)
    curve_nm, values = read_transmission(Path(band.transmission_csv.value))
    curve_nm = curve_nm * shift
    passing = curve_nm[values > _PASSES * values.max()]
    _check_table(nm, "filter.transmission_csv", passing[0], passing[-1])
    fine = np.union1d(nm[(nm > curve_nm[0]) & (nm < curve_nm[-1])], curve_nm)
    filtered = np.interp(fine, nm, spectrum) * np.interp(fine, curve_nm, values)
    return float(np.trapezoid(filtered, fine))


def _check_table(nm: Array, field: str, low_nm: Any, high_nm: Any) -> None:
    """Raise InputError for a band that leaves the solar table, with or without an angle."""
    low, high = float(np.min(low_nm)), float(np.max(high_nm))
    if not nm[0] * (1 - 1e-9) <= low <= high <= nm[-1] * (1 + 1e-9):
        raise InputError(
            f"{field}: its band, at some angles {low:.4g} to {high:.4g} nm, is outside the solar "
            f"spectrum of ASTM G-173, {nm[0]:g} to {nm[-1]:g} nm"
        )


def _integral(nm: Array, spectrum: Array, low: Any, high: Any) -> Any:
    """Integral of a spectrum, linear between its points, from ``low`` to ``high``: numbers or
    arrays.
    """
    ends = np.clip(np.stack(np.broadcast_arrays(low, high)), nm[0], nm[-1])
    at = np.interp(ends, nm, spectrum)
    # First point after low, last before high; without any between them one trapezium is all.
    first = np.searchsorted(nm, ends[0], side="right")
    last = np.searchsorted(nm, ends[1], side="left") - 1
    steps = np.concatenate([[0.0], np.cumsum(np.diff(nm) * (spectrum[1:] + spectrum[:-1]) / 2)])
    i, j = np.minimum(first, len(nm) - 1), np.maximum(last, 0)
    before = (nm[i] - ends[0]) * (at[0] + spectrum[i]) / 2
    after = (ends[1] - nm[j]) * (at[1] + spectrum[j]) / 2
    alone = (ends[1] - ends[0]) * (at[0] + at[1]) / 2
    return np.where(first <= last, before + steps[j] - steps[i] + after, alone)[()]
