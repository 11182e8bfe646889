"""Recovery of a truncated or damaged log: what is intact of it is written as a complete log.

Chunks end where they did: up to the first loss the recovered log has the bytes of the original.
"""

import itertools
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Header, Metadata
from mcap.writer import CompressionType, Writer

from hardware.errors import InputError
from hardware.files import is_held, place_beside
from hardware.recording.ending import Ending
from hardware.recording.reading import Beside, LoggedMessage, read_all, with_records

#: Name of the metadata that stand where data were lost between messages.
LOST = "lost"


@dataclass(frozen=True)
class RecoveryResult:
    """Result of `recover`: number of messages, state of the log before, new path of the damaged
    original (None: not moved, or nothing was lost), and records that are copied but cannot be read
    (empty: none).
    """

    kept: int
    ending: Ending
    original: Path | None = None
    unreadable: str = ""


def recover(path: str | Path, out: str | Path | None = None) -> RecoveryResult:
    """Recover a truncated or damaged log: all its intact messages, metadata and attachments, with
    index and footer. Metadata named `LOST` stand where bytes between messages are lost.

    The new file replaces the log (or ``out``) at the end. Where data are lost, the original file is
    kept beside it as NAME-damaged. A log without faults is not changed.

    Raises as `read_messages`, and InputError where no message can be read, or the log is still
    being written; the file is not changed then.
    """
    path, ending, unreadable = Path(path), Ending(), Ending()
    if is_held(path):
        raise InputError(f"{path}: still being written; expected a log whose writer has ended")
    target = Path(out) if out else path
    original = None
    with place_beside(target) as partial:
        with partial.open("xb") as file:
            kept = _copy(read_all(path, ending), ending, unreadable, file)
        if ending.fault is not None and not kept:
            raise InputError(f"{path}: no whole message in it: {ending.fault}")
        if ending.lost and not out:
            original = path_of_damaged(path)
            os.rename(path, original)
        if ending.fault is not None or out:
            os.replace(partial, target)
    told = unreadable.told_unreadable if unreadable.n_unreadable else ""
    return RecoveryResult(kept, ending, original, told)


def path_of_damaged(path: Path) -> Path:
    """A free path beside a damaged log for it as it is: NAME-damaged."""
    names = (f"{path.stem}-damaged{n or ''}{path.suffix}" for n in itertools.count())
    return next(free for name in names if not (free := path.with_name(name)).exists())


def _copy(
    records: Iterable[LoggedMessage | Beside], ending: Ending, unreadable: Ending, file: IO[bytes]
) -> int:
    """Write records as a complete log; returns the number of messages."""
    copy, n = None, 0
    for record, _ in with_records(records, unreadable):
        if copy is None:
            copy = _Copy(file, record if isinstance(record, Header) else _HEADER)
        if isinstance(record, LoggedMessage):
            n += 1
            copy.message(record, ending.lost_bytes)
        elif isinstance(record, Metadata):
            copy.metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            copy.attachment(record)
    if copy is not None:
        copy.finish()
    return n


#: Of a log whose own header is lost.
_HEADER = Header(profile="ros2", library="ugv recover")


class _Copy:
    """A log being written from the records of another."""

    def __init__(self, file: IO[bytes], header: Header) -> None:
        self._writer = Writer(file, 1 << 20, CompressionType.ZSTD)
        self._writer.start(profile=header.profile, library=header.library)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._chunk: int | None = None
        self._lost_bytes = 0

    def message(self, logged: LoggedMessage, lost_bytes: int) -> None:
        """A message, before which so many bytes are lost in all."""
        if lost_bytes > self._lost_bytes:
            self.metadata(LOST, {"bytes": str(lost_bytes - self._lost_bytes)})
            self._lost_bytes = lost_bytes
        if logged.chunk != self._chunk:
            self._close_chunk()
            self._chunk = logged.chunk
        schema, message = logged.schema, logged.message
        if schema.name not in self._schemas:
            self._schemas[schema.name] = self._writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        if logged.topic not in self._channels:
            self._channels[logged.topic] = self._writer.register_channel(
                logged.topic, "cdr", self._schemas[schema.name]
            )
        self._writer.add_message(
            self._channels[logged.topic],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )

    def metadata(self, name: str, words: dict[str, str]) -> None:
        """Metadata behind the messages before them."""
        self._close_chunk()
        self._writer.add_metadata(name, words)

    def attachment(self, one: Attachment) -> None:
        """An attachment behind the messages before it."""
        self._close_chunk()
        self._writer.add_attachment(
            one.create_time, one.log_time, one.name, one.media_type, one.data
        )

    def finish(self) -> None:
        """Index and footer."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _close_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
