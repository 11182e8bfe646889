"""The speed/accuracy trade: time, memory and error of every rung on one's own scene and machine."""

from twin.trade.measurement import Choice, Cost, Measurement, cheapest, front
from twin.trade.pareto import TOLERANCE, choose_fidelity, run_trade
from twin.trade.result import Trade

__all__ = [
    "TOLERANCE",
    "Choice",
    "Cost",
    "Measurement",
    "Trade",
    "cheapest",
    "choose_fidelity",
    "front",
    "run_trade",
]
