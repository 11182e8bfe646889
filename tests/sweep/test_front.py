"""The designs on a Pareto front: against every pair compared, printed, as CSV and as JSON."""

import csv
import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from studies import CLOSED, write
from typer.testing import CliRunner

from twin.cli import app
from twin.errors import InputError
from twin.sweep import load_study, open_sweep, run_sweep
from twin.sweep.dataset import metrics_of
from twin.sweep.front import all_points, designs_on_front
from twin.sweep.show import plot_front

GRID = """
[grid]
"system.optics.f_number" = [0.8, 1.0, 1.4, 2.0]
"system.detector.width_m" = ["500 um", "1 mm", "3 mm"]
"link.reflectance" = [0.2, 0.8]
"""
METRICS = ("snr", "minimum_time_s")


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("front")
    study = load_study(write(folder, GRID, CLOSED))
    return run_sweep(study, out=folder / "out", workers=0).out


def test_no_other_design_beats_them_in_both(swept: Path) -> None:
    """More signal over noise and less time are better; each is compared with all others."""
    data = open_sweep(swept)
    snr, time_s = (data[name].to_numpy().ravel() for name in METRICS)

    def beats(a: int, b: int) -> bool:
        better = snr[a] > snr[b] or time_s[a] < time_s[b]
        return bool(snr[a] >= snr[b] and time_s[a] <= time_s[b] and better)

    beaten = {b for a, b in product(range(len(snr)), repeat=2) if beats(a, b)}
    designs = designs_on_front(data, *METRICS)
    assert {row["point"] for row in designs.rows} == set(range(len(snr))) - beaten
    assert designs.n_points == len(snr)


def test_each_has_the_parameters_of_its_point(swept: Path) -> None:
    data, study = open_sweep(swept), load_study(swept.parent / "study.toml")
    for row in designs_on_front(data, *METRICS).rows:
        point = study.point(row["point"])
        for name, value in point.items():
            assert row[name] == pytest.approx(value)
        place = np.unravel_index(row["point"], data["snr"].shape)
        assert row["snr"] == data["snr"].to_numpy()[place]


def test_printed_as_a_table_as_csv_and_as_json(swept: Path, tmp_path: Path) -> None:
    """All three from the same rows."""
    words = ["show", str(swept), "--metric", METRICS[0], "--front", METRICS[1]]
    words += ["--csv", str(tmp_path / "front.csv"), "--out", str(tmp_path / "front.png")]
    rows = designs_on_front(open_sweep(swept), *METRICS).rows
    shown = CliRunner().invoke(app, words, catch_exceptions=False)
    assert shown.exit_code == 0
    assert f"{len(rows)} of 24 points are on the Pareto front" in shown.stdout
    assert "3 mm" in shown.stdout
    document = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert [design["point"] for design in document["designs"]] == [row["point"] for row in rows]
    assert document["designs"][0]["snr"] == rows[0]["snr"]
    assert document["written"] == [str(tmp_path / "front.csv"), str(tmp_path / "front.png")]
    with (tmp_path / "front.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == list(rows[0])
    assert [float(row["snr"]) for row in read] == [row["snr"] for row in rows]


def test_metrics_stand_in_the_order_of_the_study(swept: Path, tmp_path: Path) -> None:
    """The first is drawn unless another is asked for; a folder of arrays has them in any order."""
    data = open_sweep(swept)
    expected = list(load_study(swept.parent / "study.toml").metrics)
    assert metrics_of(data) == expected
    assert metrics_of(data[sorted(data.data_vars)]) == expected
    words = ["show", str(swept), "--out", str(tmp_path / "first.png")]
    assert "variance of snr" in CliRunner().invoke(app, words).stdout


def test_a_front_is_of_two_metrics(swept: Path) -> None:
    words = ["show", str(swept), "--metric", "snr", "--front", "snr"]
    shown = CliRunner().invoke(app, words)
    assert isinstance(shown.exception, InputError)
    assert str(shown.exception) == "front: 'snr' stands twice, expected two metrics"
    for make in (designs_on_front, plot_front):
        with pytest.raises(InputError, match="stands twice"):
            make(open_sweep(swept), "snr", "snr")


def test_a_front_without_points_says_so(swept: Path) -> None:
    data = open_sweep(swept).load()
    designs = designs_on_front(data.assign(snr=data["snr"] * np.nan), *METRICS)
    assert designs.verdict == "no point has a number of both snr and minimum_time_s"


def test_designs_that_equal_one_on_the_front_are_counted(swept: Path) -> None:
    """One of several that are equal in both metrics is listed."""
    data = open_sweep(swept).load()
    first = {"system.optics.f_number": 0}
    for name in METRICS:  # all f-numbers as the first
        data[name] = data[name].copy(data=data[name] * 0 + data[name][first])
    designs = designs_on_front(data, *METRICS)
    n = len(designs.rows)
    assert designs.n_equal == 3 * n
    assert designs.verdict.endswith(
        f"{n} of 24 points are on the Pareto front; {3 * n} more equal one of them in both metrics"
    )
    assert not designs_on_front(open_sweep(swept), *METRICS).n_equal


def test_without_a_front_every_point_is_listed(swept: Path, tmp_path: Path) -> None:
    """Those off the front had their numbers in Python alone."""
    words = ["show", str(swept), "--csv", str(tmp_path / "points.csv")]
    words += ["--out", str(tmp_path / "snr.png")]
    shown = CliRunner().invoke(app, words, catch_exceptions=False)
    assert str(tmp_path / "points.csv") in shown.stdout
    data, study = open_sweep(swept), load_study(swept.parent / "study.toml")
    with (tmp_path / "points.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [int(row["point"]) for row in read] == list(range(study.n_points))
    assert {"snr", "minimum_time_s", "maximum_distance_m", "snr.half_width"} <= set(read[0])
    assert [float(row["snr"]) for row in read] == data["snr"].to_numpy().ravel().tolist()
    assert float(read[7]["system.optics.f_number"]) == study.point(7)["system.optics.f_number"]


def test_rows_need_no_picture(tmp_path: Path) -> None:
    """Shares of variance take 32 drawn points, a CSV file none: where it alone is asked for, it is
    written and the picture is left out with a note; who asks for the picture is refused.
    """
    ranges = '[sample.ranges]\n"link.distance_m" = {low = 1, high = 9}\n'
    sample = f'[sample]\nmethod = "sobol"\nn = 24\n{ranges}'
    study = load_study(write(tmp_path, sample, CLOSED.replace('"snr", "minimum_time_s", ', "")))
    out, path = run_sweep(study, out=tmp_path / "out", workers=0).out, tmp_path / "points.csv"
    words, reason = ["show", str(out), "--csv", str(path)], "24 drawn points are left"
    shown = CliRunner().invoke(app, words, catch_exceptions=False)
    assert f"note: no picture: maximum_distance_m: {reason}, expected 32 or more" in shown.stdout
    with path.open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 24
    assert not list(out.glob("*.png"))
    asked_metric = [*words, "--metric", "maximum_distance_m"]
    for asked in (["show", str(out)], asked_metric, [*words, "--out", "snr.png"]):
        assert reason in str(CliRunner().invoke(app, asked).exception)


def test_a_point_that_failed_says_why(swept: Path) -> None:
    data = open_sweep(swept).load()
    data["error"] = data["error"].astype("<U9")
    data["error"].to_numpy().ravel()[5] = "too far"
    rows = all_points(data)
    assert [row["point"] for row in rows if row["error"]] == [5]
