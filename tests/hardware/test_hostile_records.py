"""Records that lie, on the vehicle: one line of error each, in little memory."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from full_disk import files_up_to
from hostile import refused
from radar_cubes import STEP, Echo, cube
from ugv_command import ugv

from hardware import PatternSet, SpiRecord
from hardware.drivers.settings import SpiSettings, read_settings, write_settings
from hardware.errors import InputError
from hardware.files import (
    read_array,
    said,
)
from hardware.patterns import own_patterns
from hardware.records import (
    QuaternionPose,
    RadarRecord,
    read_radar_record,
    read_record,
    write_radar_record,
    write_record,
)
from hardware.records.spi import LAYOUT


@pytest.fixture
def record() -> SpiRecord:
    patterns = PatternSet(8, 8, 64, "natural", "plain")
    return SpiRecord(
        counts=np.arange(64, dtype=np.int32)[:, None],
        device_time_ns=np.arange(64, dtype=np.int64),
        sequence=np.arange(64, dtype=np.uint32),
        flags=np.zeros(64, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=16,
        device="camera",
        pose=QuaternionPose(),
    )


def promised(file: h5py.File) -> None:
    file.create_dataset("counts", shape=(2**36, 1), dtype="i4", chunks=(1024, 1))


def unpacked(file: h5py.File) -> None:
    """256 MiB of which a part is there: 16 MiB of zeros in 16 kB."""
    made = file.create_dataset("counts", (2**26, 1), "i4", chunks=(2**20, 1), compression="gzip")
    made[: 2**22] = np.zeros((2**22, 1), np.int32)


def unpacked_whole(file: h5py.File) -> None:
    """128 MiB of zeros in 130 kB, all of it there."""
    made = file.create_dataset("counts", (64, 2**19), "i4", chunks=(64, 2**14), compression="gzip")
    for at in range(0, 2**19, 2**14):
        made[:, at : at + 2**14] = 0


def linked(file: h5py.File) -> None:
    file["counts"] = h5py.ExternalLink("other.h5", "/counts")


def stored_elsewhere(file: h5py.File) -> None:
    file.create_dataset("counts", (64, 1), "i4", external=[("raw.bin", 0, 256)])


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((64, 1), "i4")
    layout[:] = h5py.VirtualSource("other.h5", "counts", (64, 1))
    file.create_virtual_dataset("counts", layout)


def group(file: h5py.File) -> None:
    file.create_group("counts")


def complex_counts(file: h5py.File) -> None:
    file["counts"] = np.zeros((64, 1), complex)


def array_for_a_number(file: h5py.File) -> None:
    file["counts"] = np.zeros((64, 1), np.int32)
    file.attrs["integration_time_s"] = np.zeros(5)


def array_for_the_version(file: h5py.File) -> None:
    file.attrs["schema_version"] = np.arange(3)


def no_text(file: h5py.File) -> None:
    file["counts"] = np.zeros((64, 1), np.int32)
    file.attrs["device"] = np.bytes_(b"\xff\xfe")


def sequence_for_a_text(file: h5py.File) -> None:
    """One flipped bit makes it of a text."""
    file["counts"] = np.zeros((64, 1), np.int32)
    del file.attrs["device"]
    kind = h5py.h5t.py_create(h5py.vlen_dtype(np.int32), logical=True)
    h5py.h5a.create(file.id, b"device", kind, h5py.h5s.create(h5py.h5s.SCALAR))


def too_many_cells(file: h5py.File) -> None:
    file["counts"] = np.zeros((64, 1), np.int32)
    file["patterns"].attrs["rows"] = file["patterns"].attrs["columns"] = 2**30


def patterns_elsewhere(file: h5py.File) -> None:
    file["counts"] = np.zeros((64, 1), np.int32)
    del file["patterns"]
    file["patterns"] = h5py.ExternalLink("other.h5", "/")


@pytest.mark.parametrize(
    ("spoil", "because"),
    [
        (promised, "counts: 274877906944 bytes of shape .*, but the file holds 0"),
        (unpacked, "counts: 268435456 bytes of shape .*, but the file holds"),
        (unpacked_whole, "counts: 134217728 bytes of shape .*, but the file holds"),
        (linked, "counts: stands in another file"),
        (stored_elsewhere, "counts: stands in another file"),
        (virtual, "counts: stands in another file"),
        (group, "counts: a group, expected an array of int32"),
        (complex_counts, "counts: complex128, expected an array of int32"),
        (array_for_a_number, "integration_time_s: an array of shape"),
        (array_for_the_version, "schema_version: an array of shape"),
        (no_text, "device: 'utf-8' codec can't decode"),
        (sequence_for_a_text, "device: neither a number nor a text"),
        (too_many_cells, "rows, columns: 1073741824 x 1073741824 cells"),
        (patterns_elsewhere, "patterns: stands in another file"),
    ],
)
def test_a_record_holds_what_it_says_and_nothing_of_other_files(
    spoil: Callable[[h5py.File], None],
    because: str,
    record: SpiRecord,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with h5py.File("other.h5", "w") as other:
        other["counts"] = np.full((64, 1), 7, np.int32)
    np.full((64, 1), 7, np.int32).tofile("raw.bin")
    write_record(record, path := tmp_path / "record.h5")
    np.testing.assert_array_equal(read_record(path).counts, record.counts)
    with h5py.File(path, "r+") as file:
        del file["counts"]
        spoil(file)
    with refused(path, because):
        read_record(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
@pytest.mark.parametrize("kind", ["spi", "radar"])
def test_a_record_that_was_cut_short_says_by_how_much(
    kind: str, share: float, record: SpiRecord, tmp_path: Path
) -> None:
    """As a full disk or a broken transfer leaves it: in our words, with both sizes."""
    path, read = written(kind, record, tmp_path)
    whole = path.read_bytes()
    held = int(share * len(whole))
    path.write_bytes(whole[:held])
    with refused(path, f"is cut short: expected {len(whole)} bytes, the file holds {held}"):
        read(path)


@pytest.mark.parametrize("kind", ["spi", "radar"])
@pytest.mark.parametrize(
    ("content", "because"),
    [
        (b"", "is empty, expected a ugv-{kind}-record"),
        (b"hello world\n", "is no HDF5 file, expected a ugv-{kind}-record"),
        (b"\x89HDF\r\n\x1a\n", "is damaged, HDF5 cannot read it: "),
    ],
)
def test_what_is_no_record_says_what_was_expected(
    kind: str, content: bytes, because: str, record: SpiRecord, tmp_path: Path
) -> None:
    path, read = written(kind, record, tmp_path)
    path.write_bytes(content)
    with refused(path, because.format(kind=kind)):
        read(path)


@pytest.mark.parametrize("name", ["counts", "device", "patterns"])
def test_what_a_record_lacks_is_named(name: str, record: SpiRecord, tmp_path: Path) -> None:
    write_record(record, path := tmp_path / "record.h5")
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        else:
            del file.attrs[name]
    with refused(path, f"{name}: missing from the file"):
        read_record(path)


def written(
    kind: str, record: SpiRecord, folder: Path
) -> tuple[Path, Callable[[Path], SpiRecord | RadarRecord]]:
    """A record's file, and what reads it."""
    path = folder / f"{kind}.h5"
    if kind == "spi":
        write_record(record, path)
        return path, read_record
    write_radar_record(cube(STEP, [Echo((5.0, 0, 0))]), path)
    return path, read_radar_record


