"""Budgets in closed form: one's own system before a wall; the paper's Table 1, re-derived."""

from twin.budget.design import WallRow, wall_rows
from twin.budget.frame_rate import FrameRate, frame_rates
from twin.budget.link import Link
from twin.budget.table1 import SENSORS, Row, audit, link_of

__all__ = [
    "SENSORS",
    "FrameRate",
    "Link",
    "Row",
    "WallRow",
    "audit",
    "frame_rates",
    "link_of",
    "wall_rows",
]
