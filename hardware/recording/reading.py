"""Reading of complete, truncated and damaged logs; `recovery` writes them anew."""

import logging
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import blake2b
from io import BytesIO
from pathlib import Path
from typing import IO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
)

from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.files import is_held
from hardware.recording.chunks import (
    MOST_CHUNK_BYTES,
    RefusedError,
    one_record,
    records_of_broken_chunk,
    records_of_chunk,
)
from hardware.recording.ending import Ending
from hardware.recording.heads import MAGIC, Head, Heads
from hardware.recording.kinds import BY_NAME, KINDS, Record

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoggedMessage:
    """One message of a log; ``chunk``: offset of the chunk that holds it, None if none does."""

    topic: str
    schema: Schema
    message: Message
    chunk: int | None = None


#: What a log holds beside messages and their definitions.
Beside = Header | Metadata | Attachment


@dataclass(frozen=True, eq=False)
class Received:
    """A record with its topic, time of arrival (host clock), and the model of the device clock.

    ``number``: of a log, among the records of its topic, from 1 and with those that cannot be read;
    0 of a sensor.
    """

    topic: str
    record: Record
    host_ns: int
    clock: ClockModel | None
    number: int = 0


def read_messages(path: str | Path, ending: Ending | None = None) -> Iterator[LoggedMessage]:
    """Messages in the order of writing; ``ending`` is filled in.

    A broken chunk is skipped; a truncated file is read to its end.

    Raises FileNotFoundError; InputError for a file that is not MCAP, or of which nothing can be
    read because a chunk is too large or of an unknown compression.
    """
    for record in _read(path, ending, beside=False):
        if isinstance(record, LoggedMessage):
            yield record


def read_all(path: str | Path, ending: Ending | None = None) -> Iterator[LoggedMessage | Beside]:
    """As `read_messages`, and the log's header, metadata and attachments in their places."""
    return _read(path, ending, beside=True)


def _read(
    path: str | Path, ending: Ending | None, *, beside: bool
) -> Iterator[LoggedMessage | Beside]:
    path, ending = Path(path), ending or Ending()
    with path.open("rb") as file:
        size = path.stat().st_size
        if not MAGIC.startswith(file.read(len(MAGIC))):
            if not Heads(file, size).follow_at(len(MAGIC)):
                raise InputError(f"{path}: no MCAP file")
            ending.fault = "its first bytes are damaged"
        ending.being_written = is_held(path)
        reader = _LogReader(file, size, ending, beside=beside)
        yield from reader.records()
        if reader.refused and not reader.n_messages:
            raise InputError(f"{path}: {reader.refused}")


