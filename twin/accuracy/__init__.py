"""How far results are from the truth: intervals of figures, and what a model left out and why."""

from twin.accuracy.decision import Decision, missed_effects, of_earlier_run
from twin.accuracy.figure import Figure
from twin.accuracy.interval import Interval, propagated

__all__ = ["Decision", "Figure", "Interval", "missed_effects", "of_earlier_run", "propagated"]
