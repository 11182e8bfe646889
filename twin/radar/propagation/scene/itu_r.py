"""Specific attenuation as two ITU-R recommendations give it: rain, P.838-3; gases, P.676-12.

Written out here: the package `itur`, whose values these are, brings 276 MB with astropy, pyproj and
maps of the Earth, a sixth of the whole installation, and is imported in 1.2 s.
"""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Polarization = Literal["horizontal", "vertical"]

# P.838-3, Tables 1 to 4: terms (a, b, c), then slope and offset over log10 of GHz.
_K = {
    "horizontal": (
        [
            (-5.33980, -0.10008, 1.13098),
            (-0.35351, 1.2697, 0.454),
            (-0.23789, 0.86036, 0.15354),
            (-0.94158, 0.64552, 0.16817),
        ],
        -0.18961,
        0.71147,
    ),
    "vertical": (
        [
            (-3.80595, 0.56934, 0.81061),
            (-3.44965, -0.22911, 0.51059),
            (-0.39902, 0.73042, 0.11899),
            (0.50167, 1.07319, 0.27195),
        ],
        -0.16398,
        0.63297,
    ),
}
_ALPHA = {
    "horizontal": (
        [
            (-0.14318, 1.82442, -0.55187),
            (0.29591, 0.77564, 0.19822),
            (0.32177, 0.63773, 0.13164),
            (-5.37610, -0.96230, 1.47828),
            (16.1721, -3.29980, 3.4399),
        ],
        0.67849,
        -1.95537,
    ),
    "vertical": (
        [
            (-0.07771, 2.3384, -0.76284),
            (0.56727, 0.95545, 0.54039),
            (-0.20238, 1.1452, 0.26809),
            (-48.2991, 0.791669, 0.116226),
            (48.5833, 0.791459, 0.116479),
        ],
        -0.053739,
        0.83433,
    ),
}


def rain_db_per_km(rain_mm_per_h: float, carrier_hz: float, polarization: Polarization) -> float:
    """P.838-3, Eq. 1: k R^alpha, on a level path, 1 to 1000 GHz."""
    log_f = np.log10(carrier_hz / 1e9)
    k = 10 ** _fitted(log_f, *_K[polarization])  # Eq. 2
    return float(k * rain_mm_per_h ** _fitted(log_f, *_ALPHA[polarization]))  # Eq. 3


def _fitted(
    log_f: float, terms: list[tuple[float, float, float]], slope: float, offset: float
) -> float:
    bells = sum(a * np.exp(-(((log_f - b) / c) ** 2)) for a, b, c in terms)
    return float(bells + slope * log_f + offset)


def gas_db_per_km(
    carrier_hz: float, dry_air_hpa: float, vapour_g_per_m3: float, temperature_k: float
) -> float:
    """P.676-12, Annex 1, line by line, Eq. 1: oxygen, then water vapour; 1 to 1000 GHz."""
    f, p = carrier_hz / 1e9, dry_air_hpa
    e, theta = vapour_g_per_m3 * temperature_k / 216.7, 300 / temperature_k  # Eq. 4: hPa
    oxygen = _oxygen_lines(f, p, e, theta) + _dry_continuum(f, p, e, theta)
    return float(0.1820 * f * oxygen) + float(0.1820 * f * _vapour_lines(f, p, e, theta))


def _oxygen_lines(f: float, p: float, e: float, theta: float) -> float:
    """Eq. 2a: strengths (3), widths (6a) that Zeeman splitting bounds (6b), interference (7)."""
    f0, a1, a2, a3, a4, a5, a6 = _table("oxygen")
    strength = a1 * 1e-7 * p * theta**3 * np.exp(a2 * (1 - theta))
    width = a3 * 1e-4 * (p * (theta ** (0.8 - a4)) + 1.1 * e * theta)
    width = np.sqrt(width**2 + 2.25e-6)
    interference = (a5 + a6 * theta) * 1e-4 * (p + e) * theta**0.8
    return float((strength * _shape(f, f0, width, interference)).sum())


def _vapour_lines(f: float, p: float, e: float, theta: float) -> float:
    """Eq. 2b: strengths (3), widths (6a) that Doppler broadening bounds (6b)."""
    f0, b1, b2, b3, b4, b5, b6 = _table("water_vapour")
    strength = b1 * 1e-1 * e * theta**3.5 * np.exp(b2 * (1 - theta))
    width = b3 * 1e-4 * (p * theta**b4 + b5 * e * theta**b6)
    width = 0.535 * width + np.sqrt(0.217 * width**2 + 2.1316e-12 * f0**2 / theta)
    return float((strength * _shape(f, f0, width, 0.0)).sum())


def _shape(f: float, f0: Array, width: Array, interference: Array | float) -> Array:
    """Eq. 5: shape of lines, 1/GHz."""
    below = (width - interference * (f0 - f)) / ((f0 - f) ** 2 + width**2)
    above = (width - interference * (f0 + f)) / ((f0 + f) ** 2 + width**2)
    return np.asarray(f / f0 * (below + above))


def _dry_continuum(f: float, p: float, e: float, theta: float) -> float:
    """Eqs. 8 and 9: non-resonant absorption of oxygen, and of nitrogen under pressure."""
    d = 5.6e-4 * (p + e) * theta**0.8
    oxygen = 6.14e-5 / (d * (1 + (f / d) ** 2))
    nitrogen = 1.4e-12 * p * theta**1.5 / (1 + 1.9e-5 * f**1.5)
    return f * p * theta**2 * (oxygen + nitrogen)


@lru_cache(maxsize=2)
def _table(gas: str) -> tuple[Array, ...]:
    """Columns of the recommendation's table: frequencies in GHz, then coefficients."""
    path = Path(__file__).with_name(f"p676_12_{gas}.csv")
    return tuple(np.loadtxt(path, delimiter=",", skiprows=2, unpack=True))
