"""A point of a sweep as a system of one's own: the same values, and the command that runs it."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from studies import CLOSED, SMALL, write
from typer.testing import CliRunner

from twin.cli import app
from twin.errors import InputError
from twin.radar.device.design import load_radar
from twin.sweep import load_study, open_sweep, run_sweep
from twin.sweep.chosen import best_point, chosen, write_chosen
from twin.sweep.front import designs_on_front
from twin.sweep.inputs import inputs_of
from twin.sweep.names import CLOSED_FORM, RENDERED, Named
from twin.sweep.setup import system_of
from twin.sweep.store import create_or_resume
from twin.system import load_system

MINE = 'base = "workable"\n[readout]\nread_noise_e = { value = 900, assumed = "a guess" }\n'
GRID = """
system = "parts/mine.toml"
[grid]
"system.optics.f_number" = [0.8, 1.4]
"link.reflectance" = [0.2, 0.8]
[[zip]]
"system.detector.width_m" = ["500 um", "3 mm"]
"system.detector.dark_current_a" = ["1 nA", "12 nA"]
[sample]
method = "sobol"
n = 16
[sample.ranges]
"system.emitter.line_fwhm_m" = { low = "60 nm", high = "120 nm" }
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("chosen")
    (folder / "parts").mkdir()
    (folder / "parts" / "mine.toml").write_text(MINE)
    study = load_study(write(folder, GRID, CLOSED))
    return run_sweep(study, out=folder / "out", workers=0).out


def show(*words: object):
    return CliRunner().invoke(app, ["show", *map(str, words)])


def test_a_saved_point_is_the_system_that_was_swept(swept: Path, tmp_path: Path) -> None:
    """Every value to the last bit, above a file of one's own that lies elsewhere; what was swept
    counts as assumed, with the point it is from.
    """
    study = load_study(swept.parent / "study.toml")
    inputs = inputs_of(study)
    for point in (0, 5, study.n_points - 1):
        path = tmp_path / f"{point}.toml"
        found = chosen(swept, point, path)
        write_chosen(found)
        saved = load_system(path)
        expected = system_of(study, study.point(point), inputs)
        assert [(n, v.value) for n, v in saved.values()] == [
            (n, v.value) for n, v in expected.values()
        ]
        assert saved.name == str(point)
        assert saved.detector.width_m.assumed == f"out, point {point}"
        assert saved.readout.read_noise_e.assumed == "a guess"
    assert found.left_out == (f"link.reflectance = {study.point(point)['link.reflectance']:g}",)


def test_the_best_point_is_that_of_most_or_least(swept: Path) -> None:
    data = open_sweep(swept)
    snr, time_s = (data[name].to_numpy().ravel() for name in ("snr", "minimum_time_s"))
    assert snr[best_point(data, "snr").point] == snr.max()
    assert time_s[best_point(data, "minimum_time_s").point] == time_s.min()


#: Of these less is better: what spoils an image, and what one waits for.
LESS = {
    "background_e", "noise_e", "saturated", "minimum_time_s", "range_error_m", "background_e_per_s"
}  # fmt: skip


def test_every_metric_says_itself_whether_more_or_less_is_better(tmp_path: Path) -> None:
    """None by a default: sunlight of a closed form had been best where there was most of it."""
    with pytest.raises(TypeError, match="better"):
        Named("1", "a metric that does not say")  # type: ignore[call-arg]
    for known in (RENDERED, CLOSED_FORM):
        assert {name for name, one in known.items() if one.better == "less"} == LESS & known.keys()
    head = 'model = "closed-form"\nmetrics = ["background_e_per_s", "signal_e_per_s"]\n'
    study = load_study(write(tmp_path, '[grid]\n"system.optics.f_number" = [1.4, 0.8, 2]\n', head))
    data = open_sweep(run_sweep(study, out=tmp_path / "out", workers=0).out)
    for name, best in (("background_e_per_s", 2), ("signal_e_per_s", 1)):
        assert best_point(data, name).point == best
    assert len(designs_on_front(data, *study.metrics).rows) == 3  # a trade, of each other


def test_points_that_are_void_are_not_the_best_and_near_ones_are_told(swept: Path) -> None:
    """Of those within the errors of the best each is counted."""
    data = open_sweep(swept).load()
    order = np.argsort(-data["snr"].to_numpy().ravel())
    shape, dims = data["snr"].shape, data["snr"].dims
    void = np.zeros(data["snr"].size, bool)
    void[order[0]] = True
    data["void"] = (dims, void.reshape(shape))
    data["snr"].attrs["void"] = "void"
    assert best_point(data, "snr").point == order[1]
    assert best_point(data, "snr", void=True).point == order[0]
    snr = data["snr"].to_numpy().ravel()
    error = 0.51 * (snr[order[1]] - snr[order[3]])
    data["snr.standard_error"] = (dims, np.zeros(shape))
    data["snr.systematic"] = (dims, np.full(shape, error))
    near = int((snr[order[2:]] >= snr[order[1]] - 2 * error).sum())
    assert near >= 2
    assert best_point(data, "snr").n_as_good == near


@pytest.mark.parametrize(("unknown", "equal"), [("all", 3), ("all", 1), ("one", 1)])
def test_of_errors_that_are_not_known_nothing_is_within(
    swept: Path, unknown: str, equal: int
) -> None:
    """As of a metric of one's own that gives a number alone: exact ties are counted, and the best
    point with them. On 43f3f9f7 "-1 more within the model's errors".
    """
    data = open_sweep(swept).load()
    order = np.argsort(-data["snr"].to_numpy().ravel())
    data["snr"].to_numpy().ravel()[order[:equal]] = 1e6
    error = np.full(data["snr"].shape, np.nan if unknown == "all" else 1e5)
    error.ravel()[order[5]] = np.nan
    for kind in ("standard_error", "systematic"):
        data[f"snr.{kind}"] = (data["snr"].dims, error)
    best = best_point(data, "snr")
    assert (best.n_as_good, best.errors_known) == (equal - 1, False)
    more = ", 2 more exactly equal" if equal == 3 else ""
    assert str(best) == f"point {best.point}; the model's errors are not known{more}"


