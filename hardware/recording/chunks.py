"""Records within a chunk of a log, whole or broken, in memory that a file cannot choose."""

from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import get_chunk_data_stream

from hardware.errors import InputError

#: Of one chunk when unpacked. `Log` closes one at 1 MiB and the message that goes beyond; more is
#: not taken into memory, whatever a file claims.
MOST_CHUNK_BYTES = 1 << 29
#: Of a broken chunk: how much is unpacked at a time, and how far definitions are looked for.
_PIECE_BYTES, _MOST_DEFINITIONS_BYTES = 1 << 14, 1 << 25


class RefusedError(InputError):
    """A chunk that is not read at all, whatever it holds."""


def in_chunk(chunk: Chunk) -> Iterator[Schema | Channel | Message]:
    """Records of a whole chunk; `RefusedError` before one is unpacked that is too large or packed
    in a way that is not known, other errors where it is broken.
    """
    size = max(chunk.uncompressed_size, _told_size(chunk))
    if size > MOST_CHUNK_BYTES:
        raise RefusedError(f"a chunk of {size} bytes, expected at most {MOST_CHUNK_BYTES}")
    if chunk.compression not in ("", "zstd", "lz4"):
        raise RefusedError(f"a chunk compressed by {chunk.compression!r:.20}, expected zstd or lz4")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    yield from _records(stream, length)


def unchecked(body: bytes) -> Iterator[Schema | Channel | Message]:
    """Records of a broken chunk up to where they make no sense, whatever its CRC-32 says."""
    with suppress(Exception):  # of spoilt bytes readers raise whatever there is
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if chunk.compression not in ("", "zstd"):
            return
        data = _unpacked(chunk.data) if chunk.compression else chunk.data
        yield from _records(ReadDataStream(BytesIO(data)), len(data))


def _unpacked(data: bytes) -> bytes:
    """What of a broken zstd frame can be unpacked: all up to the broken block."""
    import zstandard

    unpacked, reader = bytearray(), zstandard.ZstdDecompressor().stream_reader(data)
    with suppress(zstandard.ZstdError):
        while (piece := reader.read(_PIECE_BYTES)) and len(unpacked) < _MOST_DEFINITIONS_BYTES:
            unpacked += piece
    return bytes(unpacked)


def _records(stream: ReadDataStream, length: int) -> Iterator[Schema | Channel | Message]:
    while stream.count < length:
        kind, size = stream.read1(), stream.read8()
        if kind == 0:
            raise InputError("a record of no kind")
        if found := one_record(kind, stream, size):
            yield found


def one_record(kind: int, stream: ReadDataStream, size: int) -> Schema | Channel | Message | None:
    """The record of a kind and size that comes next; None: of no interest, passed over."""
    if kind == Opcode.MESSAGE:
        return Message.read(stream, size)
    if kind == Opcode.CHANNEL:
        return Channel.read(stream)
    if kind == Opcode.SCHEMA:
        return Schema.read(stream)
    stream.read(size)
    return None


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
