"""How far results are from the truth: intervals of figures, and what a model left out and why."""

from twin.accuracy.decision import Decision
from twin.accuracy.interval import Interval

__all__ = ["Decision", "Interval"]
