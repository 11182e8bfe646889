"""Sweeps made in Python: functions as metrics, objects as values, the same as by their names."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hardware.radar.range_doppler import RangeDopplerMap
from twin.accuracy import Interval
from twin.cli import app
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.geometry.shape import shapes_of
from twin.radar import load_radar
from twin.scene import load_scene
from twin.sweep import Study, load_study, open_sweep, run_sweep
from twin.sweep.evaluate import outcome_of
from twin.sweep.inputs import inputs_of
from twin.sweep.metrics import Outcome
from twin.sweep.names import ERRORS
from twin.system import load_part, load_system

WORKABLE = load_system("workable")
QUICK = Fidelity(samples=1, max_depth=1, noise="gaussian")


def brightest(outcome) -> float:
    """Electrons of the brightest cell."""
    return float(outcome.capture.scene_e.max())


brightest.unit = "e"  # type: ignore[attr-defined]


def _study(**fields) -> Study:
    return Study(
        **{"name": "mine", "metrics": ["signal_e"], "set": {"fidelity.preset": QUICK}} | fields
    )


@pytest.mark.parametrize("workers", [0, pytest.param(1, marks=pytest.mark.whole)])
def test_functions_and_objects_in_this_process_and_in_another(tmp_path: Path, workers: int) -> None:
    """A function that closes over a value travels too; what it gives is what the object does."""
    factor = 2.0
    dark = WORKABLE.with_({"emitter.radiant_intensity_w_per_sr": 0.0, "name": "dark"})
    study = _study(
        metrics=["signal_e", brightest, lambda outcome: factor * brightest(outcome)],
        grid={"system": [WORKABLE, dark]},
    )
    done = run_sweep(study, out=tmp_path / "out", workers=workers)
    assert done.n_failed == 0, done.reasons
    data = open_sweep(done.out)
    own, twice = (name for name in study.metrics if ":" in name)
    assert own.endswith(":brightest")
    assert data[own].attrs["units"] == "e"
    assert data[own].attrs["long_name"] == "Electrons of the brightest cell."
    np.testing.assert_array_equal(data[twice], 2 * data[own])
    assert data[own].sel(system="workable") > data[own].sel(system="dark") == 0


def test_objects_give_what_their_names_give(tmp_path: Path) -> None:
    by_name = Study(
        name="a",
        metrics=("detections", "signal_e"),
        scene="table1",
        set={"fidelity.preset": "draft", "fidelity.radar": "targets"},
        grid={"system.detector.part": ["fga015", "ingaas-apd-200"]},
    )
    parts = [load_part("fga015"), load_part("ingaas-apd-200")]
    by_object = Study(
        name="b",
        metrics=("detections", "signal_e"),
        scene=load_scene("table1"),
        system=WORKABLE,
        radar=load_radar("hybrid-79"),
        set={"fidelity.preset": "draft", "fidelity.radar": "targets"},
        grid={"system.detector.part": parts},
    )
    names = by_object.values_of("system.detector.part")
    assert names == [part.name for part in parts]
    found = [
        open_sweep(run_sweep(study, out=tmp_path / study.name, workers=0).out)
        for study in (by_name, by_object)
    ]
    for metric in ("detections", "signal_e"):
        assert np.isfinite(found[0][metric]).all()
        np.testing.assert_array_equal(found[0][metric], found[1][metric])


def test_each_object_has_a_name_of_its_own() -> None:
    changed = [WORKABLE.with_({"optics.f_number": f}) for f in (0.8, 0.9)]
    study = _study(grid={"system": ["workable", WORKABLE, *changed]})
    assert study.grid["system"] == [
        "workable",
        "workable_2",
        "workable (changed)",
        "workable (changed)_2",
    ]


def test_a_value_twice_is_named_by_what_the_user_gave() -> None:
    with pytest.raises(ValueError, match="system: a value stands twice"):
        _study(grid={"system": [WORKABLE, WORKABLE]})


def test_arrays_are_values() -> None:
    study = _study(grid={"system.optics.f_number": np.linspace(0.8, 1.0, 3), "seed": range(2)})
    assert study.shape == (2, 3)  # a seed needs a new render: the slowest
    assert study.point(0)["seed"] == 0


@pytest.mark.thorough
def test_results_are_of_one_content() -> None:
    """Of objects, of a function's source and of what it closes over."""

    def scaled(factor: float):
        return lambda outcome: factor * outcome.capture.noise.signal_e

    def stamp(**fields) -> str:
        return inputs_of(_study(**fields)).stamp

    one = WORKABLE.with_({"optics.f_number": 0.8})
    assert stamp(system=one) == stamp(system=WORKABLE.with_({"optics.f_number": 0.8}))
    assert stamp(system=one) != stamp(system=WORKABLE.with_({"optics.f_number": 0.9}))
    assert stamp(metrics=[scaled(1.0)]) == stamp(metrics=[scaled(1.0)])
    assert stamp(metrics=[scaled(1.0)]) != stamp(metrics=[scaled(2.0)])
    assert stamp(scene=load_scene("yard").with_({"rig.x_m": 1.0})) != stamp()


