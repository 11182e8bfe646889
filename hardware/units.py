"""Numbers with a unit, as text: ``"200 um"``, ``"20 klx"``, ``"79 GHz"``, ``"10 dBm"``, ``"85 %"``.

The one place that reads them. A name says its unit by its end (``width_m``, ``carrier_hz``), and
text has to be of that dimension; numbers without a unit are in the unit of the name. The result is
the double nearest to the exact decimal value: ``"200 um"`` is ``200e-6`` to the last bit.
"""

import math
import re
import unicodedata
from functools import lru_cache
from typing import TYPE_CHECKING

from hardware.errors import InputError

if TYPE_CHECKING:
    from fractions import Fraction

#: Units that end a name; of two that fit the longer one holds.
_ENDS = {
    "_kg_per_m3": "kg/m^3",
    "_deg_per_s": "deg/s",
    "_mm_per_h": "mm/h",
    "_m_per_s": "m/s",
    "_w_per_sr": "W/sr",
    "_a_per_w": "A/W",
    "_s_per_m": "S/m",
    "_dbc_per_hz": "dBc/Hz",
    "_ohm": "ohm",
    "_deg": "deg",
    "_dbi": "dBi",
    "_db": "dB",
    "_hz": "Hz",
    "_m2": "m^2",
    "_lx": "lx",
    "_pa": "Pa",
    "_sr": "sr",
    "_w": "W",
    "_s": "s",
    "_m": "m",
    "_k": "K",
    "_f": "F",
    "_a": "A",
    "_v": "V",
    "_e": "e",
}
#: Levels over a reference that is not a number's own: what they are converted to, the reference.
_LEVELS = {"dBm": ("W", 1e-3), "dBW": ("W", 1.0), "dBsm": ("m^2", 1.0)}
#: Logarithmic units, which are not converted.
_DECIBELS = ("dB", "dBi", "dBc/Hz")
_CELSIUS = ("degC", "°C")
_ZERO_CELSIUS_K = "273.15"
_PREFIXES = dict(
    zip("fpnuμmcdhkMGT", (-15, -12, -9, -6, -6, -3, -2, -1, 2, 3, 6, 9, 12), strict=True)
)
#: Factor and powers of the base units m, kg, s, A, K, lx, deg, sr, e; the first ones take prefixes.
_PREFIXED = {
    "m": ("1", "m"),
    "g": ("1/1000", "kg"),
    "s": ("1", "s"),
    "A": ("1", "A"),
    "K": ("1", "K"),
    "lx": ("1", "lx"),
    "lm": ("1", "lx m2"),
    "sr": ("1", "sr"),
    "rad": (repr(180 / math.pi), "deg"),
    "Hz": ("1", "s-1"),
    "W": ("1", "kg m2 s-3"),
    "J": ("1", "kg m2 s-2"),
    "Pa": ("1", "kg m-1 s-2"),
    "V": ("1", "kg m2 s-3 A-1"),
    "ohm": ("1", "kg m2 s-3 A-2"),
    "Ω": ("1", "kg m2 s-3 A-2"),
    "S": ("1", "kg-1 m-2 s3 A2"),
    "C": ("1", "s A"),
    "F": ("1", "kg-1 m-2 s4 A2"),
}
_PLAIN = {
    "1": ("1", ""),
    "min": ("60", "s"),
    "h": ("3600", "s"),
    "d": ("86400", "s"),
    "deg": ("1", "deg"),
    "°": ("1", "deg"),
    "arcmin": ("1/60", "deg"),
    "arcsec": ("1/3600", "deg"),
    "e": ("1", "e"),
    "lux": ("1", "lx"),
}
_PER_CENT = {"%": -2, "ppm": -6}

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?", re.ASCII)
_POWER = re.compile(r"([^\d^-]+|1$)(?:\^?(-?[1-9]))?")
#: Of a unit; a number has none, and no other digits beyond ASCII are read.
_SUPERSCRIPTS = str.maketrans("⁻¹²³⁴⁵⁶⁷⁸⁹", "-123456789")
_PRODUCT = re.compile(r"[^\s*·/]+(?:(?:\s*[*·/]\s*|\s+)[^\s*·/]+)*")
_LONGEST = 64

_Powers = dict[str, int]


def unit_of(name: str) -> str | None:
    """Unit that the end of a name says, None where it says none.

    >>> unit_of("optics.focus_m"), unit_of("filter.transmission")
    ('m', None)
    """
    fits = [end for end in _ENDS if name.endswith(end)]
    return _ENDS[max(fits, key=len)] if fits else None


