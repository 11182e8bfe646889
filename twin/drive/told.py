"""Warnings of a drive's records: how many of each kind, and the first."""

from collections.abc import Iterable
from dataclasses import dataclass

from twin.warned import CaptureWarning


@dataclass(frozen=True)
class ToldWarning:
    """Warnings of one kind that records of one sensor had: of how many, and the first in words."""

    sensor: str
    kind: str
    records: int
    words: str


class ToldWarnings:
    """Warnings of all records so far, however many: memory does not grow with them."""

    def __init__(self) -> None:
        self._told: dict[tuple[str, str], ToldWarning] = {}

    def add(self, sensor: str, warnings: Iterable[CaptureWarning]) -> None:
        """Those of one record."""
        first = {warning.kind: str(warning) for warning in reversed(tuple(warnings))}
        for kind, words in first.items():
            told = self._told.get((sensor, kind), ToldWarning(sensor, kind, 0, words))
            self._told[sensor, kind] = ToldWarning(sensor, kind, told.records + 1, told.words)

    @property
    def told(self) -> tuple[ToldWarning, ...]:
        """By sensor and kind."""
        return tuple(self._told[key] for key in sorted(self._told))