def test_a_folder_of_another_object_is_refused(tmp_path: Path) -> None:
    def run(f_number: float) -> None:
        system = WORKABLE.with_({"optics.f_number": f_number})
        where = {"link.distance_m": [2.0, 5.0]}
        study = Study(name="mine", model="closed-form", metrics=["snr"], system=system, grid=where)
        run_sweep(study, out=tmp_path / "out", workers=0)

    run(0.8)
    run(0.8)
    with pytest.raises(InputError, match="other content of system workable"):
        run(0.9)


def test_a_curve_of_an_object_that_changes_meanwhile_is_told(tmp_path: Path) -> None:
    curve = tmp_path / "filter.csv"
    curve.write_text("nm,T\n1530,0\n1550,0.5\n1570,0\n")
    inputs = inputs_of(_study(system=WORKABLE.with_({"filter.transmission_csv": str(curve)})))
    inputs.check()
    curve.write_text("nm,T\n1530,0\n1550,0.6\n1570,0\n")
    with pytest.raises(InputError, match="a file of it has changed"):
        inputs.check()


def test_objects_are_where_they_belong(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="system"):
        _study(system=load_scene("yard"))
    with pytest.raises(ValueError, match="f_number"):
        _study(grid={"system.optics.f_number": [WORKABLE]})
    path = tmp_path / "study.toml"
    path.write_text('metrics = ["snr_median"]\nobjects = {}\n')
    with pytest.raises(InputError, match=r"study\.toml: objects: is no field"):
        load_study(path)


def test_what_no_study_can_be_is_the_projects_error() -> None:
    with pytest.raises(InputError, match="metrics: 'nope' is unknown"):
        Study(name="s", metrics=["nope"])
    with pytest.raises(
        InputError, match="metrics: 'snr' is unknown; it belongs to model = \"closed"
    ):
        Study(name="s", metrics=["snr"])
    with pytest.raises(InputError, match="'psnr_db' is unknown; it belongs to model = \"rendered"):
        Study(name="s", model="closed-form", metrics=["psnr_db"])
    with pytest.raises(InputError, match="name: missing; metrics: missing"):
        Study()
    assert Study(name="s", metrics=["psnr_db"], seed=1e6).seed == 10**6


def test_a_closed_study_may_vary_nothing(tmp_path: Path) -> None:
    """One point, which is that of a study that sets what is the default."""
    fields = {"model": "closed-form", "metrics": ["snr"]}
    one, same = (
        run_sweep(Study(name="s", **fields, **more), out=tmp_path / name, workers=0)
        for name, more in (("one", {}), ("same", {"set": {"link.distance_m": 5.0}}))
    )
    values = [open_sweep(done.out).snr.values.ravel().tolist() for done in (one, same)]
    assert values[0] == values[1]
    assert len(values[0]) == 1


def test_a_metric_changes_no_result_and_ends_no_sweep(tmp_path: Path) -> None:
    """Metrics share a point's results: a write to one of their arrays, or `sys.exit`, is the
    point's error, and the other point's figures are what they are without.
    """

    def writes(outcome) -> float:
        if outcome.setup.system.name != "dark":
            outcome.capture.truth.albedo[:] = 7
        return 0.0

    def leaves(outcome) -> float:
        raise SystemExit(0)

    dark = WORKABLE.with_({"emitter.radiant_intensity_w_per_sr": 1.0, "name": "dark"})
    for own, failed, told in ((writes, 1, "read-only"), (leaves, 2, "SystemExit: 0")):
        study = _study(metrics=[own, "psnr_db"], grid={"system": [WORKABLE, dark]})
        done = run_sweep(study, out=tmp_path / own.__name__, workers=0)
        assert done.n_failed == failed
        assert told in str(done.reasons)


@np.errstate()  # a failure ends here
def test_what_a_metric_tells_numpy_ends_with_it(tmp_path: Path) -> None:
    """`numpy.seterr` of one metric neither reaches the metrics after it, nor what the twin computes
    for it: light and scores underflow where nothing is wrong.
    """
    before = np.geterr()

    def careful(outcome) -> float:
        np.seterr(all="raise")
        return 0.0

    def undisturbed(outcome) -> float:
        return float(np.geterr() == before)

    study = _study(metrics=[careful, undisturbed], grid={"seed": [1, 2]})
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    assert done.n_failed == 0, done.reasons
    assert np.geterr() == before
    assert (open_sweep(done.out)[study.metrics[1]] == 1).all()
    setup = outcome_of(study, 0).setup
    outcome = Outcome(setup, np.geterr, np.geterr)  # type: ignore[arg-type]
    with np.errstate(all="raise"):
        assert outcome.capture == outcome.radar == before


def test_errors_of_a_metric_that_gives_none_are_not_known(tmp_path: Path) -> None:
    """What draws of the noise make of a plain number is no more known than the model's errors."""
    metrics = [lambda outcome: 1.0, lambda outcome: np.nan, lambda outcome: np.inf]
    study = _study(metrics=[*metrics, lambda outcome: Interval(1.0, noise=0.5)])
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    assert done.n_failed == 0, done.reasons
    data = open_sweep(done.out)
    *plain, with_errors = study.metrics
    for name in plain:
        for kind in ERRORS:
            assert np.isnan(data[f"{name}.{kind}"]).all(), f"{name}.{kind}"
    assert data[f"{with_errors}.noise"] == 0.5


