"""Systems, radars and scenes with some of their values changed: what is wrong fails where it is
set, and names field, value and what was expected.
"""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.files import InputError
from twin.radar import load_radar
from twin.scene import Pose, SceneObject, Sun, load_scene, parse_pose, parse_track
from twin.system import Part, load_part, load_system

WORKABLE = load_system("workable")


def test_a_changed_value_is_the_only_difference() -> None:
    same = {"name": WORKABLE.name, "description": WORKABLE.description}
    changed = WORKABLE.with_({"optics.f_number": 0.8, **same})
    assert changed.optics.f_number.value == 0.8
    assert changed.optics.f_number.assumed
    back = changed.with_({"optics.f_number": WORKABLE.optics.f_number, **same})
    assert back == WORKABLE


def test_the_description_says_what_was_changed_as_that_of_a_file_does(tmp_path: Path) -> None:
    """In the words of its base a detector of 1 mm was one of 3 mm."""
    once = WORKABLE.with_({"detector.width_m": "1 mm"})
    path = tmp_path / "mine.toml"
    path.write_text('base = "workable"\n[detector]\nwidth_m = "1 mm"\n')
    assert once.description == load_system(path).description
    again = once.with_({"detector.pixels": 1, "detector.width_m": "2 mm"})
    assert again.description == "as workable, but for detector.width_m, detector.pixels"
    named = again.with_({"name": "mine"})
    assert named.description == again.description
    other = named.with_({"optics.f_number": 0.8})
    assert other.description == "as mine, but for optics.f_number"
    assert once.with_({"description": "mine", "detector.pixels": 1}).description == "mine"


def test_the_name_says_once_that_something_was_changed() -> None:
    once = WORKABLE.with_({"optics.f_number": 0.8})
    assert once.name == "workable (changed)"
    assert once.with_({"optics.f_number": 0.9}).name == "workable (changed)"


def test_values_keep_their_source() -> None:
    value = {"value": 0.8, "source": "data sheet"}
    assert WORKABLE.with_({"optics.f_number": value}).optics.f_number.source == "data sheet"


def test_parts_sections_and_fields_over_them() -> None:
    part = load_part("ingaas-apd-200")
    by_name = WORKABLE.with_({"detector.part": "ingaas-apd-200"})
    by_object = WORKABLE.with_({"detector.part": part})
    by_section = WORKABLE.with_({"detector": part.detector})
    assert by_name.detector == by_object.detector == by_section.detector == part.detector
    over = WORKABLE.with_({"detector.width_m": 1e-4, "detector.part": part})
    assert over.detector.width_m.value == 1e-4
    assert over.detector.gain == part.detector.gain


