"""The sun's direct spectrum, as ASTM G-173 tabulates it and as a clear sky leaves it."""

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LM_PER_W = 683.0  # maximum luminous efficacy of radiation
#: In a file of its own: colour-science, which also has it, takes half a second to import.
_G173 = Path(__file__).with_name("astm_g173.csv")


def clear_sun(elevation_deg: float) -> tuple[Array, Array]:
    """Direct spectrum of the sun in a clear sky: wavelength in nm, W/m^2/nm on the normal plane.

    ASTM G-173 tabulates the spectrum above the atmosphere and behind 1.5 air masses; the
    transmission of one air mass is the 1.5th root of their ratio, and Beer's law scales it to the
    air mass of the elevation (Kasten and Young, Applied Optics 28, 1989). Zero below the horizon.
    """
    nm, outside, direct, _ = g173()
    if elevation_deg <= 0:
        return nm, np.zeros_like(nm)
    transmission = np.divide(direct, outside, out=np.zeros_like(direct), where=outside > 0)
    return nm, outside * transmission ** (air_mass(elevation_deg) / 1.5)


def air_mass(elevation_deg: float) -> float:
    """Relative optical air mass (Kasten and Young 1989): 1 at the zenith, 38 at the horizon."""
    sine = math.sin(math.radians(elevation_deg))
    return 1 / (sine + 0.50572 * (elevation_deg + 6.07995) ** -1.6364)


def spectrum_lx(spectrum: Array) -> float:
    """Of a spectrum on the standard's grid, W/m^2/nm."""
    nm, _, _, v = g173()
    return float(_LM_PER_W * np.trapezoid(spectrum * v, nm))


def direct_sun() -> tuple[Array, Array]:
    """ASTM G-173's direct spectrum: nm, W/m^2/nm on the plane normal to the sun."""
    nm, _, direct, _ = g173()
    return nm, direct


@lru_cache(maxsize=1)
def g173() -> tuple[Array, Array, Array, Array]:
    """ASTM G-173: nm, above the atmosphere, direct and circumsolar; and V(lambda) on its grid."""
    nm, outside, direct, v = np.loadtxt(_G173, delimiter=",", unpack=True)
    return nm, outside, direct, v
