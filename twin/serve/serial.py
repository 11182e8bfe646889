"""Runs a virtual camera on a line, with injected faults."""

import selectors
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock
from twin.serve.faults import CameraFaults
from twin.serve.line import Line

_MOST_WAITING = 65536  # bytes that the line has not taken; beyond, frames are dropped
_MOST_TOGETHER, _TOGETHER = 16, 2048  # frames, and bytes, that go to the line at once
_DEAF_S = 0.02  # of making frames before the line is read again, a last record apart
_POLL_S = 0.05


class CameraServer:
    """Serves a camera until it is stopped.

    Parameters
    ----------
    camera
        Makes the camera, from its functions ``send`` and ``overrun``.
    line, clock
        Its line, and its clock.
    faults, seed
        Injected faults, and the seed of their random numbers.
    """

    def __init__(
        self,
        camera: Callable[[Callable[[bytes], bool], Callable[[], bool]], VirtualCamera],
        line: Line,
        *,
        clock: DeviceClock,
        faults: CameraFaults | None = None,
        seed: int = 0,
    ) -> None:
        self.line, self._clock = line, clock
        self._faults, self._rng = faults or CameraFaults(), np.random.default_rng([seed, 5])
        self._waiting: deque[bytes] = deque()
        self._held: bytes | None = None  # goes out after the next frame
        self._silent_until = 0.0
        self._reset = self._stopped = False
        self.camera = camera(self._send, lambda: self._happens(self._faults.overrun))

    def run(self) -> None:
        """Serve until `stop`."""
        try:
            while not self._stopped:
                if (due := self._work()) == 0:
                    continue
                with selectors.DefaultSelector() as ready:
                    self.line.register(ready)
                    ready.select(_POLL_S if due is None else min(due, _POLL_S))
        finally:
            self.line.close()

    def stop(self) -> None:
        """End `run` soon; from any thread."""
        self._stopped = True

    def _work(self) -> float | None:
        """Do all pending work; returns seconds until there may be more, None: unknown."""
        data = self.line.read()
        if self.line.has_new_host():
            self.camera.meet_host()
            self._waiting.clear()  # it may begin in the middle of a frame
            self._held = None
        if data:
            self.camera.receive(data)
        self._flush()
        if self._reset:
            self._reset = False
            self._waiting.clear()
            self.camera.start_up()
        waiting = sum(map(len, self._waiting))
        if waiting and self._clock.pace == "fast":
            return 1e-3  # a fast clock waits for the line
        deaf_until = time.monotonic() + _DEAF_S
        for _ in range(_MOST_TOGETHER):
            due = self.camera.poll()
            if due != 0 or self._reset or sum(map(len, self._waiting)) > _TOGETHER:
                break
            if time.monotonic() > deaf_until:  # records take their time: a request may wait
                break
        self._flush()
        return 1e-3 if self._waiting else due

    def _flush(self) -> None:
        while self._waiting and time.monotonic() >= self._silent_until:
            piece = self._waiting.popleft()
            if (written := self.line.write(piece)) < len(piece):
                self._waiting.appendleft(piece[written:])
                return

    def _send(self, frame: bytes) -> bool:
        """Queue a frame, with its faults; False where the line is full."""
        if sum(map(len, self._waiting)) > _MOST_WAITING:
            return False
        faults = self._faults
        if self._happens(faults.reset):
            self._reset = True
        if self._happens(faults.hang_up):
            self.line.hang_up()
        if self._happens(faults.stall):
            self._silent_until = time.monotonic() + faults.stall_s
        if self._happens(faults.drop):
            return True
        if self._happens(faults.flip):
            at = int(self._rng.integers(len(frame)))
            bit = 1 << int(self._rng.integers(8))
            frame = frame[:at] + bytes([frame[at] ^ bit]) + frame[at + 1 :]
        if self._held is not None:
            frame, self._held = frame + self._held, None
        elif self._happens(faults.reorder):
            self._held = frame
            return True
        if self._happens(faults.duplicate):
            frame += frame
        if self._happens(faults.split):
            cuts = np.sort(self._rng.integers(0, len(frame), 4))
            ends = zip([0, *cuts], [*cuts, len(frame)], strict=True)
            self._waiting.extend(frame[start:stop] for start, stop in ends if stop > start)
        else:
            self._waiting.append(frame)
        return True

    def _happens(self, chance: float) -> bool:
        return chance > 0 and bool(self._rng.random() < chance)
