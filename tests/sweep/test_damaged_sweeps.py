"""A sweep's folder that was damaged: told with the file, and computed again by the same command."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
import xarray
from studies import CLOSED
from typer.testing import CliRunner

from twin.cli import app
from twin.files import InputError
from twin.sweep import DamagedWarning, open_sweep, run_sweep
from twin.sweep.checksums import sealed

#: The second illuminance saturates the converter: points that are void.
GRID = '[grid]\n"link.distance_m" = [2, 5]\n"system.sky.illuminance_lx" = [0, "100 klx"]\n'

#: Of Python's audit events, those that change a folder.
_WRITES = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.chmod"}


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
    with pytest.warns(DamagedWarning, match=r"points: is damaged: .* 4 points from 0 on"):
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
        with pytest.warns(DamagedWarning, match=r"journal\.jsonl: is damaged in line 1: "):
            found = open_sweep(out)
        assert found.attrs["points_done"] == 0
        assert found["snr"].isnull().all()
        journal.write_bytes(intact)
    flip(journal, intact.index(b'"camera": [') + len(b'"camera": ['), 1)  # another void point
    with pytest.warns(DamagedWarning, match=r"journal\.jsonl: is damaged in line 1: "):
        run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)


def test_a_bit_of_the_study_is_told(finished) -> None:
    path, out, _ = finished
    plan = out / "study.json"
    flip(plan, plan.read_bytes().index(b"2.0") if b"2.0" in plan.read_bytes() else 60, 0)
    shutil.rmtree(out / "results.zarr")
    for use in (lambda: open_sweep(out), lambda: run_sweep(path, out=out)):
        with pytest.raises(InputError, match=r"study\.json: is damaged \(.* put back"):
            use()


def test_a_folder_of_an_older_version_goes_on_without_checksums(finished) -> None:
    """And says so; what is seen to be damaged is one line all the same."""
    path, out, whole = finished
    for name in ("study.json", "journal.jsonl"):
        content = json.loads((out / name).read_text())
        del content["crc32"]
        (out / name).write_text(json.dumps(content) + "\n")
    (out / "points" / "checksums.npy").unlink()
    (out / "results.sha256").unlink()
    older = pytest.warns(DamagedWarning, match="without checksums, as of an older version")
    with older:
        assert open_sweep(out).identical(whole)
    for name in ("snr/.zarray", "snr/0.0", ".zattrs", ".zgroup"):
        (out / "results.zarr" / name).write_bytes(b"")
        with pytest.raises(InputError, match=r"out: results\.zarr: can't be read"):
            open_sweep(out)
        with older:
            run_sweep(path, out=out)
        assert open_sweep(out).identical(whole)
        (out / "results.sha256").unlink()
    shutil.rmtree(out / "results.zarr")
    with older:
        assert open_sweep(out).identical(whole)
    (out / "points" / "snr.npy").unlink()
    with pytest.warns(DamagedWarning, match=r"snr\.npy: is missing: .* computed again"), older:
        run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)


@pytest.mark.parametrize("damaged", [(b"}", b"{"), (b"<f8", b",f8"), (b"\x93NUM", b"PK\3\4")])
def test_the_head_of_an_array_that_is_no_python_is_one_line(finished, damaged) -> None:
    """NumPy evaluates it, and tells of a bracket that is not closed by an error of its own."""
    path, out, _ = finished
    shutil.rmtree(out / "results.zarr")
    numbers = out / "points" / "snr.npy"
    content = numbers.read_bytes()
    numbers.write_bytes(content.replace(*damaged, 1))
    with pytest.raises(InputError, match=r"snr\.npy: is damaged .*`twin sweep` again"):
        open_sweep(out)
    with pytest.warns(DamagedWarning, match=r"snr\.npy: is damaged"):
        run_sweep(path, out=out)


@pytest.mark.quick(1)
@pytest.mark.parametrize("is_finished", [True, False])
def test_a_missing_file_of_points_is_computed_again(finished, is_finished: bool) -> None:
    """Each of them, and the journal; cut short likewise."""
    path, out, whole = finished
    names = sorted(p.relative_to(out) for p in (out / "points").iterdir())
    assert len(names) == 4
    for name in (*names, Path("journal.jsonl")):
        for spoil in (Path.unlink, lambda p: p.write_bytes(p.read_bytes()[:-9])):
            if not is_finished:
                shutil.rmtree(out / "results.zarr")
            if name.name == "journal.jsonl" and spoil is not Path.unlink:
                continue  # is what a kill leaves
            spoil(out / name)
            with pytest.warns(DamagedWarning, match=rf"out/{name}: is (missing|damaged)"):
                run_sweep(path, out=out)
            assert open_sweep(out).identical(whole)
            assert json.loads((out / "journal.jsonl").read_text().splitlines()[0])


def test_without_checksums_numbers_of_points_are_those_of_the_results(finished) -> None:
    """Measured points are not lost; what the results hold otherwise is computed again."""
    path, out, whole = finished
    sums, journal = out / "points" / "checksums.npy", out / "journal.jsonl"
    sums.unlink()
    unchecked = pytest.warns(DamagedWarning, match=r"checksums\.npy: is missing: .* unchecked")
    with unchecked:
        run_sweep(path, out=out)
    assert "again" not in journal.read_text()
    sums.unlink()
    flip(out / "points" / "snr.npy", -1, 1)
    unlike = pytest.warns(DamagedWarning, match="points: is damaged: .* computed again")
    with unlike, unchecked:
        run_sweep(path, out=out)
    assert open_sweep(out).identical(whole)
    shutil.rmtree(out / "results.zarr")
    sums.unlink()
    with unchecked:
        assert open_sweep(out).identical(whole)


def test_a_study_that_is_missing_is_told_with_what_to_do(finished) -> None:
    path, out, whole = finished
    (out / "study.json").unlink()
    assert open_sweep(out).identical(whole)
    shutil.rmtree(out / "results.zarr")
    for use in (lambda: open_sweep(out), lambda: run_sweep(path, out=out)):
        with pytest.raises(InputError, match=r"out/study\.json: is missing: .* put back a copy"):
            use()


def test_lines_that_the_journal_lacks_are_told(study, tmp_path: Path, monkeypatch) -> None:
    """A kill leaves the numbers of one run of points without their line, no more."""
    monkeypatch.setattr("twin.sweep.run._CLOSED_CHUNK", 2)
    grid = '"link.distance_m" = [1, 2, 3]\n"system.sky.illuminance_lx" = [0, "100 klx"]\n'
    path, out = study(f"[grid]\n{grid}", CLOSED), tmp_path / "out"
    run_sweep(path, out=out)
    whole = open_sweep(out).load()
    shutil.rmtree(out / "results.zarr")
    journal = out / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:2]))
    assert open_sweep(out).attrs["points_done"] == 4
    journal.write_text(lines[0])
    with pytest.warns(DamagedWarning, match=r"journal\.jsonl: lacks lines"):
        assert open_sweep(out).attrs["points_done"] == 2
    for damaged in (2, 1):
        line = lines[damaged - 1]
        journal.write_text("".join(lines).replace(line, line.replace("renders", "Renders")))
        said = rf"journal\.jsonl: is damaged in line {damaged}:"
        with pytest.warns(DamagedWarning, match=said):
            run_sweep(path, out=out)
        assert open_sweep(out).identical(whole)
        shutil.rmtree(out / "results.zarr")
    assert open_sweep(out).identical(whole)  # nothing is left to be warned of
    with journal.open("a") as file:  # killed as it began to compute damaged points again
        file.write(json.dumps(sealed({"again": [0, 1, 2, 3, 4, 5]})) + "\n")
    assert open_sweep(out).attrs["points_done"] == 0


def test_damaged_checksums_of_the_results_are_told_by_their_line(finished) -> None:
    """Whatever name such a line holds is none of a file."""
    _, out, whole = finished
    sums = out / "results.sha256"
    intact = sums.read_bytes()
    names = {p.relative_to(out).as_posix() for p in (out / "results.zarr").rglob("*")}
    begins = intact.index(b"\n") + 1  # of line 2
    for byte in range(begins, intact.index(b"\n", begins) + 1, 3):
        for bit in (0, 5, 7):
            flip(sums, byte, bit)
            with pytest.raises(InputError, match=r"results\.sha256.* line 2|is missing") as told:
                open_sweep(out)
            name = str(told.value).removeprefix(f"{out}: ").split(":")[0]
            assert name in names | {"results.sha256"}
            sums.write_bytes(intact)
    for cut in (0, begins, len(intact) - 1):
        sums.write_bytes(intact[:cut])
        with pytest.raises(InputError, match=r"results\.sha256: is damaged: lacks "):
            open_sweep(out)
    sums.write_bytes(intact)
    assert open_sweep(out).identical(whole)


@pytest.mark.parametrize("is_finished", [True, False])
def test_rows_of_a_sweep_are_read_without_writing_into_its_folder(
    finished, tmp_path: Path, is_finished: bool
) -> None:
    """As of another user's, or of an archive: no file there is opened for writing or removed."""
    _, out, _ = finished
    if not is_finished:
        shutil.rmtree(out / "results.zarr")
    for path in out.rglob("*.npy"):
        path.chmod(0o444)
    changed, is_watched = [], True

    def watch(event: str, arguments: tuple) -> None:
        if is_watched and event in _WRITES:
            is_write = event != "open" or (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR)
            if is_write and str(arguments[0]).startswith(str(out)):
                changed.append((event, arguments))

    sys.addaudithook(watch)  # there is no way to remove one
    try:
        words = ["show", str(out), "--csv", str(tmp_path / "points.csv")]
        shown = CliRunner().invoke(app, words, catch_exceptions=False)
    finally:
        is_watched = False
    assert shown.exit_code == 0
    assert len((tmp_path / "points.csv").read_text().splitlines()) == 5
    assert not changed


