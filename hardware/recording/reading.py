"""A log read back, whole or cut short, and finished where its writer could not."""

import logging
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from hardware.drivers.clock import ClockModel
from hardware.recording.kinds import BY_NAME, Record

_log = logging.getLogger(__name__)

_MAGIC = b"\x89MCAP0\r\n"
#: Of one chunk when unpacked. `Log` closes one at 1 MiB and the message that goes beyond; more is
#: not taken into memory, whatever a file claims.
_MOST_CHUNK_BYTES = 1 << 29


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

    def advice(self, path: str | Path) -> str:
        """Why the log at a path is not finished, and what finishes it."""
        return f"not finished: {self.fault}; `ugv recover {path}` finishes it"


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
        reader = StreamReader(
            file, emit_chunks=True, validate_crcs=True, record_size_limit=path.stat().st_size
        )
        try:
            for found in _within_chunks(reader.records):
                if isinstance(found, Schema):
                    schemas[found.id] = found
                elif isinstance(found, Channel):
                    channels[found.id] = found
                elif isinstance(found, Message):
                    channel = channels[found.channel_id]
                    yield Logged(channel.topic, schemas[channel.schema_id], found)
                elif isinstance(found, Footer):
                    ending.fault = None
        except (EndOfFile, EOFError, struct.error):
            ending.fault = "it ends within a record"
        except KeyError as error:
            ending.fault = f"a message refers to channel or schema {error}, which is not there"
        except (McapError, ValueError, OSError) as error:
            ending.fault = str(error) or type(error).__name__
        except Exception as error:
            if type(error).__module__.split(".")[0] not in ("zstandard", "lz4"):
                raise
            ending.fault = str(error)


def _within_chunks(records: Iterator[McapRecord]) -> Iterator[McapRecord]:
    """Records, those in a chunk one by one. Raises ValueError for a chunk that is too large."""
    for found in records:
        if isinstance(found, Chunk):
            size = max(found.uncompressed_size, _told_size(found))
            if size > _MOST_CHUNK_BYTES:
                raise ValueError(f"a chunk of {size} bytes, expected at most {_MOST_CHUNK_BYTES}")
            yield from breakup_chunk(found, validate_crc=True)
        else:
            yield found


def _told_size(chunk: Chunk) -> int:
    """Bytes that the compressed data themselves say they unpack to; 0 where they do not."""
    if chunk.compression == "zstd":
        import zstandard

        size = int(zstandard.frame_content_size(chunk.data))
        return max(size, 0)
    if chunk.compression == "lz4":
        import lz4.frame

        return int(lz4.frame.get_frame_info(chunk.data)["content_size"])
    return 0


def unpacked(path: str | Path, found: Logged) -> Received | None:
    """Record in a message of a log, None for a message of another kind.

    Raises ValueError for a broken one, naming the file.
    """
    kind = BY_NAME.get(found.schema.name)
    if kind is None:
        return None
    try:
        record, clock = kind.unpack(found.message.data)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {found.topic}: {error}") from error
    return Received(found.topic, record, found.message.log_time, clock)


def read_records(path: str | Path, ending: Ending | None = None) -> Iterator[Received]:
    """Records in a log, bit for bit as they went in.

    A log that was not finished gives what of it is whole. Then ``ending`` says so; without it a
    warning is logged. Raises as `read_messages`, and ValueError for a broken message.
    """
    tell, ending = ending is None, ending or Ending()
    for found in read_messages(path, ending):
        if received := unpacked(path, found):
            yield received
    if tell and ending.fault:
        _log.warning("%s: %s", path, ending.advice(path))


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