class _Definitions:
    """Channels and schemas by their numbers."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def take(self, records: Iterable[object]) -> None:
        """Add the schemas and channels among records."""
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._channels[record.id] = record

    def of(self, message: Message) -> tuple[str, Schema] | None:
        """Topic and schema of a message, None where unknown."""
        channel = self._channels.get(message.channel_id)
        schema = self._schemas.get(channel.schema_id) if channel else None
        return (channel.topic, schema) if channel and schema else None


class _LogReader:
    """Iterates over the records of a file by their lengths."""

    def __init__(self, file: IO[bytes], size: int, ending: Ending, *, beside: bool) -> None:
        self._file, self._size, self._ending = file, size, ending
        self._kinds = (Opcode.CHUNK, *_DEFINITIONS, *(_BESIDE if beside else ()))
        self._known = _Definitions()
        self._searched = False
        self._from_broken_chunks = _Definitions()
        self._end = "it ends before its footer"
        self._chunks: set[bytes] = set()
        self.refused: str | None = None
        self.n_messages = self._n_counted = self._loose_bytes = 0
        self._in_index = False
        #: Messages of the broken chunk just passed; None: none is broken.
        self._n_of_broken: int | None = None

    def records(self) -> Iterator[LoggedMessage | Beside]:
        """Every message that can be read, and what is asked for beside them."""
        for head in Heads(self._file, self._size):
            if head.fault:
                self._note(head.fault)
                self._ending.lost_bytes += head.skipped
            if self._is_last(head):
                break
            if self._may_hold_messages(head):
                for record in self._in_head(head):
                    self.n_messages += isinstance(record, LoggedMessage)
                    yield record
        if (missing := self._n_counted - self.n_messages - self._ending.lost_messages) > 0:
            self._note(f"{missing} of the {self._n_counted} messages that it counts are missing")
            self._ending.lost_messages += missing
        if not self._ending.finished:
            before = f"{self._ending.fault}; " if self._ending.fault else ""
            self._ending.fault = before + self._end

    def _is_last(self, head: Head) -> bool:
        """Whether nothing comes after it: the footer, or what the file's end cuts off."""
        whole = head.at + head.length <= self._size
        if not whole:
            self._end = "it ends within a record"
            if head.kind not in _WITHOUT_DATA and not self._ending.being_written:
                self._ending.lost_bytes += self._size - head.at
        elif head.kind == Opcode.FOOTER:
            if not self._index_matches(head.at, head.length):
                self._note("its index is damaged")
            self._ending.finished = True
        return not whole or head.kind == Opcode.FOOTER

    def _may_hold_messages(self, head: Head) -> bool:
        """Whether a record may, says what they are, or is asked for beside them; of others what
        they say is noted.
        """
        kind, at, length = head.kind, head.at, head.length
        if kind == Opcode.MESSAGE_INDEX:
            if self._n_of_broken is not None:
                indexed = self._indexed(at, length)
                self._ending.lost_messages += max(indexed - self._n_of_broken, 0)
                self._n_of_broken = max(self._n_of_broken - indexed, 0)
            return False
        self._n_of_broken = None
        if kind == Opcode.DATA_END:
            self._in_index = True
            if not self._crc_matches(at, length):
                self._note("the CRC-32 of the data is another")
                self._ending.lost_bytes += self._loose_bytes  # any of which may be altered
        if kind == Opcode.STATISTICS:
            self._n_counted = int.from_bytes(self._body(at, 8), "little")
        if kind == Opcode.MESSAGE and not self._in_index:
            self._loose_bytes += length
            return True
        return kind in self._kinds

    def _in_head(self, head: Head) -> Iterator[LoggedMessage | Beside]:
        """Messages of a record as far as they can be read; the rest is noted as lost."""
        n = 0
        try:
            body = self._body(head.at, head.length)
            if head.kind == Opcode.CHUNK and self._is_there_already(body):
                return
            for record in self._in_record(head.kind, body):
                n += 1
                if isinstance(record, LoggedMessage) and head.kind == Opcode.CHUNK:
                    yield replace(record, chunk=head.at)
                else:
                    yield record
        except Exception as error:
            if not _is_data_error(error):
                raise
            if isinstance(error, RefusedError):
                self.refused = str(error)
            self._note(_describe(error))
            self._ending.lost_bytes += head.length
            self._n_of_broken = n
            if head.kind == Opcode.CHUNK and not isinstance(error, RefusedError):
                broken = self._body(head.at, head.length)
                self._from_broken_chunks.take(records_of_broken_chunk(broken))

    def _is_there_already(self, chunk: bytes) -> bool:
        """Whether a chunk is a copy of an earlier one, whose messages would come twice."""
        key = blake2b(chunk, digest_size=16).digest()
        if is_copy := key in self._chunks:
            self._note("a chunk is there twice; the second is left out")
        self._chunks.add(key)
        return is_copy

    def _note(self, fault: str) -> None:
        """Store the first of several faults."""
        self._ending.fault = self._ending.fault or fault

    def _body(self, at: int, length: int) -> bytes:
        if length > MOST_CHUNK_BYTES:
            raise RefusedError(f"a record of {length} bytes, expected at most {MOST_CHUNK_BYTES}")
        self._file.seek(at)
        return self._file.read(length)

    def _in_record(self, kind: int, body: bytes) -> Iterator[LoggedMessage | Beside]:
        stream = ReadDataStream(BytesIO(body))
        if kind in _BESIDE:
            if kind == Opcode.ATTACHMENT:
                _check_attachment(body)
            yield _BESIDE[kind].read(stream)
            return
        within = (
            records_of_chunk(Chunk.read(stream))
            if kind == Opcode.CHUNK
            else (one_record(kind, stream, len(body)),)
        )
        for record in within:
            self._known.take([record])
            if isinstance(record, Message) and (logged := self._logged(record)):
                yield logged

    def _logged(self, message: Message) -> LoggedMessage | None:
        """A message with its topic and schema; None, and counted as lost, where unknown."""
        if not self._known.of(message) and not self._searched:
            self._searched = True
            self._search()
        definition = (
            self._known.of(message)
            or self._by_content(message)
            or self._from_broken_chunks.of(message)
        )
        if definition:
            return LoggedMessage(*definition, message)
        number = message.channel_id
        self._note(f"a message refers to channel {number}, whose definition is lost or none")
        self._ending.lost_bytes += len(message.data)
        self._ending.lost_messages += 1
        return None

    def _search(self) -> None:
        """Read definitions from the summary, since the chunk that had them is broken."""
        for head in Heads(self._file, self._size):
            if head.kind in _DEFINITIONS and head.at + head.length <= self._size:
                for _ in self._in_record(head.kind, self._body(head.at, head.length)):
                    pass

    def _by_content(self, message: Message) -> tuple[str, Schema] | None:
        """Topic and schema of a record from its content; the topic is named after the number of its
        channel, unless a broken chunk contains it.
        """
        for kind in KINDS:
            try:
                kind.unpack(message.data)
            except (TypeError, ValueError, OverflowError):
                continue
            topic = f"/channel{message.channel_id}/record"
            text = kind.definition.text.encode()
            definition = self._from_broken_chunks.of(message)
            schema = Schema(0, text, "ros2msg", kind.definition.name)
            return definition[0] if definition else topic, schema
        return None

    def _crc_matches(self, at: int, length: int) -> bool:
        """Whether the data have the CRC-32 of this end-of-data record; 0 stands for none."""
        expected = int.from_bytes(self._body(at, length)[:4], "little")
        if not expected:
            return True
        return self._crc(0, at - 9) == expected

    def _index_matches(self, at: int, length: int) -> bool:
        """Whether the index has the CRC-32 of this footer; 0 stands for none."""
        body = self._body(at, length)
        if len(body) < _FOOTER.size:
            return False
        begin, _, expected = _FOOTER.unpack_from(body)
        return not (begin and expected) or self._crc(begin, at + _FOOTER.size - 4) == expected

    def _crc(self, begin: int, end: int) -> int:
        self._file.seek(min(begin, self._size))
        crc, left = 0, end - begin
        while left > 0 and (part := self._file.read(min(left, 1 << 20))):
            crc, left = zlib.crc32(part, crc), left - len(part)
        return crc

    def _indexed(self, at: int, length: int) -> int:
        """Number of messages in an index of a chunk."""
        try:
            return len(MessageIndex.read(ReadDataStream(BytesIO(self._body(at, length)))).records)
        except (EndOfFile, struct.error):
            return 0


