"""Texts in records: checksums in what is written, and old files that HDF5 would read for ever."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from ugv_command import started

from hardware import InputError, PatternSet, SpiRecord, read_record, write_record
from hardware.records import QuaternionPose
from hardware.records.global_heap import has_endless_heap

#: Of an object in a collection of texts: index 2 bytes, references 2, reserved 4, size 8.
_HEADER = 16


@pytest.fixture
def record() -> SpiRecord:
    patterns = PatternSet(8, 8, 64)
    n = patterns.n_exposures
    return SpiRecord(
        counts=np.arange(n, dtype=np.int32)[:, None],
        device_time_ns=np.arange(n, dtype=np.int64) * 100_000,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=80e-6,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=16,
        device="Gerät A",
        pose=QuaternionPose(0.0, 0.0, 0.0),
    )


def test_a_bit_that_has_flipped_in_a_text_is_an_error(record: SpiRecord, tmp_path: Path) -> None:
    """Of every byte of the device's name: texts of variable length have no checksum."""
    path = tmp_path / "r.h5"
    write_record(record, path)
    intact, name = path.read_bytes(), record.device.encode()
    place = intact.find(name)
    assert place > 0
    assert b"GCOL" not in intact
    for byte in range(place, place + len(name)):
        damaged = bytearray(intact)
        damaged[byte] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="is damaged"):
            read_record(path)


@pytest.mark.parametrize("text", ["", "Gerät", "x" * 40_000])
def test_texts_of_any_length_come_back(text: str, record: SpiRecord, tmp_path: Path) -> None:
    write_record(replace(record, device=text), tmp_path / "r.h5")
    assert read_record(tmp_path / "r.h5").device == text


def with_texts_of_variable_length(path: Path) -> None:
    """The file as records were written before: its texts in a heap."""
    with h5py.File(path, "a", libver=("v110", "v110")) as file:
        for held in (file, *file.values()):
            for name, value in list(held.attrs.items()):
                if isinstance(value, bytes):
                    del held.attrs[name]
                    held.attrs[name] = value.decode()


def test_an_old_record_whose_heap_never_ends_is_an_error(record: SpiRecord, tmp_path: Path) -> None:
    """HDF5 itself follows free space of size 0 for ever; in a process, which can be ended."""
    path = tmp_path / "old.h5"
    write_record(record, path)
    with_texts_of_variable_length(path)
    assert read_record(path).device == record.device
    assert not has_endless_heap(path)
    damaged = bytearray(path.read_bytes())
    place = damaged.find(b"GCOL") + _HEADER
    damaged[place : place + _HEADER] = bytes(_HEADER)
    path.write_bytes(damaged)
    process = started("reconstruct", path)
    try:
        _, told = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 2
    assert f"{path}: is damaged" in told
