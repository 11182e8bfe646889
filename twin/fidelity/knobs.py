"""What a knob takes, and which of two values is the stricter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar, get_args

import numpy as np

from twin.errors import InputError

K = TypeVar("K", bound="Knobs")

#: Knobs of earlier versions, and what became of them.
REPLACED = {"radar_rays": "gave way to radar_tolerance, the error of the echo of every body"}
#: In text what None is elsewhere.
NONE = "none"


@dataclass(frozen=True)
class Rule:
    """What a knob takes, and which of two values is the stricter.

    ``made_of`` makes the value of what is given, such as 1 000 000 of 1e6; ``check`` says what is
    wrong with it, nothing where it is right; ``told`` is a name or number that stands for it.
    """

    check: Callable[[Any], str]
    stricter: Callable[[Any, Any], Any]
    made_of: Callable[[Any], Any] = lambda value: value
    told: Callable[[Any], Any] = lambda value: value


def whole(least: int, *, optional: bool = False, most: int | None = None) -> dict[str, Rule]:
    """A whole number, the stricter the more; ``optional``: or None, which leaves it to bounds and
    is the strictest.
    """

    def check(value: Any) -> str:
        if value is None and optional:
            return ""
        if isinstance(value, bool) or not isinstance(value, int):
            return "is no int"
        if most is not None and value > most:
            return f"is more than {most}"
        return f"is less than {least}" if value < least else ""

    def stricter(one: Any, other: Any) -> Any:
        return None if one is None or other is None else max(one, other)

    return {"rule": Rule(check, stricter, _integral)}


def _integral(value: Any) -> Any:
    """A whole number of any kind, such as 1e6, as an int; anything else as it is."""
    if isinstance(value, float | np.number) and float(value).is_integer():
        return int(value)
    return value


def depth(least: float) -> dict[str, Rule]:
    """A number, the stricter the more."""

    def check(value: Any) -> str:
        return "" if is_number(value) and value >= least else f"is less than {least:g}"

    return {"rule": Rule(check, max)}


def tolerance(low: float, high: float) -> dict[str, Rule]:
    """A number, the stricter the less."""

    def check(value: Any) -> str:
        within = is_number(value) and low <= value <= high
        return "" if within else f"is not in {low:g} to {high:g}"

    return {"rule": Rule(check, min)}


def optional_tolerance(low: float, high: float) -> dict[str, Rule]:
    """A number, the stricter the less, or None, which leaves it to other knobs; in text "none"."""
    rule = tolerance(low, high)["rule"]

    def stricter(one: Any, other: Any) -> Any:
        given = [value for value in (one, other) if value is not None]
        return min(given) if given else None

    def made_of(value: Any) -> Any:
        return None if value == NONE else value

    return {
        "rule": Rule(lambda value: "" if value is None else rule.check(value), stricter, made_of)
    }


def one_of(kind: Any, stricter: Callable[[Any, Any], Any] | None = None) -> dict[str, Rule]:
    """One of some words, the stricter the later it stands among them."""
    known = get_args(kind)

    def check(value: Any) -> str:
        return "" if value in known else f"is none of {', '.join(known)}"

    def later(one: Any, other: Any) -> Any:
        return max(one, other, key=known.index)

    return {"rule": Rule(check, stricter or later)}


def is_number(value: Any) -> bool:
    """Whether a value is a number, which True and False are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


@dataclass(frozen=True)
class Knobs:
    """Checks knobs by their rules; ``a | b`` takes the stricter of each."""

    def __post_init__(self) -> None:
        for knob in fields(self):
            value = knob.metadata["rule"].made_of(getattr(self, knob.name))
            object.__setattr__(self, knob.name, value)
            if wrong := knob.metadata["rule"].check(value):
                raise InputError(f"{knob.name}: {value!r:.60} {wrong}")

    def __or__(self, other: Self) -> Self:
        """The stricter of each knob."""
        one, two = self._said(), other._said()
        stricter = {
            knob.name: knob.metadata["rule"].stricter(
                getattr(one, knob.name), getattr(two, knob.name)
            )
            for knob in fields(self)
        }
        return type(self)(**stricter)

    def _said(self) -> Self:
        """The same, with what a default stands for."""
        return self

    def with_(self, changes: Mapping[str, Any] | None = None, **knobs: Any) -> Self:
        """The same with some knobs changed. Raises InputError for a knob that is none, or a value
        that it does not take.

        >>> from twin.fidelity import Fidelity
        >>> Fidelity().with_({"radar_tolerance": 0.03}) == Fidelity(radar_tolerance=0.03)
        True
        >>> Fidelity().with_(radar_tolerance=3)
        Traceback (most recent call last):
        hardware.errors.InputError: radar_tolerance: 3 is not in 0.001 to 1
        """
        new = {**(changes or {}), **knobs}
        unknown = new.keys() - {knob.name for knob in fields(self)}
        if unknown:
            gone = "".join(f"; {old} {REPLACED[old]}" for old in sorted(unknown & REPLACED.keys()))
            raise InputError(f"fidelity: no knob {', '.join(sorted(unknown))}{gone}")
        return replace(self, **new)

    def said(self) -> dict[str, Any]:
        """Knobs as names and numbers; a user's own model by name and digest."""
        return {
            knob.name: knob.metadata["rule"].told(getattr(self, knob.name)) for knob in fields(self)
        }

    def part(self, kind: type[K]) -> K:
        """The knobs of light alone, or those of the radar alone: what results depend on.

        >>> from twin.fidelity import Fidelity, RadarFidelity
        >>> Fidelity(samples=16, radar="paths").part(RadarFidelity)
        RadarFidelity(radar='paths', ...)
        """
        return kind(**{knob.name: getattr(self, knob.name) for knob in fields(kind)})
