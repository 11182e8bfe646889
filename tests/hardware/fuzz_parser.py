"""Coverage-guided fuzzing of the parser: ``python fuzz_parser.py -max_total_time=120 CORPUS``.

Arguments are libFuzzer's; an empty CORPUS begins with `write_seeds`. Needs the package `atheris`.
The checksum would keep a fuzzer out, so the first byte of an input says how the rest becomes bytes
on the line: as they are, after a long run of others, as one payload in a good frame, or as a
series of frames.
"""

import json
import sys
import zlib
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["hardware.drivers"]):
    from hardware.drivers import framing, messages
    from hardware.drivers.assembly import Assembly

import hardware
from hardware import PatternSet
from hardware.drivers.framing import MAX_ENCODED, MAX_PAYLOAD, Deframer, ProtocolFrame
from hardware.drivers.messages import (
    UPLOADED,
    Arm,
    Configure,
    Configured,
    Identify,
    Measurement,
    Query,
    Request,
    Start,
    Stop,
    Time,
    Upload,
    from_frame,
    to_frame,
)
from hardware.drivers.table import table_bytes

_MADE = Configured(
    exposures=32, exposures_per_frame=5, detectors=2, table_bytes=64, table_crc=0,
    integration_time_s=1e-4, pattern_period_s=1.1e-4, electrons_per_count=1.0, offset_counts=0.0,
)  # fmt: skip
_TYPES = sorted(messages._BY_TYPE)


def on_the_line(data: bytes) -> bytes:
    """Bytes on the line of a fuzzer's input."""
    how, rest = data[0] % 4, data[1:]
    if how == 0:
        return rest
    if how == 3:  # longer than any frame
        return b"\x55" * (40 * rest[0]) + rest[1:] if rest else b""
    if how == 1:
        return framing.encode(ProtocolFrame(rest[0], 0, rest[1:][:MAX_PAYLOAD])) if rest else b""
    # A series: a byte for the type, one for the length of the payload, the payload.
    line, at = b"", 0
    while at + 2 <= len(rest):
        kind, size = _TYPES[rest[at] % len(_TYPES)], rest[at + 1]
        line += framing.encode(ProtocolFrame(kind, 0, rest[at + 2 : at + 2 + size]))
        at += 2 + size
    return line


def write_seeds(folder: Path) -> None:
    """Inputs to begin with: every vector of the protocol, and two conversations that measure."""
    vectors = Path(hardware.__file__).parent / "drivers" / "vectors.json"
    lines = [bytes.fromhex(vector["wire"]) for vector in json.loads(vectors.read_text())]
    seeds = [b"\0" + line for line in lines]
    for line in lines:
        (frame,) = Deframer().feed(line)
        seeds.append(b"\1" + bytes([frame.type]) + frame.payload)
    patterns = PatternSet(4, 8, 5, "natural")
    table = table_bytes(patterns)
    for order in (0, UPLOADED):
        requests: list[Request] = [Identify(), Configure(4, 8, 5, order, 0, 0, 3, 1e-4, 0.0)]
        if order == UPLOADED:
            requests += [Upload(0, table[:20]), Upload(0, table[:20]), Upload(20, table[20:])]
        requests += [Arm(zlib.crc32(table)), Time(1), Start(1, 2), Query(), Stop(), Start(2, 0)]
        series = [(_TYPES.index(one.TYPE), one.pack()) for one in requests]
        seeds.append(b"\2" + b"".join(bytes([kind, len(p)]) + p for kind, p in series))
    for number, seed in enumerate(seeds):
        (folder / f"seed-{number}").write_bytes(seed)


def taken(line: bytes, step: int) -> tuple[list[ProtocolFrame], int]:
    """Frames of a line that comes in portions, and what was rejected."""
    deframer, found = Deframer(), []
    for at in range(0, len(line), step):
        found += deframer.feed(line[at : at + step])
        assert len(deframer._rest) <= MAX_ENCODED
    return found, deframer.rejected


def one_input(data: bytes) -> None:
    """No crash; the same frames however they are split; what is understood can be said again."""
    if not data:
        return
    line = on_the_line(data)
    frames, rejected = taken(line, max(len(line), 1))
    assert taken(line, 1 + data[0]) == (frames, rejected)
    assembly, lost, sets = Assembly(9, _MADE, 16, lambda numbers: lost.append(numbers)), [], 0
    for frame in frames:
        assert taken(framing.encode(frame), 7) == ([frame], 0)
        try:
            message = from_frame(frame)
        except ValueError:
            continue
        again = from_frame(to_frame(message))
        assert again.pack() == message.pack()
        if isinstance(message, Measurement):
            for found in assembly.take(message):
                sets += 1
                assert len(found.counts) == _MADE.exposures
                assert 0 <= found.counts.min() <= found.counts.max() < 2**16
    assert sets <= len(frames)
    assert all(0 <= numbers.start < numbers.stop for numbers in lost)


def seeded(arguments: list[str]) -> list[str]:
    """The arguments; a corpus among them that is empty gets its seeds."""
    for folder in map(Path, arguments):
        if folder.is_dir() and not any(folder.iterdir()):
            write_seeds(folder)
    return arguments


if __name__ == "__main__":
    atheris.Setup(seeded(sys.argv), one_input)
    atheris.Fuzz()
