"""What the closed form of a study takes from its system: as `twin budget`, or it says that not."""

import math
from pathlib import Path

import numpy as np
import pytest
from studies import write

from twin.budget import wall_rows
from twin.camera.shutters import shutters
from twin.files import InputError
from twin.sweep import load_study, open_sweep, run_sweep
from twin.sweep.evaluate import Chunk, evaluate_chunk
from twin.system import load_system

ALL = (
    'system = "mine.toml"\nmodel = "closed-form"\nmetrics = ["signal_e_per_s", '
    '"background_e_per_s", "snr", "minimum_time_s", "maximum_distance_m"]\n'
)
AT_5_M = '[grid]\n"link.distance_m" = [5.0]\n'


def points(folder: Path, system: str, grid: str = AT_5_M) -> Chunk:
    (folder / "mine.toml").write_text(f'base = "workable"\n{system}')
    plan = load_study(write(folder, grid, ALL))
    return evaluate_chunk(plan, 0, plan.n_points)


@pytest.mark.parametrize(
    "system",
    [
        "",
        "[emitter]\nfield_of_view_deg = 60.0\n[optics]\nfield_of_view_deg = 60.0\n",
        "[emitter]\nfield_of_view_deg = 20.0\n[optics]\nfield_of_view_deg = 40.0\n",
        '[filter]\nplace = "behind lens"\n[optics]\nfield_stop = "detector"\n',
    ],
)
def test_light_is_that_of_the_budget(tmp_path: Path, system: str) -> None:
    """With the cosines of the field and the shift of the filter: on the axis alone a field of 60
    degrees had 7 times the signal. To rounding, both being the same means over the field.
    """
    chunk = points(tmp_path, system)
    made = load_system(tmp_path / "mine.toml")
    (row,) = wall_rows(made, [5.0], [0.5])
    time_s = made.acquisition.integration_time_s.value
    others_e = row.budget.background_e + row.budget.dark_e
    found = {name: column[0] for name, column in chunk.values.items()}
    assert found["signal_e_per_s"] == pytest.approx(2 * row.budget.signal_e / time_s, rel=1e-12)
    assert found["background_e_per_s"] == pytest.approx(others_e / time_s, rel=1e-12)
    assert not chunk.warnings


def test_an_array_of_f_numbers_behind_the_filters_cone(tmp_path: Path) -> None:
    """Each f-number has a cone of its own, which moves the band by its own angles."""
    grid = '[grid]\n"system.optics.f_number" = [1.0, 1.5, 4.0]\n'
    system = '[filter]\nplace = "behind lens"\n[optics]\nf_number = {}\n'
    together = points(tmp_path, system.format(2.0), grid).values["signal_e_per_s"]
    for f_number, signal in zip((1.0, 1.5, 4.0), together, strict=True):
        alone = points(tmp_path, system.format(f_number)).values["signal_e_per_s"]
        assert signal == pytest.approx(alone[0], rel=1e-12)


@pytest.mark.parametrize(
    "readout",
    ["transimpedance_ohm = 1e6", "feedback_capacitance_f = 1e-11\nread_noise_e = 1e5"],
)
def test_the_emitters_fluctuation_and_the_amplifier_are_in_the_noise(
    tmp_path: Path, readout: str
) -> None:
    """No exposure to a light that fluctuates by a tenth has an SNR above 10; and what is solved for
    is where the SNR is 1, with Johnson noise and the converter's rounding.
    """
    system = f"[emitter]\nintensity_noise = 0.1\n[readout]\n{readout}\nadc_bits = 10\n"
    found = {name: float(v[0]) for name, v in points(tmp_path, system).values.items()}
    assert 1 < found["snr"] < 10
    far = f'[grid]\n"link.distance_m" = [{found["maximum_distance_m"]!r}]\n'
    assert points(tmp_path, system, far).values["snr"][0] == pytest.approx(1, rel=1e-9)
    time = f'[set]\n"system.acquisition.integration_time_s" = {found["minimum_time_s"]!r}\n'
    assert points(tmp_path, system, time + AT_5_M).values["snr"][0] == pytest.approx(1, rel=1e-9)


def test_rounding_that_grows_as_the_signal_does_forbids_an_snr_at_any_time(tmp_path: Path) -> None:
    """Behind an amplifier that averages a longer exposure gives no more counts."""
    found = points(tmp_path, "[readout]\ntransimpedance_ohm = 1e3\nadc_bits = 4\n").values
    assert found["snr"][0] < 1
    assert found["minimum_time_s"][0] == math.inf


