"""System files: typed, sourced, inheriting, and clear about what is wrong."""

from pathlib import Path

import pytest

from twin.files import InputError
from twin.system import load_system, system_names


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


def test_systems_build_on_files_beside_them(tmp_path: Path) -> None:
    write(tmp_path, 'base = "workable"\nname = "a"\n[sky]\nilluminance_lx = 5.0\n', "a.toml")
    path = write(tmp_path, 'base = "a.toml"\nname = "b"\n', "b.toml")
    assert load_system(path).sky.illuminance_lx.value == 5.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[optics]\nf_number = -1", r"optics\.f_number\.value = -1: .*greater than 0"),
        ("[optics]\nf_number = nan", r"optics\.f_number"),
        ("[optics]\nf_numbr = 1", r"optics\.f_numbr = 1: Extra inputs"),
        ("[emitter]\nrows = 60", r"rows: 60 is not a power of two"),
        (
            "[acquisition]\nn_patterns = 5000",
            r"acquisition\.n_patterns: 5000 is not between 1 and 4096",
        ),
        ("[acquisition]\nn_patterns = 0", r"acquisition\.n_patterns\.value = 0"),
        ("[acquisition]\norder = 'random'", r"acquisition\.order.*'random'"),
        ("[acquisition]\nintegration_time_s = 1.0", "longer than pattern_period_s"),
        ("[detector]\nwidth_m = 'wide'", r"detector\.width_m\.value = 'wide'"),
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


def test_unknown_names_and_circles(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'nope' is neither a TOML file nor one of paper"):
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
