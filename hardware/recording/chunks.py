"""Records within an intact or broken chunk of a log, in bounded memory."""

from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import get_chunk_data_stream

from hardware.errors import InputError

#: Largest size of one unpacked chunk. `Log` closes chunks at 1 MiB plus one message.
MOST_CHUNK_BYTES = 1 << 29
#: Of a broken chunk: bytes unpacked at a time, and in all.
_PIECE_BYTES, _MOST_DEFINITIONS_BYTES = 1 << 14, 1 << 25


class RefusedError(InputError):
    """A chunk that is not read at all."""


def records_of_chunk(chunk: Chunk) -> Iterator[Schema | Channel | Message]:
    """Records of an intact chunk; `RefusedError` for one that is too large or of an unknown
    compression, other errors for a broken one.
    """
    size = max(chunk.uncompressed_size, _stated_size(chunk))
    if size > MOST_CHUNK_BYTES:
        raise RefusedError(f"a chunk of {size} bytes, expected at most {MOST_CHUNK_BYTES}")
    if chunk.compression not in ("", "zstd", "lz4"):
        raise RefusedError(f"a chunk compressed by {chunk.compression!r:.20}, expected zstd or lz4")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    yield from _records(stream, length)


def records_of_broken_chunk(body: bytes) -> Iterator[Schema | Channel | Message]:
    """Records of a broken chunk up to the first invalid one, without a check of its CRC-32."""
    with suppress(Exception):  # readers may raise any error for damaged bytes
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if chunk.compression not in ("", "zstd"):
            return
        data = _unpacked(chunk.data) if chunk.compression else chunk.data
        yield from _records(ReadDataStream(BytesIO(data)), len(data))


def _unpacked(data: bytes) -> bytes:
    """Content of a broken zstd frame up to the broken block."""
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
        if record := one_record(kind, stream, size):
            yield record


def one_record(kind: int, stream: ReadDataStream, size: int) -> Schema | Channel | Message | None:
    """The next record, of a kind and size; None for other kinds, which are skipped."""
    if kind == Opcode.MESSAGE:
        return Message.read(stream, size)
    if kind == Opcode.CHANNEL:
        return Channel.read(stream)
    if kind == Opcode.SCHEMA:
        return Schema.read(stream)
    stream.read(size)
    return None


def _stated_size(chunk: Chunk) -> int:
    """Unpacked size according to the compressed data; 0 where they do not contain it."""
    if chunk.compression == "zstd":
        import zstandard

        size = int(zstandard.frame_content_size(chunk.data))
        return max(size, 0)
    if chunk.compression == "lz4":
        import lz4.frame

        return int(lz4.frame.get_frame_info(chunk.data)["content_size"])
    return 0