@pytest.mark.parametrize("content", [b"", b"hello world\n", b"\x80\x04N.", b"PK\x03\x04"])
def test_what_is_no_array_is_not_said_to_be_a_pickle_to_trust(
    content: bytes, tmp_path: Path
) -> None:
    """NumPy takes any text for a pickled object, and says how to load it unsafely."""
    (path := tmp_path / "light.npy").write_bytes(content)
    with refused(path, r"is no NumPy array \(.npy\)"):
        read_array(path)


def test_the_head_of_an_array_that_is_no_python_is_one_line(tmp_path: Path) -> None:
    """One flipped bit of its type, `<f8`, which NumPy evaluates."""
    np.save(path := tmp_path / "light.npy", np.zeros(3))
    path.write_bytes(path.read_bytes().replace(b"<f8", b",f8"))
    with refused(path, "can't be read as a NumPy array"):
        read_array(path)


def test_a_folder_that_is_missing_is_told_by_the_users_name(
    record: SpiRecord, tmp_path: Path
) -> None:
    """Not by that of the place beside, where a file is written first."""
    path = tmp_path / "missing" / "record.h5"
    with pytest.raises(FileNotFoundError) as caught:
        write_record(record, path)
    assert caught.value.filename == str(path)


def test_a_compressed_record_is_read(record: SpiRecord, tmp_path: Path) -> None:
    """As other tools may repack it: by deflate, which packs at most 1032 to 1."""
    write_record(record, path := tmp_path / "record.h5")
    with h5py.File(path, "r+") as file:
        del file["counts"]
        file.create_dataset("counts", data=record.counts, compression="gzip")
    np.testing.assert_array_equal(read_record(path).counts, record.counts)


def test_a_bit_that_has_flipped_in_a_record_is_an_error(record: SpiRecord, tmp_path: Path) -> None:
    """Anywhere in the file: the record is refused, or is the same to the bit."""
    path = tmp_path / "r.h5"
    write_record(record, path)
    intact, written, rng = path.read_bytes(), LAYOUT.arrays, np.random.default_rng(3)
    counts = intact.find(record.counts.astype("<i4").tobytes())
    assert counts > 0
    places = [8 * (counts + 4 * 20 + 1) + 6, *rng.integers(0, 8 * len(intact), 400)]
    refused = 0
    for place in map(int, places):
        flipped = bytearray(intact)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        try:
            found = read_record(path)
        except InputError:
            refused += 1
            continue
        for name in written:
            np.testing.assert_array_equal(getattr(found, name), getattr(record, name))
        for name in LAYOUT.settings:
            assert getattr(found, name) == getattr(record, name)
    assert refused > 100