def test_a_field_drops_its_alternatives() -> None:
    low = WORKABLE.with_({"sky.sun_elevation_deg": 10.0})
    assert low.sky.illuminance_lx is None
    assert low.with_({"sky.illuminance_lx": 2e4}).sky.sun_elevation_deg is None


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"detector.width_m": "-2 mm"}, "detector.width_m.value = '-2 mm': expected above 0"),
        ({"optics.f_number": 0.3}, "system: optics.f_number.value = 0.3: .*0.5"),
        ({"optics.f_number": "fast"}, "optics.f_number"),
        ({"optics.f_nummer": 0.8}, "optics.f_nummer: no such field; .*optics.f_number"),
        ({"lens.f_number": 0.8}, "lens.f_number: no such field"),
        ({"f_number": 0.8}, "f_number: no such field; did you mean optics.f_number"),
        ({"optics": None}, "optics"),
        ({"detector.part": "clear-air"}, "this part has no detector"),
        ({"detector.part": "nope"}, "'nope'"),
        ({"acquisition.n_patterns": 1000.5}, "acquisition.n_patterns"),
        # What must fit between sections.
        ({"detector.responsivity_a_per_w": 1.3}, "one electron a photon"),
        ({"acquisition.n_patterns": 5000}, "acquisition.n_patterns"),
        ({"filter.transmission_csv": "nowhere.csv"}, "nowhere.csv"),
    ],
)
def test_what_is_wrong_fails_where_it_is_set(changes: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        WORKABLE.with_(changes)


def test_copies_of_sections_are_validated_too() -> None:
    with pytest.raises(InputError, match=r"f_number.value = 0.3"):
        WORKABLE.optics.model_copy(update={"f_number": 0.3})
    with pytest.raises(InputError, match="f_nummer"):
        WORKABLE.optics.model_copy(update={"f_nummer": 0.8})
    optics = WORKABLE.optics.model_copy(update={"f_number": 0.8})
    assert optics.f_number.value == 0.8
    line = WORKABLE.filter.model_copy(update={"center_wavelength_m": 2e-6})
    strong = WORKABLE.detector.model_copy(update={"responsivity_a_per_w": 1.3})
    assert WORKABLE.model_copy(update={"filter": line}).filter is line
    with pytest.raises(InputError, match="one electron a photon"):
        WORKABLE.model_copy(update={"detector": strong})


def test_optional_sections_come_and_go() -> None:
    weather = load_part("fog-50m").weather
    foggy = WORKABLE.with_({"weather.part": "fog-50m"})
    assert foggy.weather == weather
    assert foggy.with_({"weather": None}).weather is None


def test_radars_and_parts_change_alike() -> None:
    radar = load_radar("hybrid-79").with_({"waveform.n_slots": 128})
    assert radar.ofdm.n_slots == 128
    with pytest.raises(InputError, match=r"waveform.n_slots.value = 0"):
        radar.with_({"waveform.n_slots": 0})
    with pytest.raises(InputError, match="has no parts"):
        radar.with_({"antenna.part": "fga015"})
    part: Part = load_part("fga015").with_({"detector.width_m": 1e-3})
    assert part.detector.width_m.value == 1e-3


def test_scenes_change_by_the_names_of_a_study() -> None:
    scene = load_scene("yard")
    name = next(t.object for t in scene.targets if t.object)
    changed = scene.with_(
        {
            "rig.x_m": 1.0,
            "rig.yaw_deg": 5.0,
            "sun.illuminance_lx": 2e4,
            "objects.*.reflectance": 0.3,
            f"objects.{name}.velocity_m_per_s": (1.0, 0.0, 0.0),
            f"objects.{name}.shift_y_m": 2.0,
            "targets.*.rcs_m2": 3.0,
        }
    )
    assert changed.rig.pose.position_m == (1.0, *scene.rig.pose.position_m[1:])
    assert changed.rig.pose.yaw_deg == 5.0
    assert changed.sun == Sun(scene.sun.azimuth_deg, scene.sun.elevation_deg, 2e4)
    assert {o.reflectance for o in changed.objects} == {0.3}
    assert {t.rcs_m2 for t in changed.targets} == {3.0}
    (before,) = (o for o in scene.objects if o.name == name)
    (after,) = (o for o in changed.objects if o.name == name)
    assert after.velocity_m_per_s == (1.0, 0.0, 0.0)
    moved = after.vertices_m - before.vertices_m
    np.testing.assert_allclose(moved, np.broadcast_to([0, 2, 0], moved.shape), atol=1e-12)
    carried = [(a, b) for a, b in zip(changed.targets, scene.targets, strict=True) if a.object]
    for a, b in carried:
        own = a.object == name
        assert a.velocity_m_per_s == ((1.0, 0.0, 0.0) if own else b.velocity_m_per_s)
        assert a.position_m[1] == pytest.approx(b.position_m[1] + 2 * own)


@pytest.mark.quick(6)
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"sun.elevation_deg": 91}, "scene.sun.elevation_deg = 91: expected -90 to 90"),
        ({"sun.elevation": 20}, "did you mean sun.elevation_deg"),
        ({"rig.x_m": float("nan")}, "scene.rig.position_m = nan: expected a finite number"),
        ({"objects.*.reflectance": 1.2}, r"reflectance = 1.2: expected 0 to 1"),
        ({"objects.*.reflectance": True}, r"reflectance = True"),
        ({"objects.*.velocity_m_per_s": 3.0}, "velocity_m_per_s = 3.0: expected three numbers"),
        ({"objects.*.velocity_m_per_s": (3e8, 0, 0)}, "velocity_m_per_s"),
        ({"objects.*.radar": "mirror"}, "radar = 'mirror': expected one of surface"),
        ({"objects.*.thickness_m": 0}, "thickness_m = 0: expected a number above 0"),
        ({"objects.*.shift_x_m": "far"}, "shift_x_m = 'far'"),
        ({"objects.nobody.reflectance": 0.5}, "no 'nobody'; there are"),
        ({"targets.*.rcs_m2": 0.0}, "rcs_m2 = 0.0: expected a number above 0"),
    ],
)
def test_scenes_that_cannot_be_fail_where_they_are_made(
    changes: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        load_scene("yard").with_(changes)


def test_pieces_of_a_scene_check_themselves() -> None:
    with pytest.raises(InputError, match=r"rig\.yaw_deg = inf"):
        Pose((0.0, 0.0, 0.0), yaw_deg=float("inf"))
    item: SceneObject = load_scene("yard").objects[0]
    with pytest.raises(InputError, match=f"objects.{item.name}.reflectance = -0.1"):
        replace(item, reflectance=-0.1)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"rig.x_m": 1e300}, r"scene.rig.x_m = 1e\+300: expected at most 1e\+09 m"),
        ({"rig.x_m": 1e6}, r"objects.ground is then up to 1e\+06 m from the rig"),
        ({"rig.yaw_deg": 1e300}, r"scene.rig.yaw_deg = 1e\+300: expected"),
        ({"objects.wall.shift_x_m": 1e9}, r"objects.wall is then up to 1e\+09 m from the rig"),
        ({"objects.*.shift_x_m": 1e300}, "expected at most 100000 m"),
    ],
)
def test_a_scene_is_moved_no_farther_than_a_file_may(changes: dict, told: str) -> None:
    with pytest.raises(InputError, match=told):
        load_scene("yard").with_(changes)


