"""Spectra against the filter's band: the sun by illuminance or elevation, the emitter's line.

Everything is integrated over wavelength on a fine grid, except where a closed form exists.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from twin.errors import InputError
from twin.system import Emitter, Filter, Photodetector, Sky
from twin.system.curves import read_curve, read_responsivity, read_transmission

Array = NDArray[np.float64]

_LM_PER_W = 683.0  # maximum luminous efficacy of radiation
#: Share of a curve's peak below which it blocks.
_PASSES = 1e-2
_FINE = 20_001  # points of a numerical integral over a line or a band

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


def in_band_fraction(emitter: Emitter, band: Filter, angle_deg: float = 0.0) -> float:
    """Share of the emitter's line that the filter transmits at an angle.

    A Gaussian line of 100 nm full width at half maximum through 1550 +/- 6 nm: 0.112. Line and flat
    band may hold arrays that broadcast.
    """
    if emitter.spectrum_csv is None and band.transmission_csv is None:
        sigma = emitter.line_fwhm_m.value / math.sqrt(8 * math.log(2))
        center = band.center_wavelength_m.value * angle_shift(band, angle_deg)
        offset = center - emitter.peak_wavelength_m.value
        half = band.width_m.value * angle_shift(band, angle_deg) / 2
        edges = [(offset + side * half) / (math.sqrt(2) * sigma) for side in (-1, 1)]
        share: float = (erf(edges[1]) - erf(edges[0])) / 2
        return share
    nm, line = emitter_line(emitter)
    fine, through = _filtered_line(nm, line, band, angle_deg)
    return float(np.trapezoid(through, fine) / np.trapezoid(line, nm))


def angle_shift(band: Filter, angle_deg: float) -> float:
    """Factor by which a filter's wavelengths shrink at an angle: sqrt(1 - (sin / n)^2).

    1 where the filter has no effective index.
    """
    if band.effective_index is None:
        return 1.0
    ratio = math.sin(math.radians(angle_deg)) / band.effective_index.value
    return math.sqrt(1 - ratio**2)


def passband(band: Filter, wavelength_nm: Array, angle_deg: float = 0.0) -> Array:
    """The filter's shape at wavelengths: 1 inside a flat band, or the vendor's curve."""
    at_normal = wavelength_nm / angle_shift(band, angle_deg)
    if band.transmission_csv is not None:
        nm, values = read_transmission(Path(band.transmission_csv.value))
        return np.interp(at_normal, nm, values, left=0.0, right=0.0)
    offset = np.abs(at_normal * 1e-9 - band.center_wavelength_m.value)
    return (offset <= band.width_m.value / 2).astype(np.float64)


def responsivity_a_per_w(detector: Photodetector, emitter: Emitter, band: Filter) -> float:
    """Responsivity over the part of the emitter's line that the filter passes."""
    if detector.responsivity_csv is None:
        return detector.responsivity_a_per_w.value
    nm, filtered = _filtered_line(*emitter_line(emitter), band)
    power = np.trapezoid(filtered, nm)
    if power == 0:
        return detector.responsivity_a_per_w.value
    curve_nm, curve = read_responsivity(detector)
    current = np.trapezoid(filtered * np.interp(nm, curve_nm, curve, left=0.0, right=0.0), nm)
    return float(current / power)


def emitter_line(emitter: Emitter) -> tuple[Array, Array]:
    """The emitter's line on a fine grid of wavelengths in nm, arbitrary scale."""
    if emitter.spectrum_csv is not None:
        nm, values = read_curve(Path(emitter.spectrum_csv.value))
        fine = np.linspace(nm[0], nm[-1], _FINE)
        return fine, np.interp(fine, nm, values)
    peak, fwhm = emitter.peak_wavelength_m.value * 1e9, emitter.line_fwhm_m.value * 1e9
    fine = np.linspace(peak - 4 * fwhm, peak + 4 * fwhm, _FINE)
    return fine, np.exp(-4 * math.log(2) * ((fine - peak) / fwhm) ** 2)


def _filtered_line(
    nm: Array, line: Array, band: Filter, angle_deg: float = 0.0
) -> tuple[Array, Array]:
    """A line behind the filter, on a grid that contains the edges of the passband."""
    shift = angle_shift(band, angle_deg)
    if band.transmission_csv is not None:
        edges = read_transmission(Path(band.transmission_csv.value))[0] * shift
    else:
        center, half = band.center_wavelength_m.value * 1e9, band.width_m.value * 1e9 / 2
        edges = np.array([c + s * 1e-6 for c in (center - half, center + half) for s in (-1, 1)])
        edges *= shift
    fine = np.union1d(nm, edges[(edges > nm[0]) & (edges < nm[-1])])
    return fine, np.interp(fine, nm, line) * passband(band, fine, angle_deg)


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
    with np.printoptions():  # colour-science changes them on import
        import colour
        from colour.plotting.datasets import astm_g_173
    outside, direct = astm_g_173.SD_ASTMG173_ETR, astm_g_173.SD_ASTMG173_DIRECT_CIRCUMSOLAR
    photopic = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    nm = np.asarray(direct.wavelengths)
    v = np.interp(nm, photopic.wavelengths, photopic.values, left=0, right=0)
    return nm, outside.values, direct.values, v
