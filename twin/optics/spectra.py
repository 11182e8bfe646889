"""Spectra against the filter's band: the sun by its illuminance, the emitter's line."""

import math
from functools import lru_cache

import numpy as np

from twin.system import Emitter, Filter

_LM_PER_W = 683.0  # maximum luminous efficacy of radiation

#: Declared with every result that depends on it.
SUN_ASSUMPTION = (
    "sun: ASTM G-173 global tilt spectrum, scaled to the illuminance; one directional source, "
    "no light from the sky itself"
)


@lru_cache(maxsize=32)
def sun_band_irradiance(illuminance_lx: float, center_wavelength_m: float, width_m: float) -> float:
    """Irradiance of the sun in a band, W/m^2, on the plane that receives ``illuminance_lx``.

    ASTM G-173-03 (global tilt, 1.5 air masses), 300 to 4000 nm, integrated over
    ``center +/- width / 2`` and scaled by its luminous flux, 683 lm/W x integral of E V
    (the intent of the paper's Eq. 1, which as printed weights the band itself by V(1550 nm) = 0).

    Raises ValueError for a band outside the table.
    """
    with np.printoptions():  # colour-science changes them on import
        import colour
        from colour.plotting.datasets import astm_g_173
    spectrum = astm_g_173.SD_ASTMG173_GLOBAL_TILT

    wavelength_nm, irradiance = spectrum.wavelengths, spectrum.values  # W/m^2/nm
    low, high = ((center_wavelength_m + side * width_m / 2) * 1e9 for side in (-1, 1))
    if low < wavelength_nm[0] or high > wavelength_nm[-1]:
        raise ValueError(f"band {low:g} to {high:g} nm is outside the solar spectrum's table")
    inside = wavelength_nm[(wavelength_nm > low) & (wavelength_nm < high)]
    band = np.concatenate([[low], inside, [high]])
    in_band = np.trapezoid(np.interp(band, wavelength_nm, irradiance), band)
    photopic = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    v = np.interp(wavelength_nm, photopic.wavelengths, photopic.values, left=0, right=0)
    table_lx = _LM_PER_W * np.trapezoid(irradiance * v, wavelength_nm)
    return float(in_band * illuminance_lx / table_lx)


def in_band_fraction(emitter: Emitter, band: Filter) -> float:
    """Share of the emitter's Gaussian line inside the filter's band.

    A line of 100 nm full width at half maximum through 1550 +/- 6 nm: 0.112.
    """
    sigma = emitter.line_fwhm_m.value / math.sqrt(8 * math.log(2))
    offset = band.center_wavelength_m.value - emitter.peak_wavelength_m.value
    edges = [(offset + side * band.width_m.value / 2) / (math.sqrt(2) * sigma) for side in (-1, 1)]
    return (math.erf(edges[1]) - math.erf(edges[0])) / 2
