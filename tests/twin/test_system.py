"""System files: typed, sourced, inheriting, and clear about what is wrong."""

import json
from pathlib import Path

import pytest

from twin.files import InputError
from twin.system import System, load_part, load_system, part_names, system_names


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", system_names())
def test_bundled_systems_source_every_value(name: str) -> None:
    """No bare number: each says where it comes from, or why it is assumed."""
    for field, value in load_system(name).values():
        text = value.source or value.assumed
        assert text != "given without a source", field
        assert len(text) > 5 or text.startswith("as "), field


def test_a_user_overrides_what_he_changes(tmp_path: Path) -> None:
    path = write(tmp_path, 'base = "paper"\nname = "mine"\n[optics]\nf_number = 2.0\n')
    mine, paper = load_system(path), load_system("paper")
    assert mine.optics.f_number.value == 2.0
    assert mine.optics.f_number.assumed == "given without a source"
    assert mine.detector == paper.detector


@pytest.mark.parametrize(
    ("base", "given", "left"),
    [
        ("[sky]\nilluminance_lx = 5.0", "[sky]\nsun_elevation_deg = 30.0", "sky.illuminance_lx"),
        (
            "[readout]\npart = 'ctia-high-gain'",
            "[readout]\ntransimpedance_ohm = 1e6",
            "readout.full_well_e",
        ),
        (
            "[time_of_flight]\nmodulation_hz = [1e7]\ncontrast = 0.5",
            "[time_of_flight]\npulse_width_s = 2e-8\npulse_rate_hz = 1e5\n"
            "gate_width_s = 2e-8\ngate_delays_s = [1e-8]",
            "time_of_flight.contrast",
        ),
    ],
)
def test_the_other_of_two_alternatives_replaces_the_bases(
    tmp_path: Path, base: str, given: str, left: str
) -> None:
    """Where a section holds one thing or another, the file's own is taken and the base's left."""
    write(tmp_path, f'base = "paper"\n{base}\n', "a.toml")
    path = write(tmp_path, f'base = "a.toml"\nname = "b"\n{given}\n', "b.toml")
    values = dict(load_system(path).values())
    for line in given.splitlines()[1:]:
        assert f"{given.splitlines()[0].strip('[]')}.{line.split()[0]}" in values
    assert left not in values
    assert left in dict(load_system(tmp_path / "a.toml").values())


