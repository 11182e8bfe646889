"""A sweep's folder that was damaged: told with the file, and computed again by the same command."""

import json
import shutil
from pathlib import Path

import pytest
import xarray
from studies import CLOSED

from twin.files import InputError
from twin.sweep import open_sweep, run_sweep

#: The second illuminance saturates the converter: points that are void.
GRID = '[grid]\n"link.distance_m" = [2, 5]\n"system.sky.illuminance_lx" = [0, "100 klx"]\n'


@pytest.fixture
def finished(study, tmp_path: Path) -> tuple[Path, Path, xarray.Dataset]:
    """Study, folder and results of a sweep of four points, two of which are void."""
    path, out = study(GRID, CLOSED), tmp_path / "out"
    run_sweep(path, out=out)
    return path, out, open_sweep(out).load()


def flip(path: Path, byte: int, bit: int = 0) -> None:
    """One bit of a file; bytes from its end are negative."""
    content = bytearray(path.read_bytes())
    content[byte] ^= 1 << bit
    path.write_bytes(content)


def test_a_damaged_file_of_the_results_is_named_and_written_again(finished) -> None:
    """Each of them: numbers, marks of void points, shapes, units; damaged, cut short, missing."""
    path, out, whole = finished
    assert whole["void"].sum() == 2
    names = [p.relative_to(out) for p in (out / "results.zarr").rglob("*") if p.is_file()]
    assert any(name.parent.name == "void" and name.name[0] != "." for name in names)
    kept = out.with_name("kept")
    shutil.copytree(out, kept)
    for name in names:
        for spoil in (lambda p: flip(p, -1), lambda p: p.write_bytes(b""), Path.unlink):
            spoil(out / name)
            with pytest.raises(InputError, match=f"out: {name}: is .*`twin sweep` again"):
                open_sweep(out)
            shutil.copy(kept / name, out / name)
    assert open_sweep(out).identical(whole)
    shutil.rmtree(out / "results.zarr" / "void")
    run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)


@pytest.mark.parametrize("byte", [-1, 128 + 6, -9])
@pytest.mark.parametrize("name", ["snr", "checksums"])
def test_damaged_numbers_of_points_are_told_and_computed_again(
    finished, name: str, byte: int
) -> None:
    path, out, whole = finished
    shutil.rmtree(out / "results.zarr")
    flip(out / "points" / f"{name}.npy", byte, 4)
    with pytest.raises(InputError, match=r"points: is damaged: .*`twin sweep` again"):
        open_sweep(out)
    run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)


def test_no_bit_of_the_journal_changes_the_results(finished) -> None:
    """Points of a damaged line are not done, and are computed again."""
    path, out, whole = finished
    shutil.rmtree(out / "results.zarr")
    journal = out / "journal.jsonl"
    intact = journal.read_bytes()
    for byte in range(0, len(intact), 7):
        flip(journal, byte)
        assert open_sweep(out).attrs["points_done"] in (0, 4)
        assert open_sweep(out)["snr"].isnull().all() or open_sweep(out).identical(whole)
        journal.write_bytes(intact)
    flip(journal, intact.index(b'"camera": [') + len(b'"camera": ['), 1)  # another void point
    run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)


def test_a_bit_of_the_study_is_told(finished) -> None:
    path, out, _ = finished
    plan = out / "study.json"
    flip(plan, plan.read_bytes().index(b"2.0") if b"2.0" in plan.read_bytes() else 60, 0)
    shutil.rmtree(out / "results.zarr")
    for use in (lambda: open_sweep(out), lambda: run_sweep(path, out=out)):
        with pytest.raises(InputError, match=r"study\.json: (is damaged|can't be read)"):
            use()


def test_a_folder_of_an_older_version_goes_on_without_checksums(finished) -> None:
    """What is seen to be damaged is one line all the same."""
    path, out, whole = finished
    for name in ("study.json", "journal.jsonl"):
        content = json.loads((out / name).read_text())
        del content["crc32"]
        (out / name).write_text(json.dumps(content) + "\n")
    (out / "points" / "checksums.npy").unlink()
    (out / "results.sha256").unlink()
    assert open_sweep(out).identical(whole)
    for name in ("snr/.zarray", "snr/0.0", ".zattrs", ".zgroup"):
        (out / "results.zarr" / name).write_bytes(b"")
        with pytest.raises(InputError, match=r"out: results\.zarr: can't be read"):
            open_sweep(out)
        run_sweep(path, out=out)
        assert open_sweep(out).identical(whole)
        (out / "results.sha256").unlink()


def test_the_head_of_an_array_that_is_no_python_is_one_line(finished) -> None:
    """NumPy evaluates it, and tells of a bracket that is not closed by an error of its own."""
    path, out, _ = finished
    shutil.rmtree(out / "results.zarr")
    numbers = out / "points" / "snr.npy"
    content = numbers.read_bytes()
    numbers.write_bytes(content.replace(b"}", b"{", 1))
    with pytest.raises(InputError, match=r"snr\.npy: is damaged"):
        run_sweep(path, out=out)
