"""Samples of the objects' states between measurements of a drive."""

import numpy as np

from twin.drive.plan import Drive
from twin.drive.truth import ObjectStates

#: Computed together. Always the same ones, whichever is asked for first, so that a drive that is
#: gone on with has the same bytes.
_TOGETHER = 64


class TruthSamples:
    """Of a drive, by number."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._first, self._held = 0, list[ObjectStates]()

    def __call__(self, number: int) -> ObjectStates:
        """Sample ``number``."""
        first = number - number % _TOGETHER
        if first != self._first or not self._held:
            self._first, self._held = first, self._computed(first)
        return self._held[number - first]

    def _computed(self, first: int) -> list[ObjectStates]:
        end_ns = round(1e9 * self._drive.duration_s)
        times = [self._drive.truth_ns(number) for number in range(first, first + _TOGETHER)]
        within = np.array([at_ns for at_ns in times if at_ns <= end_ns])
        return ObjectStates.at(self._drive.scene, 1e-9 * within)