def test_systems_build_on_files_beside_them(tmp_path: Path) -> None:
    write(tmp_path, 'base = "workable"\nname = "a"\n[sky]\nilluminance_lx = 5.0\n', "a.toml")
    path = write(tmp_path, 'base = "a.toml"\nname = "b"\n', "b.toml")
    assert load_system(path).sky.illuminance_lx.value == 5.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[optics]\nf_number = -1", r"optics\.f_number\.value = -1: expected at least 0.5"),
        ("[optics]\nf_number = nan", r"optics\.f_number"),
        ("[optics]\nf_numbr = 1", r"optics\.f_numbr = 1: no such field; did you mean f_number\?"),
        ("[optic]\nf_number = 1", r"optic: no such field; did you mean optics\?"),
        (
            "[detector]\ncapacitance_f = 2e-10",
            r"capacitance_f = 2e-10: no such field, expected dark_current_a, .*width_m",
        ),
        (
            "[detector]\nwidth_m = { value = 1e-3, assumd = 'x' }",
            r"width_m\.assumd = 'x': no such field; did you mean assumed\?",
        ),
        ("[detector]\ncapacitance_f = 1", r"no such field, expected .*line_rate_hz, part, pixels"),
        ("[acquisition]\nsubset = 1", r"expected columns, .*order, pattern_period_s"),
        ("[zzz]\nf_number = 1", r"zzz: no such field, expected acquisition, base, description"),
        ("[detector]\nwidth_m = '-2 mm'", r"width_m\.value = '-2 mm': expected above 0"),
        (
            "[detector.width_m]\nvalue = '-2 mm'\nsource = 'x'",
            r"width_m\.value = '-2 mm': expected above 0",
        ),
        ("[detector]\nwidth_m = 0", r"detector\.width_m\.value = 0: expected above 0"),
        ("[emitter]\nrows = 60", r"rows: 60 is not a power of two"),
        (
            "[acquisition]\nn_patterns = 5000",
            r"acquisition\.n_patterns: 5000 is not a whole number between 1 and 4096",
        ),
        ("[acquisition]\nn_patterns = 0", r"acquisition\.n_patterns\.value = 0"),
        (
            "[acquisition]\norder = 'random'",
            r"acquisition\.order\.value = 'random': expected 'natural', .* 'raster'$",
        ),
        ("[acquisition]\norder = 'custom'", r"acquisition\.order: 'custom' needs the rows .*masks"),
        (
            "[acquisition]\nintegration_time_s = 1.0",
            "integration_time_s = 1: expected at most pattern_period_s",
        ),
        ("[detector]\nwidth_m = 'wide'", r"detector\.width_m = 'wide'"),
        ("[detector]\nwidth_m = { value = 1e-3 }", "needs either `source` or `assumed`"),
        ("[detector", "no valid TOML"),
    ],
)
def test_errors_name_file_field_and_value(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, f'base = "paper"\nname = "mine"\n{text}\n')
    with pytest.raises(InputError, match=expected) as caught:
        load_system(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_changes_its_base_does_not_go_by_the_words_of_it(tmp_path: Path) -> None:
    """A detector of 1 mm was told as "3 mm InGaAs photodiode", in the words of the base."""
    write(tmp_path, 'base = "workable"\n[detector]\nwidth_m = "1 mm"\npixels = 1\n', "a.toml")
    path = write(tmp_path, 'base = "a.toml"\nname = "b"\n', "b.toml")
    told = "as workable, but for detector.width_m, detector.pixels"
    assert load_system(tmp_path / "a.toml").description == told
    assert load_system(path).description == told  # it changes nothing
    own = write(tmp_path, 'base = "a.toml"\ndescription = "mine"\n[sky]\npart = "dusk"\n', "c.toml")
    assert load_system(own).description == "mine"


def test_unknown_names_and_circles(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'nope' is neither a TOML file nor one of led-16x16"):
        load_system("nope")
    write(tmp_path, 'base = "b.toml"\nname = "a"', "a.toml")
    path = write(tmp_path, 'base = "a.toml"\nname = "b"', "b.toml")
    with pytest.raises(InputError, match="in a circle"):
        load_system(path)


def test_a_file_without_a_name_is_called_after_itself(tmp_path: Path) -> None:
    assert load_system(write(tmp_path, 'base = "paper"\n', "night.toml")).name == "night"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[emitter]\nrows = '64'", r"emitter\.rows\.value = '64'"),
        ("[emitter]\nrows = true", r"emitter\.rows\.value = True"),
        ("[emitter]\nrows = { source = 'x' }", r"emitter\.rows\.value: missing"),
        ("[filter]\ncenter_wavelength_m = 1550.0", "outside the solar spectrum"),
    ],
)
def test_slips_are_caught(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        load_system(write(tmp_path, f'base = "paper"\n{text}\n'))


# Parts.


@pytest.mark.parametrize("name", part_names())
def test_bundled_parts_source_every_value(name: str) -> None:
    part = load_part(name)
    for field, value in part.values():
        assert (value.source or value.assumed) != "given without a source", field


def test_a_system_names_parts_and_overrides_them(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        'base = "paper"\n[filter]\npart = "fb1550-30"\ntransmission = 0.7\n[sky]\npart = "night"\n',
    )
    mine = load_system(path)
    assert mine.filter.width_m.value == 30e-9
    assert mine.filter.transmission.value == 0.7
    assert mine.sky.illuminance_lx.value == 0.25


def test_a_users_own_part_beside_the_system(tmp_path: Path) -> None:
    write(tmp_path, 'base = "fga015"\n[detector]\nwidth_m = 2e-3\n', "big.toml")
    path = write(tmp_path, 'base = "paper"\n[detector]\npart = "big.toml"\n')
    assert load_system(path).detector.width_m.value == 2e-3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[filter]\npart = "nope"', "filter.part: 'nope' is neither"),
        ('[filter]\npart = "fga015"', "filter.part = 'fga015': this part has no filter"),
        ("[filter]\npart = 3", "filter.part = 3: expected the name"),
        (
            "[sky]\nsun_elevation_deg = 30.0\nilluminance_lx = 5.0",
            "either illuminance_lx or sun_elevation_deg",
        ),
        ("[detector]\nheight_m = 1e-3", "width_m alone"),
    ],
)
def test_bad_references(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        load_system(write(tmp_path, f'base = "paper"\n{text}\n'))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[acquisition]\ncolumns = 100", "columns: 100 does not divide detector.pixels, 1024"),
        ("[emitter]\ncolumns = 16", r"emitter.columns must be 1 \(it is 16\)"),
    ],
)
def test_line_sensors_that_do_not_fit(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        load_system(write(tmp_path, f'base = "line-256x16"\n{text}\n'))


def test_the_schema_offers_what_a_system_takes() -> None:
    """Complementary sets need two detectors, and a system has one."""
    text = json.dumps(System.model_json_schema())
    assert '"s-matrix"' in text
    assert "complementary" not in text


def test_schemas_know_every_section() -> None:
    """What an editor checks against: sections, required fields, allowed words."""
    text = json.dumps(System.model_json_schema())
    for word in ("radiant_intensity_w_per_sr", "sequency", "matched", "sun_elevation_deg"):
        assert word in text


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("emitter.peak_wavelength_m", 1550, "1550: expected 1e-07 to 0.0001"),
        ("emitter.peak_wavelength_m", 1.55, "1.55: expected 1e-07 to 0.0001"),
        ("emitter.line_fwhm_m", 5e-324, "4.94066e-324: expected 1e-24 to 0.0001"),
    ],
)
def test_wavelengths_are_those_of_light(field: str, value: float, told: str) -> None:
    """One in nm or um in place of m gave an emitter of which no light passes the filter; of a line
    narrower than floats divide NumPy warned.
    """
    with pytest.raises(InputError, match=rf"{field.partition('.')[2]} = {told}"):
        load_system("workable").with_({field: value})


