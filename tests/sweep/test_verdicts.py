"""What a sweep says of its points: void, warned of, failed; and what nothing depends on."""

import csv
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from designs import changed
from studies import CLOSED, SMALL, write

from twin import cli
from twin.budget import wall_rows
from twin.camera import capture
from twin.files import InputError
from twin.scene import load_scene
from twin.sweep import Study, load_study, open_sweep, run_sweep
from twin.sweep.dataset import column, half_width, warned_points
from twin.sweep.effects import check_points
from twin.sweep.evaluate import evaluate_chunk, kind_of, outcome_of
from twin.sweep.front import all_points, write_rows
from twin.sweep.inputs import inputs_of
from twin.sweep.sensitivity import sensitivities
from twin.sweep.show import plot_front, plot_plane
from twin.system import load_system


@pytest.mark.thorough
def test_void_points_are_marked_counted_and_left_out(a_worker: str, tmp_path: Path) -> None:
    """A 3 mm diode in 100 klx fills its converter, and its electrons would be the most: the largest
    diode and the brightest sky are void, said by name, and on no front, map or share of variance.
    """
    path = write(
        tmp_path,
        '[grid]\n"system.detector.width_m" = ["150 um", "3 mm"]\n'
        '"system.sky.illuminance_lx" = [100, 1e5]\n',
        SMALL.replace("psnr_db", 'signal_e", "saturated'),
    )
    summary = run_sweep(path, out=tmp_path / "out", scheduler=a_worker)
    data = open_sweep(tmp_path / "out").load()
    expected = np.array([[False, False], [False, True]])
    void = data["void"].transpose("system.detector.width_m", "system.sky.illuminance_lx")
    np.testing.assert_array_equal(void, expected)
    assert summary.n_void == data.attrs["points_void"] == 1
    assert summary.n_failed == 0
    assert dict(summary.warned)["saturated"] == 1
    saturated = data["warned.saturated"]
    np.testing.assert_array_equal(saturated, data["void"])
    assert "saturate the ADC" in saturated.attrs["first"]
    signal = data["signal_e"]
    assert signal.where(data["void"]).max() == signal.max()  # the best there is
    assert np.isnan(column(data, "signal_e").where(data["void"])).all()
    front = plot_front(data, "signal_e", "snr_median").axes[0]
    drawn = front.lines[0].get_xdata()
    assert np.isfinite(drawn).sum() == 3
    assert "1 of 4 points left out" in front.get_title()
    plane = plot_plane(data, "signal_e", "system.detector.width_m", "system.sky.illuminance_lx")
    assert np.ma.masked_invalid(plane.axes[0].images[0].get_array()).count() == 3
    assert np.isfinite(
        plot_front(data, "signal_e", "snr_median", void=True).axes[0].lines[0].get_xdata()
    ).all()
    # Listed, the void point has no numbers, and no widths, of what its record does not tell.
    rows = all_points(data)
    is_void = data["void"].to_numpy().ravel().tolist()
    for end in ("", ".half_width", ".standard_error", ".systematic", ".noise"):
        assert [bool(np.isnan(row[f"signal_e{end}"])) for row in rows] == is_void
    assert [row["saturated"] for row in rows] == data["saturated"].to_numpy().ravel().tolist()
    assert rows[is_void.index(True)]["saturated"] == 1
    assert np.isfinite([row["signal_e.half_width"] for row in all_points(data, void=True)]).all()
    # Beside the width of an interval, what it is made of.
    write_rows(all_points(data, void=True), tmp_path / "points.csv")
    with (tmp_path / "points.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    for kind in ("standard_error", "systematic", "noise"):
        told = [float(row[f"signal_e.{kind}"]) for row in read]
        np.testing.assert_array_equal(told, data[f"signal_e.{kind}"].to_numpy().ravel())
    width = half_width(data, "signal_e")
    assert [float(row["signal_e.half_width"]) for row in read] == width.to_numpy().ravel().tolist()
    # Signal knows nothing of the sun: without the void point the diode is all that moves it.
    shares = sensitivities(data, "signal_e")
    assert shares["system.detector.width_m"].first == pytest.approx(1.0)


@pytest.mark.thorough
def test_a_closed_point_that_saturates_is_void_as_in_the_budget(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`workable` at 100 klx: of the apertures those whose budget says that all cells lit saturate,
    one pixel's and without the field's cosines. The widest would have the best SNR.
    """
    (tmp_path / "bright.toml").write_text(
        'base = "workable"\n[sky]\nilluminance_lx = 1e5\n[optics]\nf_number = 1.0\n'
    )
    head = CLOSED.replace(', "maximum_distance_m"', "") + f'system = "{tmp_path / "bright.toml"}"\n'
    stops = [0.8, 1.0, 2.0, 4.0, 8.0]
    path = write(tmp_path, f'[grid]\n"system.optics.f_number" = {stops}\n', head)
    summary = run_sweep(path, out=tmp_path / "out", workers=1)
    data = open_sweep(tmp_path / "out").load()
    rows = [
        wall_rows(changed(load_system(tmp_path / "bright.toml"), optics__f_number=n), [5.0], [0.5])
        for n in stops
    ]
    saturates = [row.saturates for (row,) in rows]
    assert saturates == [True, True, True, False, False]
    np.testing.assert_array_equal(data["void"], saturates)
    np.testing.assert_array_equal(data["warned.saturated"], saturates)
    first = data["warned.saturated"].attrs["first"]
    (fill,) = re.findall(r"([\d.]+) % of the converter's range", first)
    assert float(fill) / 100 == pytest.approx(rows[0][0].fill, rel=0.05)
    assert summary.n_void == 3
    np.testing.assert_array_equal(np.isnan(column(data, "snr")), saturates)
    assert np.isfinite(column(data, "minimum_time_s")).all()
    saved = ["--metric", "snr", "--save", str(tmp_path / "b.toml")]
    monkeypatch.setattr(sys, "argv", ["twin", "show", str(tmp_path / "out"), *saved])
    with pytest.raises(SystemExit):
        cli.main()
    said = " ".join(capsys.readouterr().out.split())
    assert "best snr: point 3 (signal over noise of one exposure with all cells lit" in said


def test_a_sweep_judges_by_the_cells_that_receive_light(tmp_path: Path) -> None:
    """Most of figure 3's picture is empty: the sweep's SNR is that of the verdict, and at the
    time that it gives for SNR 1 the verdict's median is 1.
    """
    head = SMALL.replace("table1", "fig3b").replace("psnr_db", "minimum_time_s")
    plan = load_study(write(tmp_path, '[grid]\n"system.optics.f_number" = [2.0]\n', head))
    verdict = outcome_of(plan, 0).capture.verdict
    chunk = evaluate_chunk(plan, 0, 1)
    assert verdict.lit_share < 0.5
    assert chunk.values["snr_median"][0] == verdict.snr_median > 0
    time_s = chunk.values["minimum_time_s"][0]
    text = f'"system.acquisition.integration_time_s" = [{time_s}]\n'
    again = load_study(write(tmp_path, f'[grid]\n"system.optics.f_number" = [2.0]\n{text}', head))
    assert outcome_of(again, 0).capture.verdict.snr_median == pytest.approx(1.0, rel=0.02)


def test_a_point_warns_as_a_capture_does(tmp_path: Path) -> None:
    """A rescaled render says what a rendered one says: here of objects smaller than the spacing of
    rays, 4 x 4 cells of 4.
    """
    head = SMALL.replace("= 16", "= 4").replace("= 256", "= 16")
    plan = load_study(write(tmp_path, '[grid]\n"scene" = ["yard"]\n', head))
    outcome = outcome_of(plan, 0)
    made = outcome.setup
    by_hand = capture(made.scene, made.system, fidelity=made.fidelity, seed=plan.seed)
    assert "rendering" in {w.kind for w in by_hand.warnings}
    assert outcome.capture.warnings == by_hand.warnings
    chunk = evaluate_chunk(plan, 0, 1)
    assert chunk.warnings.keys() == {w.kind for w in by_hand.warnings}
    assert chunk.void == ({"camera": [0]} if by_hand.void else {})


def test_failed_points_end_in_their_reasons_and_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def status(times_s: list[float]) -> object:
        text = f'[grid]\n"system.acquisition.integration_time_s" = {times_s}\n'
        path = write(tmp_path, text, CLOSED)
        out = str(tmp_path / f"out-{len(times_s)}")
        monkeypatch.setattr(sys, "argv", ["twin", "sweep", str(path), "--out", out])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code or 0

    assert status([1e-6, 1.0, 2.0]) == 1
    done = capsys.readouterr()
    assert "3 points, 2 failed" in done.out
    for point, time_s in ((1, 1), (2, 2)):
        name = "acquisition.integration_time_s"
        which = f"failed: 1 point, the first {point}: system.{name} = {time_s} s: InputError"
        told = f"{which}: system: acquisition: integration_time_s = {time_s}: expected at most"
        assert told in done.err
    assert "Traceback" not in done.err
    assert status([1e-6, 2e-6]) == 0


@pytest.mark.slow  # a worker is started anew some eight times
def test_a_point_that_kills_its_worker_is_a_row_with_its_error(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import os\n\n\ndef deadly(outcome):\n"
        "    return 1.0 if outcome.setup.system.optics.f_number.value < 2 else os._exit(1)\n"
    )
    head = SMALL.replace('"snr_median", "psnr_db"', '"mine:deadly"')
    path = write(tmp_path, '[grid]\n"system.optics.f_number" = [1.0, 2.0, 1.5]\n', head)
    assert run_sweep(path, out=tmp_path / "out", workers=1).n_failed == 1
    data = open_sweep(tmp_path / "out").load()
    np.testing.assert_array_equal(data["mine:deadly"], [1.0, np.nan, 1.0])
    assert "died" in str(data["error"].to_numpy()[1])


@pytest.mark.parametrize(
    ("text", "head", "complaint"),
    [
        ('[grid]\n"processing.method" = ["lmmse", "lmsse"]\n', SMALL, "did you mean lmmse"),
        ('[grid]\n"system.optics.f_number" = [1.0, "fast"]\n', CLOSED, "numbers and text"),
        (
            '[grid]\n"scene" = ["yard", 2.0]\n',
            SMALL,
            "numbers and text, expected values of one kind",
        ),
        ('[grid]\n"fidelity.radar_scatterers" = [4, true]\n', SMALL, "expected values of one kind"),
        ('[grid]\n"link.distance_m" = [1.0, 2.0]\n', SMALL, "link.distance_m: has no effect here"),
        ('[grid]\n"radar.waveform.carrier_hz" = [76e9, 79e9]\n', SMALL, "looks at the radar"),
        (
            '[grid]\n"processing.method" = ["tv"]\n',
            SMALL.replace('"psnr_db"', '"noise_e"'),
            "image",
        ),
        *(
            (f'[grid]\n"{name}" = {values}\n', CLOSED, f"{name}: has no effect here")
            for name, values in (
                ("weather.visibility_m", "[50.0, 200.0]"),
                ("processing.method", '["lmmse", "tv"]'),
                ("system.optics.blur_rms_deg", "[0.1, 0.2]"),
                ("system.acquisition.n_patterns", "[64, 128]"),
                ("scene.sun.illuminance_lx", "[0.0, 1e5]"),
                ("seed", "[0, 1]"),
            )
        ),
        ('[set]\n"weather.part" = "fog-200m"\n', CLOSED, "weather.part: has no effect here"),
    ],
)
def test_what_has_no_effect_is_refused(
    tmp_path: Path, text: str, head: str, complaint: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_study(write(tmp_path, text, head))
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("text", "head", "complaint"),
    [
        (
            '[grid]\n"weather.visibility_m" = [50.0, 200.0]\n',
            SMALL,
            "no point can be set up: system: weather.single_scattering_albedo: missing",
        ),
        ('[grid]\n"scene.sun.illuminance_lx" = [0.0, 1e5]\n', SMALL, "a sky of its own"),
        ('[grid]\n"link.distance_m" = [1.0]\n', 'system = "foggy.toml"\n' + CLOSED, "has weather"),
        ('[grid]\n"link.distance_m" = [1.0]\n', 'scene = "nope"\n' + CLOSED, "nope: no such scene"),
    ],
)
def test_what_no_point_can_be_is_found_before_the_first(
    tmp_path: Path, text: str, head: str, complaint: str
) -> None:
    (tmp_path / "foggy.toml").write_text('base = "workable"\n[weather]\npart = "fog-200m"\n')
    with pytest.raises(InputError, match=rf"study\.toml: .*{complaint}"):
        run_sweep(write(tmp_path, text, head), out=tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()


def test_one_point_that_can_be_is_enough(tmp_path: Path) -> None:
    """Others are rows with their errors: of a grid whose last point alone is possible too."""
    text = '[grid]\n"system.acquisition.integration_time_s" = ["2 s", "1 s", "1 us"]\n'
    path = write(tmp_path, text, CLOSED)
    check_points(plan := load_study(path), inputs_of(plan))
    summary = run_sweep(path, out=tmp_path / "out")
    assert summary.n_failed == 2


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('"system.filter.part" = ["fb1550-12", "nosuch"]', "'nosuch': .* is neither a TOML file"),
        ('"system.filter.part" = ["fb1550-12", "fga015"]', "'fga015': .*this part has no filter"),
        ('"weather.part" = ["clear-air", "nosuch"]', "'nosuch': .* is neither a TOML file"),
        ('"scene" = ["table1", "nosuch"]', "nosuch: no such scene"),
        ('"system.optics.f_number" = [1.0, -1e-3]', r"-0\.001: expected at least 0\.5"),
        ('"system.optics.f_number" = [1.0, nan]', "nan: expected a finite number"),
        ('"system.detector.width_m" = ["1 mm", 1e-15]', "1e-15: expected 1e-12 to 1000"),
        ('"system.detector.function" = ["mine.py:f"]', r"mine\.py does not exist"),
        ('"system.readout.adc_bits" = [16, 16.5]', r"16\.5: expected a whole number"),
    ],
)
def test_a_value_that_no_point_may_have_is_told_before_any_point(
    tmp_path: Path, text: str, told: str
) -> None:
    """With study, parameter and value. Each had cost its point, whose message named neither."""
    parameter = text.split('"')[1]
    with pytest.raises(InputError, match=rf"study\.toml: {parameter}(\.value)? = .*{told}"):
        run_sweep(write(tmp_path, f"[grid]\n{text}\n", SMALL), out=tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (f'[{table}]\n"system.optics.f_number" = {given}\n', f"{table}.system.optics.f_number")
        for table in ("grid", "zip")
        for given in ('[["1 mm", "2 mm"], ["3 mm"]]', "2", '"2"', "{ a = 1 }", "1979-05-27")
    ],
)
def test_what_is_no_list_of_values_is_told_in_a_short_line(
    tmp_path: Path, text: str, place: str
) -> None:
    """Lists within lists had been told with every type that a value may have, each."""
    place, text = place.replace("zip", "zip.0"), text.replace("[zip]", "[[zip]]")
    with pytest.raises(InputError, match=rf"study\.toml: {place}.*: expected a list of values$"):
        load_study(write(tmp_path, text, SMALL))


def test_what_is_set_is_a_single_value(tmp_path: Path) -> None:
    text = 'scene = "yard"\nmetrics = ["snr_median"]\n[set]\n"system.optics.f_number" = [1, 2]\n'
    with pytest.raises(InputError, match=r"f_number = \[1, 2\]: expected a single value"):
        load_study(write(tmp_path, text, ""))


def test_of_long_and_drawn_lists_the_ends_are_told(tmp_path: Path) -> None:
    values = [*np.linspace(1, 2, 2000).tolist(), -1.0]
    drawn = '[sample]\nmethod = "sobol"\nn = 64\n[sample.ranges]\n"system.optics.f_number" = '
    for text in (
        f'[grid]\n"system.optics.f_number" = {values}\n',
        f"{drawn}{{ low = -1, high = 1 }}\n",
    ):
        with pytest.raises(InputError, match=r"f_number\.value = -.*: expected at least 0\.5"):
            run_sweep(write(tmp_path, text, CLOSED), out=tmp_path / "out")


@pytest.mark.parametrize(
    ("parameter", "values"),
    [
        ("system.emitter.peak_wavelength_m", (1540e-9, 1550e-9)),
        ("system.emitter.line_fwhm_m", (50e-9, 100e-9)),
        ("system.emitter.radiant_intensity_w_per_sr", (1.0, 2.0)),
        ("system.filter.center_wavelength_m", (1545e-9, 1550e-9)),
        ("system.filter.width_m", (12e-9, 30e-9)),
        ("system.filter.transmission", (0.5, 0.9)),
        ("system.optics.transmission", (0.5, 0.9)),
        ("system.optics.f_number", (1.0, 2.0)),
        ("system.detector.width_m", (1e-3, 2e-3)),
        ("system.detector.responsivity_a_per_w", (0.5, 0.9)),
        ("system.detector.dark_current_a", (1e-9, 1e-6)),
        ("system.readout.read_noise_e", (1e2, 1e4)),
        ("system.acquisition.integration_time_s", (1e-5, 1e-4)),
        ("system.sky.illuminance_lx", (1e3, 1e5)),
        ("link.distance_m", (1.0, 2.0)),
        ("link.reflectance", (0.2, 0.8)),
    ],
)
def test_what_the_closed_form_takes_it_depends_on(
    tmp_path: Path, parameter: str, values: tuple[float, float]
) -> None:
    path = write(tmp_path, f'[grid]\n"{parameter}" = {list(values)}\n', CLOSED)
    chunk = evaluate_chunk(load_study(path), 0, 2)
    assert not chunk.errors
    assert np.ptp(chunk.values["snr"]) != 0


def test_a_parameter_without_effect_is_said(tmp_path: Path) -> None:
    """No bit of a picture, noise and all, moves with the kind of the source, which eye safety asks
    for; and no signal with the read noise: the sweep says so at its end.
    """
    text = '[grid]\n"system.emitter.kind" = ["led", "laser"]\n'
    psnr_db = evaluate_chunk(load_study(write(tmp_path, text)), 0, 2).values["psnr_db"]
    assert psnr_db[0] == psnr_db[1]
    text = '[grid]\n"system.readout.read_noise_e" = [1.0, 9.0]\n"link.distance_m" = [1.0, 2.0]\n'
    head = 'model = "closed-form"\nmetrics = ["signal_e_per_s"]\n'
    summary = run_sweep(write(tmp_path, text, head), out=tmp_path / "out")
    assert summary.without_effect == ("system.readout.read_noise_e",)


def test_a_study_without_metrics_or_values_says_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    for text, told in (
        ("metrics = []", "metrics = (): expected at least 1 of them"),
        ('metrics = ["snr_median"]\n[grid]\n"link.distance_m" = []', "expected at least 1 of them"),
    ):
        path.write_text(f'scene = "table1"\n{text}\n')
        with pytest.raises(InputError, match=re.escape(told)):
            load_study(path)


def test_a_misspelt_metric_is_an_error_in_python_too() -> None:
    with pytest.raises(ValueError, match="did you mean snr_median"):
        Study(name="mine", metrics=("snr_medain",))
    with pytest.raises(ValueError, match="did you mean lmmse"):
        Study(name="mine", metrics=("psnr_db",), set={"processing.method": "lmsse"})


def test_a_point_has_the_warnings_of_the_radars_processing(tmp_path: Path) -> None:
    """Of 4 slots, which tell no migration, the rates are ambiguous."""
    head = 'scene = "yard"\nmetrics = ["detections"]\n[set]\n"fidelity.radar" = "targets"\n'
    plan = load_study(write(tmp_path, '[grid]\n"radar.waveform.n_slots" = [4]\n', head))
    told = outcome_of(plan, 0).radar.frame.warnings
    assert any("range rate: ambiguous" in warning for warning in told)
    given = evaluate_chunk(plan, 0, 1).warnings
    assert {text for said in given.values() for text in said.values()} >= set(told)
    assert given["processing:range-rate-ambiguous-for-of"][0].startswith("range rate: ambiguous")


def test_kinds_of_processing_warnings_hold_no_figures() -> None:
    """The same warning of two points is of one kind; the one with prototype at every point is not
    that of a reference below an echo, which it had hidden.
    """
    weak = "carrier steps: the reference is {} dB above the strongest echo (expected 6.5 dB)"
    holds = "range: holds at a range rate of 0 m/s (range_rate_m_per_s): carrier steps one after"
    assert kind_of(weak.format("4.6")) == kind_of(weak.format("-3"))
    assert kind_of(weak.format("4.6")) != kind_of(holds)
    assert kind_of("burst 0: IQ is all zero") == kind_of("burst 12: IQ is all zero")
    assert " " not in kind_of(holds)


def test_what_few_points_are_warned_of_comes_first() -> None:
    marks = {"a": [1, 1, 1, 1], "b": [0, 0, 1, 0], "c": [0, 1, 1, 0]}
    data = xarray.Dataset(
        {f"warned.{k}": ("point", np.array(v, bool), {"first": k}) for k, v in marks.items()}
    )
    assert [one.kind for one in warned_points(data)] == ["b", "c", "a"]


def test_an_object_takes_its_target_along(tmp_path: Path) -> None:
    """The car 2 m farther: its mesh, and the point that declares it to the radar; nothing else."""
    path = write(tmp_path, '[grid]\n"scene.objects.car.shift_x_m" = [2.0]\n"scene" = ["yard"]\n')
    moved, scene = outcome_of(load_study(path), 0).setup.scene, load_scene("yard")
    for before, after in zip(scene.targets, moved.targets, strict=True):
        shift = np.subtract(after.position_m, before.position_m)
        np.testing.assert_allclose(shift, [2.0 if before.object == "car" else 0.0, 0, 0])
    assert [replace(t, position_m=(0, 0, 0)) for t in moved.targets] == [
        replace(t, position_m=(0, 0, 0)) for t in scene.targets
    ]


def test_what_changes_together_may_repeat_values(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '[[zip]]\n"link.distance_m" = [1.0, 1.0, 2.0]\n"link.reflectance" = [0.2, 0.8, 0.8]\n',
        CLOSED,
    )
    run_sweep(path, out=tmp_path / "out")
    data = open_sweep(tmp_path / "out").load()
    np.testing.assert_array_equal(data["link.distance_m"], [1.0, 1.0, 2.0])
    assert len(set(data["snr"].to_numpy().tolist())) == 3


def test_a_metric_of_ones_own_may_look_at_the_radar(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "def strongest(outcome):\n    return outcome.setup.radar.waveform.carrier_hz.value\n"
    )
    head = SMALL.replace('"psnr_db"', '"mine:strongest"').replace('"snr_median", ', "")
    plan = load_study(write(tmp_path, '[grid]\n"radar.waveform.carrier_hz" = [78e9, 79e9]\n', head))
    values = evaluate_chunk(plan, 0, 2).values["mine:strongest"]
    np.testing.assert_array_equal(values, [78e9, 79e9])
