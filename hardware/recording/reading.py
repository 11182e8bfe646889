"""A log read back, whole, cut short or damaged, and finished where its writer could not."""

import itertools
import logging
import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
from mcap.writer import CompressionType, Writer

from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.files import place_beside
from hardware.recording.chunks import (
    MOST_CHUNK_BYTES,
    RefusedError,
    in_chunk,
    one_record,
    unchecked,
)
from hardware.recording.kinds import BY_NAME, KINDS, Record

_log = logging.getLogger(__name__)

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
    """How a log was read.

    Parameters
    ----------
    fault
        Why it is not whole; None: it was finished and every chunk of it is, or nothing was met so
        far.
    lost_bytes
        Of the file, in chunks and messages that are broken or cut off; the rest is read.
    lost_messages
        In those, as far as the index behind each broken chunk tells.
    """

    fault: str | None = None
    lost_bytes: int = 0
    lost_messages: int = 0

    @property
    def lost(self) -> str:
        """What cannot be read, in words; empty: nothing is lost."""
        if not self.lost_bytes:
            return ""
        return f"lost: {self.lost_bytes} bytes, {self.lost_messages or 'unknown'} messages"

    def advice(self, path: str | Path) -> str:
        """Why the log at a path is not whole, and what finishes it."""
        if self.lost:
            return f"damaged: {self.fault}; {self.lost}; `ugv recover {path}` keeps the rest"
        return f"not finished: {self.fault}; `ugv recover {path}` finishes it"


def read_messages(path: str | Path, ending: Ending | None = None) -> Iterator[Logged]:
    """Messages in the order of writing; ``ending`` is filled in.

    A chunk that is broken is passed over, what stands behind it is read; a file that was cut short
    is read to where it ends.

    Raises FileNotFoundError; InputError for a file that is no MCAP, or of which nothing is read
    because a chunk is too large or packed in a way that is not known.
    """
    path, ending = Path(path), ending or Ending()
    with path.open("rb") as file:
        if not _MAGIC.startswith(file.read(len(_MAGIC))):
            raise InputError(f"{path}: no MCAP file")
        walk, n = _Walk(file, path.stat().st_size, ending), 0
        for found in walk.messages():
            n += 1
            yield found
        if walk.refused and not n:
            raise InputError(f"{path}: {walk.refused}")


