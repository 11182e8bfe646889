"""An effect that a model takes or leaves out, with the bound that decided."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

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
        Time that it took, NaN where it was not measured or not taken.

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

    def __str__(self) -> str:
        took = f" ({si(self.cost_s, 's')})" if self.cost_s >= 0 else ""
        return (
            f"{self.sensor}: {self.effect}: at most {number(self.bound, 2)} {self.unit}, "
            f"{number(self.permitted, 2)} permitted: {'taken' if self.taken else 'left out'}{took}"
        )

    @property
    def is_missed(self) -> bool:
        """Whether it is left out although it may change more than is permitted."""
        return not self.taken and self.bound > self.permitted


def missed_effects(decisions: Iterable[Decision]) -> list[str]:
    """Sentences on effects that are left out although they may change more than is permitted, each
    where its bound is largest.

    >>> indirect = Decision("camera", "indirect light", 0.3, 0.02, "of a pixel's noise", False)
    >>> missed_effects([indirect])
    ["indirect light: not computed; at most 0.3 of a pixel's noise, where 0.02 is permitted"]
    """
    worst: dict[str, Decision] = {}
    for decision in decisions:
        if decision.is_missed:
            known = worst.setdefault(decision.effect, decision)
            if decision.bound > known.bound:
                worst[decision.effect] = decision
    return [
        f"{decision.effect}: not computed; at most {decision.bound:.2g} {decision.unit}, where "
        f"{decision.permitted:.2g} is permitted"
        for decision in worst.values()
    ]
