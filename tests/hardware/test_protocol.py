"""The protocol's bytes: two implementations agree on them, and no fault gets through unseen."""

import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hardware
from hardware import PatternSet
from hardware.drivers import framing, messages
from hardware.drivers.assembly import Assembly, ExposureSet
from hardware.drivers.framing import MAX_ENCODED, MAX_PAYLOAD, Deframer, ProtocolFrame
from hardware.drivers.messages import Configured, Measurement, from_frame, to_frame
from hardware.drivers.preparation import _fault
from hardware.drivers.table import table_bytes
from hardware.records import Flag

VECTORS = json.loads(
    (Path(hardware.__file__).parent / "drivers" / "vectors.json").read_text(encoding="utf-8")
)


def plain(message: messages.Message) -> dict[str, object]:
    fields = asdict(message)
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            fields[name] = value.tolist()
        elif isinstance(value, bytes):
            fields[name] = value.hex()
        elif isinstance(value, tuple):
            fields[name] = [list(row) for row in value]
    return fields


@pytest.mark.parametrize("vector", VECTORS, ids=[v["name"] for v in VECTORS])
def test_vectors(vector: dict[str, object]) -> None:
    """The file's frame and fields are one message; the file changes only with the version."""
    wire = bytes.fromhex(str(vector["wire"]))
    (frame,) = Deframer().feed(wire)
    message = from_frame(frame)
    assert (type(message).__name__, frame.tag) == (vector["message"], vector["tag"])
    assert plain(message) == vector["fields"]
    assert framing.encode(to_frame(message, frame.tag)) == wire


def test_vectors_hold_every_message() -> None:
    assert {v["message"] for v in VECTORS} == {kind.__name__ for kind in messages._BY_TYPE.values()}