def test_whole_numbers_may_have_an_exponent() -> None:
    system = load_system("workable").with_({"acquisition.n_patterns": 1e3})
    assert system.acquisition.n_patterns.value == 1000
    assert type(system.acquisition.n_patterns.value) is int
    with pytest.raises(InputError, match=r"acquisition\.n_patterns\.value = 1\.5"):
        system.with_({"acquisition.n_patterns": 1.5})


def test_what_is_wrong_is_told_before_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "x"\n[emitter]\nrows = 7\n[optics]\nf_number = -1\n')
    with pytest.raises(InputError, match=r"mine\.toml: optics\.f_number\.value = -1: .*missing"):
        load_system(path)


@pytest.mark.parametrize(
    ("grid", "note"),
    [
        ("rows = 64", None),
        ("columns = 128", "samples half of the 8192 patterns of 128 x 64 cells"),
        ("rows = 128\ncolumns = 128", "n_patterns = 4096: samples a quarter of the 16384 patterns"),
        ("rows = 1024\ncolumns = 64", "samples 6.2 % of the 65536"),
    ],
)
def test_another_grid_with_the_patterns_of_its_base_says_what_it_samples(
    tmp_path: Path, grid: str, note: str | None
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "workable"\n[emitter]\n{grid}\n')
    found = load_system(path).sampling_note
    assert found is None if note is None else note in found
