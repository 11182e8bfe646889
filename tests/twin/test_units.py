"""Text with a unit wherever a number with a unit is read: files, studies, the command line."""

from pathlib import Path

import jsonschema
import pytest
from typer.testing import CliRunner

from twin.cli import app
from twin.files import InputError
from twin.radar import load_radar
from twin.radar.device.design import RadarDesign
from twin.scene import load_scene, parse_pose, parse_track
from twin.scene.settings import SceneSettings
from twin.sweep import load_study
from twin.system import Part, System, load_system
from twin.toml import Entry

_SYSTEM = """base = "workable"
[detector]
width_m = {width}
[acquisition]
integration_time_s = {time}
pattern_period_s = {{ value = "1 ms", source = "its data sheet" }}
"""


def _system(folder: Path, width: str = '"200 um"', time: str = '"315 us"') -> System:
    path = folder / "mine.toml"
    path.write_text(_SYSTEM.format(width=width, time=time))
    return load_system(path)


def test_a_system_says_the_same_in_both_forms(tmp_path: Path) -> None:
    assert _system(tmp_path) == _system(tmp_path, "200e-6", "315e-6")
    assert _system(tmp_path).acquisition.pattern_period_s.source == "its data sheet"


@pytest.mark.parametrize("width", ['"20 klx"', '{ value = "20 klx", source = "a mistake" }'])
def test_another_dimension_names_file_field_and_value(tmp_path: Path, width: str) -> None:
    told = r"mine\.toml: detector\.width_m = '20 klx': expected a number or a quantity in m; 'klx'"
    with pytest.raises(InputError, match=told):
        _system(tmp_path, width)


def test_limits_hold_for_text_too(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"integration_time_s.* = '0 us'"):
        _system(tmp_path, time='"0 us"')
    with pytest.raises(InputError, match=r"filter\.transmission.* = '120 %'"):
        load_system("workable").with_({"filter.transmission": "120 %"})


def test_counts_and_words_take_no_units() -> None:
    with pytest.raises(InputError, match=r"acquisition\.n_patterns"):
        load_system("workable").with_({"acquisition.n_patterns": "1 m"})
    with pytest.raises(InputError, match=r"detector\.shape"):
        load_system("workable").with_({"detector.shape": "1 m"})


def test_lists_and_levels_of_a_radar() -> None:
    radar = load_radar("hybrid-79").with_(
        {
            "waveform.carrier_hz": "79 GHz",
            "front_end.transmit_power_w": "10 dBm",
            "front_end.noise_figure_db": "12 dB",
            "elements.receivers_m": [["0 m", "-1 mm", 0.0], [0.0, "1 mm", 0.0]],
            "elements.transmitters_m": [[0.0, 0.0, 0.0]],
        }
    )
    assert radar.waveform.carrier_hz.value == 79e9
    assert radar.front_end.transmit_power_w.value == 0.01
    assert radar.elements is not None
    assert radar.elements.receivers_m.value == ((0.0, -1e-3, 0.0), (0.0, 1e-3, 0.0))
    with pytest.raises(InputError, match=r"noise_figure_db = '12 %'.* in dB"):
        radar.with_({"front_end.noise_figure_db": "12 %"})


def test_a_scene(tmp_path: Path) -> None:
    toml = (load_scene("yard").path.parent / "scene.toml").read_text()
    plain = SceneSettings.model_validate(_read(tmp_path, toml))
    assert plain.sun.illuminance_lx != 2e4
    lines = [
        'illuminance_lx = "20 klx"' if line.startswith("illuminance_lx") else line
        for line in toml.splitlines()
    ]
    assert SceneSettings.model_validate(_read(tmp_path, "\n".join(lines))).sun == (
        plain.sun.model_copy(update={"illuminance_lx": 2e4})
    )
    scene = load_scene("yard").with_({"sun.illuminance_lx": "20 klx", "rig.x_m": "150 cm"})
    assert scene.sun.illuminance_lx == 2e4
    assert scene.rig.pose.position_m[0] == 1.5
    with pytest.raises(InputError, match=r"scene\.rig\.x_m = '20 klx': .* in m;"):
        scene.with_({"rig.x_m": "20 klx"})


