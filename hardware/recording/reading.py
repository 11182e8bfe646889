"""A log read back, whole or cut short, and finished where its writer could not."""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from hardware.drivers.clock import ClockModel
from hardware.recording.kinds import BY_NAME, Record

_MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Logged:
    """One message as it stands in a log."""

    topic: str
    schema: Schema
    message: Message


@dataclass(frozen=True, eq=False)
class Received:
    """A record with the topic it came under, when it came (host clock), and the device's clock."""

    topic: str
    record: Record
    host_ns: int
    clock: ClockModel | None


@dataclass
class Ending:
    """How a log ends: ``fault`` says why it could not be read on; None: it was finished."""

    fault: str | None = "it ends before its footer"


def read_messages(path: str | Path, ending: Ending | None = None) -> Iterator[Logged]:
    """Messages in the order of writing, as far as the file is whole; ``ending`` is filled in.

    Raises FileNotFoundError; ValueError for a file that is no MCAP.
    """
    path, ending = Path(path), ending or Ending()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with path.open("rb") as file:
        if not _MAGIC.startswith(file.read(len(_MAGIC))):
            raise ValueError(f"{path}: no MCAP file")
        file.seek(0)
        reader = StreamReader(file, validate_crcs=True, record_size_limit=path.stat().st_size)
        try:
            for found in reader.records:
                if isinstance(found, Schema):
                    schemas[found.id] = found
                elif isinstance(found, Channel):
                    channels[found.id] = found
                elif isinstance(found, Message):
                    channel = channels[found.channel_id]
                    yield Logged(channel.topic, schemas[channel.schema_id], found)
                elif isinstance(found, Footer):
                    ending.fault = None
        except (McapError, EOFError, KeyError, struct.error, ValueError, OSError) as error:
            ending.fault = str(error) or type(error).__name__
        except Exception as error:
            if type(error).__module__.split(".")[0] not in ("zstandard", "lz4"):
                raise
            ending.fault = str(error)


def read_records(path: str | Path) -> Iterator[Received]:
    """Records in a log, bit for bit as they went in. Raises ValueError for a broken message."""
    for found in read_messages(path):
        if kind := BY_NAME.get(found.schema.name):
            record, clock = kind.unpack(found.message.data)
            yield Received(found.topic, record, found.message.log_time, clock)


def recover(path: str | Path, out: str | Path | None = None) -> tuple[int, str | None]:
    """Finish a log that was cut short: all its whole messages, with index and footer.

    Written beside it and put in its place (or that of ``out``) at the very end.

    Returns
    -------
    Messages kept, and what was wrong (None: nothing was, and the file stays as it is).
    """
    path, ending = Path(path), Ending()
    target = Path(out) if out else path
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    kept = 0
    try:
        with partial.open("xb") as file:
            writer = Writer(file, 1 << 20, CompressionType.ZSTD)
            writer.start(profile="ros2", library="ugv recover")
            for found in read_messages(path, ending):
                schema, message = found.schema, found.message
                if schema.name not in schemas:
                    schemas[schema.name] = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                if found.topic not in channels:
                    channels[found.topic] = writer.register_channel(
                        found.topic, "cdr", schemas[schema.name]
                    )
                writer.add_message(
                    channels[found.topic],
                    message.log_time,
                    message.data,
                    message.publish_time,
                    message.sequence,
                )
                kept += 1
            writer.finish()  # type: ignore[no-untyped-call]
        if ending.fault is not None or out:
            os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)
    return kept, ending.fault
