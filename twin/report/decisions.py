"""What the models took and left out, by the bounds that decided: for the page and the terminal."""

from collections.abc import Sequence
from math import isfinite

from hardware.formatting import number
from twin.accuracy import Decision
from twin.camera.evaluation import Evaluation
from twin.radar.evaluation import RadarEvaluation

HEAD = ("sensor", "effect", "adds at most", "permitted", "", "taken", "time")


def decisions_of(
    evaluations: Sequence[Evaluation], radar: RadarEvaluation | None
) -> list[tuple[str, Decision]]:
    """Decisions of all sensors, with the name of the design."""
    told = [(e.system.name, decision) for e in evaluations for decision in e.capture.decisions]
    if radar:
        told += [(radar.radar.name, decision) for decision in radar.capture.decisions]
    return told


def rows(told: Sequence[tuple[str, Decision]]) -> list[tuple[str, ...]]:
    """The table's cells under `HEAD`, in the order in which they were decided."""
    return [
        (
            name,
            decision.effect,
            number(decision.bound, 2) if isfinite(decision.bound) else "not bounded",
            number(decision.permitted, 2),
            decision.unit,
            "yes" if decision.taken else "no",
            decision.cost,
        )
        for name, decision in told
    ]
