"""Sweeps to a tolerance: who shares a render, how fine it is, and what says the tolerance."""

import math
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from test_sweep import assert_is_what_one_process_gives
from typer.testing import CliRunner

from twin.camera import capture
from twin.camera.chain import Chain
from twin.camera.intervals import capture_intervals
from twin.camera.light import render
from twin.camera.permitted_error import PermittedError
from twin.cli import app
from twin.fidelity import PRESETS, Fidelity, LightFidelity, Tolerance, knobs_of
from twin.files import InputError
from twin.radar import load_radar
from twin.sweep import Study, load_study, open_sweep, run_sweep, shared_light
from twin.sweep.accuracy import with_accuracy
from twin.sweep.evaluate import evaluate_chunk, outcome_of
from twin.sweep.inputs import Held, inputs_of
from twin.sweep.run import points_in_a_run
from twin.sweep.setup import setup

#: Knobs of a study that names none.
STILL = knobs_of(None).with_(motion_tolerance=None)
#: Lit faces at several depths; sensors of noise between 1 and some 30 times the least.
HEAD = """
scene = "yard"
metrics = ["snr_median", "psnr_db"]
[set]
"system.emitter.rows" = 16
"system.emitter.columns" = 16
"system.acquisition.n_patterns" = 256
"""
SENSORS = (
    '[grid]\n"scene.rig.x_m" = [0.0, 0.5]\n"system.sky.illuminance_lx" = [1e5, 0.0, 1e3]\n'
    '"system.readout.read_noise_e" = [3e4, 1e3, 5e3]\n'
)


