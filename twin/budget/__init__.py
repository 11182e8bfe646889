"""The paper's budget re-derived in closed form: integration times, distances, frame rates."""

from twin.budget.frame_rate import FrameRate, frame_rates
from twin.budget.link import Link
from twin.budget.sensors import SensorPart, load_part, part_names
from twin.budget.table1 import Row, audit, link_of

__all__ = [
    "FrameRate",
    "Link",
    "Row",
    "SensorPart",
    "audit",
    "frame_rates",
    "link_of",
    "load_part",
    "part_names",
]
