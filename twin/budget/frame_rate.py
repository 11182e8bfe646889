"""Frame rates from patterns, line rate and processing, sequential or overlapped."""

from dataclasses import dataclass

from twin.budget.table1 import PRINTED, REFLECTANCES, detector_of
from twin.system import Part

PATTERNS = 64  # paper, section 2
PROCESSING_S = 13e-3  # paper, section 2, ref. [22]
#: As the paper prints them, per sensor, for its three distances; None where it prints none.
PRINTED_FPS = {
    "fga015": (65.8, None, 30.16),
    "g10768-1024d": (57.2, None, 24.0),
    "g9201-256": (None, None, None),
}


@dataclass(frozen=True)
class FrameRate:
    """One sensor at one distance of Table 1, frames per second."""

    sensor: str
    distance_m: float
    reflectance: float
    printed: float | None
    plain: float
    differential: float
    plain_overlapped: float
    differential_overlapped: float


def frame_rates(
    part: Part, patterns: int = PATTERNS, processing_s: float = PROCESSING_S
) -> list[FrameRate]:
    """Frame rates at the printed integration times, the sensor's line rate respected.

    Sequential, a frame takes acquisition plus processing; overlapped, the longer of the two.
    """
    name = part.name.removesuffix("-paper")
    line_rate = detector_of(part).line_rate_hz
    shortest = 1 / line_rate.value if line_rate else 0.0
    rows = []
    for number, (distance, time) in enumerate(PRINTED[name]):
        plain = patterns * max(time, shortest)
        rows.append(
            FrameRate(
                sensor=part.name,
                distance_m=distance,
                reflectance=REFLECTANCES[number],
                printed=PRINTED_FPS[name][number],
                plain=1 / (plain + processing_s),
                differential=1 / (2 * plain + processing_s),
                plain_overlapped=1 / max(plain, processing_s),
                differential_overlapped=1 / max(2 * plain, processing_s),
            )
        )
    return rows