def _read(folder: Path, text: str) -> object:
    from twin.toml import read_toml

    (folder / "some.toml").write_text(text)
    return read_toml(folder / "some.toml")


def test_a_study(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    text = 'metrics = ["snr_median"]\n[grid]\n"system.detector.width_m" = ["200 um", 1e-3]\n'
    path.write_text(text + '"system.filter.transmission" = ["50 %", 0.9]\n')
    study = load_study(path)
    assert study.point(0)["system.detector.width_m"] == 200e-6
    assert study.point(0)["system.filter.transmission"] == 0.5
    path.write_text(text.replace("200 um", "200 lx"))
    with pytest.raises(InputError, match=r"study\.toml: .*width_m = '200 lx': .* in m; 'lx'"):
        load_study(path)


def test_poses_and_tracks() -> None:
    assert parse_pose("100 cm, 0, 1.2 m, 15 deg") == parse_pose("1,0,1.2,15")
    assert parse_pose("1 0 1.2 15") == parse_pose("1 m 0 m 1.2 m 15 deg")
    assert parse_track("0,15 mm,0,65,100 ms") == parse_track("0,0.015,0,65,0.1")
    for wrong in ("1 s,0,1", "1,0", "1,0,1,1 m", "1,0,1,0,0,0,0", "1,,1"):
        with pytest.raises(InputError, match="expected x,y,z"):
            parse_pose(wrong)
    for wrong in (
        "0,1 s,0,65",
        "0,1,0,65.5",
        "0,1,0",
        "0,1,0,65,1 m",
        "0,1,0,65,1,1",
        "0,1,0,65,0",
    ):
        with pytest.raises(InputError, match="expected dx,dy,dz"):
            parse_track(wrong)


def _twin(*words: str) -> str:
    """What a command says, on the terminal or in the error that ends it."""
    done = CliRunner().invoke(app, words)
    return done.output + str(done.exception or "")


def test_the_command_line() -> None:
    told = _twin("budget", "--system", "workable", "--distances", "2 m,500 cm")
    assert "assumed:" in told
    assert told == _twin("budget", "--system", "workable", "--distances", "2,5")
    told = " ".join(_twin("rcs", "x.stl", "--carrier-hz", "79 Gm", "--azimuth", "0").split())
    assert "'79 Gm': expected a number or a quantity in Hz; 'Gm' is of another dimension" in told
    told = _twin("budget", "--system", "workable", "--distances", "2 s")
    assert "distances: '2 s': expected a number or a quantity in m; 's' is of" in told


@pytest.mark.parametrize(
    ("model", "section", "field", "good", "bad"),
    [
        (System, "detector", "width_m", [2e-4, "200 um"], [True, "wide"]),
        (System, "filter", "transmission", [0.9, "90 %"], [None, 1.5]),
        (System, "acquisition", "n_patterns", [64], ["64 m", 1.5]),
        (Part, "time_of_flight", "modulation_hz", [], []),
        (RadarDesign, "oscillator", "offset_hz", [[1e3, "10 kHz"]], [["fast"], "10 kHz"]),
    ],
)
def test_schemas_know_both_forms(
    model: type[Entry], section: str, field: str, good: list[object], bad: list[object]
) -> None:
    """With a source or without."""
    schema = model.model_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    kind = model.sections().get(section)
    part = kind and schema["$defs"].get(kind.__name__)
    if part is None:
        assert not good
        return
    own = {"$defs": schema["$defs"], **part["properties"][field]}
    valid = jsonschema.Draft202012Validator(own).is_valid
    for value in good:
        assert valid(value), value
        assert valid({"value": value, "source": "x"}), value
    for value in bad:
        assert not valid(value) or (value is None and "null" in str(own)), value
        assert not valid({"value": value, "source": "x"}), value


def test_the_schema_of_a_scene_knows_both_forms() -> None:
    schema = SceneSettings.model_json_schema()
    valid = jsonschema.Draft202012Validator(schema).is_valid
    scene = {
        "rig": {"position_m": ["1 m", 0, 1.2], "yaw_deg": "5 deg"},
        "sun": {"azimuth_deg": 0, "elevation_deg": 20, "illuminance_lx": "20 klx"},
    }
    assert valid(scene)
    assert not valid({**scene, "rig": {"position_m": ["far", 0, 1.2]}})
