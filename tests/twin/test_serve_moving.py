"""The moving world behind the camera's protocol: frames of their own instants, late if need be."""

import logging
import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import psutil
import pytest

from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import (
    Arm,
    Configure,
    Configured,
    Measurement,
    Start,
    State,
    Status,
    from_frame,
    to_frame,
)
from hardware.errors import InputError
from hardware.records import SpiRecord
from twin.camera.acquisition import capture
from twin.camera.stream import MovingFrames
from twin.fidelity import Fidelity
from twin.scene import load_scene
from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock
from twin.serve.frames import FramesAhead, FramesOfRuns
from twin.system import System, load_system

SYSTEM = load_system("workable").with_(
    {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 8}
)
QUICK = Fidelity(samples=4, max_depth=1, motion_tolerance=None)
FRAME_S = 1.6e-3


class ComputedSlowly(FramesAhead):
    """Frames that are ready so many seconds after the one before was taken; after ``last`` none."""

    def __init__(self, frames: MovingFrames, takes_s: float, last: int = 100) -> None:
        self._takes_s, self._last = takes_s, last
        self._made = [frames(number) for number in range(min(last + 1, 5))]  # not while it answers
        self._next, self._ready_s = 0, time.monotonic() + takes_s

    def __next__(self) -> SpiRecord:
        if self._next > self._last:
            raise InputError("scene yard: time 9 s from now on: its trajectories cover 0 to 8 s")
        self._next, self._ready_s = self._next + 1, time.monotonic() + self._takes_s
        return self._made[self._next - 1]

    def ready(self) -> bool:
        return time.monotonic() >= self._ready_s


class Host:
    """A camera without a line, configured and started, and what it sends."""

    def __init__(self, takes_s: float, last: int = 100, sets: int = 5) -> None:
        self.made: list[ComputedSlowly] = []
        self._takes_s = takes_s
        self._sent, self._deframer = bytearray(), Deframer()

        def records(asked: System) -> Iterator[SpiRecord]:
            frames = MovingFrames(load_scene("yard"), asked, 5, QUICK)
            self.made.append(ComputedSlowly(frames, takes_s, last))
            return self.made[-1]

        self.camera = VirtualCamera(
            SYSTEM,
            load_scene("yard").sun,
            records,
            clock=DeviceClock("real"),
            send=lambda data: self._sent.extend(data) is None,
        )
        self.answers()
        configured = self.ask(Configure(8, 8, 8, 1, 0, 0, 16, 80e-6, 100e-6))
        assert isinstance(configured, Configured)
        self.ask(Arm(configured.table_crc))
        self.ask(Start(1, sets))

    def ask(self, message: object) -> object:
        self.camera.receive(encode(to_frame(message, 1)))
        return self.answers()[-1]

    def answers(self) -> list[object]:
        found = [from_frame(frame) for frame in self._deframer.feed(bytes(self._sent))]
        self._sent.clear()
        return found

    def served(self, seconds: float) -> list[object]:
        """What it sends in a while, asked as the server asks it."""
        found, end_s = [], time.monotonic() + seconds
        while time.monotonic() < end_s:
            begun_s = time.monotonic()
            left_s = self.camera.poll()
            if self.made[0].ready() is False:
                assert time.monotonic() - begun_s < self._takes_s / 2  # it goes on answering
            found += self.answers()
            if left_s is None:
                break
            time.sleep(min(left_s, 0.002))
        return found


def test_frames_are_those_of_the_world_at_their_own_instants() -> None:
    """Frame k is the capture of the scene after k frames; device time and numbers go on."""
    scene = load_scene("yard")
    frames = MovingFrames(scene, SYSTEM, 3, QUICK)
    for number in (0, 4):
        record = frames(number)
        world = scene.after(number * SYSTEM.frame_time_s)
        expected = capture(world, SYSTEM, seed=3 + number, fidelity=QUICK).record
        np.testing.assert_array_equal(record.counts, expected.counts)
        assert record.device_time_ns[0] == round(number * 1e9 * FRAME_S)
        assert record.sequence.tolist() == list(range(16 * number, 16 * (number + 1)))


