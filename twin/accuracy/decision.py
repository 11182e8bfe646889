"""An effect that a model takes or leaves out, with the bound that decided."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from hardware.formatting import number, si


@dataclass(frozen=True)
class Decision:
    """Whether an effect is modelled, and why.

    Parameters
    ----------
    sensor
        ``camera`` or ``radar``.
    effect
        In words: ``indirect light``, ``edges of car``.
    bound
        What leaving it out would change at most, in ``unit``.
    permitted
        What leaving it out may change, in ``unit``; the error of several effects that are left out
        adds, so each is permitted a part of the tolerance.
    unit
        Of both: ``of a pixel's noise``, ``of the echo``, ``dB``.
    taken
        Whether it is modelled. An effect whose bound is below what is permitted is left out; so is
        one that no model follows, such as reflections beyond the last: its bound is in the
        systematic error all the same.
    cost_s
        Time that it took; of what is left out, that finding this out took by traces of its own. NaN
        where it was not measured.
    body
        The name in ``effect`` of what it is of, where others may have the same effect.
    is_told
        Whether a warning of the same burst says what is left out, with the same figure.
    is_kept
        Whether it is of an earlier run, which took the time.

    >>> str(Decision("camera", "indirect light", 0.003, 0.02, "of a pixel's noise", False))
    "camera: indirect light: at most 0.003 of a pixel's noise, 0.02 permitted: left out"
    """

    sensor: str
    effect: str
    bound: float
    permitted: float
    unit: str
    taken: bool
    cost_s: float = math.nan
    body: str = ""
    is_told: bool = False
    is_kept: bool = False

    def __str__(self) -> str:
        took = f" ({self.cost})" if self.cost else ""
        return (
            f"{self.sensor}: {self.effect}: at most {number(self.bound, 2)} {self.unit}, "
            f"{number(self.permitted, 2)} permitted: {'taken' if self.taken else 'left out'}{took}"
        )

    @property
    def cost(self) -> str:
        """Time in words; empty where it was not measured."""
        if not self.cost_s >= 0:
            return ""
        return si(self.cost_s, "s") + " of an earlier run" * self.is_kept

    @property
    def is_missed(self) -> bool:
        """Whether it is left out although it may change more than is permitted."""
        return not self.taken and self.bound > self.permitted


def of_earlier_run(decisions: Iterable[Decision]) -> tuple[Decision, ...]:
    """Decisions that a kept result brings along: their time is none of this run's.

    >>> taken = Decision("camera", "indirect light", 0.3, 0.02, "of a pixel's noise", True, 1.2)
    >>> (kept,) = of_earlier_run([taken])
    >>> kept.cost
    '1.20 s of an earlier run'
    """
    return tuple(replace(decision, is_kept=True) for decision in decisions)


def missed_effects(decisions: Iterable[Decision]) -> list[str]:
    """Sentences on effects that are left out although they may change more than is permitted, each
    where its bound is largest; one for all bodies that lack the same.

    >>> indirect = Decision("camera", "indirect light", 0.3, 0.02, "of a pixel's noise", False)
    >>> missed_effects([indirect])
    ["indirect light: not computed; at most 0.3 of a pixel's noise, where 0.02 is permitted"]
    >>> waves = [
    ...     Decision("radar", f"waves to {name}", bound, 0.01, "of the echo", False, body=name)
    ...     for name, bound in (("car", 0.34), ("post", 0.19))
    ... ]
    >>> missed_effects(waves)
    ['waves to car, post: not computed; at most 34, 19 % of the echo, where 1 % is permitted']
    """
    worst: dict[str, Decision] = {}
    for decision in decisions:
        if decision.is_missed:
            known = worst.setdefault(decision.effect, decision)
            if decision.bound > known.bound:
                worst[decision.effect] = decision
    alike: dict[tuple[str, str, float], list[Decision]] = {}
    for decision in worst.values():
        stem = decision.effect.removesuffix(decision.body)
        alike.setdefault((stem, decision.unit, decision.permitted), []).append(decision)
    return [_missed(some) for some in alike.values()]


def _missed(some: Sequence[Decision]) -> str:
    """The sentence on one effect of one or several bodies."""
    first = some[0]
    names = ", ".join([first.effect, *(decision.body for decision in some[1:])])
    is_share = first.unit.startswith("of the echo")
    values = [100 * decision.bound if is_share else decision.bound for decision in some]
    permitted = 100 * first.permitted if is_share else first.permitted
    sign = " %" if is_share else ""
    return (
        f"{names}: not computed; at most {', '.join(number(value, 2) for value in values)}{sign} "
        f"{first.unit}, where {number(permitted, 2)}{sign} is permitted"
    )
