"""What the solver of physical optics takes and leaves out, as decisions with their bounds."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.radar.propagation.facets.convergence import label_of
from twin.radar.propagation.facets.reflections import ReflectionChoice
from twin.radar.propagation.scene.culling import OF_NOISE

Array = NDArray[np.float64]
#: Decisions, and bounds of what is left out of every body's echo, relative as its errors are.
Decided = tuple[tuple[Decision, ...], Array]

UNIT = "of the echo, or of the least level that counts"
_FAINT = OF_NOISE, "of a cell's noise", False
#: What reflects, and the least number of reflections.
_KINDS = {"bounces": ("reflections at bodies", 1), "images": ("reflections at large surfaces", 0)}
_NAMED = 32  # bodies with decisions of their own, the strongest ones


def on_faint_bodies(
    objects: Sequence[tuple[str, ...]], bound: Array, noise: float
) -> tuple[Decision, ...]:
    """Bodies left out altogether, since nothing of their size rises above the noise from there.

    ``bound`` (n_bodies,): of their echoes, in amplitude; ``noise``: of a cell, likewise.
    """
    order = np.argsort(-bound, kind="stable")
    decisions = [
        Decision("radar", f"echo of {label_of(objects[k])}", float(bound[k]) / noise, *_FAINT)
        for k in order[:_NAMED]
    ]
    if len(order) > _NAMED:
        effect = f"echoes of {len(order) - _NAMED} fainter bodies"
        most = float(bound[order[_NAMED:]].sum()) / noise
        decisions.append(Decision("radar", effect, most, *_FAINT))
    return tuple(decisions)


def on_edges(
    objects: Sequence[tuple[str, ...]],
    bound: Array,
    is_taken: NDArray[np.bool_],
    permitted: float,
    cost_s: float,
) -> tuple[Decision, ...]:
    """Decisions on the sharp edges of bodies, the largest bounds first, which took so long.

    ``bound`` (n_bodies,), relative to what errors of their echoes are relative to.
    """
    decisions = []
    for taken in (True, False):
        order = [k for k in np.argsort(-bound, kind="stable") if is_taken[k] == taken]
        cost_of_each_s = cost_s / max(len(order), 1) if taken else math.nan
        for k in order[:_NAMED]:
            name, at_most = label_of(objects[k]), float(bound[k])
            decisions.append(
                Decision(
                    *("radar", f"edges of {name}", at_most, permitted, UNIT, taken),
                    cost_s=cost_of_each_s,
                    body=name,
                )
            )
        if len(order) > _NAMED:
            effect = f"edges of {len(order) - _NAMED} further bodies"
            at_most = float(bound[order[_NAMED:]].max())
            cost_of_all_s = cost_of_each_s * (len(order) - _NAMED)
            decisions.append(
                Decision("radar", effect, at_most, permitted, UNIT, taken, cost_of_all_s)
            )
    return tuple(decisions)


def on_two_edges(
    objects: Sequence[tuple[str, ...]], left_out: Array, permitted: float
) -> tuple[Decision, ...]:
    """Decisions on waves over two edges of bodies, and at their corners, which are not computed."""
    effect = "waves over two edges, and at corners, of"
    return _on_waves(effect, objects, left_out, permitted, math.nan)


def on_reflections(
    choice: ReflectionChoice,
    kinds: Sequence[str],
    objects: Sequence[tuple[str, ...]],
    level: Array,
    permitted: float,
) -> tuple[Decision, ...]:
    """Decisions on further reflections at bodies, and at large surfaces on the way to them.

    ``kinds``: which of both, ``bounces`` and ``images``, were decided on; ``level`` (n_bodies,):
    what errors of their echoes are relative to, without the front end's losses; ``permitted``,
    relative to these. The time of reflections at bodies is divided among those that have them;
    echoes over large surfaces are computed together with direct ones.
    """
    decisions: list[Decision] = []
    strongest = np.argsort(-level, kind="stable")
    for kind in kinds:
        what, least = _KINDS[kind]
        most = getattr(choice.limits, kind)
        left_out, without = (
            getattr(part, kind) / level for part in (choice.left_out, choice.without)
        )
        is_followed = most > least
        cost_s = choice.cost_s if kind == "bounces" else math.nan
        cost_of_each_s = cost_s / max(int(is_followed.sum()), 1)
        for number, bound, which in (
            (most - 1, without, is_followed),
            (most, left_out, np.ones(len(level), dtype=bool)),
        ):
            some = strongest[which[strongest]]
            is_taken = number is not most
            took_s = cost_of_each_s if is_taken else math.nan
            for body in some[:_NAMED]:
                name = label_of(objects[body])
                effect = f"{what} beyond {number[body]}, {name}"
                at_most = float(bound[body])
                decisions.append(
                    Decision("radar", effect, at_most, permitted, UNIT, is_taken, took_s, name)
                )
            if len(some) > _NAMED:
                fainter = some[_NAMED:]
                effect = f"further {what}, {len(fainter)} fainter bodies"
                most_of, all_s = float(bound[fainter].max()), took_s * len(fainter)
                decisions.append(
                    Decision("radar", effect, most_of, permitted, UNIT, is_taken, all_s)
                )
    return (*decisions, *_on_coarse_tubes(choice.undivided / level, objects, permitted))


def _on_coarse_tubes(
    bound: Array, objects: Sequence[tuple[str, ...]], permitted: float
) -> list[Decision]:
    """On paths of many reflections that only coarse ray tubes follow, since there are too many; the
    largest bounds first.
    """
    effect = "finer ray tubes for more than 3 reflections at bodies"
    some = np.argsort(-bound, kind="stable")[: np.count_nonzero(bound)]
    decisions = []
    for k in some[:_NAMED]:
        name = label_of(objects[k])
        what, at_most = f"{effect}, {name}", float(bound[k])
        decisions.append(Decision("radar", what, at_most, permitted, UNIT, False, body=name))
    if len(some) > _NAMED:
        what = f"{effect}, {len(some) - _NAMED} further bodies"
        at_most = float(bound[some[_NAMED]])
        decisions.append(Decision("radar", what, at_most, permitted, UNIT, False))
    return decisions


def on_mirror_borders(
    objects: Sequence[tuple[str, ...]], left_out: Array, permitted: float, cost_s: float
) -> tuple[Decision, ...]:
    """Decisions on waves over the borders of mirrors to bodies, which are not computed, the largest
    first; ``left_out`` (n_bodies,) as of `on_round_obstacles`.
    """
    return _on_waves("waves over borders of mirrors to", objects, left_out, permitted, cost_s)


def on_edges_beside(
    objects: Sequence[tuple[str, ...]], left_out: Array, permitted: float, cost_s: float
) -> tuple[Decision, ...]:
    """Likewise on waves round obstacles over several mirrors, and to be reflected several times at
    bodies.
    """
    effect = "waves round obstacles, over more mirrors or reflected several times, to"
    return _on_waves(effect, objects, left_out, permitted, cost_s)


def on_corners(
    objects: Sequence[tuple[str, ...]],
    bound: Array,
    bodies: NDArray[np.bool_],
    permitted: float,
    cost_s: float,
) -> tuple[Decision, ...]:
    """Decisions on waves round obstacles that some ``bodies`` (n_bodies,) reflect several times;
    ``bound`` (n_bodies,): what they change, as of `on_round_obstacles`.
    """
    taken = np.where(bodies, bound, 0.0)
    effect = "waves round obstacles, reflected several times by"
    return _on_waves(effect, objects, taken, permitted, cost_s, is_taken=True)


def _on_waves(
    effect: str,
    objects: Sequence[tuple[str, ...]],
    bound: Array,
    permitted: float,
    cost_s: float,
    *,
    is_taken: bool = False,
) -> tuple[Decision, ...]:
    """On waves to some bodies, the largest first."""
    order = [k for k in np.argsort(-bound, kind="stable") if bound[k] > 0][:_NAMED]
    decisions = []
    for row in order:
        name, at_most, cost = label_of(objects[row]), float(bound[row]), cost_s / len(order)
        what = f"{effect} {name}"
        decisions.append(
            Decision("radar", what, at_most, permitted, UNIT, is_taken, cost, body=name)
        )
    return tuple(decisions)


def on_round_obstacles(
    objects: Sequence[tuple[str, ...]],
    bound: Array,
    left_out: Array,
    permitted: float,
    cost_s: float,
) -> tuple[Decision, ...]:
    """Decisions on what comes round obstacles to bodies, the largest bounds first.

    ``bound`` and ``left_out`` (n_bodies,), relative to what errors of their echoes are relative to,
    without and with what was computed.
    """
    is_taken = bound > permitted
    decisions, cost_of_each_s = [], cost_s / max(int(is_taken.sum()), 1)
    for taken, values in ((True, bound), (False, left_out)):
        rows = np.argsort(-values, kind="stable")
        order = [k for k in rows if (is_taken[k] if taken else values[k] > 0)]
        which = "waves diffracted round obstacles"
        for k in order[:_NAMED]:
            # Of a body to which such waves were computed, what is left is of further paths.
            rest = "" if taken or not is_taken[k] else "the weaker "
            name, at_most = label_of(objects[k]), float(values[k])
            effect = f"{rest}{which} to {name}"
            cost = cost_of_each_s if taken else math.nan
            decisions.append(
                Decision("radar", effect, at_most, permitted, UNIT, taken, cost, body=name)
            )
        if len(order) > _NAMED:
            rest = "" if taken else "the weaker "
            effect = f"{rest}{which} to {len(order) - _NAMED} more bodies"
            at_most = float(values[order[_NAMED:]].max())
            cost = cost_of_each_s * (len(order) - _NAMED) if taken else math.nan
            decisions.append(Decision("radar", effect, at_most, permitted, UNIT, taken, cost))
    return tuple(decisions)
