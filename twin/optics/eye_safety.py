"""Exposure limits of the eye, 700-1800 nm: IEC 60825-1:2014 for lasers, IEC 62471:2006 for LEDs.

Checked against what is public: Annex II of Directive 2006/25/EC below 10 s (1400-1800 nm the same;
ns pulses on the retina 2.5 times higher there, since the 2014 edition lowered them), an open
implementation of the 2014 tables for 700-1050 nm, and a manufacturer's application note for LEDs.
Not checked against a public source: class 1 limits of 1400-1800 nm (they equal the exposure limits
through the aperture within 5 %), retinal limits of pulses at 1050-1400 nm, and all numbers of
tables and clauses. The text of the standards was not available: nothing here is a conformity
assessment. Skin is left out: its limits are at or above those of the eye.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError

Array = NDArray[np.float64]

#: IEC 60825-1, 4.3 e): time base of class 1 above 400 nm without intended long viewing.
CLASS_1_TIME_S = 100.0
#: IEC 60825-1, 5.4, Table 10, condition 3 (the unaided eye); condition 1, a telescope 2 m away,
#: collects 8 times less of a beam that fills it, as that of a projector does.
LASER_DISTANCE_M = 0.1
#: IEC 62471, clause 6.1: for lamps other than for general lighting.
LAMP_DISTANCE_M = 0.2

_ALPHA_MIN = 1.5e-3
_LAMP_ALPHA_MAX = 0.1


def c4(wavelength_m: float) -> float:
    """Correction factor C4 (Table 9): absorption of the eye falls from 700 to 1050 nm."""
    nm = _retinal(wavelength_m)
    return 10 ** (0.002 * (nm - 700)) if nm < 1050 else 5.0


def c7(wavelength_m: float) -> float:
    """Correction factor C7 (Table 9): absorption in front of the retina, 1150 to 1400 nm."""
    nm = _retinal(wavelength_m)
    if nm < 1150:
        return 1.0
    return 10 ** (0.018 * (nm - 1150)) if nm < 1200 else 8 + 10 ** (0.04 * (nm - 1250))


def c6(time_s: Any, subtense_rad: float) -> Array:
    """Correction factor C6 (Table 9): an extended source, up to alpha_max, which time widens."""
    t = np.asarray(time_s, dtype=np.float64)
    widest = np.clip(0.2 * np.sqrt(t), 5e-3, 0.1)
    return np.asarray(np.clip(subtense_rad, _ALPHA_MIN, widest) / _ALPHA_MIN)


def t2_s(subtense_rad: float) -> float:
    """Breakpoint T2 (Table 9): eye movements stop helping, 10 s for a point, 100 s at 100 mrad."""
    alpha = min(max(subtense_rad, _ALPHA_MIN), 0.1)
    return 10 * 10 ** ((alpha - _ALPHA_MIN) / 98.5e-3)


def is_retinal(wavelength_m: float) -> bool:
    """Whether light reaches the retina: 700-1400 nm. InputError outside 700-1800 nm."""
    nm = wavelength_m * 1e9
    if not 700 <= nm < 1800:
        raise InputError(f"wavelength_m: {wavelength_m:g} is not between 700e-9 and 1800e-9")
    return nm < 1400


def mpe_j_per_m2(wavelength_m: float, time_s: Any, subtense_rad: float = 0.0) -> Array:
    """Maximum permissible exposure of the cornea (Tables A.1, A.2), J/m^2.

    ``time_s`` from 1 ns to 30 000 s, an array; InputError outside. ``subtense_rad`` of the
    apparent source counts at 700-1400 nm only.
    """
    t = _time(time_s)
    nm = wavelength_m * 1e9
    if not is_retinal(wavelength_m):
        if nm >= 1500:
            return np.where(t <= 10, 1e4, 1e3 * t)
        return np.select([t <= 1e-3, t <= 10], [1e3, 5600 * t**0.25], 1e3 * t)
    short, long, until = (2e-3, 18.0, 5e-6) if nm < 1050 else (2e-2, 90.0, 13e-6)
    factor = c4(wavelength_m) if nm < 1050 else c7(wavelength_m)
    return _retinal_limit(wavelength_m, t, subtense_rad, (short * factor, long * factor, until, 10))


def class_1_ael_j(wavelength_m: float, time_s: Any, subtense_rad: float = 0.0) -> Array:
    """Accessible emission limit of class 1 (Tables 3, 4), J, through `aperture_m`; as the MPE."""
    t = _time(time_s)
    nm = wavelength_m * 1e9
    if not is_retinal(wavelength_m):
        middle = 1.8e-2 * t**0.75 if nm >= 1500 else 1e-2 * t
        short = 8e-3 if nm >= 1500 else np.where(t <= 1e-3, 8e-4, 4.4e-3 * t**0.25)
        return np.select([t <= 0.35, t <= 10], [short, middle], 1e-2 * t)
    short, long, until = (7.7e-8, 7e-4, 5e-6) if nm < 1050 else (7.7e-7, 3.5e-3, 13e-6)
    factor = c4(wavelength_m) if nm < 1050 else c7(wavelength_m)
    limit = (short * factor, long * factor, until, 3.9e-4)
    return _retinal_limit(wavelength_m, t, subtense_rad, limit)


def aperture_m(wavelength_m: float, time_s: Any) -> Array:
    """Diameter of the limiting aperture (Tables 10, A.6): 7 mm at 700-1400 nm; above, 1 to 3.5 mm,
    growing with time.
    """
    t = _time(time_s)
    if is_retinal(wavelength_m):
        return np.full(t.shape, 7e-3)
    return np.select([t <= 0.35, t < 10], [1e-3, 1.5e-3 * t**0.375], 3.5e-3)


def c5(wavelength_m: float, pulse_s: float, pulses: float, subtense_rad: float = 0.0) -> float:
    """Correction factor C5 (clause 4.3 f) 3) of many equal pulses within T2; 1 above 1400 nm.

    The caller must merge pulses closer together than T_i (5 us; 13 us from 1050 nm on) into one.
    Sources above 100 mrad are treated as those just below it, on the safe side.
    """
    if not is_retinal(wavelength_m) or pulse_s > 0.25:
        return 1.0
    if pulse_s <= (5e-6 if wavelength_m < 1050e-9 else 13e-6):
        return 1.0 if pulses <= 600 else max(0.4, 5 * pulses**-0.25)
    if subtense_rad <= 5e-3:
        return 1.0
    widest = min(max(0.2 * math.sqrt(pulse_s), 5e-3), 0.1)
    least = 0.4 if subtense_rad <= widest else 0.2
    return max(least, pulses**-0.25)


def retinal_weight(wavelength_m: float) -> float:
    """Burn hazard weighting R(lambda) of IEC 62471, Table 4.2, 700-1400 nm; 0 above."""
    nm = wavelength_m * 1e9
    if not is_retinal(wavelength_m):
        return 0.0
    if nm <= 1150:
        return max(10 ** ((700 - nm) / 500), 0.2)
    return max(0.2 * 10 ** (0.02 * (1150 - nm)), 0.02)


def lamp_cornea_w_per_m2(time_s: Any) -> Array:
    """Infrared exposure of cornea and lens, 780-3000 nm (IEC 62471, 4.3.7), W/m^2."""
    t = np.asarray(time_s, dtype=np.float64)
    return np.where(t <= 1000, 18000 * t**-0.75, 100.0)


@dataclass(frozen=True)
class LampRetina:
    """A lamp on the retina: its radiance as the standard averages it, and the limit.

    Both in W/(m^2 sr), weighted by R(lambda).
    """

    radiance: float
    limit: float


def lamp_retina(
    wavelength_m: float, intensity_w_per_sr: float, diameter_m: float, time_s: float
) -> LampRetina:
    """Retinal thermal hazard (IEC 62471, 4.3.5), beyond 10 s that of an unseen source (4.3.6).

    At 0.2 m. A source below alpha_min (1.7 mrad to 0.25 s, growing to 11 mrad at 10 s) counts as
    one of alpha_min, above 100 mrad the limit falls no more.
    """
    smallest = min(max(1.7e-3 * math.sqrt(time_s / 0.25), 1.7e-3), 11e-3)
    if time_s >= 10:
        smallest = 11e-3
    alpha = max(diameter_m / LAMP_DISTANCE_M, smallest)
    area = math.pi / 4 * (alpha * LAMP_DISTANCE_M) ** 2
    least = min(alpha, _LAMP_ALPHA_MAX)
    limit = 6000 / least if time_s > 10 else 50000 / (least * time_s**0.25)
    return LampRetina(retinal_weight(wavelength_m) * intensity_w_per_sr / area, limit)


def _retinal_limit(
    wavelength_m: float, t: Array, alpha: float, limit: tuple[float, float, float, float]
) -> Array:
    """Short pulses constant, then t^0.75, then constant power: after 10 s for a point (Table 3,
    A.1), after T2 for an extended source (Table 4, A.2).
    """
    short, long, until, watts = limit
    size = c6(t, alpha)
    rising = long * t**0.75
    if alpha <= _ALPHA_MIN:
        steady = watts * c4(wavelength_m) * c7(wavelength_m) * t
        return np.select([t <= until, t <= 10], [np.full(t.shape, short), rising], steady)
    last = t2_s(alpha)
    steady = long * last**-0.25 * t
    return size * np.select([t <= until, t <= last], [np.full(t.shape, short), rising], steady)


def _retinal(wavelength_m: float) -> float:
    if not is_retinal(wavelength_m):
        raise InputError(f"wavelength_m: {wavelength_m:g} does not reach the retina")
    return wavelength_m * 1e9


def _time(time_s: Any) -> Array:
    t = np.asarray(time_s, dtype=np.float64)
    if not ((t >= 1e-9) & (t <= 3e4)).all():
        raise InputError(f"time_s: {time_s} is not between 1e-9 and 3e4")
    return t