class _Definitions:
    """Channels and schemas by their numbers."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def take(self, records: Iterable[object]) -> None:
        """Keep those among records."""
        for found in records:
            if isinstance(found, Schema):
                self._schemas[found.id] = found
            elif isinstance(found, Channel):
                self._channels[found.id] = found

    def of(self, message: Message) -> tuple[str, Schema] | None:
        """Topic and schema of a message, None where they are not known."""
        channel = self._channels.get(message.channel_id)
        schema = self._schemas.get(channel.schema_id) if channel else None
        return (channel.topic, schema) if channel and schema else None


class _Walk:
    """Through the records of a file, from one to the next by their lengths."""

    def __init__(self, file: IO[bytes], size: int, ending: Ending) -> None:
        self._file, self._size, self._ending = file, size, ending
        self._known = _Definitions()
        self._searched = False
        self._doubtful = _Definitions()
        self._end = "it ends before its footer"
        self.refused: str | None = None

    def messages(self) -> Iterator[Logged]:
        """Every message that can be read."""
        finished = False
        given: int | None = None  # messages of the broken chunk just passed; None: none is broken
        for kind, at, length in self._heads():
            whole = at + length <= self._size
            if kind == Opcode.FOOTER and whole:
                finished = True
                break
            if not whole:
                self._end = "it ends within a record"
                if kind not in _WITHOUT_MESSAGES:
                    self._ending.lost_bytes += self._size - at
                break
            if kind == Opcode.MESSAGE_INDEX:
                if given is not None:
                    indexed = self._indexed(at, length)
                    self._ending.lost_messages += max(indexed - given, 0)
                    given = max(given - indexed, 0)
                continue
            given = None
            if kind == Opcode.DATA_END and not self._sums_up(at, length):
                self._note("the CRC-32 of the data is another")
            if kind not in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                continue
            here = 0
            try:
                for found in self._in_record(kind, self._body(at, length)):
                    here += 1
                    yield found
            except Exception as error:
                if not _of_the_data(error):
                    raise
                if isinstance(error, RefusedError):
                    self.refused = str(error)
                self._note(_in_words(error))
                self._ending.lost_bytes += length
                given = here
                if kind == Opcode.CHUNK and not isinstance(error, RefusedError):
                    self._doubtful.take(unchecked(self._body(at, length)))
        if not finished:
            before = f"{self._ending.fault}; " if self._ending.fault else ""
            self._ending.fault = before + self._end

    def _note(self, fault: str) -> None:
        """Of several faults the first is told."""
        self._ending.fault = self._ending.fault or fault

    def _heads(self, at: int = len(_MAGIC)) -> Iterator[tuple[int, int, int]]:
        """Kind of each record, where its content begins, and how long it says that is."""
        while at < self._size:
            self._file.seek(at)
            head = self._file.read(9)
            if len(head) < 9:
                self._end = "it ends within a record"
                return
            length = int.from_bytes(head[1:], "little")
            yield head[0], at + 9, length
            at += 9 + length

    def _body(self, at: int, length: int) -> bytes:
        if length > MOST_CHUNK_BYTES:
            raise RefusedError(f"a record of {length} bytes, expected at most {MOST_CHUNK_BYTES}")
        self._file.seek(at)
        return self._file.read(length)

    def _in_record(self, kind: int, body: bytes) -> Iterator[Logged]:
        stream = ReadDataStream(BytesIO(body))
        within = (
            in_chunk(Chunk.read(stream))
            if kind == Opcode.CHUNK
            else (one_record(kind, stream, len(body)),)
        )
        for found in within:
            self._known.take([found])
            if isinstance(found, Message) and (logged := self._logged(found)):
                yield logged

    def _logged(self, found: Message) -> Logged | None:
        """A message with its topic and schema; None, and it is lost, where nothing tells them."""
        if not self._known.of(found) and not self._searched:
            self._searched = True
            self._search()
        told = self._known.of(found) or self._by_content(found) or self._doubtful.of(found)
        if told:
            return Logged(*told, found)
        number = found.channel_id
        self._note(f"a message refers to channel {number}, whose definition is lost or none")
        self._ending.lost_bytes += len(found.data)
        self._ending.lost_messages += 1
        return None

    def _search(self) -> None:
        """Take definitions from the summary: the chunk that held them is broken."""
        for kind, at, length in self._heads():
            if kind in (Opcode.SCHEMA, Opcode.CHANNEL) and at + length <= self._size:
                for _ in self._in_record(kind, self._body(at, length)):
                    pass

    def _by_content(self, found: Message) -> tuple[str, Schema] | None:
        """Topic and schema of a record, which says itself what it is; the topic by the number of
        its channel, unless what is left of a broken chunk names it.
        """
        for kind in KINDS:
            try:
                kind.unpack(found.data)
            except (TypeError, ValueError, OverflowError):
                continue
            topic = f"/channel{found.channel_id}/record"
            text = kind.definition.text.encode()
            told = self._doubtful.of(found)
            schema = Schema(0, text, "ros2msg", kind.definition.name)
            return told[0] if told else topic, schema
        return None

    def _sums_up(self, at: int, length: int) -> bool:
        """Whether everything before this end of the data has the CRC-32 in it; 0 there: none."""
        expected = int.from_bytes(self._body(at, length)[:4], "little")
        if not expected:
            return True
        self._file.seek(0)
        crc, left = 0, at - 9
        while left and (part := self._file.read(min(left, 1 << 20))):
            crc, left = zlib.crc32(part, crc), left - len(part)
        return crc == expected

    def _indexed(self, at: int, length: int) -> int:
        """Messages that an index says are in its chunk."""
        try:
            return len(MessageIndex.read(ReadDataStream(BytesIO(self._body(at, length)))).records)
        except (EndOfFile, struct.error):
            return 0


_WITHOUT_MESSAGES = set(Opcode) - {Opcode.CHUNK, Opcode.MESSAGE}


def _of_the_data(error: Exception) -> bool:
    """Whether an error is of spoilt data (zstandard has classes of its own, lz4 RuntimeError)."""
    known = (McapError, EOFError, OSError, RuntimeError, ValueError, struct.error)
    return isinstance(error, known) or type(error).__module__.split(".")[0] == "zstandard"


def _in_words(error: Exception) -> str:
    if isinstance(error, (EOFError, EndOfFile, struct.error)):
        return "a record ends too early"
    return str(error) or type(error).__name__


def unpacked(path: str | Path, found: Logged) -> Received | None:
    """Record in a message of a log, None for a message of another kind.

    Raises InputError for a broken one, naming the file.
    """
    kind = BY_NAME.get(found.schema.name)
    if kind is None:
        return None
    try:
        record, clock = kind.unpack(found.message.data)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: {found.topic}: {error}") from error
    return Received(found.topic, record, found.message.log_time, clock)


def read_records(path: str | Path, ending: Ending | None = None) -> Iterator[Received]:
    """Records in a log, bit for bit as they went in.

    A log that was not finished, or is damaged, gives what of it is whole. Then ``ending`` says
    so; without it a warning is logged. Raises as `read_messages`, and InputError for a broken
    message.
    """
    tell, ending = ending is None, ending or Ending()
    for found in read_messages(path, ending):
        if received := unpacked(path, found):
            yield received
    if tell and ending.fault:
        _log.warning("%s: %s", path, ending.advice(path))


@dataclass(frozen=True)
class Recovered:
    """What `recover` did: messages kept, how the log was found, and where the damaged original
    was put (None: it stayed where it was, or nothing of it was thrown away).
    """

    kept: int
    ending: Ending
    original: Path | None = None


def recover(path: str | Path, out: str | Path | None = None) -> Recovered:
    """Finish a log that was cut short or damaged: all its whole messages, with index and footer.

    Written beside it and put in its place (or that of ``out``) at the very end. Where anything is
    thrown away, the file as it was stays beside it, as NAME-damaged. A log with which nothing was
    wrong stays as it is.

    Raises as `read_messages`, and InputError where not one message can be read; then too the file
    stays as it is.
    """
    path, ending = Path(path), Ending()
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
    return Recovered(kept, ending, original)


def _beside(path: Path) -> Path:
    """A name for the damaged original that no file has."""
    names = (f"{path.stem}-damaged{n or ''}{path.suffix}" for n in itertools.count())
    return next(free for name in names if not (free := path.with_name(name)).exists())


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
