"""Speed against accuracy: time, memory and error of every fidelity level on a scene and machine."""

from twin.trade.measurement import Choice, Cost, LevelMeasurement, cheapest, front, most_accurate
from twin.trade.pareto import choose_fidelity, run_trade
from twin.trade.result import Trade
from twin.trade.time_limit import TimedFidelity, fidelity_within

__all__ = [
    "Choice",
    "Cost",
    "LevelMeasurement",
    "TimedFidelity",
    "Trade",
    "cheapest",
    "choose_fidelity",
    "fidelity_within",
    "front",
    "most_accurate",
    "run_trade",
]
