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


def test_a_frame_that_is_refused_is_told_with_the_reason(
    firmware: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Once a run: counts that the converter cannot give."""

    def too_bright(one: Message) -> Message:
        if isinstance(one, Measurement) and one.sequence % 2:
            return replace(one, counts=one.counts + 2**16)
        return one

    with firmware.running("--fast") as path, bridged(path) as bridge:
        bridge.spoil = changed(too_bright)
        with SpiCamera(bridge.url, SETTINGS, patience=QUICK) as camera:
            records = list(camera.records(sets=4))
            assert camera.statistics.refused > 1
    assert all((record.counts < 2**16).all() for record in records)
    (told,) = (one for one in caplog.messages if "refused" in one)
    assert "expected 0 to 65535" in told


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
