"""Frames of a camera in a world that moves, computed ahead in other processes."""

import pickle
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

    def begin_again(self) -> bool:
        """From frame 0 on, by the same processes; False where one has died."""
        self._number = 0
        return self._prefetcher.begin_again()

    def close(self) -> None:
        """End the processes; any number of times."""
        self._prefetcher.close()


class FramesOfRuns:
    """Frames of one run of a camera after another. The processes of a run go on with the next one
    where its frames are the same: to start others takes seconds.
    """

    def __init__(self) -> None:
        self._frames: FramesAhead | None = None
        self._made_by = b""

    def __call__(self, frames: MovingFrames) -> FramesAhead:
        """Frames 0, 1, 2 ... of the next run; those of the run before end."""
        made_by = pickle.dumps(frames)
        if self._frames is not None:
            if made_by == self._made_by and self._frames.begin_again():
                return self._frames
            self._frames.close()
        self._frames, self._made_by = FramesAhead(frames), made_by
        return self._frames
