"""Warnings of a drive's records: how many of each kind, and the first."""

from collections.abc import Iterable
from dataclasses import dataclass

from twin.warned import CaptureWarning


@dataclass(frozen=True)
class WarningCount:
    """Warnings of one kind that records of one sensor had: of how many, and the first in words."""

    sensor: str
    kind: str
    records: int
    words: str


class WarningCounts:
    """Warnings of all records so far, however many: memory does not grow with them."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], WarningCount] = {}

    def add(self, sensor: str, warnings: Iterable[CaptureWarning]) -> None:
        """Those of one record."""
        first = {warning.kind: str(warning) for warning in reversed(tuple(warnings))}
        for kind, words in first.items():
            known = self._counts.get((sensor, kind), WarningCount(sensor, kind, 0, words))
            self._counts[sensor, kind] = WarningCount(sensor, kind, known.records + 1, known.words)

    @property
    def counts(self) -> tuple[WarningCount, ...]:
        """By sensor and kind."""
        return tuple(self._counts[key] for key in sorted(self._counts))
