"""A host without a driver: one request, one answer."""

import itertools
from collections.abc import Callable
from typing import Any

import serial

from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import from_frame, to_frame


def asking(line: serial.Serial) -> Callable[[Any], Any]:
    """Sends a request on a line, gives the answer."""
    frames, tags = Deframer(), itertools.cycle(range(1, 256))

    def ask(message: Any) -> Any:
        tag = next(tags)
        line.write(encode(to_frame(message, tag)))
        while True:
            data = line.read(max(1, line.in_waiting))
            assert data, "no answer"
            for frame in frames.feed(data):
                if frame.tag == tag:
                    return from_frame(frame)

    return ask