def test_the_command_saves_it_and_says_how_it_is_run(swept: Path, tmp_path: Path) -> None:
    words = [swept, "--metric", "snr", "--save", tmp_path / "best.toml", "--json"]
    document = json.loads(show(*words).stdout)
    data = open_sweep(swept)
    assert document["point"] == best_point(data, "snr").point
    assert document["written"] == [str(tmp_path / "best.toml")]
    assert shlex.split(document["run"]) == [
        "twin", "budget", "--system", str(tmp_path / "best.toml")
    ]  # fmt: skip
    assert document["left_out"] == ["link.reflectance = 0.8"]
    assert show(*words).exit_code == 0  # the same again
    other = show(*words, "--save", tmp_path / "other.toml", "--point", 3)
    assert json.loads(other.stdout)["point"] == 3
    assert "out, point 3" in (tmp_path / "other.toml").read_text()


def test_a_file_that_says_something_else_is_not_written_over(swept: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "paper"\n')
    refused = show(swept, "--metric", "snr", "--save", mine)
    assert f"{mine}: exists already, expected a new file" in str(refused.exception)
    assert mine.read_text() == 'base = "paper"\n'


def test_what_cannot_be_saved_is_said(swept: Path, tmp_path: Path) -> None:
    refused = show(swept, "--point", 3)
    assert "--point: chooses the point to save; expected --save" in str(refused.exception)
    for option in ("--save", "--csv", "--out"):
        empty = show(swept, option, "")
        assert str(empty.exception) == f"{option}: is empty, expected a file to write"
    far = show(swept, "--save", tmp_path / "best.toml", "--point", 128)
    assert "point = 128: expected 0 to 127" in str(far.exception)
    assert not (tmp_path / "best.toml").exists()
    study = load_study(write(tmp_path, '[grid]\n"link.distance_m" = [2, 5]\n', CLOSED))
    out = run_sweep(study, out=tmp_path / "out", workers=0).out
    with pytest.raises(InputError, match="differs in neither system nor radar: link"):
        chosen(out, 0, tmp_path / "best.toml")


def test_a_design_that_no_command_takes_is_not_written(tmp_path: Path) -> None:
    """Of a line sensor the closed form takes one pixel; with the study's emitter of many columns
    it is no system. What was there stays.
    """
    head = CLOSED + '[grid]\n"system.detector.part" = ["fga015", "g9201-256-paper"]\n'
    out = run_sweep(load_study(write(tmp_path, "", head)), out=tmp_path / "out", workers=0).out
    path = tmp_path / "best.toml"
    refused = show(out, "--save", path, "--point", 1)
    assert f"{path}: a line sensor takes its columns itself" in str(refused.exception)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "study.toml"]
    assert show(out, "--save", path, "--point", 0).exit_code == 0
    assert load_system(path).name == "best"


def test_a_base_that_changed_since_is_refused(tmp_path: Path) -> None:
    """Its values would not be those of the point."""
    (tmp_path / "parts").mkdir()
    mine = tmp_path / "parts" / "mine.toml"
    mine.write_text(MINE)
    out = run_sweep(load_study(write(tmp_path, GRID, CLOSED)), out=tmp_path / "out", workers=0).out
    mine.write_text(MINE.replace("900", "901"))
    with pytest.raises(InputError, match=r"system parts/mine.toml: is not, or no longer, a file"):
        chosen(out, 0, tmp_path / "best.toml")


def test_radar_parts_and_options_of_the_command(tmp_path: Path) -> None:
    """A study need not have run for its points to be written down."""
    text = SMALL.replace('["snr_median", "psnr_db"]', '["psnr_db", "range_error_m"]')
    text += '"processing.method" = "tv"\n"fidelity.tolerance" = "0.5"\n"seed" = 7\n'
    text = text.replace('"fidelity.samples" = 4\n"fidelity.max_depth" = 1\n', "")
    text += (
        '[grid]\n"radar.front_end.noise_figure_db" = [12, 15]\n"scene.rig.x_m" = [0.0, 1.0]\n'
        '"system.detector.part" = ["fga015", "ingaas-apd-200"]\n'
    )
    folder = tmp_path / "out"
    path = write(tmp_path, text, "")
    study = load_study(path)
    create_or_resume(study, folder, 16, inputs_of(study), {})
    point = next(
        i
        for i in range(study.n_points)
        if study.point(i)["system.detector.part"] == "ingaas-apd-200"
        and study.point(i)["radar.front_end.noise_figure_db"] == 15
        and study.point(i)["scene.rig.x_m"] == 1
    )
    found = chosen(folder, point, tmp_path / "best.toml")
    write_chosen(found)
    assert load_radar(tmp_path / "best-radar.toml").front_end.noise_figure_db.value == 15
    expected = system_of(study, study.point(point), inputs_of(study))
    assert load_system(tmp_path / "best.toml").detector == expected.detector
    assert found.left_out == ("scene.rig.x_m = 1 m",)
    words = shlex.split(found.command)
    assert words[:3] == ["twin", "run", "table1"]
    for option, value in (
        ("--system", str(tmp_path / "best.toml")),
        ("--radar", str(tmp_path / "best-radar.toml")),
        ("--method", "tv"),
        ("--tolerance", "0.5"),
        ("--seed", "7"),
    ):
        assert words[words.index(option) + 1] == value
