"""A log cut short, damaged, killed or removed: what was flushed before is read and recovered."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from log_records import assert_same, camera_record, check_by_rosbags, written
from mcap.reader import SeekingReader
from mcap.writer import Writer

from hardware import PatternSet
from hardware.errors import InputError
from hardware.recording import Log, read_messages, read_records, recover
from hardware.recording.ending import Ending
from hardware.recording.reading import read_all
from hardware.recording.recovery import LOST


def test_every_cut_leaves_what_was_flushed_before_it(tmp_path: Path) -> None:
    """At any byte: the messages of whole chunks, then a file that others open."""
    path = tmp_path / "run.mcap"
    ends = []
    with Log(path, flush_s=1e9) as log:
        for seed in range(6):
            log.record("/spi/record", camera_record(seed), host_ns=seed)
            log.flush()
            ends.append(path.stat().st_size)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for size in {8, 9, 30, *ends, *(end - 1 for end in ends), *rng.integers(8, len(data), 30)}:
        cut = tmp_path / f"cut-{size}.mcap"
        cut.write_bytes(data[:size])
        n = sum(end <= size for end in ends)
        found = list(read_records(cut))
        assert n <= len(found) <= n + 1  # the chunk's index comes after its messages
        for seed, received in enumerate(found):
            assert_same(received.record, camera_record(seed))
        if not found:
            with pytest.raises(ValueError, match="no whole message"):
                recover(cut)
            assert cut.read_bytes() == data[:size]
            continue
        done = recover(cut)
        kept = done.kept
        assert (kept, done.ending.fault is None) == (2 * len(found), False)
        if done.original:  # within a chunk: its bytes are not thrown away
            assert done.original.read_bytes() == data[:size]
        assert (done.original is None) == (done.ending.lost_bytes == 0)
        with cut.open("rb") as file:
            assert SeekingReader(file).get_summary().statistics.message_count == kept  # type: ignore[union-attr]
        assert (recover(cut).kept, recover(cut).ending.fault) == (kept, None)


def of_chunks(path: Path, n: int = 4, patterns: PatternSet | None = None) -> list[tuple[int, int]]:
    """A log with one camera record in each of so many chunks; where each chunk's data begin, end.

    Found from the layout in the MCAP specification: opcode 6, length u64, then the content.
    """
    with Log(path, flush_s=1e9) as log:
        for seed in range(n):
            log.record("/spi/record", camera_record(seed, patterns), host_ns=seed)
            log.flush()
    data, at, chunks = path.read_bytes(), 8, []
    while at < len(data) - 8:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == 6:
            chunks.append((at + 9, at + 9 + length))
        at += 9 + length
    assert len(chunks) == n
    return chunks


def test_a_cut_within_the_head_of_a_record_loses_what_is_there_of_it(tmp_path: Path) -> None:
    """Of a chunk all bytes from its head on, of an index of messages nothing. Of the first 8 bytes
    of either "lost: -7 bytes" had been told, of 9 of a chunk none.
    """
    path = tmp_path / "log.mcap"
    chunks = of_chunks(path)
    whole = path.read_bytes()
    begin, end = chunks[-1]
    for at, is_lost in ((begin - 9, True), (end, False)):
        for n_bytes in range(1, 20):
            path.write_bytes(whole[: at + n_bytes])
            ending = Ending()
            list(read_messages(path, ending))
            assert ending.lost_bytes == (n_bytes if is_lost else 0)
            assert ending.fault == "it ends within a record"


def with_words(path: Path) -> list[int]:
    """A log with metadata before and between two chunks, an attachment behind the second, and a
    third chunk; where each record ends.
    """
    with Log(path, flush_s=1e9, about={"digest": "1"}) as log:
        ends = []
        for seed in range(3):
            log.record("/spi/record", camera_record(seed), host_ns=seed)
            log.flush()
            ends.append(path.stat().st_size)
            if seed == 0:
                log._writer.add_metadata("later", {"a": "b"})
            if seed == 1:
                log._writer.add_attachment(0, 1, "a.txt", "text/plain", b"words")
            log.flush()
            ends.append(path.stat().st_size)
    return ends


def beside(path: Path) -> list[object]:
    """Header, metadata and attachments."""
    return [one for one in read_all(path) if not hasattr(one, "topic")]


def test_metadata_and_attachments_are_recovered(tmp_path: Path) -> None:
    """Up to the cut: as the log begins, byte for byte, with an index of them."""
    path = tmp_path / "log.mcap"
    ends = with_words(path)
    data, whole = path.read_bytes(), beside(path)
    assert [type(one).__name__ for one in whole] == ["Header", *["Metadata"] * 2, "Attachment"]
    for end in ends[2:]:
        path.write_bytes(data[: end + 20])  # and the head of the next
        recover(path)
        assert path.read_bytes()[:end] == data[:end]
        assert beside(path) == whole[: 4 if end >= ends[3] else 3]
        with path.open("rb") as file:
            summary = SeekingReader(file).get_summary()
        assert summary.statistics.metadata_count == 2  # type: ignore[union-attr]


def test_where_data_were_lost_stands_in_a_recovered_log(tmp_path: Path) -> None:
    """And a damaged attachment is told, not copied."""
    path = tmp_path / "log.mcap"
    ends = with_words(path)
    whole = bytearray(path.read_bytes())
    data = bytearray(whole)
    data[ends[3] - 6] ^= 1  # of the attachment's words, before its CRC-32
    path.write_bytes(data)
    done = recover(path)
    assert done.ending.fault == "the CRC-32 of an attachment is another"
    assert done.original
    names = [getattr(one, "name", None) for one in beside(path)]
    assert names == [None, "about", "later", LOST]
    data = bytearray(whole)
    data[ends[2] - 200] ^= 1  # of the second chunk, or its index
    path.write_bytes(data)
    lost = recover(path).ending.lost_bytes
    kinds = [getattr(one, "topic", None) or getattr(one, "name", "") for one in read_all(path)]
    assert kinds[-4:] == ["a.txt", LOST, "/spi/record", "/tf"]
    [there] = [one for one in beside(path) if getattr(one, "name", "") == LOST]
    assert there.metadata == {"bytes": str(lost)}  # type: ignore[attr-defined]
    assert recover(path).ending.fault is None


@pytest.mark.parametrize("broken", [0, 1, 3])
def test_a_broken_chunk_takes_none_of_the_others_with_it(tmp_path: Path, broken: int) -> None:
    """One bit of a chunk of four: the three others are read and recovered bit for bit, also where
    the first, in which the topics are defined, is the broken one; what is lost is told; the file
    as it was stays beside the recovered one.
    """
    path = tmp_path / "run.mcap"
    begin, end = of_chunks(path)[broken]
    data = bytearray(path.read_bytes())
    data[(begin + end) // 2] ^= 1
    path.write_bytes(data)
    rest = [seed for seed in range(4) if seed != broken]
    found = list(read_records(path))
    assert [received.host_ns for received in found] == rest
    for seed, received in zip(rest, found, strict=True):
        assert_same(received.record, camera_record(seed))
    done = recover(path)
    assert done.kept == 2 * 3  # a record and its pose
    assert (done.ending.lost_messages, done.ending.lost_bytes) == (2, end - begin)
    assert done.original == tmp_path / "run-damaged.mcap"
    assert done.original.read_bytes() == data
    with path.open("rb") as file:
        assert SeekingReader(file).get_summary().statistics.message_count == 6  # type: ignore[union-attr]
    assert [received.host_ns for received in read_records(path)] == rest
    again = recover(path)
    assert (again.kept, again.ending.fault, again.original) == (6, None, None)


@pytest.mark.parametrize("place", [0.1, 0.5, 0.99])
def test_a_log_without_summary_and_first_chunk_keeps_the_others(
    tmp_path: Path, place: float
) -> None:
    """Killed before its summary, and one bit of the chunk spoilt that alone defines the topics: the
    three other records come back bit for bit, with their topic where it can be unpacked still, and
    `recover` makes a log of them that names its topics itself.
    """
    path = tmp_path / "run.mcap"
    patterns = PatternSet(128, 128, 16384)  # zstd packs half a megabyte in several blocks
    chunks = of_chunks(path, patterns=patterns)
    begin, end = chunks[0]
    data = bytearray(path.read_bytes()[: chunks[-1][1]])
    data[begin + int(place * (end - begin))] ^= 1
    path.write_bytes(data)
    found = list(read_records(path, ending := Ending()))
    assert [received.host_ns for received in found] == [1, 2, 3]
    for seed, received in enumerate(found, 1):
        assert_same(received.record, camera_record(seed, patterns))
    assert ending.fault is not None
    assert ending.lost_bytes >= end - begin
    if place > 0.1:  # the first block, which holds the definitions, is whole
        assert {received.topic for received in found} == {"/spi/record"}
    done = recover(path)
    assert done.kept >= 3
    assert done.original == tmp_path / "run-damaged.mcap"
    again = Ending()
    assert [received.host_ns for received in read_records(path, again)] == [1, 2, 3]
    assert again.fault is None


def test_a_message_outside_chunks_is_covered_by_the_crc_of_the_data(tmp_path: Path) -> None:
    """As other writers may lay out a log; one bit of the payload, and the reader says so."""
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_data_crcs=True)
        writer.start()
        channel = writer.register_channel("/x", "cdr", writer.register_schema("x", "ros2msg", b""))
        writer.add_message(channel, 1, b"payload", 1)
        writer.finish()
    for data, fault in (
        (path.read_bytes(), None),
        (path.read_bytes().replace(b"payload", b"qayload"), "the CRC-32 of the data is another"),
    ):
        path.write_bytes(data)
        assert len(list(read_messages(path, ending := Ending()))) == 1
        assert ending.fault == fault
        assert bool(ending.lost) == (fault is not None)  # any message may be another


def test_a_damaged_index_is_told_and_written_anew(tmp_path: Path) -> None:
    """All messages are there, but a reader that goes by the index may miss some: any byte of it."""
    path = tmp_path / "run.mcap"
    with Log(path) as log:
        for seed in range(3):
            log.record("/spi/record", camera_record(seed), host_ns=seed)
    data = path.read_bytes()
    assert not list(read_messages(path, ending := Ending()))[6:]
    assert ending.fault is None
    footer = len(data) - 8 - 20
    begin = int.from_bytes(data[footer : footer + 8], "little")
    for at in np.random.default_rng(0).integers(begin, footer + 20, 30):
        path.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :])
        assert len(list(read_messages(path, ending := Ending()))) == 6
        assert ending.fault is not None
        assert recover(path).kept == 6
        assert len(list(read_messages(path, ending := Ending()))) == 6
        assert ending.fault is None


@pytest.mark.parametrize("flip", [0x01, 0x40, 0x80])
def test_a_damaged_head_of_any_record_takes_no_message_with_it(tmp_path: Path, flip: int) -> None:
    """Kind and length of every record before the footer, a byte at a time: all messages come, and
    the damage is told unless it changed nothing.
    """
    path = tmp_path / "run.mcap"
    of_chunks(path)
    data, at, heads = path.read_bytes(), 8, []
    while at < len(data) - 8:
        heads.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    assert len(heads) > 12
    whole = [message.message for message in read_messages(path)]
    for place in (head + byte for head in heads[1:-1] for byte in range(9)):
        spoiled = bytearray(data)
        spoiled[place] ^= flip
        path.write_bytes(spoiled)
        ending = Ending()
        found = [message.message for message in read_messages(path, ending)]
        assert found == whole, place
        done = recover(path, tmp_path / "whole.mcap")
        assert done.kept == len(whole)


def test_garbage_between_records_is_passed_and_the_original_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    chunks = of_chunks(path)
    data = path.read_bytes()
    garbage = np.random.default_rng(3).bytes(5000)
    path.write_bytes(data[: chunks[2][0] - 9] + garbage + data[chunks[2][0] - 9 :])
    ending = Ending()
    assert len(list(read_records(path, ending))) == 4
    assert (ending.lost_bytes, ending.finished) == (5000, True)
    assert f"5000 bytes before offset {chunks[2][0] - 9 + 5000} are no record" in str(ending.fault)
    done = recover(path)
    assert done.original is not None
    assert len(list(read_records(path))) == 4


def test_a_chunk_that_is_gone_is_missed_by_the_logs_own_count(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    (_, _), (begin, end), *_ = of_chunks(path)
    data = path.read_bytes()
    path.write_bytes(data[: begin - 9] + data[end:])
    ending = Ending()
    assert len(list(read_records(path, ending))) == 3
    assert ending.fault == "its index is damaged"
    assert "lost: 0 bytes, 2 messages" in ending.advice(path)
    assert recover(path).original is not None


def test_a_copy_of_a_chunk_is_left_out_and_told(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    _, (begin, end), (other, _), _ = of_chunks(path)
    data = path.read_bytes()
    path.write_bytes(data[: other - 9] + data[begin - 9 : end] + data[other - 9 :])
    ending = Ending()
    assert [received.host_ns for received in read_records(path, ending)] == [0, 1, 2, 3]
    assert ending.fault == "a chunk is there twice; the second is left out"
    assert recover(path).kept == 8


def test_the_end_of_another_log_in_the_middle_is_not_the_end(tmp_path: Path) -> None:
    """Index, footer and last bytes, as where two files were joined."""
    path = tmp_path / "run.mcap"
    chunks = of_chunks(path)
    data, at = path.read_bytes(), chunks[2][0] - 9
    end_of_data = data.rindex(b"\x0f" + (4).to_bytes(8, "little"))
    path.write_bytes(data[:at] + data[end_of_data:] + data[at:])
    ending = Ending()
    assert [received.host_ns for received in read_records(path, ending)] == [0, 1, 2, 3]
    assert "bytes before offset" in str(ending.fault)
    assert recover(path).original is not None


@pytest.mark.parametrize("place", [28, 43], ids=["compression's name", "what it holds"])
def test_a_size_within_a_chunk_that_cannot_be_takes_that_chunk_alone(
    tmp_path: Path, place: int
) -> None:
    """Behind times, size and CRC-32: a name's length, the name, and the length of what follows."""
    path = tmp_path / "run.mcap"
    (_, _), (begin, _), *_ = of_chunks(path)
    spoiled = bytearray(path.read_bytes())
    spoiled[begin + place] ^= 0x82
    path.write_bytes(spoiled)
    ending = Ending()
    assert [received.host_ns for received in read_records(path, ending)] == [0, 2, 3]
    assert ending.lost
    assert recover(path).original is not None