@pytest.mark.parametrize("name", ["counts", "flags", "sequence"])
def test_numbers_of_more_bits_than_a_records_do_not_wrap(
    name: str, record: SpiRecord, tmp_path: Path
) -> None:
    """2**32 + n of 64 bits is no n of 32, nor of 8."""
    path = tmp_path / "r.h5"
    write_record(record, path)
    with h5py.File(path, "a") as file:
        wide = file[name][()].astype(np.int64 if name == "counts" else np.uint64)
        del file[name]
        file[name] = wide
    np.testing.assert_array_equal(getattr(read_record(path), name), getattr(record, name))
    with h5py.File(path, "a") as file:
        file[name][5] += 2**32
    with pytest.raises(InputError, match=rf"r\.h5: {name}: \d+ to 429\d+, expected "):
        read_record(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("electrons_per_count", 1e300),
        ("offset_counts", "abc"),
        ("offset_counts", -1e300),
        ("pulse_width_s", "abc"),
        ("integration_time_s", 1e300),
        ("shutters", 3.0),
        ("shutters", [[1e6, 0.0, 1e-9, 1e-9]]),
        ("pose", [0.0] * 7),
    ],
)
def test_numbers_that_cannot_be_are_told_with_their_field(
    name: str, value: Any, record: SpiRecord, tmp_path: Path
) -> None:
    """Some had ended in a library's error, or in an overflow of the reconstruction."""
    path = tmp_path / "r.h5"
    write_record(record, path)
    with h5py.File(path, "a") as file:
        if name in file:
            del file[name]
            file[name] = np.array(value)
        else:
            file.attrs[name] = value
    with pytest.raises(InputError, match=rf"r\.h5: {name}: .*, expected "):
        read_record(path)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("pose = [1, 2]", r"pose: \(1.0, 2.0\), expected x y z"),
        ("pose = [0, 0, 0, 0, 0, 0, 0]", "pose: .* that is not 0"),
        ("pose = [1e308, 0, 0, 1, 0, 0, 0]", "pose: .* expected x y z of at most 1e\\+09 m"),
        ("pose = [0, 0, 0, 1e200, 0, 0, 0]", "pose: .* of about length 1"),
        ("pose = 3", "pose: 3, expected a list of 7 numbers"),
        ('shutters = "x"', "shutters: 'x', expected a list of lists of 4 numbers"),
        ("shutters = [[1e6, 0, 1e-9, 1e-9]]", "shutters: .* one shutter is not both"),
    ],
)
def test_settings_that_no_camera_may_be_sent_name_their_field(
    line: str, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(
        f"integration_time_s = 1e-4\n{line}\n[patterns]\nrows = 8\ncolumns = 8\ncount = 64\n"
    )
    with pytest.raises(InputError, match=rf"camera\.toml: {told}"):
        read_settings(path)


def test_a_record_whose_exposures_are_lost_is_told_by_its_name(
    record: SpiRecord, tmp_path: Path
) -> None:
    path = tmp_path / "r.h5"
    write_record(replace(record, flags=np.full(64, 8, np.uint8)), path)
    told = ugv("reconstruct", path)
    assert told.returncode == 2
    assert f"{path}: flags: exposures are lost" in told.stderr


def test_a_full_disk_is_told_by_the_files_name_and_leaves_nothing(
    record: SpiRecord, tmp_path: Path
) -> None:
    """In a process whose files may not grow: HDF5, met by that at its own end, would take the
    process with it.
    """
    write_record(record, tmp_path / "before.h5")
    program = (
        "import resource, signal\n"
        "from hardware.records import read_record, write_record\n"
        "from hardware.files import said\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"record = read_record({str(tmp_path / 'before.h5')!r})\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "try:\n"
        f"    write_record(record, {str(tmp_path / 'after.h5')!r})\n"
        "except OSError as error:\n"
        "    print(said(error))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == f"{tmp_path / 'after.h5'}: File too large"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["before.h5"]


@pytest.mark.library("PIL")
def test_a_picture_that_does_not_fit_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    from hardware.png import write_grey

    noise = np.random.default_rng(0).random((200, 200))
    with files_up_to(4096), pytest.raises(OSError, match="File too large") as caught:
        write_grey(tmp_path / "image.png", noise)
    assert said(caught.value) == f"{tmp_path / 'image.png'}: File too large"
    assert not list(tmp_path.iterdir())


def test_own_patterns_that_do_not_fit_are_named(tmp_path: Path) -> None:
    """NumPy's own words were `16384 requested and 3968 written`, without the file."""
    levels = np.arange(16384).reshape(64, 16, 16) % 3 == 0
    settings = SpiSettings(own_patterns(levels, "plain"), 1e-6)
    with files_up_to(4096), pytest.raises(OSError, match="File too large") as caught:
        write_settings(settings, tmp_path / "camera.toml")
    assert said(caught.value) == f"{tmp_path / 'camera-patterns.npy'}: File too large"
    assert not list(tmp_path.iterdir())