#: Where the index begins, where its second part does, and CRC-32 of both with these two numbers.
_FOOTER = struct.Struct("<QQI")
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_BESIDE: dict[int, type[Beside]] = {
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}
_WITHOUT_DATA = set(Opcode) - {Opcode.CHUNK, Opcode.MESSAGE, Opcode.METADATA, Opcode.ATTACHMENT}


def _check_attachment(body: bytes) -> None:
    """Raise InputError where an attachment has another CRC-32 than it tells; 0 stands for none."""
    told = int.from_bytes(body[-4:], "little")
    if told and told != zlib.crc32(body[:-4]):
        raise InputError("the CRC-32 of an attachment is another")


def _is_data_error(error: Exception) -> bool:
    """Whether an error is due to damaged data (zstandard has its own classes, lz4 RuntimeError)."""
    known = (McapError, EOFError, OSError, OverflowError, RuntimeError, ValueError, struct.error)
    return isinstance(error, known) or type(error).__module__.split(".")[0] == "zstandard"


def _describe(error: Exception) -> str:
    if isinstance(error, (EOFError, EndOfFile, struct.error)):
        return "a record ends too early"
    return str(error) or type(error).__name__


_Logged = TypeVar("_Logged", LoggedMessage, LoggedMessage | Beside)


def with_records(
    messages: Iterable[_Logged], ending: Ending
) -> Iterator[tuple[_Logged, Received | None]]:
    """Messages of a log and the record in each; None for one of another kind, what is beside
    messages, and a record that cannot be read, which ``ending`` counts.
    """
    numbers = Counter[str]()
    for logged in messages:
        if not isinstance(logged, LoggedMessage):
            yield logged, None
            continue
        topic, received = logged.topic, None
        if kind := BY_NAME.get(logged.schema.name):
            numbers[topic] += 1
            try:
                record, clock = kind.unpack(logged.message.data)
            except (TypeError, ValueError, OverflowError) as error:
                ending.leave_out(f"{topic}, record {numbers[topic]}", error)
            else:
                at_ns = logged.message.log_time
                received = Received(topic, record, at_ns, clock, numbers[topic])
        yield logged, received


def read_records(path: str | Path, ending: Ending | None = None) -> Iterator[Received]:
    """Records of a log, bit for bit as written.

    An unfinished or damaged log gives its intact records. Then ``ending`` has the fault; without it
    a warning is logged. Raises as `read_messages`.
    """
    tell, ending = ending is None, ending or Ending()
    for _, received in with_records(read_messages(path, ending), ending):
        if received:
            yield received
    if tell and ending.fault:
        _log.warning("%s: %s", path, ending.advice(path))
