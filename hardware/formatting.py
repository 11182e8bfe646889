"""Figures as text, for terminals and reports: digits by the error, SI prefixes, no raw reprs; and
as JSON.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from hardware.units import unit_of

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
#: Units that take a prefix; decibels, angles in degrees, squares and counts do not.
_PREFIXED = frozenset({"m", "s", "Hz", "W", "A", "V", "J", "F", "ohm", "lx", "rad", "W/sr"})
#: Decimals of a value from which on its error stands in a unit of its own.
_MOST_DECIMALS = 4
#: Digits of a setting, and items of a list that are printed.
_SETTING_DIGITS, _MOST_ITEMS = 7, 8


def number(value: float, digits: int = 3) -> str:
    """A number to significant digits; very large and very small ones with an exponent.

    >>> number(16812.0), number(0.03371), number(1.98e7), number(0.0), number(3.0, 4)
    ('16800', '0.0337', '1.98e7', '0', '3')
    """
    if not math.isfinite(value) or value == 0:
        return _special(value)
    rounded = float(f"{value:.{digits - 1}e}")
    if 1e-4 <= abs(rounded) < 1e6:
        return _trimmed(f"{rounded:.{max(digits - 1 - _place(rounded), 0)}f}")
    mantissa, _, power = f"{rounded:.{digits - 1}e}".partition("e")
    return f"{_trimmed(mantissa)}e{int(power)}"


def si(value: float, unit: str, digits: int = 3) -> str:
    """A number with an SI prefix, to significant digits.

    >>> si(3.6e-6, "m"), si(0.99996, "s"), si(0.0, "W"), si(79e9, "Hz", 2)
    ('3.60 um', '1.00 s', '0 W', '79 GHz')
    """
    if not math.isfinite(value) or value == 0:
        return f"{_special(value)} {unit}".rstrip()
    rounded = float(f"{value:.{digits - 1}e}")
    power = _power(rounded)
    decimals = max(digits - 1 - _place(rounded) + power, 0)
    return f"{rounded / 10.0**power:.{decimals}f} {_PREFIXES[power]}{unit}"


def counted(count: int, noun: str) -> str:
    """A number of things, the noun in its singular.

    >>> counted(1, "point"), counted(2, "point")
    ('1 point', '2 points')
    """
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def with_error(value: float, error: float, unit: str = "", *, sign: bool = False) -> str:
    """A figure and its error, to two significant digits of the error.

    ``sign``: a plus before positive values. Where the value would take many digits, the error
    stands in a smaller unit; an error that is no number is one that nothing bounds, and one of 0 is
    not printed.

    >>> with_error(27.3123, 0.098, "dB"), with_error(0.0123456, 0.00032, "m")
    ('27.312 ± 0.098 dB', '12.35 ± 0.32 mm')
    >>> with_error(10.0000321, 3.1e-6, "m"), with_error(12345, 231)
    ('10.0000321 m ± 3.1 um', '12340 ± 230')
    """
    tail = f" {unit}" if unit else ""
    if not math.isfinite(value):
        return f"{_special(value)}{tail}"
    plus = "+" if sign and value > 0 else ""
    if not math.isfinite(error):
        return f"{plus}{_alone(value, unit)}, error not bounded"
    if error <= 1e-12 * abs(value):
        return f"{plus}{_alone(value, unit)}"
    error = float(f"{error:.1e}")
    scale = _power(max(abs(value), error)) if unit in _PREFIXED else 0
    decimals = 1 - _place(error) + scale
    value, scaled = value / 10.0**scale, error / 10.0**scale
    scaled_tail = f" {_PREFIXES[scale]}{unit}" if unit else ""
    if max(abs(value), scaled) >= 1e6:
        digits = max(_place(value) - _place(scaled) + 1, 1) if value else 1
        return (
            f"{plus}{_exponent(f'{value:.{digits}e}')} ± {_exponent(f'{scaled:.1e}')}{scaled_tail}"
        )
    shown = f"{plus}{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"  # no minus before 0
    if decimals <= _MOST_DECIMALS:
        return f"{shown} ± {round(scaled, decimals):.{max(decimals, 0)}f}{scaled_tail}"
    if unit in _PREFIXED:
        return f"{shown}{scaled_tail} ± {si(error, unit, 2)}"
    small = f"{scaled:.{decimals}f}" if scaled >= 1e-4 else _exponent(f"{scaled:.1e}")
    return f"{shown} ± {small}{tail}"


def at_most(value: float, above: float, unit: str = "", *, sign: bool = False) -> str:
    """A figure that may be any smaller, and larger by an error at most; to two digits of that.

    >>> at_most(-98.183, 3.04, "dBm"), at_most(2.31, 4.1, "dB", sign=True)
    ('-98.2, at most -95.1 dBm', '+2.3, at most +6.4 dB')
    """
    ends = value, value + above
    plus = ["+" if sign and end > 0 else "" for end in ends]
    if unit in _PREFIXED or not above > 0:
        shown = [_alone(end, unit) for end in ends]
        return f"{plus[0]}{shown[0]}, at most {plus[1]}{shown[1]}"
    decimals = max(1 - _place(above), 0)
    least, most = (f"{mark}{end:.{decimals}f}" for mark, end in zip(plus, ends, strict=True))
    return f"{least}, at most {most}{f' {unit}' if unit else ''}"


def quantity_text(value: float, unit: str | None, digits: int = 3) -> str:
    """A number with its unit, with a prefix where the unit takes one; no trailing zeros.

    >>> quantity_text(5e-05, "m"), quantity_text(20.0, "deg"), quantity_text(0.5, None)
    ('50 um', '20 deg', '0.5')
    """
    if unit not in _PREFIXED or not math.isfinite(value) or value == 0:
        return f"{number(value, digits)} {unit or ''}".rstrip()
    scaled, _, prefixed = si(value, unit, digits).partition(" ")
    return f"{_trimmed(scaled)} {prefixed}"


def setting_text(name: str, value: Any) -> str:
    """Value of a setting, in the unit that the end of its name says.

    >>> setting_text("detector.width_m", 5e-05), setting_text("filter.transmission", 0.5)
    ('50 um', '0.5')
    >>> setting_text("time_of_flight.modulation_hz", (1e7, 1.1e7)), setting_text("x", True)
    ('10 MHz, 11 MHz', 'true')
    """
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float | int):
        unit = unit_of(name)
        if isinstance(value, int) and unit is None:
            return str(value)
        return quantity_text(value, unit, _SETTING_DIGITS)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {setting_text(f'{name}.{key}', v)}" for key, v in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        more = f", ... ({len(value)})" if len(value) > _MOST_ITEMS else ""
        return ", ".join(setting_text(name, item) for item in value[:_MOST_ITEMS]) + more
    return str(value)


def json_text(content: Any) -> str:
    """A JSON document, null for numbers that are none or infinite."""
    return json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """Content as JSON knows it: dataclasses, arrays and paths too; text of anything else.

    >>> plain({"range_m": (1.0, math.nan), "file": None})
    {'range_m': [1.0, None], 'file': None}
    """
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str):
        return str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, Iterable):
        return [plain(each) for each in value]
    return str(value)


def _alone(value: float, unit: str) -> str:
    """A figure whose error is not printed."""
    return si(value, unit, 4) if unit in _PREFIXED else f"{number(value, 4)} {unit}".rstrip()


def _special(value: float) -> str:
    return f"{value:g}" if value else "0"


def _place(value: float) -> int:
    """Decimal place of the first digit."""
    return math.floor(math.log10(abs(value)))


def _power(value: float) -> int:
    """Power of ten of the prefix that leaves 1 to 3 digits before the point."""
    power = 3 * math.floor(float(f"{math.log10(abs(value)):.12g}") / 3)
    return min(max(power, min(_PREFIXES)), max(_PREFIXES))


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def _exponent(text: str) -> str:
    """``1.5e-07`` as ``1.5e-7``."""
    mantissa, _, power = text.partition("e")
    return f"{mantissa}e{int(power)}"