def test_what_is_left_out_of_a_system_is_told_of_each_point(tmp_path: Path) -> None:
    """It travels with the figures: into the sweep's lines, its dataset, and tables of points."""
    system = (
        "[emitter]\nswitching_time_s = 1e-6\n[optics]\nedge_illumination = 0.1\n"
        "[readout]\nflicker_corner_hz = 1e6\nbandwidth_hz = 2e3\n"
        "[time_of_flight]\nmodulation_hz = [1e7]\ncontrast = 0.8\n"
    )
    chunk = points(tmp_path, system, '[grid]\n"link.distance_m" = [5.0, 6.0]\n')
    assert set(chunk.warnings["left_out"]) == {0, 1}
    said = chunk.warnings["left_out"][1]
    for what in ("1/f noise", "vignetting", "settling", "switching", "shutters"):
        assert what in said
    summary = run_sweep(tmp_path / "study.toml", out=tmp_path / "out")
    assert dict(summary.warned) == {"left_out": 2}
    assert open_sweep(tmp_path / "out")["warned.left_out"].all()
    assert len(shutters(load_system(tmp_path / "mine.toml"))) == 4


@pytest.mark.parametrize(
    ("parameter", "values"),
    [
        ("adc_full_scale_v", [0.1, 4.0]),
        ("adc_offset_v", [4.09, 0.02]),
        ("full_well_e", [1e6, 1e9]),
        ("feedback_capacitance_f", [1e-13, 1e-9]),
        ("transimpedance_ohm", [1e9, 1e6]),
    ],
)
def test_what_decides_whether_a_point_is_void_may_vary(
    tmp_path: Path, parameter: str, values: list[float]
) -> None:
    """The first of them is void, in a grid as alone; and none is called without effect."""
    system = ""
    if parameter in ("full_well_e", "feedback_capacitance_f"):
        system = "[readout]\nfeedback_capacitance_f = 1e-9\nfull_well_e = 1e9\n"
    alone = f'[set]\n"system.readout.{parameter}" = {values[0]}\n{AT_5_M}'
    assert points(tmp_path, system, alone).void == {"camera": [0]}
    grid = f'[grid]\n"system.readout.{parameter}" = {values}\n'
    assert points(tmp_path, system, grid).void == {"camera": [0]}
    assert not run_sweep(tmp_path / "study.toml", out=tmp_path / "out").without_effect


@pytest.mark.parametrize("tof", ["", "[time_of_flight]\nmodulation_hz = [1e5]\ncontrast = 0.8\n"])
def test_a_time_that_no_system_exposes_for_fails_as_in_a_rendered_sweep(
    tmp_path: Path, tof: str
) -> None:
    """Longer than its period, or too short for its modulation: each point against the system with
    that time, which says why. They had been the best, and were saved in files that nothing takes.
    """
    drawn = (
        '[sample]\nmethod = "sobol"\nn = 64\n[sample.ranges]\n'
        '"system.acquisition.integration_time_s" = { low = 1e-6, high = 1e-2, log = true }\n'
    )
    chunk, expected = points(tmp_path, tof, drawn), {}
    made, plan = load_system(tmp_path / "mine.toml"), load_study(tmp_path / "study.toml")
    for index in range(64):
        (time_s,) = plan.point(index).values()
        try:
            made.with_({"acquisition.integration_time_s": time_s})
        except InputError as error:
            expected[index] = f"InputError: {error}"
    assert chunk.errors == expected
    assert len({why.partition(" = ")[0] for why in expected.values()}) == (2 if tof else 1)
    failed = np.isin(np.arange(64), list(expected))
    assert 10 < failed.sum() < 60
    for column in chunk.values.values():
        np.testing.assert_array_equal(np.isnan(column), failed)
    assert not chunk.warnings.get("left_out", {}).keys() & expected.keys()


def test_a_time_that_is_too_long_in_every_point_is_refused_by_the_files_name(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine.toml").write_text('base = "workable"\n')
    text = '[set]\n"system.acquisition.integration_time_s" = "1 ms"\n' + AT_5_M
    path, wanted = (
        write(tmp_path, text, ALL),
        "expected at most pattern_period_s = ",
    )
    with pytest.raises(InputError, match=f"study.toml: no point can be set up: .*{wanted}"):
        run_sweep(path, out=tmp_path / "out")


def test_many_amplifiers_are_one_array(tmp_path: Path) -> None:
    """As quick as any other number, and each what it is alone."""
    ranges = (
        '[sample]\nmethod = "latin-hypercube"\nn = 4096\n[sample.ranges]\n'
        '"system.readout.adc_full_scale_v" = { low = 1.0, high = 5.0 }\n'
        '"system.readout.temperature_k" = { low = 100.0, high = 400.0 }\n'
    )
    found = points(tmp_path, "[readout]\nadc_bits = 8\n", ranges)
    plan = load_study(tmp_path / "study.toml")
    own = {n.rpartition(".")[2]: v for n, v in plan.point(77).items()}
    text = "".join(f"{name} = {value!r}\n" for name, value in own.items())
    alone = points(tmp_path, f"[readout]\nadc_bits = 8\n{text}")
    assert found.values["snr"][77] == pytest.approx(alone.values["snr"][0], rel=1e-12)
    assert np.ptp(found.values["snr"]) > 0
