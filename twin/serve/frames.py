"""Frames of a camera in a world that moves, computed ahead in other processes."""

import pickle
from collections.abc import Iterator
from typing import Self

from hardware.records import SpiRecord
from twin.camera.stream import MovingFrames
from twin.fidelity import Accuracy
from twin.scene import Scene
from twin.serve.prefetcher import Prefetcher
from twin.system import System

_LOOK_S = 0.1
_OLD_S = 60.0  # of a frame that is still waited for: some six times what a host's driver waits


class _Frames:
    """Frame k of a run: of a system, that begins at an instant of the scene. The scene goes to
    another process once, runs are small.
    """

    def __init__(self, scene: Scene, seed: int, fidelity: Accuracy | None) -> None:
        self._scene, self._seed, self._fidelity = scene, seed, fidelity
        self._begins_s = 0.0
        self._of_run: MovingFrames | None = None

    def __call__(self, number: int, system: System, begins_s: float) -> SpiRecord:
        of_run = self._of_run
        if of_run is None or of_run.system is not system or self._begins_s != begins_s:
            now = self._scene.after(begins_s)
            of_run = MovingFrames(now, system, self._seed, self._fidelity)
            self._of_run, self._begins_s = of_run, begins_s
        return of_run(number)


class FramesAhead(Iterator[SpiRecord]):
    """Frames 0, 1, 2 ... of a camera, while a device that must answer at once goes on.

    ``begins_s``: the scene's instant that frame 0 shows. ``none_came``: frame 0 has neither been
    taken nor failed.
    """

    def __init__(self, make: _Frames, system: System, begins_s: float) -> None:
        self._prefetcher, self._number = Prefetcher(make, system, begins_s), 0
        self.begins_s, self.none_came = begins_s, True

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> SpiRecord:
        """The next frame. Raises InputError as `MovingFrames`, EngineError for all other errors."""
        self.none_came = False
        record = self._prefetcher(self._number)
        self._number += 1
        return record

    def ready(self, timeout_s: float = 0.0) -> bool:
        """Whether the next frame is there, or has failed, within a time."""
        return self._prefetcher.ready(self._number, timeout_s)

    def begin_again(self, system: System, begins_s: float) -> bool:
        """From frame 0 on, by the same processes; False where others have to be started."""
        self._number, self.begins_s, self.none_came = 0, begins_s, True
        return self._prefetcher.begin_again(system, begins_s)

    def close(self) -> None:
        """End the processes; any number of times."""
        self._prefetcher.close()


class FramesOfRuns:
    """Frames of one run of a camera after another, by the same processes: to start others takes
    seconds. They start at once, with frame 0 of a run of ``system`` now.

    Parameters
    ----------
    scene, system, seed, fidelity
        As in `MovingFrames`.
    """

    def __init__(
        self, scene: Scene, system: System, seed: int, fidelity: Accuracy | None = None
    ) -> None:
        self._make = _Frames(scene, seed, fidelity)
        self._frames = FramesAhead(self._make, system, 0.0)
        self._system = b""  # of the latest run

    def wait(self) -> None:
        """Wait until a process has loaded its libraries and computed a frame, or failed at it."""
        while not self._frames.ready(_LOOK_S):
            pass

    def __call__(self, system: System, begins_s: float = 0.0) -> FramesAhead:
        """Frames 0, 1, 2 ... of the next run, which begins at an instant of the scene; those of the
        run before end.

        After a run of the same system of which no frame came its frames go on, though they begin
        up to `_OLD_S` earlier: a host that gives up waiting and starts the camera anew would wait
        forever.
        """
        asked = pickle.dumps(system)
        is_recent = begins_s - self._frames.begins_s < _OLD_S
        if asked == self._system and self._frames.none_came and is_recent:
            return self._frames
        self._system = asked
        if not self._frames.begin_again(system, begins_s):
            self._frames.close()
            self._frames = FramesAhead(self._make, system, begins_s)
        return self._frames
