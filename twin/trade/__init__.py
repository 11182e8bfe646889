"""Speed against accuracy: time, memory and error of every fidelity level on a scene and machine."""

from twin.trade.choice import Choice, cheapest, most_accurate
from twin.trade.criterion import Criterion
from twin.trade.measurement import Cost, LevelMeasurement, front
from twin.trade.pareto import choose_fidelity, run_trade
from twin.trade.result import Trade
from twin.trade.score_tolerance import ScoredFidelity, fidelity_for_scores
from twin.trade.time_limit import TimedFidelity, fidelity_within

__all__ = [
    "Choice",
    "Cost",
    "Criterion",
    "LevelMeasurement",
    "ScoredFidelity",
    "TimedFidelity",
    "Trade",
    "cheapest",
    "choose_fidelity",
    "fidelity_for_scores",
    "fidelity_within",
    "front",
    "most_accurate",
    "run_trade",
]
