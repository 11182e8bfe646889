"""Checked access to the fields of a radio's answer."""

from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import Fault, RadioError

#: Largest time of a device clock: 146 years, half the range of int64, which leaves room for a
#: schedule.
MOST_NS = 2**62

_MOST_TEXT = 200
_FAULTS = {str(fault.name).lower(): fault for fault in Fault}


@dataclass(frozen=True)
class Answer:
    """The JSON object that answers a command ``to`` a ``device``.

    Every method raises RadioError for a field that is missing or wrong: one line with the device,
    the command, the field, its value, and what was expected.
    """

    device: str
    to: str
    fields: dict[str, Any]

    def whole(self, name: str, least: int, most: int) -> int:
        """A whole number between limits, written as one (5) or as a float without a rest (5.0)."""
        value = self.fields.get(name)
        if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            expected = f"{least}" if least == most else f"a whole number from {least} to {most}"
            self._refuse(name, expected)
        return value

    def positive(self, name: str, most: float = 1e15) -> float:
        """A positive number."""
        value = self.fields.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most:
            self._refuse(name, f"a positive number up to {most:g}")
        return float(value)

    def text(self, name: str) -> str:
        """A text, on one line."""
        value = self.fields.get(name)
        if not isinstance(value, str) or not value.strip():
            self._refuse(name, "a text")
        return " ".join("".join(c if c.isprintable() else " " for c in value).split())[:_MOST_TEXT]

    def faults(self) -> Fault:
        """The field ``faults``: a list of names."""
        value, faults = self.fields.get("faults"), Fault(0)
        if not isinstance(value, list):
            self._refuse("faults", f"a list of {', '.join(_FAULTS)}")
        for name in value:
            if not isinstance(name, str) or name not in _FAULTS:
                self._refuse("faults", f"a list of {', '.join(_FAULTS)}")
            faults |= _FAULTS[name]
        return faults

    def there(self, n_samples: int) -> NDArray[np.bool_]:
        """Which samples are not in one of the ``gaps``, a list of ``[first, stop]``."""
        there, gaps = np.ones(n_samples, dtype=np.bool_), self.fields.get("gaps")
        expected = f"a list of [first, stop], 0 <= first < stop <= {n_samples}"
        if not isinstance(gaps, list):
            self._refuse("gaps", expected)
        for gap in gaps:
            if not (
                isinstance(gap, list)
                and [type(edge) for edge in gap] == [int, int]
                and 0 <= gap[0] < gap[1] <= n_samples
            ):
                self._refuse("gaps", expected)
            there[gap[0] : gap[1]] = False
        return there

    def _refuse(self, name: str, expected: str) -> NoReturn:
        said = _short(self.fields[name]) if name in self.fields else "missing"
        raise RadioError(
            f"{self.device}: {self.to}: {name}: {said} in the answer, expected {expected}"
        )


def _short(value: Any) -> str:
    """A value shortened for an error message."""
    if isinstance(value, int) and value.bit_length() > 128:
        return f"a number of {value.bit_length()} bits"
    try:
        return f"{value!r:.60}"
    except RecursionError:
        return type(value).__name__
