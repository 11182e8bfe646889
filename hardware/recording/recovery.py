"""Recovery of a truncated or damaged log: its intact messages are written as a complete log."""

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.writer import CompressionType, Writer

from hardware.errors import InputError
from hardware.files import is_held, place_beside
from hardware.recording.reading import Ending, LoggedMessage, read_messages


@dataclass(frozen=True)
class RecoveryResult:
    """Result of `recover`: number of messages, state of the log before, and new path of the damaged
    original (None: not moved, or nothing was lost).
    """

    kept: int
    ending: Ending
    original: Path | None = None


def recover(path: str | Path, out: str | Path | None = None) -> RecoveryResult:
    """Recover a truncated or damaged log: all its intact messages, with index and footer.

    The new file replaces the log (or ``out``) at the end. Where data are lost, the original file is
    kept beside it as NAME-damaged. A log without faults is not changed.

    Raises as `read_messages`, and InputError where no message can be read, or the log is still
    being written; the file is not changed then.
    """
    path, ending = Path(path), Ending()
    if is_held(path):
        raise InputError(f"{path}: still being written; expected a log whose writer has ended")
    target = Path(out) if out else path
    original = None
    with place_beside(target) as partial:
        with partial.open("xb") as file:
            kept = _copy(read_messages(path, ending), file)
        if ending.fault is not None and not kept:
            raise InputError(f"{path}: no whole message in it: {ending.fault}")
        if ending.lost and not out:
            original = _beside(path)
            os.rename(path, original)
        if ending.fault is not None or out:
            os.replace(partial, target)
    return RecoveryResult(kept, ending, original)


def _beside(path: Path) -> Path:
    """A free path for the damaged original."""
    names = (f"{path.stem}-damaged{n or ''}{path.suffix}" for n in itertools.count())
    return next(free for name in names if not (free := path.with_name(name)).exists())


def _copy(messages: Iterator[LoggedMessage], file: IO[bytes]) -> int:
    """Write messages as a complete log; returns their number."""
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    n = 0
    writer = Writer(file, 1 << 20, CompressionType.ZSTD)
    writer.start(profile="ros2", library="ugv recover")
    for logged in messages:
        n += 1
        schema, message = logged.schema, logged.message
        if schema.name not in schemas:
            schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if logged.topic not in channels:
            channels[logged.topic] = writer.register_channel(
                logged.topic, "cdr", schemas[schema.name]
            )
        writer.add_message(
            channels[logged.topic],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
    writer.finish()  # type: ignore[no-untyped-call]
    return n