def test_the_table_of_the_vectors_is_that_of_their_patterns() -> None:
    """16 x 16 cells, 512 exposures: written out by the protocol's own words, bit by bit."""

    def changes(i: int) -> int:
        signs = [(i & j).bit_count() % 2 for j in range(16)]
        return sum(a != b for a, b in pairwise(signs))

    rows = sorted(range(256), key=lambda i: (changes(i // 16) + changes(i % 16), i))
    table = bytearray()
    for row in rows:
        lit = "".join("10"[(row & j).bit_count() % 2] for j in range(256))
        plus = int(lit, 2)
        table += plus.to_bytes(32) + (2**256 - 1 - plus).to_bytes(32)
    told = {v["name"]: v["fields"] for v in VECTORS}
    assert told["configured"]["table_bytes"] == len(table)
    assert told["configured"]["table_crc"] == told["arm"]["table_crc"] == zlib.crc32(table)


def test_second_implementation_agrees_on_the_vectors(firmware) -> None:  # type: ignore[no-untyped-def]
    wires = [v["wire"] for v in VECTORS]
    frames = [Deframer().feed(bytes.fromhex(wire))[0] for wire in wires]
    bodies = [(bytes((f.type, f.tag)) + f.payload).hex() for f in frames]
    assert firmware.translate("encode", bodies) == wires
    assert firmware.translate("decode", wires) == bodies


def test_second_implementation_agrees_on_any_bytes(firmware) -> None:  # type: ignore[no-untyped-def]
    """Sizes around the blocks of 254 bytes, all zeros, no zeros, and the longest frame."""
    rng = np.random.default_rng(0)
    sizes = [0, 1, 246, 247, 248, 249, 250, 251, 252, 253, 254, 255, 500, 506, 1000, MAX_PAYLOAD]
    payloads = [rng.integers(low, high, n, np.uint8).tobytes()
                for n in sizes for low, high in ((0, 1), (0, 2), (0, 256), (1, 256))]  # fmt: skip
    bodies = [(b"\x42\x07" + payload).hex() for payload in payloads]
    wires = [framing.encode(ProtocolFrame(0x42, 7, payload)).hex() for payload in payloads]
    assert firmware.translate("encode", bodies) == wires
    assert firmware.translate("decode", wires) == bodies
    broken = [wire[:-4] + "00" for wire in wires]
    assert set(firmware.translate("decode", broken)) == {""}


def test_checksum_is_the_one_of_the_standard() -> None:
    assert zlib.crc32(b"123456789") == 0xCBF43926


@given(
    kind=st.integers(0, 255),
    tag=st.integers(0, 255),
    payload=st.binary(max_size=MAX_PAYLOAD),
    cut=st.integers(1, 4200),
)
def test_any_frame_comes_back_however_it_is_split(
    kind: int, tag: int, payload: bytes, cut: int
) -> None:
    frame = ProtocolFrame(kind, tag, payload)
    wire = framing.encode(frame)
    assert len(wire) <= MAX_ENCODED + 1
    assert wire.count(0) == 1
    deframer = Deframer()
    stream = b"\0" + wire + b"\0\0" + wire
    found = [f for at in range(0, len(stream), cut) for f in deframer.feed(stream[at : at + cut])]
    assert found == [frame, frame]
    assert deframer.rejected == 0


@given(st.lists(st.binary(max_size=6000), max_size=20))
def test_any_bytes_are_survived_in_bounded_memory(portions: list[bytes]) -> None:
    deframer = Deframer()
    for portion in portions:
        for frame in deframer.feed(portion):
            try:
                from_frame(frame)
            except ValueError:
                continue
        assert len(deframer._rest) <= MAX_ENCODED


@given(kind=st.sampled_from(sorted(messages._BY_TYPE)), payload=st.binary(max_size=400))
def test_any_payload_is_a_message_or_a_value_error(kind: int, payload: bytes) -> None:
    """What is accepted says in its own bytes what it was: nothing is guessed or left out."""
    try:
        message = from_frame(ProtocolFrame(kind, 0, payload))
    except ValueError:
        return
    if isinstance(message, Measurement):
        form = payload[27]
        lean = message.counts.max() <= 0xFFFF and form & Measurement.WIDE
        if lean or (form & Measurement.FLAGGED and not message.flags.any()):
            return  # allowed, though we would send it shorter
    if isinstance(message, (messages.Configured, messages.Status, messages.Identity)):
        return  # reserved bytes are not looked at
    if isinstance(message, messages.Refused) and "\N{REPLACEMENT CHARACTER}" in message.text:
        return  # what cannot be printed
    assert message.pack() == payload


def test_text_of_a_device_is_printable() -> None:
    """A name could forge a line on a terminal; broken UTF-8 would leave a request unanswered."""
    told = messages.Refused(3, "").pack() + b"off\nugv: error: none\x1b[2J\xff"
    assert messages.Refused.unpack(told).text == "off\ufffdugv: error: none\ufffd[2J\ufffd"


def test_times_that_no_device_has_are_refused() -> None:
    """Device times are whole nanoseconds in 64 bits: a set of 1e9 s and more has none."""
    identity = messages.Identity(1, 16, 2, 16, 64, 1, 1, 1, 1e-6, 1.0, "camera")
    assert not _fault(_MADE, identity, _MADE.exposures, 64)
    for name in ("integration_time_s", "pattern_period_s", "electrons_per_count"):
        for value in (0.0, -1.0, 1e300, np.inf, np.nan):
            made = replace(_MADE, **{name: value})
            assert _fault(made, identity, _MADE.exposures, 64).startswith(f"{name} = {value:g}, ")
    for value in (1e300, -1e300, np.nan):
        made = replace(_MADE, offset_counts=value)
        assert _fault(made, identity, _MADE.exposures, 64).startswith(f"offset_counts = {value:g},")
    short = replace(_MADE, pattern_period_s=0.9e-4)
    assert _fault(short, identity, _MADE.exposures, 64).startswith("integration_time_s = 0.0001,")


# A stream of measurements under faults.

_PATTERNS = PatternSet(4, 4, 16)
_MADE = Configured(
    exposures=_PATTERNS.n_exposures, exposures_per_frame=5, detectors=2, table_bytes=64,
    table_crc=0, integration_time_s=1e-4, pattern_period_s=1.1e-4, electrons_per_count=1.0,
    offset_counts=0.0,
)  # fmt: skip
_PER_SET = 7


def sent_frames(n: int, rng: np.random.Generator) -> list[Measurement]:
    frames = []
    for sequence in range(n):
        first = sequence % _PER_SET * 5
        size = min(5, _MADE.exposures - first)
        counts = rng.integers(0, 2**16, (size, 2), np.int32)
        flags = (rng.random(size) < 0.05).astype(np.uint8)
        time_ns = 110_000 * (sequence // _PER_SET * _MADE.exposures + first)
        frames.append(Measurement(9, sequence, time_ns, first, counts, flags))
    return frames


def dropped(stream: bytearray, at: int, rng: np.random.Generator) -> None:
    del stream[at : at + int(rng.integers(1, 80))]


def duplicated(stream: bytearray, at: int, rng: np.random.Generator) -> None:
    stream[at:at] = stream[at : at + int(rng.integers(1, 80))]


def flipped(stream: bytearray, at: int, rng: np.random.Generator) -> None:
    for place in range(at, min(at + int(rng.integers(1, 4)), len(stream))):
        stream[place] ^= 1 << int(rng.integers(8))


def reordered(stream: bytearray, at: int, rng: np.random.Generator) -> None:
    part = stream[at : at + int(rng.integers(2, 80))]
    stream[at : at + len(part)] = bytes(rng.permutation(list(part)).astype(np.uint8))


def frames_reordered(stream: bytearray, at: int, rng: np.random.Generator) -> None:
    """Whole frames change places, or come twice."""
    parts = bytes(stream[at : at + 400]).split(b"\0")
    rng.shuffle(parts[1:-1])
    stream[at : at + 400] = b"\0".join(parts + parts[1:2])


FAULTS: tuple[Callable[[bytearray, int, np.random.Generator], None], ...] = (
    dropped, duplicated, flipped, reordered, frames_reordered,
)  # fmt: skip


def check_stream(n: int, faults: int, seed: int) -> None:
    """What is accepted is what was sent, to the bit; all else is reported by its number."""
    rng = np.random.default_rng(seed)
    sent = sent_frames(n, rng)
    stream = bytearray(b"".join(framing.encode(to_frame(frame)) for frame in sent))
    for _ in range(faults):
        if stream:
            FAULTS[rng.integers(len(FAULTS))](stream, int(rng.integers(len(stream))), rng)

    lost: set[int] = set()
    sets: list[ExposureSet] = []
    accepted = 0
    assembly = Assembly(9, _MADE, 16, lambda numbers: lost.update(numbers))
    deframer, at = Deframer(), 0
    while at < len(stream):
        step = int(rng.integers(1, 300))
        for frame in deframer.feed(bytes(stream[at : at + step])):
            message = from_frame(frame)  # raises where the checksum let something through
            assert isinstance(message, Measurement)
            before = assembly.refused
            sets.extend(assembly.take(message))
            accepted += assembly.refused == before
        at += step
    sets.extend(assembly.finish(n))

    assert max(lost, default=-1) < n
    assert accepted + len(lost) == n
    for found in sets:
        for place, original in enumerate(sent[found.number * _PER_SET :][:_PER_SET]):
            part = slice(original.first, original.first + len(original.counts))
            if found.number * _PER_SET + place in lost:
                assert (found.flags[part] == Flag.LOST).all()
                continue
            np.testing.assert_array_equal(found.counts[part], original.counts)
            np.testing.assert_array_equal(found.flags[part], original.flags)
            assert found.device_time_ns[original.first] == original.time_ns
        n_exposures = _MADE.exposures
        first = found.number * n_exposures
        np.testing.assert_array_equal(found.sequence, np.arange(first, first + n_exposures))
    whole = {number // _PER_SET for number in set(range(n)) - lost}
    assert [found.number for found in sets] == sorted(s for s in whole if (s + 1) * _PER_SET <= n)


@given(seed=st.integers(0, 2**32), faults=st.integers(0, 60), n=st.integers(0, 400))
@settings(max_examples=50, deadline=None)
def test_no_fault_gets_through_and_every_loss_is_named(seed: int, faults: int, n: int) -> None:
    """About 10 000 frames. The checksum misses one broken frame in 4e9."""
    check_stream(n, faults, seed)


@pytest.mark.slow
def test_no_fault_gets_through_in_a_million_frames() -> None:
    for seed in range(500):
        check_stream(2000, 300, seed)


def test_frames_of_other_runs_and_impossible_ones_are_left_out() -> None:
    rng = np.random.default_rng(0)
    good = sent_frames(1, rng)[0]
    fields = {**good.__dict__}
    for change in (
        {"run": 8},
        {"first": 5},
        {"counts": good.counts[:3], "flags": good.flags[:3]},
        {"counts": good.counts[:, :1]},
        {"counts": np.full_like(good.counts, 1 << 16)},
        {"counts": np.full_like(good.counts, -1)},
    ):
        assembly = Assembly(9, _MADE, 16)
        assert not list(assembly.take(Measurement(**{**fields, **change})))
        assert (assembly.refused, assembly.next_sequence) == (1, 0)


@pytest.mark.parametrize(
    ("later", "field", "ahead", "fault"),
    [
        (1, "sequence", 7 * 10**17, "after the one before, which by its number takes"),
        (1, "sequence", 7 * 1200, "after the one before, which by its number takes"),
        (0, "sequence", 7 * 10**17, "into its run by its number"),
        (1, "time_ns", -(10**10), "begins -9"),
        (1, "time_ns", 2**61, "begins 2.3"),
        (0, "time_ns", 2**62 + 1, "expected at most 4.6"),
        (0, "time_ns", -(2**63), "expected at most 4.6"),
    ],
)
def test_a_frame_that_its_time_or_number_contradicts_is_refused(
    later: int, field: str, ahead: int, fault: str
) -> None:
    """One such frame would have all further ones taken for late, or its set's times for others."""
    lost: list[range] = []
    assembly = Assembly(9, _MADE, 16, lost.append)
    *frames, third = sent_frames(3, np.random.default_rng(0))
    wrong = getattr(frames[later], field) + ahead
    frames[later] = replace(frames[later], **{field: wrong})  # type: ignore[arg-type]
    for frame in frames[: later + 1]:
        assert not list(assembly.take(frame))
    assert (assembly.refused, lost) == (1, [])
    assert fault in assembly.fault
    assert not list(assembly.take(third))
    assert assembly.next_sequence == 3
    assert lost == [range(later, 2)]


@pytest.mark.parametrize("ahead_s", [1, 60, 80_000])
def test_a_false_time_ahead_costs_its_frame_and_the_next(ahead_s: int) -> None:
    """It is believed until two frames after it agree with each other and not with it."""
    lost: list[range] = []
    assembly, frames = (
        Assembly(9, _MADE, 16, lost.append),
        sent_frames(2 * _PER_SET, np.random.default_rng(1)),
    )
    false = replace(frames[2], time_ns=frames[2].time_ns + ahead_s * 10**9)
    sent = [*frames[:2], false, *frames[3:]]
    first, second = (one for frame in sent for one in assembly.take(frame))
    assert (assembly.refused, lost) == (1, [range(3, 4)])
    missing = np.flatnonzero(first.flags & Flag.LOST)
    assert missing.tolist() == list(range(10, 20))
    since_ns = np.diff(np.concatenate([first.device_time_ns, second.device_time_ns]))
    assert (since_ns == 110_000).all()


@pytest.mark.parametrize("mode", messages.MODE_CODES)
def test_table_is_the_masks_bit_by_bit(mode: str) -> None:
    patterns = PatternSet(2, 2, 4, "natural", mode)  # type: ignore[arg-type]
    masks = patterns.masks().reshape(-1, 4)
    assert table_bytes(patterns) == bytes(int("".join(map(str, row)) + "0000", 2) for row in masks)
