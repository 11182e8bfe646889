"""The reference firmware asked for patterns faster than it can play them (PROTOCOL.md, 1 and 7)."""

import struct
import time
from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np
import pytest
import serial
from asking import asking

from hardware import PatternSet
from hardware.drivers import Patience, SpiCamera, SpiSettings
from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import (
    Arm,
    Configure,
    Measurement,
    Query,
    Refusal,
    Refused,
    Start,
    State,
    Stop,
    from_frame,
    to_frame,
)
from hardware.records import Flag

#: 3 us a pattern, of which this firmware computes 4096 cells for two detectors: tens of times that.
OVERLOAD = SpiSettings(PatternSet(64, 64, 4096, "natural", "plain"), 1e-6)
PATIENT = Patience(reply_s=1.0, attempts=1, reconnect_s=5.0)
#: The firmware's buffer of exposures, and what a busy test machine may add.
BACKLOG_S, BUSY_S = 0.25, 0.5
SHALLOW = ("--backlog", "250")


def test_an_overloaded_camera_answers_stops_and_tells_what_it_left_out(firmware: Any) -> None:
    """Query and Stop are answered as ever; every frame is either sent or counted as dropped, the
    first exposure after a gap says so, and no frame is older than the buffer.
    """
    with (
        firmware.running(*SHALLOW) as path,
        SpiCamera(path, OVERLOAD, patience=PATIENT) as camera,
    ):
        records, ages, waits = [], [], []
        for record in islice(camera.records(), 6):
            begun = time.monotonic()
            status = camera.status()
            waits.append(time.monotonic() - begun)
            here = (record.flags & Flag.LOST) == 0
            ages.append((status.time_ns - record.device_time_ns[here].max()) * 1e-9)
            records.append(record)
        before = camera._device.ask(Stop(), type(status))
        time.sleep(0.05)
        after = camera.status()
        assert camera.statistics.restarts == camera.statistics.reconnects == 0
    assert min(waits) < 0.1
    assert status.dropped > 0.5 * status.frames
    assert max(ages) < BACKLOG_S + BUSY_S
    assert (before.state, after.state, after.frames) == (State.ARMED, State.ARMED, before.frames)
    flags = np.concatenate([record.flags for record in records])
    gaps = np.flatnonzero((flags[:-1] & Flag.LOST > 0) & (flags[1:] & Flag.LOST == 0))
    assert gaps.size
    assert (flags[gaps + 1] & Flag.OVERRUN > 0).all()


def test_a_run_of_so_many_sets_ends_in_time_however_slow_the_camera(firmware: Any) -> None:
    """100 sets of 4096 patterns of 3 us take 1.2 s, of which most is left out, and no longer."""
    with (
        firmware.running(*SHALLOW) as path,
        SpiCamera(path, OVERLOAD, patience=PATIENT) as camera,
    ):
        begun = time.monotonic()
        n = sum(1 for _ in camera.records(sets=100))
        took_s = time.monotonic() - begun
        status = camera.status()
    assert (status.state, status.frames) == (State.ARMED, 100 * 64)
    assert 0 < n <= 100
    assert 1.2 < took_s < 1.2 + BACKLOG_S + 4 * BUSY_S


@pytest.mark.parametrize(("cells", "mode"), [(1, 0), (2, 4)], ids=["1 x 1, plain", "2 x 2, sums"])
def test_measurements_that_do_not_fit_are_dropped_whole(
    checked_firmware: Any, cells: int, mode: int
) -> None:
    """While nobody reads, frames of one exposure fill the queue of 65536 bytes, and answers stand
    in the room that is kept for them; whatever comes next is counted as dropped. Frames that came
    and frames that were dropped are together all that were made (Status), one by one.
    """
    with checked_firmware.running() as path, serial.Serial(path, timeout=2) as line:
        ask = asking(line)
        made = ask(Configure(cells, cells, cells**2, 0, mode, 0, 1, 1e-6, 0.0))
        ask(Arm(made.table_crc))
        ask(Start(5, 0))
        time.sleep(0.5)
        for tag in range(1, 60):
            line.write(encode(to_frame(Query(), tag)))
            time.sleep(0.005)
        frames = Deframer()
        line.write(encode(to_frame(Stop(), 200)))
        heard: list[Any] = []
        while not any(frame.tag == 200 for frame in heard):
            data = line.read(max(1, line.in_waiting))
            assert data, "the device is silent"
            heard += frames.feed(data)
        messages = [from_frame(frame) for frame in heard]
    end = messages[-1]
    numbers = [m.sequence for m in messages if isinstance(m, Measurement)]
    assert end.state == State.ARMED
    assert end.dropped > 0
    assert numbers == sorted(set(numbers))
    # Those that came together with the answer to Start were read with it.
    assert numbers[0] + len(numbers) + end.dropped == end.frames


@pytest.mark.parametrize(
    "spoil",
    [
        lambda payload: payload[:30] + struct.pack("<4d", float("nan"), 0, 0, 0),
        lambda payload: payload[:30] + struct.pack("<4d", 0, 0, float("inf"), 1e-9),
        lambda payload: payload[:30] + struct.pack("<4d", -1e7, 0, 0, 0),
        lambda payload: payload[:30] + struct.pack("<4d", 0, 0, 1e-9, -1e-9),
        lambda payload: payload[:30] + struct.pack("<4d", 1e7, 0, 1e-9, 1e-9),
    ],
    ids=["nan", "inf", "negative frequency", "negative width", "phase and gate at once"],
)
def test_shutters_that_no_device_has_are_refused(
    firmware: Any, spoil: Callable[[bytes], bytes]
) -> None:
    class Spoilt(Configure):
        def pack(self) -> bytes:
            return spoil(super().pack())

    with firmware.running("--fast") as path, serial.Serial(path, timeout=2) as line:
        answer = asking(line)(Spoilt(8, 8, 64, 0, 0, 0, 0, 1e-5, 0.0))
    assert isinstance(answer, Refused)
    assert (answer.code, answer.text[:9]) == (Refusal.UNSUPPORTED, "shutters:")
