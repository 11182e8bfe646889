"""SigMF of radar records, read back by its own library; files that cannot be written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from full_disk import files_up_to
from radar_cubes import CARRIERS, STEP, WIDE, Echo, cube, track

from hardware.records import Flag, RadarRecord


@pytest.fixture(scope="module")
def plain() -> RadarRecord:
    """One burst, carrier and receiver."""
    return cube(replace(WIDE, n_slots=4), [Echo((3.0, 0.0, 0.0))])


@pytest.mark.library("sigmf")
def test_sigmf_is_read_back_by_its_own_library(plain, tmp_path: Path) -> None:
    import sigmf

    from hardware.records.sigmf import export_sigmf

    _, meta = export_sigmf(plain, tmp_path / "radar")
    file = sigmf.fromfile(str(meta))
    file.validate()
    samples = np.asarray(file.read_samples()) * 2**15  # it scales to +/- 1
    counts = plain.iq.astype(float).reshape(-1, 2)
    np.testing.assert_allclose(samples, counts[:, 0] + 1j * counts[:, 1], atol=1e-6)
    assert file.get_captures()[0]["core:frequency"] == 79e9


@pytest.mark.library("sigmf")
def test_sigmf_has_receivers_as_channels_and_says_what_is_wrong_with_slots(tmp_path: Path) -> None:
    """Three receivers, two transmitters by turns, two bursts of two carrier steps: each sample,
    each capture's place in time and each flagged slot is where a reader of SigMF looks for it.
    """
    import sigmf

    from hardware.drivers.clock import ClockModel
    from hardware.records.sigmf import export_sigmf

    record = cube(
        replace(STEP, n_slots=4),
        [Echo((6.0, 1.0, 0.0))],
        carriers_hz=CARRIERS[:2],
        pose=track(2, 0.5),
        noise_w=1e-10,
        transmitter=(0, 1),
        transmitters_m=np.array([[0, 0, 0], [0, 0.1, 0]]),
        receivers_m=np.array([[0, 0, 0], [0, 0.2, 0], [0, 0.4, 0]]),
    )
    n = STEP.n_subcarriers
    record.flags[0, 1, 2:] = Flag.OVERRUN
    record.flags[1, 0, 0] = Flag.OVERRUN | Flag.SATURATED
    clock = ClockModel(0, -1_800_000_000_000_000_000, 0.0, 0.0)  # 2027-01-15T08:00 UTC at 0
    _, meta = export_sigmf(record, tmp_path / "radar", clock.host_ns)
    file = sigmf.fromfile(str(meta))
    file.validate()
    heard = np.asarray(file.read_samples()) * 2**15
    assert heard.shape == (2 * 2 * 4 * n, 3)
    for burst, step, slot, receiver in np.ndindex(2, 2, 4, 3):
        first = ((burst * 2 + step) * 4 + slot) * n
        counts = record.iq[burst, step, slot, receiver].astype(float)
        expected = counts[:, 0] + 1j * counts[:, 1]
        np.testing.assert_allclose(heard[first : first + n, receiver], expected, atol=1e-6)
    captures = file.get_captures()
    assert [one["core:sample_start"] for one in captures] == [0, 4 * n, 8 * n, 12 * n]
    assert [one["core:frequency"] for one in captures] == [*CARRIERS[:2], *CARRIERS[:2]]
    since_ns = record.device_time_ns[:, :, 0].ravel()
    places = [round(1e-9 * int(ns) * STEP.bandwidth_hz) for ns in since_ns]
    assert [one["core:global_index"] for one in captures] == places
    assert np.any(since_ns % 1000)  # microseconds are too coarse
    assert [one["core:datetime"] for one in captures] == [
        f"2027-01-15T08:00:00.{int(ns):09d}Z" for ns in since_ns
    ]
    notes = [
        (one["core:sample_start"], one["core:sample_count"], one["core:label"])
        for one in file.get_annotations()
    ]
    assert notes == [(6 * n, 2 * n, "overrun"), (8 * n, n, "saturated, overrun")]
    assert "transmitters by turns 0, 1, symbols" in file.get_global_field("core:description")
    _, meta = export_sigmf(record, tmp_path / "no_clock")
    assert not any("core:datetime" in one for one in sigmf.fromfile(str(meta)).get_captures())


@pytest.mark.library("sigmf")
def test_sigmf_files_that_cannot_be_written_are_named(plain, tmp_path: Path) -> None:
    """As on a full disk: files may not grow beyond a limit; nothing is left."""
    from hardware.records.sigmf import export_sigmf

    with files_up_to(1000), pytest.raises(OSError, match="File too large") as refused:
        export_sigmf(plain, tmp_path / "radar")
    assert refused.value.filename == str(tmp_path / "radar.sigmf-data")
    assert not list(tmp_path.iterdir())


@pytest.mark.library("sigmf")
@pytest.mark.parametrize("kind", ["data", "meta"])
def test_a_sigmf_recording_is_never_written_over(plain, tmp_path: Path, kind: str) -> None:
    """Whichever half is there already: nothing changes, and no half of another pair joins it."""
    from hardware.records.sigmf import export_sigmf

    there = tmp_path / f"radar.sigmf-{kind}"
    there.write_bytes(b"old")
    with pytest.raises(FileExistsError, match=rf"radar\.sigmf-{kind}: exists already"):
        export_sigmf(plain, tmp_path / "radar")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]


@pytest.mark.library("sigmf")
def test_half_a_sigmf_recording_is_never_left(
    plain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The metadata cannot be written: the data goes too."""
    import sigmf

    from hardware.records.sigmf import export_sigmf

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sigmf.SigMFFile, "tofile", full)
    with pytest.raises(OSError, match="No space left"):
        export_sigmf(plain, tmp_path / "radar")
    assert not list(tmp_path.iterdir())
