"""Frames of a camera in a world that moves, computed ahead in other processes."""

from collections.abc import Iterator
from typing import Self

from hardware.records import SpiRecord
from twin.camera.stream import MovingFrames
from twin.serve.prefetcher import Prefetcher


class FramesAhead(Iterator[SpiRecord]):
    """Frames 0, 1, 2 ... of a camera, while a device that must answer at once goes on."""

    def __init__(self, frames: MovingFrames) -> None:
        self._prefetcher, self._number = Prefetcher(frames), 0

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> SpiRecord:
        """The next frame. Raises InputError as `MovingFrames`, EngineError for all other errors."""
        record = self._prefetcher(self._number)
        self._number += 1
        return record

    def ready(self) -> bool:
        """Whether the next frame is there, or has failed."""
        return self._prefetcher.ready(self._number, 0.0)

    def close(self) -> None:
        """End the processes; any number of times."""
        self._prefetcher.close()
