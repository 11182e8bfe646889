"""Irradiance of the sun in the filter's band, by illuminance or by the sun's elevation."""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.optics.spectra import angle_shift
from twin.system import Filter, Sky
from twin.system.curves import read_transmission

Array = NDArray[np.float64]

_LM_PER_W = 683.0  # maximum luminous efficacy of radiation
#: Share of a curve's peak below which it blocks.
_PASSES = 1e-2
#: In a file of its own: colour-science, which also has it, takes half a second to import.
_G173 = Path(__file__).with_name("astm_g173.csv")

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


def sun_in_band(sky: Sky, band: Filter, angle_deg: float = 0.0) -> SunInBand:
    """Illuminance and band irradiance of a sky, on the plane normal to the sun, for an angle of
    incidence on the filter. Illuminance and flat band may hold arrays that broadcast.
    """
    if sky.sun_elevation_deg is not None:
        nm, spectrum = clear_sun(sky.sun_elevation_deg.value)
        return SunInBand(
            _illuminance(nm, spectrum), _filtered_integral(nm, spectrum, band, angle_deg)
        )
    assert sky.illuminance_lx is not None  # a Sky has one of the two
    lux = sky.illuminance_lx.value
    nm, spectrum = _direct()
    irradiance = _filtered_integral(nm, spectrum, band, angle_deg)
    return SunInBand(lux, irradiance * lux / _illuminance(nm, spectrum))


def sun_band_irradiance(illuminance_lx: float, center_wavelength_m: float, width_m: float) -> float:
    """Irradiance of the sun in a flat band, W/m^2, on the plane that receives ``illuminance_lx``.

    ASTM G-173-03 (direct and circumsolar, 1.5 air masses) integrated over ``center +/- width / 2``
    and scaled by its luminous flux, 683 lm/W x integral of E V (the intent of the paper's Eq. 1,
    which as printed weights the band itself by V(1550 nm) = 0). Light that comes from one direction
    is direct light: the standard's global tilt holds the sky's blue light too, and 9 % less at
    1550 nm per lux.

    Raises InputError for a band outside the table.
    """
    nm, spectrum = _direct()
    low, high = ((center_wavelength_m + side * width_m / 2) * 1e9 for side in (-1, 1))
    if low < nm[0] or high > nm[-1]:
        raise InputError(f"band {low:g} to {high:g} nm is outside the solar spectrum's table")
    return _integral(nm, spectrum, low, high) * illuminance_lx / _illuminance(nm, spectrum)


def clear_sun(elevation_deg: float) -> tuple[Array, Array]:
    """Direct spectrum of the sun in a clear sky: wavelength in nm, W/m^2/nm on the normal plane.

    ASTM G-173 tabulates the spectrum above the atmosphere and behind 1.5 air masses; the
    transmission of one air mass is the 1.5th root of their ratio, and Beer's law scales it to the
    air mass of the elevation (Kasten and Young, Applied Optics 28, 1989). Zero below the horizon.
    """
    nm, outside, direct, _ = _tables()
    if elevation_deg <= 0:
        return nm, np.zeros_like(nm)
    transmission = np.divide(direct, outside, out=np.zeros_like(direct), where=outside > 0)
    return nm, outside * transmission ** (air_mass(elevation_deg) / 1.5)


def air_mass(elevation_deg: float) -> float:
    """Relative optical air mass (Kasten and Young 1989): 1 at the zenith, 38 at the horizon."""
    sine = math.sin(math.radians(elevation_deg))
    return 1 / (sine + 0.50572 * (elevation_deg + 6.07995) ** -1.6364)


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


def _illuminance(nm: Array, spectrum: Array) -> float:
    return float(_LM_PER_W * np.trapezoid(spectrum * _tables()[3], nm))


def _direct() -> tuple[Array, Array]:
    """ASTM G-173's direct spectrum: nm, W/m^2/nm on the plane normal to the sun."""
    nm, _, direct, _ = _tables()
    return nm, direct


@lru_cache(maxsize=1)
def _tables() -> tuple[Array, Array, Array, Array]:
    """ASTM G-173: nm, above the atmosphere, direct and circumsolar; and V(lambda) on its grid."""
    nm, outside, direct, v = np.loadtxt(_G173, delimiter=",", unpack=True)
    return nm, outside, direct, v
