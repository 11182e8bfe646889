"""Logs and settings that lie, on the vehicle: one line of error each; and what a kill leaves."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from struct import pack
from typing import Any

import pytest
import zstandard
from hostile import refused

from hardware.drivers.radio.setup import read_setup
from hardware.drivers.settings import read_settings
from hardware.files import (
    naming,
    one_line,
    partial_path,
    read_regular,
    read_toml,
    whole_file,
)
from hardware.recording import read_messages, recover

# Logs.


def mcap_record(kind: int, body: bytes) -> bytes:
    return bytes([kind]) + pack("<Q", len(body)) + body


def text(value: str) -> bytes:
    return pack("<I", len(value)) + value.encode()


def chunk(claimed: int, packing: str, data: bytes) -> bytes:
    head = pack("<QQQI", 0, 0, claimed, 0) + text(packing) + pack("<Q", len(data))
    return b"\x89MCAP0\r\n" + mcap_record(1, text("") * 2) + mcap_record(6, head + data)


def zeros(size: int) -> bytes:
    """So many zero bytes, packed; the frame says how many there are."""
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()


@pytest.mark.parametrize("claimed", [1 << 30, 100], ids=["told", "hidden"])
def test_a_chunk_that_unpacks_to_a_gigabyte_is_not_unpacked(claimed: int, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(chunk(claimed, "zstd", zeros(1 << 30)))
    for read in (lambda: list(read_messages(path)), lambda: recover(path)):
        with refused(path, "a chunk of 1073741824 bytes, expected at most 536870912"):
            read()
    assert [found.name for found in tmp_path.iterdir()] == ["bomb.mcap"]


def test_a_chunk_of_an_unknown_packing_is_no_reason_to_replace_the_log(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(data := chunk(100, "brotli", b"abc"))
    with refused(path, "a chunk compressed by 'brotli', expected zstd or lz4"):
        recover(path)
    assert path.read_bytes() == data


# Settings.

_DEEP = 100_000


@pytest.mark.parametrize(
    ("read", "content", "because"),
    [
        (read_settings, b"a = " + b"[" * _DEEP, "no valid TOML: nested too deeply"),
        (read_settings, b"a = " + b"{a = " * 3000, "no valid TOML: nested too deeply"),
        (read_settings, b"a = " + b"9" * 5000, "no valid TOML: Exceeds the limit"),
        (read_settings, b'a = "caf\xe9"', "no valid TOML: 'utf-8' codec can't decode"),
        (read_settings, b"a" + b".a" * 50_000 + b" = 1", "no valid TOML: nested too deeply"),
        (read_settings, b"a" + b" . 'a'" * 20_000 + b" = 1", "no valid TOML: nested too deeply"),
        (read_settings, b"gain = 0x" + b"f" * 10_000, "gain: a whole number of 40000 bits"),
        (read_settings, b"patterns = 5", "patterns = 5: expected a table"),
        (read_setup, b"[" * _DEEP, "no valid JSON: nested too deeply"),
        (read_setup, b'"caf\xe9"', "no valid JSON: 'utf-8' codec can't decode"),
    ],
)
def test_settings_are_read_or_told_in_one_line(
    read: Callable[[Path], Any], content: bytes, because: str, tmp_path: Path
) -> None:
    path = tmp_path / "settings"
    path.write_bytes(content)
    with refused(path, because):
        read(path)


def test_numbers_and_words_with_points_are_no_deep_keys(tmp_path: Path) -> None:
    """Lists of numbers over lines, comments, and texts: more points than a key may have parts."""
    numbers = ", ".join(["0.5"] * 200)
    text = f"# {'. ' * 20}{'.' * 200}\na.b = [{numbers},\n{numbers}]\n"
    text += f"b = '{'.' * 150}'\nc = {2**63 - 1}\n"
    (path := tmp_path / "x.toml").write_text(text)
    assert read_toml(path) == {"a": {"b": [0.5] * 400}, "b": "." * 150, "c": 2**63 - 1}


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no device files")
def test_a_device_that_never_ends_is_no_file() -> None:
    for read in (read_toml, read_regular):
        with pytest.raises(ValueError, match=r"^/dev/zero: expected a regular file"):
            read("/dev/zero")


def test_an_error_is_one_line_that_a_terminal_can_show() -> None:
    line = one_line("file: \x1b[2Jname" + "a" * 100_000 + "\n expected b")
    assert line.isprintable()
    assert line.startswith("file: [2Jname")
    assert line.endswith(" expected b")
    assert len(line) < 4000


# What is written.


def test_what_a_kill_left_goes_with_the_next_writing(tmp_path: Path) -> None:
    """Only this machine's, of processes that run no more, and of the same file."""
    path = tmp_path / "record.h5"
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"],
                           capture_output=True, text=True, check=True)  # fmt: skip
    ours, dead = partial_path(path), int(ended.stdout)
    left = ours.with_name(ours.name.replace(f"-{os.getpid()}.", f"-{dead}."))
    others = [
        ours.with_name(ours.name.replace(f"-{os.getpid()}.", f"-{os.getppid()}.")),
        ours.with_name(f".record.h5.elsewhere-{dead}.partial"),
        ours.with_name(left.name.replace("record", "other")),
    ]
    for one in (left, *others):
        one.write_bytes(b"half")
    with whole_file(path) as partial:
        partial.write_bytes(b"whole")
    assert sorted(tmp_path.iterdir()) == sorted([path, *others])


def test_an_error_of_a_write_names_the_file() -> None:
    with pytest.raises(OSError, match=r"No space left on device: 'run\.mcap'"), naming("run.mcap"):
        os.write(os.open("/dev/full", os.O_WRONLY), b"x")