def quantity(text: str, unit: str | None, *, bare: bool = False) -> float:
    """Text with a unit as a number of ``unit``; None: a pure number, given in per cent or ppm.

    ``bare``: text without a unit is a number of ``unit`` already. Powers are read as dBm too,
    cross-sections as dBsm, temperatures as degC. Raises InputError that says what was expected.

    >>> quantity("200 um", "m"), quantity("10 dBm", "W"), quantity("85 %", None)
    (0.0002, 0.01, 0.85)
    >>> quantity("20 klx", "m")
    Traceback (most recent call last):
    hardware.errors.InputError: expected a number or a quantity in m; 'klx' is of another dimension
    """
    text = text.strip()
    match = _NUMBER.match(text) if len(text) <= _LONGEST else None
    if match is None:
        raise _wrong(unit)
    number, given = match[0], text[match.end() :].strip()
    if not given:
        if bare:
            return float(number)
        raise _wrong(unit, "the unit is missing")
    if any(c.isnumeric() and not c.isascii() for c in given[0] + given.translate(_SUPERSCRIPTS)):
        raise _wrong(unit, f"digits of a number are 0 to 9, as in 1e3; not {given!r:.20}")
    given = unicodedata.normalize("NFKC", given.translate(_SUPERSCRIPTS))
    try:
        value = _converted(number, given, unit)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise _wrong(unit, "it is too large")
    return value


def _converted(number: str, given: str, unit: str | None) -> float:
    from fractions import Fraction

    if unit is None:
        if given not in _PER_CENT:
            raise _wrong(unit)
        return float(Fraction(number) * Fraction(10) ** _PER_CENT[given])
    if given == unit:
        return float(number)
    if given in _LEVELS:
        of, reference = _LEVELS[given]
        if of != unit:
            raise _wrong(unit, f"{given!r} is of another dimension")
        return float(f"{reference * 10 ** (float(number) / 10):.15g}")
    if given in _CELSIUS and unit == "K":
        return float(Fraction(number) + Fraction(_ZERO_CELSIUS_K))
    try:
        factor, powers = _parsed(given)
    except InputError as error:
        raise _wrong(unit, str(error)) from None
    if unit in _DECIBELS or _parsed(unit)[1] != powers:
        raise _wrong(unit, f"{given!r} is of another dimension")
    return float(Fraction(number) * factor / _parsed(unit)[0])


def _wrong(unit: str | None, why: str = "") -> InputError:
    wanted = "a number, or per cent" if unit is None else f"a number or a quantity in {unit}"
    return InputError(f"expected {wanted}" + (f"; {why}" if why else ""))


@lru_cache(maxsize=256)
def _parsed(unit: str) -> "tuple[Fraction, _Powers]":
    """Factor and base units of products, quotients and powers: ``kg/m^3``, ``W sr-1``."""
    from fractions import Fraction

    if not _PRODUCT.fullmatch(unit):
        raise InputError(f"{unit!r} is no known unit")
    factor, powers, sign = Fraction(1), _Powers(), 1
    for token in re.findall(r"[*·/]|[^\s*·/]+", unit):
        if token in "*·/":
            sign = -1 if token == "/" else 1
            continue
        match = _POWER.fullmatch(token)
        known = _known(match[1]) if match else None
        if match is None or known is None:
            raise InputError(f"{token!r} is no known unit")
        power = sign * int(match[2] or 1)
        factor *= known[0] ** power
        for base, of_base in known[1].items():
            powers[base] = powers.get(base, 0) + power * of_base
        sign = 1
    return factor, {base: power for base, power in powers.items() if power}


def _known(symbol: str) -> "tuple[Fraction, _Powers] | None":
    from fractions import Fraction

    prefix, rest = symbol[:1], symbol[1:]
    if symbol in _PLAIN or symbol in _PREFIXED:
        (factor, base), ten = (_PLAIN | _PREFIXED)[symbol], 0
    elif prefix in _PREFIXES and rest in _PREFIXED:
        (factor, base), ten = _PREFIXED[rest], _PREFIXES[prefix]
    else:
        return None
    powers = {}
    for word in base.split():
        match = _POWER.fullmatch(word)
        assert match is not None
        powers[match[1]] = int(match[2] or 1)
    return Fraction(factor) * Fraction(10) ** ten, powers
