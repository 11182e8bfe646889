"""The camera's driver where a device or its line says what cannot be."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from line_bridge import bridged

from hardware import PatternSet
from hardware.drivers import DeviceError, Patience, SpiCamera, SpiSettings
from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import Identity, Measurement, Message, from_frame, to_frame

QUICK = Patience(reply_s=0.4, attempts=3, reconnect_s=5.0, between_attempts_s=0.05)
SETTINGS = SpiSettings(PatternSet(8, 8, 64), 10e-6)


def changed(change: Callable[[Message], Message | None]) -> Callable[[bytes], bytes]:
    """Of a line: each message as it is changed; None: left out."""
    deframer = Deframer()

    def spoil(data: bytes) -> bytes:
        told = b""
        for frame in deframer.feed(data):
            if (message := change(from_frame(frame))) is not None:
                told += encode(to_frame(message, frame.tag))
        return told

    return spoil


def measured(change: Callable[[Measurement], Message]) -> Callable[[bytes], bytes]:
    """Of a line: each measurement as it is changed."""
    return changed(lambda one: change(one) if isinstance(one, Measurement) else one)


def test_a_line_on_which_no_measurement_comes_ends_with_an_error(
    firmware: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """The device measures, and answers that it does: it is started anew, and then given up."""
    with firmware.running() as path, bridged(path) as bridge:
        bridge.spoil = changed(lambda one: None if isinstance(one, Measurement) else one)
        patience = replace(QUICK, reconnect_s=0.5, attempts=2)
        with (
            SpiCamera(bridge.url, SETTINGS, patience=patience) as camera,
            pytest.raises(DeviceError, match="though it was started anew 2 times"),
        ):
            next(camera.records())
    assert "and none has come whole for" in caplog.text


def test_a_device_whose_every_frame_is_refused_ends_with_an_error(
    firmware: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """As one of which no frame comes: a host that waits on would never end."""

    def cut(one: Measurement) -> Message:
        return replace(one, counts=one.counts[:-1], flags=one.flags[:-1])

    settings = replace(SETTINGS, pattern_period_s=20e-6)
    patience = replace(QUICK, reconnect_s=0.5, attempts=2)
    with firmware.running() as path, bridged(path) as bridge:
        bridge.spoil = measured(cut)
        with (
            SpiCamera(bridge.url, settings, patience=patience) as camera,
            pytest.raises(DeviceError, match=r"anew 2 times; frame .* exposures and detectors"),
        ):
            next(camera.records())
    assert "every frame was refused for" in caplog.text


def test_a_frame_that_is_refused_is_told_with_the_reason(
    firmware: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Once a run: counts that the converter cannot give."""

    def too_bright(one: Measurement) -> Message:
        return replace(one, counts=one.counts + 2**16 * (one.sequence % 2))

    with firmware.running("--fast") as path, bridged(path) as bridge:
        bridge.spoil = measured(too_bright)
        with SpiCamera(bridge.url, SETTINGS, patience=QUICK) as camera:
            records = list(camera.records(sets=4))
            assert camera.statistics.refused > 1
    assert all((record.counts < 2**16).all() for record in records)
    (told,) = (one for one in caplog.messages if "refused" in one)
    assert "expected 0 to 65535" in told


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("off_s", "told"),
    [
        (-1000.0, "s after it was started, which by its number takes"),
        (2.0, "to which that has not come when the frame arrives"),
        (3600.0, "to which that has not come when the frame arrives"),
    ],
)
def test_frames_whose_times_are_not_those_of_the_clock_are_refused(
    firmware: Any, off_s: float, told: str
) -> None:
    """A device that stamps its frames by another clock than the one that it tells: of 128
    exposures of 20 us there are two frames in 2.6 ms.
    """

    def shifted(one: Measurement) -> Message:
        return replace(one, time_ns=one.time_ns + round(off_s * 1e9))

    settings = replace(SETTINGS, pattern_period_s=20e-6)
    patience = replace(QUICK, reconnect_s=0.5, attempts=2)
    with firmware.running() as path, bridged(path) as bridge:
        bridge.spoil = measured(shifted)
        with (
            SpiCamera(bridge.url, settings, patience=patience) as camera,
            pytest.raises(DeviceError, match=told),
        ):
            next(camera.records())


def test_a_table_beyond_what_the_device_holds_is_not_sent(firmware: Any) -> None:
    """128 exposures of 8 bytes, where the device says that it holds 100 bytes."""

    def small(one: Message) -> Message:
        return replace(one, max_table_bytes=100) if isinstance(one, Identity) else one

    with firmware.running("--fast") as path, bridged(path) as bridge:
        bridge.spoil = changed(small)
        settings = replace(SETTINGS, upload=True)
        with (
            SpiCamera(bridge.url, settings, patience=QUICK) as camera,
            pytest.raises(DeviceError, match="a table of 1024 bytes; the device holds at most 100"),
        ):
            camera.acquire()
        with SpiCamera(bridge.url, SETTINGS, patience=QUICK) as camera:
            camera.acquire()


def test_another_device_after_a_reset_is_recorded_as_what_it_is(
    firmware: Any, caplog: pytest.LogCaptureFixture
) -> None:
    identities = []

    def renamed(one: Message) -> Message:
        if isinstance(one, Identity):
            identities.append(one)
            return replace(one, device=f"camera {len(identities)}")
        return one

    with firmware.running("--fast", "--reset-after", "33") as path, bridged(path) as bridge:
        bridge.spoil = changed(renamed)
        with SpiCamera(bridge.url, SETTINGS, patience=QUICK) as camera:
            records = list(camera.records(sets=40))
    assert [record.device for record in records] == ["camera 1"] * 17 + ["camera 2"] * 24
    assert "is another device now, 'camera 2' of 16 bits" in caplog.text