def test_a_scene_is_moved_as_a_whole() -> None:
    moved = load_scene("yard").with_({"rig.x_m": 1e6, "objects.*.shift_x_m": 1e6})
    assert moved.rig.position_m[0] == 1e6


@pytest.mark.parametrize(
    "changes",
    [
        {"optics.f_number": 1e300},
        {"detector.dark_current_a": 1e300},
        {"detector.width_m": 1e-300},
        {"readout.read_noise_e": 1e300},
        {"readout.bandwidth_hz": 5e-324},
        {"readout.adc_full_scale_v": 1e300},
        {"readout.transimpedance_ohm": 1e-300},
    ],
)
def test_numbers_of_no_device_are_refused_where_they_are_set(changes: dict) -> None:
    (field,) = changes
    with pytest.raises(InputError, match=field.split(".")[1] + " = .*expected"):
        load_system("workable").with_(changes)


def test_whole_numbers_may_be_numpys() -> None:
    assert load_system("workable").with_({"acquisition.n_patterns": np.int64(100)}) == (
        load_system("workable").with_({"acquisition.n_patterns": 100})
    )
    radar = load_radar("hybrid-79").with_({"waveform.n_slots": np.int64(64)})
    assert radar.waveform.n_slots.value == 64


def test_scenes_of_one_content_are_equal() -> None:
    """Loaded twice, pickled, changed alike; not where a reflectance or the rig differs."""
    scene = load_scene("yard")
    copies = [load_scene("yard"), pickle.loads(pickle.dumps(scene))]
    assert all(copy == scene and hash(copy) == hash(scene) for copy in copies)
    changes = [{"rig.x_m": 1.0}, {"objects.*.reflectance": 0.3}, {"objects.car.shift_x_m": 0.1}]
    made = [scene, *(scene.with_(change) for change in changes)]
    assert len(set(made)) == 4
    assert scene.with_(changes[0]) == load_scene("yard").with_(changes[0])
    assert scene != "yard"


@pytest.mark.parametrize("changes", [None, [], 5, {5: 1}])
def test_what_is_no_mapping_from_names_is_an_error(changes) -> None:
    for entry in (WORKABLE, load_radar("hybrid-79"), load_scene("table1")):
        with pytest.raises(InputError, match="expected values by their dotted names"):
            entry.with_(changes)


def test_messages_name_what_is_wrong_in_words_of_files(tmp_path) -> None:
    """The field of a curve's file; a part by its name; a radar, not a class of the code."""
    with pytest.raises(InputError, match=r"filter\.transmission_csv: .*nope\.csv: can't be read"):
        WORKABLE.with_({"filter.transmission_csv": str(tmp_path / "nope.csv")})
    with pytest.raises(InputError, match=r"^filter\.part = 'fga015': this part has no filter$"):
        WORKABLE.with_({"filter.part": load_part("fga015")})
    with pytest.raises(InputError, match=r"^radar: waveform\.n_slots"):
        load_radar("hybrid-79").with_({"waveform.n_slots": 0})
    with pytest.raises(InputError, match=r"^sourced: value"):
        WORKABLE.optics.f_number.model_copy(update={"value": "x"})
    told = r"scene\.rig\.x_m = array\(\[ ?1\.\]\): expected a number"
    with pytest.raises(InputError, match=told):
        load_scene("table1").with_({"rig.x_m": np.array([1.0])})


@pytest.mark.parametrize(
    ("parse", "text", "told"),
    [
        (parse_pose, "1,2 m,3k", "z = '3k': .* 'k' is no known unit"),
        (parse_pose, "1,2,3,4 m", "yaw = '4 m': .* another dimension"),
        (parse_track, "1,2 lx,3,4", "dy = '2 lx': .* another dimension"),
        (parse_track, "1,2,3,4,5 m", "interval = '5 m': .* another dimension"),
        (parse_pose, "1,2", "expected x,y,z"),
    ],
)
def test_a_pose_or_a_track_says_which_part_is_wrong(parse, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        parse(text)
