"""Speed against accuracy: time, memory and error of every fidelity level on a scene and machine."""

from twin.trade.measurement import Choice, Cost, LevelMeasurement, cheapest, front
from twin.trade.pareto import TOLERANCE, choose_fidelity, run_trade
from twin.trade.result import Trade

__all__ = [
    "TOLERANCE",
    "Choice",
    "Cost",
    "LevelMeasurement",
    "Trade",
    "cheapest",
    "choose_fidelity",
    "front",
    "run_trade",
]
