"""The record's file: complete, versioned, reproducible, and never half-written."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from hardware import InputError, PatternSet, SpiRecord, read_record, reconstruct, write_record
from hardware.records import Flag, QuaternionPose, Shutter


def make_record() -> SpiRecord:
    patterns = PatternSet(4, 4, 16)
    n = patterns.n_exposures
    counts = np.random.default_rng(5).integers(0, 2**16, size=(n, 2), dtype=np.int32)
    return SpiRecord(
        counts=counts,
        device_time_ns=np.arange(n, dtype=np.int64) * 100_000,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, dtype=np.uint8),
        patterns=patterns,
        integration_time_s=80e-6,
        electrons_per_count=780.5,
        offset_counts=320.25,
        adc_bits=16,
        device="test",
        pose=QuaternionPose(1e6, -2.5, 1.2),
    )


def test_round_trip_keeps_every_bit(tmp_path: Path) -> None:
    record = make_record()
    write_record(record, tmp_path / "r.h5")
    back = read_record(tmp_path / "r.h5")
    for name in ("counts", "device_time_ns", "sequence", "flags"):
        stored = getattr(back, name)
        np.testing.assert_array_equal(stored, getattr(record, name))
        assert stored.dtype == getattr(record, name).dtype
    assert (back.pose, back.shutters) == (record.pose, record.shutters)
    for name in ("patterns", "integration_time_s", "electrons_per_count", "offset_counts"):
        assert getattr(back, name) == getattr(record, name)
    assert (back.adc_bits, back.device) == (16, "test")


def test_same_record_same_bytes(tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        write_record(make_record(), tmp_path / name)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_format_and_schema_version_are_fixed(tmp_path: Path) -> None:
    """Whoever changes the layout must change the version, and this test with it."""
    write_record(make_record(), tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5") as file:
        assert file.attrs["format"] == b"ugv-spi-record"  # of fixed length, for its checksum
        assert file.attrs["schema_version"] == 4
        assert file.attrs["pulse_width_s"] == 0.0
        members = {"counts", "device_time_ns", "sequence", "flags", "pose", "shutters"}
        assert set(file) == members | {"patterns"}
        parameters = {"rows", "columns", "count", "order", "mode", "digest"}
        assert set(file["patterns"].attrs) == parameters


def test_records_of_version_1_are_read_without_shutters(tmp_path: Path) -> None:
    path = tmp_path / "old.h5"
    write_record(make_record(), path)
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = 1
        del file["shutters"], file.attrs["pulse_width_s"]
    old = read_record(path)
    assert old.shutters == (Shutter(),)
    np.testing.assert_array_equal(old.electrons, make_record().electrons)


def test_records_of_version_3_name_their_patterns_alone(tmp_path: Path) -> None:
    path = tmp_path / "old.h5"
    write_record(make_record(), path)
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = 3
        del file["patterns"].attrs["digest"]
    assert read_record(path).patterns == make_record().patterns


def test_records_of_version_2_do_not_state_their_pulse(tmp_path: Path) -> None:
    path, gates = tmp_path / "old.h5", (Shutter(gate_delay_s=1e-8, gate_width_s=2e-8),)
    gated = replace(make_record(), shutters=gates, pulse_width_s=2e-8)
    write_record(gated, path)
    assert read_record(path).pulse_width_s == 2e-8
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = 2
        del file.attrs["pulse_width_s"]
    old = read_record(path)
    assert old.pulse_width_s == 0.0
    assert old.shutters == gates


def test_other_versions_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_record(make_record(), path)
    with h5py.File(path, "a") as file:
        file.attrs["schema_version"] = 99
    with pytest.raises(ValueError, match=r"r\.h5: schema version 99"):
        read_record(path)
    path.write_bytes(b"no HDF5")
    with pytest.raises(ValueError, match=r"r\.h5"):
        read_record(path)
    with pytest.raises(FileNotFoundError, match="missing"):
        read_record(tmp_path / "missing.h5")


def test_truncated_file_is_an_error_not_garbage(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_record(make_record(), path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(ValueError, match=r"r\.h5"):
        read_record(path)


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_record(make_record(), path)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_record(replace(make_record(), device=object()), path)  # type: ignore[arg-type]
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("counts", np.zeros((3, 1), np.int32)),
        ("counts", np.zeros((32, 1))),
        ("counts", [[0]] * 32),
        ("device_time_ns", np.zeros(32)),
        ("flags", [0] * 32),
        ("flags", np.zeros(32)),
        ("patterns", None),
        ("counts", np.full((32, 1), 70_000, np.int32)),
        ("counts", np.full((32, 1), -1, np.int32)),
        ("sequence", np.zeros(3, np.uint32)),
        ("sequence", np.zeros(32, np.uint32)),
        ("sequence", np.arange(32, dtype=np.uint32)[::-1]),
        ("sequence", np.tile(np.arange(16, dtype=np.uint32), 2)),
        ("pose", np.zeros(3)),
        ("integration_time_s", 0.0),
        ("electrons_per_count", float("nan")),
        ("adc_bits", 0),
        ("adc_bits", 16.0),
        ("integration_time_s", "1 ms"),
        ("pulse_width_s", -1e-9),
        ("pulse_width_s", float("nan")),
    ],
)
def test_a_record_that_no_device_could_send_is_refused(field: str, value: object) -> None:
    with pytest.raises(InputError, match=f"^{field}: "):
        replace(make_record(), **{field: value})


def test_a_gap_in_the_numbers_of_a_named_order_is_refused(tmp_path: Path) -> None:
    """Of 32 exposures number 9 never came and 32, of the next set, stands in the last row: each
    row behind the gap would be taken for the pattern before its own.
    """
    record = make_record()
    numbers = np.delete(np.arange(33, dtype=np.uint32), 9)
    expected = "sequence: exposure 10 in row 9 follows 8, expected 9: one that was lost keeps"
    with pytest.raises(InputError, match=f"^{expected}"):
        replace(record, sequence=numbers)
    write_record(record, tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["sequence"][:] = numbers
    with pytest.raises(InputError, match=rf"r\.h5: {expected}"):
        read_record(tmp_path / "r.h5")


def test_numbers_that_are_right_are_taken() -> None:
    """Of any set, round 2**32, of one shutter of several, and of patterns that were left out: a gap
    tells how many exposures.
    """
    record = make_record()
    for start in (32, 2**32 - 5):
        numbers = ((start + np.arange(32)) % 2**32).astype(np.uint32)
        assert replace(record, sequence=numbers).n_left_out == 0
    two = replace(
        record,
        shutters=(Shutter(gate_width_s=1e-8), Shutter(gate_delay_s=1e-8, gate_width_s=1e-8)),
        **{name: np.repeat(getattr(record, name), 2, axis=0) for name in ("counts", "flags")},
        device_time_ns=np.arange(64),
        sequence=np.arange(64, dtype=np.uint32),
    )
    assert [part.n_left_out for part in two.by_shutter] == [0, 0]
    flags = two.flags.copy()
    flags[[20, 41]] = Flag.LOST  # in pairs 5 and 10
    received = replace(two, flags=flags).received
    assert (received.n_left_out, received.patterns.count) == (8, 14)
    assert [part.n_left_out for part in received.by_shutter] == [4, 4]


@pytest.mark.parametrize("rows", [[1, 0, *range(2, 32)], [31, *range(31)], list(range(31, -1, -1))])
def test_rows_in_another_order_than_their_times_are_refused(rows: list[int]) -> None:
    """Swapped, moved on by one, the wrong way round, with the numbers as they should be: an image
    of other patterns than those shown. All rows of a pattern with several shutters alike.
    """
    record = make_record()
    moved = {name: getattr(record, name)[rows] for name in ("counts", "device_time_ns")}
    with pytest.raises(InputError, match=r"^device_time_ns: .* rows are in another order"):
        replace(record, **moved)


def test_times_that_contradict_the_numbers_are_warned_of() -> None:
    """A step that is longer or shorter, a clock that stands still, one that begins anew; of lost
    exposures, behind a reset and between a device's frames it is as it may be.
    """
    record, number = make_record(), np.arange(32)

    def told(flags: object = None, **times: object) -> list[str]:
        made = replace(record, flags=np.zeros(32, np.uint8) if flags is None else flags, **times)
        return made.time_warnings

    times = record.device_time_ns
    assert not told()
    assert not told(device_time_ns=times + np.arange(32) % 5 * 3000)  # jitter
    for off_ns in (100_000, 10**10, -50_000):
        (text,) = told(device_time_ns=times + (number > 9) * off_ns)
        assert text.startswith("1 of 32 exposures begin ")
    assert "stands still" in told(device_time_ns=np.zeros(32, np.int64))[0]
    again = times - (number > 9) * 2**32  # a clock of 32 bits
    assert "runs back 1 time" in told(device_time_ns=again)[0]
    assert not told(np.where(number == 10, Flag.RESET, 0).astype(np.uint8), device_time_ns=again)
    assert not told(device_time_ns=times + number // 8 * 10**6)  # frames of 8
    lost = np.where(number == 10, Flag.LOST, 0).astype(np.uint8)
    assert not told(lost, device_time_ns=times + (number == 10) * 10**9)
    assert not replace(record, flags=lost).received.time_warnings


def test_shutters_that_are_open_in_the_same_exposure_have_its_time() -> None:
    record = make_record()
    two = replace(
        record,
        shutters=(Shutter(gate_width_s=1e-8), Shutter(gate_delay_s=1e-8, gate_width_s=1e-8)),
        **{
            name: np.repeat(getattr(record, name), 2, axis=0)
            for name in ("counts", "device_time_ns", "flags")
        },
        sequence=np.arange(64, dtype=np.uint32),
    )
    assert not two.time_warnings
    assert not two.by_shutter[1].time_warnings


def test_counts_at_the_rails_without_the_flag_are_warned_of() -> None:
    """At the top code, and at 0 where no light is more than that."""
    record = replace(make_record(), offset_counts=10.0)
    counts = np.full_like(record.counts, 100)
    counts[:3], counts[3:5] = 2**record.adc_bits - 1, 0
    flags = np.zeros(32, np.uint8)
    flags[0], flags[4] = Flag.SATURATED, Flag.LOST
    clipped = replace(record, counts=counts, flags=flags)
    assert clipped.n_at_rail == 3
    assert replace(clipped, offset_counts=0.0).n_at_rail == 2
    said = reconstruct(clipped, "zero-fill").warnings
    assert any("3 of 32 exposures stand at an end of the converter's range" in w for w in said)


@pytest.mark.parametrize(
    ("field", "value"),
    [("flags", np.full(32, 256)), ("sequence", np.arange(32) - 5)],
)
def test_numbers_that_a_file_could_not_hold_are_refused(field: str, value: np.ndarray) -> None:
    with pytest.raises(InputError, match=f"^{field}: .* expected 0 to"):
        replace(make_record(), **{field: value})


def test_what_is_no_path_and_no_compensation_is_told() -> None:
    for path in (None, 5):
        with pytest.raises(
            InputError, match=f"^path = {path}: expected the path of a ugv-spi-record"
        ):
            read_record(path)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^compensation = 3: expected a Compensation"):
        reconstruct(make_record(), compensation=3)  # type: ignore[arg-type]


def test_a_subset_of_patterns_is_kept(tmp_path: Path) -> None:
    """Any rows in any order; a set with a named order writes nothing new."""
    record = replace(make_record(), patterns=PatternSet.of(4, 4, list(range(15, -1, -1))))
    write_record(record, tmp_path / "r.h5")
    assert read_record(tmp_path / "r.h5").patterns == record.patterns
    with h5py.File(tmp_path / "r.h5", "a") as file:
        del file["patterns/subset"]
    with pytest.raises(ValueError, match=r"r\.h5: subset: missing, order 'custom' needs"):
        read_record(tmp_path / "r.h5")
