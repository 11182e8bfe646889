"""What the solver of physical optics takes and leaves out, as decisions with their bounds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.radar.propagation.facets.convergence import label_of
from twin.radar.propagation.facets.reflections import Choice

Array = NDArray[np.float64]

_UNIT = "of the echo"
#: What reflects, and the least number of reflections.
_KINDS = {"bounces": ("reflections at bodies", 1), "images": ("reflections at large surfaces", 0)}
_NAMED = 32  # bodies with decisions of their own, the strongest ones


def on_reflections(
    choice: Choice,
    kinds: Sequence[str],
    objects: Sequence[tuple[str, ...]],
    level: Array,
    permitted: float,
) -> tuple[Decision, ...]:
    """Decisions on further reflections at bodies, and at large surfaces on the way to them.

    ``kinds``: which of both, ``bounces`` and ``images``, were decided on; ``level`` (n_bodies,):
    what errors of their echoes are relative to, without the front end's losses; ``permitted``,
    relative to these.
    """
    decisions: list[Decision] = []
    strongest = np.argsort(-level, kind="stable")
    for kind in kinds:
        what, least = _KINDS[kind]
        most = getattr(choice.limits, kind)
        left_out, without = (
            getattr(part, kind) / level for part in (choice.left_out, choice.without)
        )
        for number, bound, which in (
            (most - 1, without, most > least),
            (most, left_out, np.ones(len(level), dtype=bool)),
        ):
            some = strongest[which[strongest]]
            is_taken = number is not most
            for body in some[:_NAMED]:
                effect = f"{what} beyond {number[body]}, {label_of(objects[body])}"
                decisions.append(
                    Decision("radar", effect, float(bound[body]), permitted, _UNIT, is_taken)
                )
            if len(some) > _NAMED:
                effect = f"further {what}, {len(some) - _NAMED} fainter bodies"
                most_of = float(bound[some[_NAMED:]].max())
                decisions.append(Decision("radar", effect, most_of, permitted, _UNIT, is_taken))
    return tuple(decisions)
