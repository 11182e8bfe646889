"""The emitter's line and the detector's responsivity behind the filter.

Everything is integrated over wavelength on a fine grid, except where a closed form exists.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from twin.system import Emitter, Filter, Photodetector
from twin.system.curves import read_curve, read_responsivity, read_transmission

Array = NDArray[np.float64]

_FINE = 20_001  # points of a numerical integral over a line or a band


def in_band_fraction(emitter: Emitter, band: Filter, angle_deg: Any = 0.0) -> float:
    """Share of the emitter's line that the filter transmits at an angle.

    A Gaussian line of 100 nm full width at half maximum through 1550 +/- 6 nm: 0.112. Line, flat
    band and angle may hold arrays that broadcast.
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


def angle_shift(band: Filter, angle_deg: Any) -> Any:
    """Factor by which a filter's wavelengths shrink at an angle, or at each of an array:
    sqrt(1 - (sin / n)^2).

    1 where the filter has no effective index.
    """
    if band.effective_index is None:
        return 1.0
    ratio = np.sin(np.radians(angle_deg)) / band.effective_index.value
    return np.sqrt(1 - ratio**2)


def filter_shape(band: Filter, wavelength_nm: Array, angle_deg: float = 0.0) -> Array:
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
    """A line behind the filter, on a grid that contains the edges of the filter's shape."""
    shift = angle_shift(band, angle_deg)
    if band.transmission_csv is not None:
        edges = read_transmission(Path(band.transmission_csv.value))[0] * shift
    else:
        center, half = band.center_wavelength_m.value * 1e9, band.width_m.value * 1e9 / 2
        edges = np.array([c + s * 1e-6 for c in (center - half, center + half) for s in (-1, 1)])
        edges *= shift
    fine = np.union1d(nm, edges[(edges > nm[0]) & (edges < nm[-1])])
    return fine, np.interp(fine, nm, line) * filter_shape(band, fine, angle_deg)