def test_an_error_of_several_lines_is_told_in_one_with_the_metric(tmp_path: Path) -> None:
    def fails(outcome) -> float:
        raise RuntimeError("first line\n  second line")

    study = _study(metrics=[fails])
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    (told, count), (name,) = done.reasons[0], study.metrics
    assert count == 1
    assert told.startswith(f"OwnFunctionError: {name}: RuntimeError: first line second line (")


@pytest.mark.parametrize(("given", "told"), [(None, "a NoneType"), (np.zeros(2), "a ndarray")])
def test_a_metric_that_gives_no_number_is_told_by_name(tmp_path: Path, given, told: str) -> None:
    study = _study(metrics=[lambda outcome: given])
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    expected = f"{study.metrics[0]}: returned {told}, expected a number or an Interval"
    assert done.reasons == ((f"OwnFunctionError: {expected}", 1),)


def test_points_left_out_of_shares_may_be_no_number(tmp_path: Path) -> None:
    """A metric of one's own gives NaN at one value of a grid: the note says so."""

    def over_two(outcome) -> float:
        width_m = outcome.setup.system.detector.width_m.value
        return float("nan") if width_m > 2e-3 else width_m

    grid = {"system.detector.width_m": [1e-3, 2e-3, 3e-3]}
    done = run_sweep(_study(metrics=[over_two], grid=grid), out=tmp_path / "out", workers=0)
    shown = CliRunner().invoke(app, ["show", str(done.out)], catch_exceptions=False)
    assert "3 mm: all its points are void, failed, infinite or not a number" in shown.output


@pytest.mark.quick(6)
@pytest.mark.parametrize(
    "array_of",
    [
        lambda outcome: outcome.capture.noise_draws.measured[0].values,
        lambda outcome: outcome.capture.noise_draws.records[0].counts,
        lambda outcome: outcome.capture.noise_draws.records[0].flags,
        lambda outcome: outcome.setup.scene.objects[0].box_m,
        lambda outcome: outcome.setup.scene.objects[0].state.velocity_m_per_s,
        lambda outcome: outcome.setup.scene.objects[0].geometry.normals,
        lambda outcome: outcome.setup.scene.objects[0].geometry.shape.hull,
        lambda outcome: outcome.setup.scene.objects[0].geometry.edges.ends,
        lambda outcome: outcome.setup.scene.rig.state.velocity_m_per_s,
        lambda outcome: outcome.setup.scene.objects[12].geometry.welded_faces,
        lambda outcome: outcome.setup.scene.objects[13].reflectance.image,
        lambda outcome: outcome.reconstruction.image,
        lambda outcome: outcome.capture.noise_draws._power.cells_w,
        lambda outcome: outcome.capture.noise_draws._chain.gains,
        lambda outcome: outcome.capture.noise_draws._chain.sky.angles_deg,
        lambda outcome: outcome.capture.noise_draws._chain._known["cells"][0][1].axes,
    ],
)
def test_what_is_computed_for_a_metric_is_read_only_too(array_of) -> None:
    """What is kept of the capture, the scene and its meshes, as of the map below, is computed when
    it is first asked for, by one's own metric perhaps. On 43f3f9f7 such a metric changed PSNR's
    error and the echoes of other points, without a word.
    """
    outcome = outcome_of(_study(metrics=["psnr_db"]), 0)
    shapes_of([item.geometry for item in outcome.setup.scene.objects])  # as the radar does
    assert not array_of(outcome).flags.writeable  # written to, it would spoil other tests


def test_results_of_a_point_cannot_be_assigned() -> None:
    outcome = outcome_of(_study(metrics=["psnr_db"]), 0)
    for name in ("capture", "reconstruction", "score", "radar", "setup"):
        with pytest.raises(AttributeError, match=f"cannot assign to field '{name}'"):
            setattr(outcome, name, None)


def test_axes_of_a_map_are_read_only() -> None:
    image = RangeDopplerMap(np.ones((2, 3)), np.arange(2.0), np.arange(3.0), 1.0)
    for axis in (image.range_m, image.range_rate_m_per_s):
        with pytest.raises(ValueError, match="read-only"):
            axis[0] = 1.0


def test_a_closed_point_that_is_no_number_says_so(tmp_path: Path) -> None:
    """Of two distances one is beyond what floats hold: its row has an error, the other none."""
    study = Study(
        name="near",
        model="closed-form",
        metrics=["snr"],
        grid={"link.distance_m": [1e-200, 2.0]},
    )
    done = run_sweep(study, out=tmp_path / "out", workers=0)
    assert done.n_failed == 1
    assert "snr is not a number" in str(done.reasons)
    with pytest.raises(InputError, match="a positive number up to"):
        run_sweep(
            Study(name="far", model="closed-form", metrics=["snr"], set={"link.distance_m": 1e300}),
            out=tmp_path / "far",
            workers=0,
        )
