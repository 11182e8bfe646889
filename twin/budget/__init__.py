"""The paper's budget re-derived in closed form: integration times, distances, frame rates."""

from twin.budget.frame_rate import FrameRate, frame_rates
from twin.budget.link import Link
from twin.budget.table1 import SENSORS, Row, audit, link_of

__all__ = [
    "SENSORS",
    "FrameRate",
    "Link",
    "Row",
    "audit",
    "frame_rates",
    "link_of",
]
