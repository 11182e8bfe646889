"""Budgets in closed form: a system in front of a wall; the paper's Table 1, re-derived."""

from twin.budget.design import WallRow, wall_rows
from twin.budget.frame_rate import FrameRate, frame_rates
from twin.budget.link import OpticalLink
from twin.budget.table1 import SENSORS, AuditRow, audit, link_of

__all__ = [
    "SENSORS",
    "AuditRow",
    "FrameRate",
    "OpticalLink",
    "WallRow",
    "audit",
    "frame_rates",
    "link_of",
    "wall_rows",
]