@pytest.mark.thorough
def test_a_device_that_computes_slowly_sends_late_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """800 ms for a frame of 1.6 ms: no frame is lost, times in them are those of the device's own
    clock, and one warning tells how late they are.
    """
    host = Host(takes_s=0.8)
    with caplog.at_level(logging.WARNING):
        sent = host.served(30.0)
    frames = [message for message in sent if isinstance(message, Measurement)]
    assert len(frames) == 5
    assert np.diff([frame.time_ns for frame in frames]).tolist() == [1_600_000] * 4
    expected = MovingFrames(load_scene("yard"), SYSTEM, 5, QUICK)
    counts = np.concatenate([frame.counts for frame in frames])
    np.testing.assert_array_equal(counts, np.concatenate([expected(k).counts for k in range(5)]))
    told = [record.message for record in caplog.records]
    assert len(told) == 1
    assert "slower than real time: a frame lasts 0.0016 s, frame 2 is sent" in told[0]


def test_a_run_ends_where_a_trajectory_does(caplog: pytest.LogCaptureFixture) -> None:
    host = Host(takes_s=0.0, last=1)
    with caplog.at_level(logging.ERROR):
        sent = host.served(30.0)
    assert sum(isinstance(message, Measurement) for message in sent) == 2
    assert isinstance(sent[-1], Status)
    assert sent[-1].state == State.ARMED
    assert "its trajectories cover 0 to 8 s" in caplog.text
    host.ask(Start(2, 1))
    assert len(host.made) == 2


def test_a_frame_that_is_long_in_coming_is_told_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it an operator saw nothing while the host gave up and started the camera anew."""
    monkeypatch.setattr("twin.serve.camera._COMPUTING_S", 0.2)
    host = Host(takes_s=0.6, sets=2)
    with caplog.at_level(logging.WARNING):
        sent = host.served(30.0)
    assert sum(isinstance(message, Measurement) for message in sent) == 2
    (told,) = caplog.messages
    assert "frame 0 is due for 0.2" in told
    assert "still being computed" in told


class Requested:
    """Stands in for a prefetcher: what it is asked, without an answer before ``is_there``."""

    made: ClassVar[list["Requested"]] = []

    def __init__(self, make: object, *args: object) -> None:
        self.runs, self.is_there, self.has_died = [args], False, False
        self.made.append(self)

    def __call__(self, number: int) -> tuple[int, object]:
        return number, self.runs[-1]

    def ready(self, number: int, timeout_s: float) -> bool:
        return self.is_there

    def begin_again(self, *args: object) -> bool:
        self.runs.append(args)
        return not self.has_died

    def close(self) -> None:
        self.runs.append(("closed",))


def test_a_run_that_was_waited_for_in_vain_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that waits 10 s gives up and starts the camera anew, in a world that has gone on by
    as much: what is being computed is not thrown away. Once a frame has come, or the system is
    another, the next run begins at its own instant, by the same processes.
    """
    monkeypatch.setattr("twin.serve.frames.Prefetcher", Requested)
    Requested.made.clear()
    other = SYSTEM.with_({"acquisition.n_patterns": 4})
    runs = FramesOfRuns(load_scene("yard"), SYSTEM, 3, QUICK)
    assert runs(SYSTEM, 30.0).begins_s == 30.0  # not what was computed when it was switched on
    for later_s in (40.0, 50.0):
        assert runs(SYSTEM, later_s).begins_s == 30.0
    assert runs(other, 60.0).begins_s == 60.0
    assert next(runs(other, 70.0)) == (0, (other, 60.0))
    assert runs(other, 80.0).begins_s == 80.0
    (only,) = Requested.made
    assert only.runs == [(SYSTEM, 0.0), (SYSTEM, 30.0), (other, 60.0), (other, 80.0)]
    assert runs(other, 141.0).begins_s == 141.0  # a host that comes back after a minute
    only.has_died = True
    next(runs(other, 150.0))
    assert runs(other, 160.0).begins_s == 160.0
    assert [each.runs[-1] for each in Requested.made] == [("closed",), (other, 160.0)]


@pytest.mark.thorough
def test_runs_share_processes() -> None:
    """A run that stops anywhere is followed by one that begins with frame 0 of its own instant and
    system.
    """
    scene, other = load_scene("yard"), SYSTEM.with_({"acquisition.n_patterns": 4})
    runs = FramesOfRuns(scene, SYSTEM, 3, QUICK)
    runs.wait()
    processes = set(psutil.Process().children())
    for length, begins_s, system in (
        (1, 0.0, SYSTEM),
        (3, 0.0, SYSTEM),
        (0, 1.5, SYSTEM),
        (2, 2.0, other),
        (2, 2.5, SYSTEM),
    ):
        run, expected = (
            runs(system, begins_s),
            MovingFrames(scene.after(begins_s), system, 3, QUICK),
        )
        for number in range(length):
            while not run.ready(1.0):
                pass
            np.testing.assert_array_equal(next(run).counts, expected(number).counts)
    assert set(psutil.Process().children()) == processes
    run.close()
