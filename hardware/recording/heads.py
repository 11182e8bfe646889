"""The records of an MCAP file, one after another, and the next ones behind damaged bytes.

Every record begins with its kind and length (MCAP, "Records"). Where these are damaged, the length
of a chunk stands in the chunk too; behind anything else the next place is looked for at which
records follow each other as they should.
"""

import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import IO

from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
#: Kind and length of a record.
HEAD_BYTES = 9
#: Records of known kinds that follow each other, from which on it is no chance.
_IN_A_ROW = 3
#: A known kind, and a length below 4 GiB.
_LIKE_A_HEAD = re.compile(rb"[\x01-\x0f][\s\S]{4}\x00{4}")
#: Of a chunk, what stands before its compression: times, size, CRC-32.
_BEFORE_COMPRESSION = 8 + 8 + 8 + 4
_COMPRESSIONS = {b"", b"zstd", b"lz4"}
_KINDS = frozenset(Opcode)
#: Those with messages or what these need, and those whose content has one form.
_KNOWN_ALONE = frozenset(
    {
        *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK),
        *(Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.FOOTER),
    }
)


@dataclass(frozen=True)
class Head:
    """A record: kind, offset and length of its content. ``skipped``: bytes before it that are no
    record; ``fault``: what is wrong with it or with these, empty if nothing.
    """

    kind: int
    at: int
    length: int
    skipped: int = 0
    fault: str = ""


class Heads:
    """Where the records of a file are."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size

    def __iter__(self) -> Iterator[Head]:
        """All of them. The last may be cut off by the file's end: it ends beyond it."""
        at, skipped = len(MAGIC), 0
        while at < self._size:
            head = self._at(at)
            if head is None:
                further = self._next(at + 1)
                if further is None:
                    yield from self._cut_off(at)
                    return
                skipped, at = further - at, further
                continue
            fault = f"{skipped} bytes before offset {at} are no record" if skipped else head.fault
            end = head.at + head.length
            if head.kind == Opcode.FOOTER:
                further = self._next(end + len(MAGIC))
                if further is not None:  # another log, or a copy of a part, in the middle of this
                    skipped, at = skipped + further - end, further
                    continue
            yield replace(head, skipped=skipped, fault=fault)
            if head.kind == Opcode.FOOTER:
                return
            at, skipped = end, 0

    def _cut_off(self, at: int) -> Iterator[Head]:
        """The last record, of which no more is there, from its head on; none where a file system
        left zeros.
        """
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if not re.compile(rb"[^\x00]").search(content, at):
                return
        head = self._stated(at)  # None where not even the length is there: the kind is
        kind = self._read(at, 1)[0] if head is None or self._is_right(head) else 0
        yield Head(kind, at, self._size)

    def _stated(self, at: int) -> Head | None:
        """What the bytes at an offset say, right or wrong; None where they are too few."""
        head = self._read(at, HEAD_BYTES)
        if len(head) < HEAD_BYTES:
            return None
        return Head(head[0], at + HEAD_BYTES, int.from_bytes(head[1:], "little"))

    def _at(self, at: int) -> Head | None:
        """The whole record at an offset, None where there is none."""
        head = self._stated(at)
        if head is None:
            return None
        in_chunk = self._length_of_chunk(head.at)
        if in_chunk is not None and self._is_chunk(head, in_chunk):
            fault = f"kind or length of the chunk at offset {at} are damaged"
            is_right = head.kind == Opcode.CHUNK and in_chunk == head.length
            return Head(Opcode.CHUNK, head.at, in_chunk, fault="" if is_right else fault)
        return head if self._is_whole(head) else None

    def _is_whole(self, head: Head) -> bool:
        """Whether a record may be one, and all of it is there. Of other kinds it is none unless a
        known kind is behind it: it would hide messages in what is taken for its length.
        """
        end = head.at + head.length
        if head.kind == 0 or end > self._size or not self._is_right(head):
            return False
        if head.kind in _KNOWN_ALONE:
            return True
        after = self._stated(end)
        if after is None:
            return end == self._size
        return after.kind in _KINDS or self._length_of_chunk(after.at) == after.length

    def _is_chunk(self, head: Head, length: int) -> bool:
        """Whether a record is a chunk of the length that its content tells."""
        if head.kind != Opcode.CHUNK or length == head.length:
            return length == head.length
        return self._is_followed(head.at + length) or not self._is_followed(head.at + head.length)

    def _is_followed(self, end: int) -> bool:
        """Whether a known record, or the end of the file, is at an offset."""
        after = self._stated(end)
        if after is None:
            return end == self._size
        return after.kind in _KINDS and self._is_whole(after)

    def _is_right(self, head: Head) -> bool:
        """Whether the content of a record may be that of its kind."""
        end = head.at + head.length
        if head.kind == Opcode.FOOTER:
            return end >= self._size - len(MAGIC) or self._read(end, len(MAGIC)) == MAGIC
        if head.kind == Opcode.DATA_END:  # a CRC-32
            return head.length == 4
        if head.kind == Opcode.MESSAGE_INDEX:  # channel, and an array of times and offsets
            content = self._read(head.at, 6)
            length = int.from_bytes(content[2:], "little")
            return len(content) < 6 or (head.length == 6 + length and length % 16 == 0)
        return True

    def _length_of_chunk(self, at: int) -> int | None:
        """Length of a chunk's content as the content tells it; None where it is none or cut off."""
        content = self._read(at, _BEFORE_COMPRESSION + 4 + 4 + 8)
        rest = content[_BEFORE_COMPRESSION:]
        name_length = int.from_bytes(rest[:4], "little")
        if len(rest) < 4 + 8 or name_length > 4 or rest[4 : 4 + name_length] not in _COMPRESSIONS:
            return None
        stated = rest[4 + name_length : 12 + name_length]
        before = _BEFORE_COMPRESSION + 4 + name_length + 8
        length = before + int.from_bytes(stated, "little")
        return length if len(stated) == 8 and at + length <= self._size else None

    def _next(self, begin: int) -> int | None:
        """The first offset from ``begin`` on at which records follow each other."""
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            for found in _overlapping(content, begin, self._size):
                if self.follow_at(found):
                    return found
        return None

    def follow_at(self, at: int) -> bool:
        """Whether some records of known kinds follow each other from an offset on, to the end of
        the file if they are fewer; a chunk whose length it tells twice is enough.
        """
        for number in range(_IN_A_ROW):
            head = self._at(at)
            if head is None or head.kind not in _KINDS:
                return number > 0 and at >= self._size
            if (head.kind == Opcode.CHUNK and not head.fault) or head.kind == Opcode.FOOTER:
                return number > 0 or head.kind == Opcode.CHUNK
            at = head.at + head.length
        return True

    def _read(self, at: int, length: int) -> bytes:
        self._file.seek(min(at, self._size))
        return self._file.read(length)


def _overlapping(content: mmap.mmap, begin: int, end: int) -> Iterator[int]:
    """Offsets of all places that look like a head, one within another too."""
    while found := _LIKE_A_HEAD.search(content, begin, end):
        yield found.start()
        begin = found.start() + 1