@pytest.fixture(autouse=True)
def _nothing_rendered_before(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_lights", "_groups", "_strictest", "_chains"):
        monkeypatch.setattr(shared_light, name, Held(32))
    monkeypatch.setattr("twin.sweep.evaluate._CAPTURES", Held(32))


@pytest.mark.thorough
def test_points_that_differ_after_the_light_share_one_render_within_what_each_permits(
    study,
) -> None:
    """Two places of the rig, nine sensors: two renders, each that of the sensor with the least
    noise, as a capture of it renders it; and every sensor's error is within its own tolerance.
    """
    plan = load_study(study(SENSORS, HEAD))
    chunk = evaluate_chunk(plan, 0, plan.n_points)
    assert not chunk.errors
    assert chunk.renders == 2
    inputs, least = inputs_of(plan), []
    for index in range(9):
        made = setup(plan, plan.point(index), inputs)
        assert made.fidelity == STILL
        light = shared_light.light_of(plan, index, made, inputs)
        chain = Chain.of(made.system, made.scene.sun)
        permitted = PermittedError(chain, light, made.fidelity).of(light.light.cells)
        assert np.sqrt(np.mean((light.light.error / permitted) ** 2)) <= 1
        least.append(np.sqrt(np.mean(permitted**2)))
    strictest = int(np.argmin(least))
    assert (plan.point(strictest)["system.sky.illuminance_lx"]) == 0
    made = setup(plan, plan.point(strictest), inputs)
    alone = capture(made.scene, made.system, fidelity=STILL, seed=made.seed)
    counts = outcome_of(plan, strictest, inputs).capture.record.counts
    np.testing.assert_array_equal(counts, alone.record.counts)


def test_points_that_share_light_are_of_one_run() -> None:
    """Of the how-to's walls, 18 points in each of two airs: runs of 16 had made two workers render
    each light. Sets of fewer points are whole in a run; larger ones are divided, so that no worker
    waits, and so are those of fewer renders than workers.
    """

    def run_of(n_workers: int | None, n: int = 9, **fidelity: float | str) -> int:
        study = Study(
            name="walls",
            metrics=["psnr_db"],
            set={f"fidelity.{name}": value for name, value in fidelity.items()},
            grid={
                "system.readout.read_noise_e": [float(1 + i) for i in range(n)],
                "weather.part": ["clear-air", "fog-200m"],
                "processing.method": ["zero-fill", "lmmse"],
            },
        )
        assert study.n_points == 4 * n
        return points_in_a_run(study, n_workers)

    assert run_of(2) == run_of(1) == 18
    assert (run_of(1, 3), run_of(2, 3)) == (12, 6)  # both sets of six; one for each worker
    assert run_of(2, motion_tolerance="none") == 18
    assert {run_of(3), run_of(None), run_of(2, 17), run_of(2, motion_tolerance=0.1)} == {16}


@pytest.mark.thorough
def test_a_sensor_in_the_dark_leaves_nothing_out_of_the_suns_light_of_others(study) -> None:
    """The quietest sensor, to whose noise the light is rendered, sees no sun. Sun and noise of
    those that share its light are all the same those of many paths, within 1.5 times their
    intervals (of one light that all share, 2.9 standard errors: false alarm 4e-3). 6 % of the
    yard's sun is indirect.
    """
    plan = load_study(study(SENSORS, HEAD))
    inputs, fine = inputs_of(plan), Fidelity(samples=1024, max_depth=12)
    for index in range(9):
        outcome = outcome_of(plan, index, inputs)
        made, stated = outcome.setup, capture_intervals(outcome.capture)
        true = capture_intervals(capture(made.scene, made.system, fidelity=fine, seed=99))
        assert stated.background_e.half_width <= 0.05 * stated.background_e.value
        for one, other in (
            (stated.background_e, true.background_e),
            (stated.noise_e, true.noise_e),
        ):
            assert abs(one.value - other.value) <= 1.5 * (one.half_width + other.half_width)


@pytest.mark.thorough
def test_bits_do_not_depend_on_which_point_comes_first(study) -> None:
    plan = load_study(study(SENSORS, HEAD))
    together = evaluate_chunk(plan, 0, plan.n_points).values["psnr_db"]
    for index in (17, 4):
        for held in (shared_light._lights, shared_light._groups, shared_light._strictest):
            held.__init__(32)
        alone = evaluate_chunk(plan, index, index + 1).values["psnr_db"]
        assert alone[0] == together[index]


def test_a_sensor_that_a_wall_would_not_tell_is_rendered_for(
    study, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The choice by a wall is a guess, which the error of the scene's own light puts right."""
    monkeypatch.setattr(shared_light, "_strictest_by_a_wall", lambda made, chains: 0)
    plan = load_study(study(SENSORS, HEAD))
    inputs = inputs_of(plan)
    made = setup(plan, plan.point(0), inputs)
    key = shared_light.light_key(made, inputs)
    sensors = shared_light._sensors(plan, plan.same_render(0), inputs)[key]
    shared = shared_light._within_all(made, sensors)
    assert max(shared.over.values()) <= 1
    assert len(sensors) == 9


def test_an_error_above_what_a_point_permits_is_told(study) -> None:
    """Of that point alone, in its own noise."""
    plan = load_study(study(SENSORS, HEAD))
    inputs = inputs_of(plan)
    noisy, quiet = (setup(plan, plan.point(i), inputs) for i in (0, 4))
    rendered = render(
        noisy.scene, noisy.system, fidelity=noisy.fidelity, seed=np.random.SeedSequence(1)
    )
    sensors = [(made.system, made.scene.sun) for made in (noisy, quiet)]
    over = {one: shared_light._over(rendered, Chain.of(*one), quiet.fidelity) for one in sensors}
    assert over[sensors[0]] <= 1 < over[sensors[1]]
    shared = shared_light._Shared(rendered, over)
    assert shared.of(noisy).warnings == rendered.warnings
    told = [str(w) for w in shared.of(quiet).warnings if w not in rendered.warnings]
    assert len(told) == 1
    assert f"{0.2 * over[sensors[1]]:.2g} of a pixel's noise" in told[0]


def test_a_point_that_fails_leaves_the_others(study) -> None:
    plan = load_study(study('[grid]\n"system.optics.f_number" = [1.0, -1.0, 2.0]\n', HEAD))
    chunk = evaluate_chunk(plan, 0, 3)
    assert list(chunk.errors) == [1]
    assert np.isfinite(chunk.values["psnr_db"][[0, 2]]).all()


@pytest.mark.whole
def test_results_to_a_tolerance_do_not_depend_on_workers(study, tmp_path: Path) -> None:
    path = study(SENSORS, HEAD)
    run_sweep(path, out=tmp_path / "out", workers=2)
    assert_is_what_one_process_gives(open_sweep(tmp_path / "out"), path)


def test_who_shares_a_render_follows_from_the_study() -> None:
    """Equal values of what may be rendered anew, wherever they stand."""
    study = Study(
        name="s",
        metrics=["psnr_db"],
        grid={"scene.rig.x_m": [0.0, 1.0], "processing.method": ["zero-fill", "lmmse"]},
        zip=[
            {"scene.rig.y_m": [0.0, 0.0, 1.0], "system.readout.read_noise_e": [1e3, 2e3, 1e3]},
        ],
    )
    assert study.shape == (2, 3, 2)
    assert study.same_render(1).tolist() == [0, 1, 2, 3]
    assert study.same_render(11).tolist() == [10, 11]
    assert Study(name="s", metrics=["psnr_db"]).same_render(0).tolist() == [0]


def test_points_that_are_only_processed_otherwise_share_a_record(study) -> None:
    plan = load_study(study('[grid]\n"processing.method" = ["zero-fill", "lmmse"]\n', HEAD))
    inputs = inputs_of(plan)
    one, other = (outcome_of(plan, index, inputs) for index in range(2))
    assert one.capture is other.capture
    assert one.score.psnr_db != other.score.psnr_db


def _knobs(plan: Study) -> Fidelity:
    return setup(plan, plan.point(0), inputs_of(plan)).fidelity


def test_what_says_the_accuracy() -> None:
    """A study's preset or tolerance; its knobs over that, over `standard` where it names none."""
    assert _knobs(Study(name="s", metrics=["psnr_db"])) == STILL
    named = Study(name="s", metrics=["psnr_db"], set={"fidelity.motion_tolerance": 0.3})
    assert _knobs(named) == Fidelity(motion_tolerance=0.3)
    for said, expected in (
        ({"fidelity.preset": "draft"}, PRESETS["draft"]),
        ({"fidelity.tolerance": 0.1}, Tolerance(0.1).knobs()),
        ({"fidelity.tolerance": "0.1, 10 %"}, Tolerance(0.1, cell_share=0.1).knobs()),
        ({"fidelity.max_depth": 1}, Fidelity(max_depth=1)),
        (
            {"fidelity.tolerance": 0.1, "fidelity.noise": "none"},
            Tolerance(0.1).knobs().with_(noise="none"),
        ),
    ):
        knobs = _knobs(Study(name="s", metrics=["psnr_db"], set=said))
        assert knobs == expected.with_(motion_tolerance=None)
    echo = Study(
        name="s", metrics=["range_error_m"], set={"fidelity.tolerance": "0.2, 0.5 dB, 2 mm"}
    )
    bandwidth_hz = load_radar("hybrid-79").total_bandwidth_hz
    asked = Tolerance(0.2, echo_db=0.5, distance_m=2e-3).knobs(bandwidth_hz)
    assert _knobs(echo) == asked.with_(motion_tolerance=None)


@pytest.mark.parametrize(
    ("said", "complaint"),
    [
        ({"fidelity.preset": "draft", "fidelity.tolerance": 0.1}, "expected one of them"),
        ({"fidelity.samples": 4, "fidelity.tolerance": 0.1}, "samples: has no effect beside"),
        ({"fidelity.tolerance": 100.0}, "100 of the noise: expected 0.0001 to 10"),
        ({"fidelity.tolerance": "0.1 s"}, "tolerance: '0.1 s'"),
    ],
)
def test_what_no_accuracy_can_be_is_told(said: dict, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        Study(name="s", metrics=["psnr_db"], set=said)


@pytest.mark.quick(1)
@pytest.mark.parametrize("asked", ["0.1, 0.5 dB", "2 mm"])
def test_an_error_of_the_radar_is_refused_where_no_metric_looks_at_it(
    study, tmp_path: Path, asked: str
) -> None:
    """Before any work, whether the study sets it, varies it, or is asked for it."""
    lens, out = '[grid]\n"system.optics.f_number" = [1.0, 2.0]\n', tmp_path / "out"
    said = f'"fidelity.tolerance" = "{asked}"\n'
    varied = f'{lens}"fidelity.tolerance" = ["0.1", "{asked}"]\n'
    refused = r"looks at the radar: tolerance: .* without a radar"
    for path, fidelity in (
        (study(lens, HEAD + said), None),
        (study(varied, HEAD, name="varied"), None),
        (study(lens, HEAD, name="plain"), Tolerance.of(asked)),
    ):
        with pytest.raises(InputError, match=refused) as told:
            run_sweep(path, out=out, workers=0, fidelity=fidelity)
        assert str(told.value).startswith(f"{path}: fidelity.tolerance = '")
    command = ["sweep", str(study(lens, HEAD)), "--out", str(out), "--tolerance", asked]
    assert "without a radar" in str(CliRunner().invoke(app, command).exception)
    assert not out.exists()


def test_what_is_asked_for_takes_the_place_of_what_the_study_sets(study, tmp_path: Path) -> None:
    """Not of its knobs, and not of what it varies; another one does not go on in a folder."""
    head = HEAD + '"fidelity.preset" = "standard"\n"fidelity.noise" = "none"\n'
    path, out = study('[grid]\n"scene.rig.x_m" = [0.0]\n', head), tmp_path / "out"
    run_sweep(path, out=out, workers=0, fidelity=Tolerance(0.5))
    stored = open_sweep(out).attrs["study"]
    assert '"fidelity.tolerance": 0.5' in stored
    assert "preset" not in stored
    assert '"fidelity.noise": "none"' in stored
    run_sweep(path, out=out, workers=0, fidelity=Tolerance(0.5))
    with pytest.raises(InputError, match=r"of fidelity\.tolerance = 0\.5, not 0\.1; expected the"):
        run_sweep(path, out=out, workers=0, fidelity=0.1)
    run_sweep(path, out=tmp_path / "text", workers=0, fidelity=Tolerance(0.5, cell_share=0.01))
    assert '"fidelity.tolerance": "0.5, 1.0 %"' in open_sweep(tmp_path / "text").attrs["study"]
    varied = study('[grid]\n"fidelity.tolerance" = [0.1, 0.2]\n', HEAD)
    with pytest.raises(InputError, match=r"varies fidelity\.tolerance"):
        run_sweep(varied, out=tmp_path / "other", fidelity="draft")
    closed = Study(name="c", model="closed-form", metrics=["snr"])
    with pytest.raises(InputError, match="closed form does not depend on it"):
        run_sweep(closed, out=tmp_path / "other", fidelity=0.1)


def test_the_command_takes_a_tolerance_or_a_time(
    study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a time allows is measured once: the same command goes on with it."""
    from twin.trade.time_limit import TimedFidelity, TimedShare

    path = str(study('[grid]\n"system.optics.f_number" = [1.0, 2.0]\n', HEAD))
    measured = iter((0.5, 1.0))

    def fidelity_within(*args: object, **options: object) -> TimedFidelity:
        share = next(measured)
        return TimedFidelity(Tolerance(share).knobs(), TimedShare(share, 0.1), None)

    monkeypatch.setattr("twin.trade.fidelity_within", fidelity_within)

    def sweep(*options: str) -> str:
        found = CliRunner().invoke(app, ["sweep", path, "--workers", "0", *options])
        if isinstance(found.exception, InputError):
            return str(found.exception)
        return found.output

    assert "expected one of them" in sweep("--tolerance", "0.1", "--within", "1 s")
    timed = ["--out", str(tmp_path / "timed"), "--within", "100 ms"]
    assert "within 100 ms: camera: 0.5 of the noise" in sweep(*timed)
    assert "2 points, from 1 render of light:" in sweep(*timed)
    assert next(measured) == 1.0  # not measured again
    stated = ["--out", str(tmp_path / "stated"), "--tolerance", "0.5"]
    assert "2 points" in sweep(*stated)
    found = [open_sweep(tmp_path / name).attrs["study"] for name in ("timed", "stated")]
    assert found[0] == found[1]


def test_a_time_is_that_of_the_sensor_for_which_light_is_rendered(
    study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the nine that share the first point's light the one in the dark with the least noise,
    which is another point's.
    """
    from twin.trade.time_limit import TimedFidelity, TimedShare

    timed = []

    def fidelity_within(*args: object, system, **options: object) -> TimedFidelity:
        timed.append(system)
        return TimedFidelity(Tolerance(2.0).knobs(), TimedShare(2.0, 0.1), None)

    monkeypatch.setattr("twin.trade.fidelity_within", fidelity_within)
    words = ["sweep", str(study(SENSORS, HEAD)), "--workers", "0", "--within", "1 s"]
    monkeypatch.setattr("twin.sweep.run_sweep", lambda *_, **__: sys.exit())  # enough
    CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out")])
    (system,) = timed
    assert system.readout.read_noise_e.value == 1e3
    assert system.sky.illuminance_lx.value == 0


def test_coarser_knobs_that_a_time_allowed_are_gone_on_with(
    study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no tolerance is fast enough, `draft` is chosen: the same command goes on with it, and
    does not measure again. Frames are timed with what the study sets: it names no motion, so that
    nothing moves.
    """
    from twin.trade.time_limit import TimedFidelity, TimedShare

    path = str(
        study(
            '[grid]\n"system.optics.f_number" = [1.0, 2.0]\n', HEAD + '"fidelity.noise" = "none"\n'
        )
    )
    fixed: list[object] = []

    def fidelity_within(*args: object, **options: object) -> TimedFidelity:
        fixed.append(options["fixed"])
        still = PRESETS["draft"].with_(motion_tolerance=None)
        return TimedFidelity(still, TimedShare(math.inf, 0.1, "`draft`"), None)

    monkeypatch.setattr("twin.trade.fidelity_within", fidelity_within)
    command = ["sweep", path, "--workers", "0", "--out", str(tmp_path / "o"), "--within", "0.1"]
    for told in ("2 points, from", "2 points"):
        found = CliRunner().invoke(app, command)
        assert found.exception is None, found.exception
        assert told in found.output
    assert fixed == [{"motion_tolerance": None, "noise": "none"}]


def test_a_time_may_take_other_knobs_of_the_camera_than_of_the_radar() -> None:
    """The camera by `draft`, the radar by its tolerance and bounds, as `--within` may choose."""
    of_camera = {
        field.name: getattr(PRESETS["draft"], field.name) for field in fields(LightFidelity)
    }
    knobs = replace(Tolerance(0.5).knobs(), **{**of_camera, "motion_tolerance": None})
    study = Study(
        name="both",
        metrics=["snr_median", "range_error_m"],
        scene="table1",
        grid={"system.optics.f_number": [1.0, 2.0]},
    )
    asked = with_accuracy(study, knobs)
    assert setup(asked, asked.point(0), inputs_of(asked)).fidelity == knobs
