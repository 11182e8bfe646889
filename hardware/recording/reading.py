"""A log read back, whole or cut short, and finished where its writer could not."""

import logging
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from hardware.drivers.clock import ClockModel
from hardware.files import naming, partial_path, remove_leftovers
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

    Raises FileNotFoundError; ValueError for a file that is no MCAP, or with a chunk that is too
    large or packed in a way that is not known.
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
        except _RefusedError as error:
            raise ValueError(f"{path}: {error}") from error
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


class _RefusedError(ValueError):
    """What is not read at all, whatever else the file holds."""


def _within_chunks(records: Iterator[McapRecord]) -> Iterator[McapRecord]:
    """Records, those in a chunk one by one, without holding them all."""
    for found in records:
        if isinstance(found, Chunk):
            yield from _in_chunk(found)
        else:
            yield found


def _in_chunk(chunk: Chunk) -> Iterator[McapRecord]:
    size = max(chunk.uncompressed_size, _told_size(chunk))
    if size > _MOST_CHUNK_BYTES:
        raise _RefusedError(f"a chunk of {size} bytes, expected at most {_MOST_CHUNK_BYTES}")
    if chunk.compression not in ("", "zstd", "lz4"):
        raise _RefusedError(
            f"a chunk compressed by {chunk.compression!r:.20}, expected zstd or lz4"
        )
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    while stream.count < length:
        kind, size = stream.read1(), stream.read8()
        if kind == Opcode.MESSAGE:
            yield Message.read(stream, size)
        elif kind == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif kind == Opcode.SCHEMA:
            yield Schema.read(stream)
        elif kind == 0:
            raise ValueError("a record of no kind")
        else:
            stream.read(size)


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

    Raises as `read_messages`; then too the file stays as it is.
    """
    path, ending = Path(path), Ending()
    target = Path(out) if out else path
    partial = partial_path(target)
    with naming(target):
        remove_leftovers(target)
        try:
            with partial.open("xb") as file:
                kept = _copy(read_messages(path, ending), file)
            if ending.fault is not None or out:
                os.replace(partial, target)
        finally:
            partial.unlink(missing_ok=True)
    return kept, ending.fault


def _copy(messages: Iterator[Logged], file: IO[bytes]) -> int:
    """Write messages as a whole log; how many they were."""
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    n = 0
    writer = Writer(file, 1 << 20, CompressionType.ZSTD)
    writer.start(profile="ros2", library="ugv recover")
    for found in messages:
        n += 1
        schema, message = found.schema, found.message
        if schema.name not in schemas:
            schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
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
    writer.finish()  # type: ignore[no-untyped-call]
    return n