def test_a_picture_without_a_place_keeps_nobody_from_the_rows(finished, tmp_path: Path) -> None:
    """In a folder that can only be read a picture that is asked for is left out with a note."""
    _, out, _ = finished
    (out / "snr-minimum_time_s.png").mkdir()
    words = ["show", str(out), "--metric", "snr", "--front", "minimum_time_s"]
    rows = ["--csv", str(tmp_path / "front.csv")]
    shown = CliRunner().invoke(app, words + rows, catch_exceptions=False)
    assert "note: no picture: " in shown.stdout
    assert (tmp_path / "front.csv").read_text().count("\n") == 2
    assert isinstance(CliRunner().invoke(app, words).exception, OSError)


def test_void_points_are_no_points_that_a_warning_is_of(study, tmp_path: Path) -> None:
    """They are told by themselves: there is no figure that the warning could be of."""
    grid = '[grid]\n"link.distance_m" = [2, 5]\n"system.sky.illuminance_lx" = [0, "100 klx"]\n'
    path, out = study(grid, 'model = "closed-form"\nmetrics = ["snr"]\n'), tmp_path / "out"
    run_sweep(path, out=out)
    journal = out / "journal.jsonl"
    entry = json.loads(journal.read_text())
    void = entry["void"]["camera"]
    assert len(void) == 2
    spoken = {"points": [0, 1, 2, 3], "first": "so it is"}
    del entry["crc32"]
    journal.write_text(json.dumps(sealed({**entry, "warnings": {"kind": spoken}})) + "\n")
    shutil.rmtree(out / "results.zarr")
    csv = ["show", str(out), "--csv", str(tmp_path / "points.csv")]
    for words, n in ((csv, 2), ([*csv, "--void"], 4)):
        shown = CliRunner().invoke(app, words, catch_exceptions=False)
        assert f"kind: {n} points, the first of the sweep: so it is" in shown.stderr
        assert ("note: 2 of 4 points void" in shown.stdout) == (n == 2)


def test_damage_is_a_warning_of_the_commands(finished, tmp_path: Path) -> None:
    """A line of its own, in the document too; of a quiet command as well."""
    path, out, _ = finished
    shutil.rmtree(out / "results.zarr")
    (out / "journal.jsonl").unlink()
    show = ["show", str(out), "--csv", str(tmp_path / "points.csv"), "--quiet"]
    for words in (show, ["sweep", str(path), "--out", str(out), "--json"]):
        shown = CliRunner().invoke(app, words, catch_exceptions=False)
        assert f"warning: {out}/journal.jsonl: is missing: points that" in shown.stderr
    assert "journal.jsonl: is missing" in json.loads(shown.stdout)["warnings"][0]