@pytest.mark.parametrize("place", range(8))
def test_damaged_first_bytes_are_told(tmp_path: Path, place: int) -> None:
    path = tmp_path / "run.mcap"
    of_chunks(path)
    spoiled = bytearray(path.read_bytes())
    spoiled[place] ^= 0x10
    path.write_bytes(spoiled)
    ending = Ending()
    assert len(list(read_records(path, ending))) == 4
    assert ending.fault == "its first bytes are damaged"
    assert recover(path).kept == 8
    assert (recover(path).kept, recover(path).ending.fault) == (8, None)


def test_zeros_that_a_file_system_left_behind_are_no_loss(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    chunks = of_chunks(path)
    path.write_bytes(path.read_bytes()[: chunks[2][0] - 9] + bytes(10_000))
    ending = Ending()
    assert len(list(read_records(path, ending))) == 2
    assert (ending.lost, ending.fault) == ("", "it ends before its footer")


def test_another_damaged_original_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    begin, end = of_chunks(path)[1]
    data = bytearray(path.read_bytes())
    data[(begin + end) // 2] ^= 1
    for name in ("run-damaged.mcap", "run-damaged1.mcap"):
        path.write_bytes(data)
        assert recover(path).original == tmp_path / name


def test_a_file_of_which_nothing_is_whole_is_left_as_it_is(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).bytes(20_000)
    for data in (b"", b"\x89MCAP0\r\n" + noise):
        path = tmp_path / "run.mcap"
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"run\.mcap: no whole message in it"):
            recover(path)
        assert path.read_bytes() == data
        assert list(tmp_path.iterdir()) == [path]


def test_spoiled_bytes_end_the_log_with_a_reason(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(8, len(data), 200):
        spoiled = bytearray(data)
        spoiled[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoiled)
        messages = list(read_messages(path))
        assert len(messages) <= 7


def test_no_log_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"no log")
    with pytest.raises(ValueError, match=r"x\.mcap: no MCAP file"):
        list(read_records(tmp_path / "x.mcap"))
    with pytest.raises(FileNotFoundError):
        list(read_records(tmp_path / "missing.mcap"))


WRITER = """
import sys, time, itertools
sys.path.insert(0, {tests!r})
from log_records import camera_record
from hardware.recording import Log
record = camera_record()
log = Log({path!r})
for n in itertools.count():
    log.record("/spi/record", record, host_ns=n)
    print(n, time.monotonic(), flush=True)
    time.sleep(0.002)
"""


def kill_once(folder: Path, wait_s: float) -> None:
    """Kill -9 while recording: what was logged a second before is there, and opens elsewhere."""
    path = folder / "run.mcap"
    program = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        time.sleep(wait_s)
        process.send_signal(signal.SIGKILL)
        killed_s = time.monotonic()
        lines = [first, *process.stdout]
    due = [int(line.split()[0]) for line in lines
           if line.endswith(b"\n") and float(line.split()[1]) < killed_s - 1]  # fmt: skip
    kept = [received.host_ns for received in read_records(path)]
    assert kept == list(range(len(kept)))
    assert len(kept) > max(due, default=-1)
    if kept:
        done = recover(path)
        n = done.kept
        assert done.ending.fault is not None
        with path.open("rb") as file:
            assert sum(1 for _ in SeekingReader(file).iter_messages()) == n
        assert check_by_rosbags(path) == n
    path.unlink()


@pytest.mark.library("rosbags")
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX")
@pytest.mark.parametrize("times", [5, pytest.param(200, marks=pytest.mark.slow)])
def test_a_kill_takes_no_more_than_a_second(tmp_path: Path, times: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(times):
        kill_once(tmp_path, float(rng.uniform(0, 2.5)))


@pytest.mark.skipif(os.name != "posix", reason="locks and SIGKILL are POSIX")
def test_a_log_that_is_being_written_is_not_recovered(tmp_path: Path) -> None:
    """Another process writes: recovery refuses and leaves the file, reading loses nothing and does
    not advise it. Once the writer is killed the log is recovered.
    """
    path, ending = tmp_path / "run.mcap", Ending()
    program = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        for _ in range(400):
            process.stdout.readline()
        file = path.stat().st_ino
        for out in (None, tmp_path / "copy.mcap"):
            with pytest.raises(InputError, match=r"run\.mcap: still being written"):
                recover(path, out)
        assert path.stat().st_ino == file
        assert list(read_records(path, ending))
        assert (ending.being_written, ending.lost) == (True, "")
        assert "recover" not in ending.advice(path)
        process.kill()
    assert recover(path).ending.fault


def test_a_writer_notices_that_its_log_is_gone(tmp_path: Path) -> None:
    """Removed or replaced: the next flush raises. Moved: it is written to its end, and told."""
    for change, at_flush in (("unlink", True), ("replace", True), ("rename", False)):
        path, other = tmp_path / f"{change}.mcap", tmp_path / "other.mcap"
        log = Log(path, flush_s=1e9)
        log.record("/spi/record", camera_record(), host_ns=0)
        if change == "unlink":
            path.unlink()
        elif change == "replace":
            other.write_bytes(b"")
            other.replace(path)
        else:
            path.rename(other)
        if at_flush:
            with pytest.raises(InputError, match="removed or replaced while it was written"):
                log.flush()
        else:
            log.flush()
        with pytest.raises(InputError, match="removed or replaced while it was written"):
            log.close()
    assert len(list(read_records(other))) == 1
