"""The radar chain against the radar equation, image theory, the direct sum and its bounds."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import constants

from hardware.radar import channel, detect, range_doppler
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.geometry import Geometry
from twin.radar import load_radar, radar_capture, radar_echo
from twin.radar.acquisition import contributions
from twin.radar.device.design import RadarDesign
from twin.radar.evaluation import evaluate_radar
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.scene.materials import radio_properties
from twin.radar.propagation.scene.scattering_models import ScatteringModel, assign_scattering_models
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.report.radar_findings import radar_finding
from twin.report.summary import summary
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, Target, load_scene
from twin.scene.materials import load_materials

C = constants.c
MATERIALS = load_materials(Path(__file__).parents[2] / "scenes" / "materials.toml")
AT_ORIGIN = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))


def plate(name: str, distance_m: float, side_m: float, material: str = "concrete") -> SceneObject:
    """A square facing the radar."""
    h = side_m / 2
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]]) + [distance_m, 0, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    return SceneObject(name, Geometry(corners, faces), material, 0.5)


def target(position, velocity=(0.0, 0.0, 0.0), rcs_m2: float = 10.0, name: str = "t") -> Target:
    return Target(name, tuple(position), tuple(velocity), rcs_m2, "declared here")


def world(*objects: SceneObject, targets: tuple[Target, ...] = (), rig: Rig = AT_ORIGIN) -> Scene:
    sun = Sun(180.0, 30.0, 0.0)
    return Scene("test", Path("test"), "", objects, rig, sun, targets, materials=MATERIALS)


def changed(radar: RadarDesign, **changes: object) -> RadarDesign:
    content = radar.model_dump()
    for name, value in changes.items():
        section, field = name.split("__")
        content[section][field] = value
    return RadarDesign.model_validate(content)


# Design.


def test_link_budget_is_the_audited_one() -> None:
    """12 dBm, 2 x 20 dBi, 13 dB, 6 dB: 10 m^2 at 150 m give -112.4 dBm; 28.5 dB after 10 ms of
    energy, of which the prefix takes 0.11 dB and the pause at a slot's end 0.02 dB.
    """
    radar = load_radar("hybrid-79")
    received = radar.received_power_w(150.0, 10.0)
    assert 10 * np.log10(received * 1e3) == pytest.approx(-112.4, abs=0.05)
    assert 10 * np.log10(radar.image_snr(received)) == pytest.approx(28.5, abs=0.15)


def test_antenna_pattern_radiates_what_it_is_fed() -> None:
    """The gain integrates to 4 pi over the sphere, by quadrature."""
    antenna = load_radar("hybrid-79").antenna
    cos = (np.arange(200_000) + 0.5) / 200_000
    towards = np.column_stack([cos, np.sqrt(1 - cos**2), 0 * cos])
    assert antenna.gain(towards).mean() * 2 * np.pi == pytest.approx(4 * np.pi, rel=1e-4)
    assert antenna.gain(np.array([1.0, 0, 0])) == pytest.approx(100.0)
    assert antenna.gain(np.array([-0.6, 0.8, 0])) == 0.0


def test_designs_say_where_they_contradict_themselves() -> None:
    radar = load_radar("hybrid-79")
    assert radar.warnings() == []
    assert "78.00-82.00 GHz leaves 76-81 GHz" in load_radar("paper-80").warnings()[0]
    (far,) = radar.warnings(farthest_m=160.0)
    assert "appears at 6.5 m" in far
    fast = radar.warnings(fastest_m_per_s=30.0)
    assert "beyond the unambiguous +/- 24.29 m/s" in fast[0]
    wave = radar.ofdm  # repeats are so many that their mean is nearly an integral
    integral_db = -20 * np.log10(
        np.sinc(2 * 30.0 / wave.wavelength_m * wave.repeats * wave.symbol_s)
    )
    (told,) = re.findall(r"loses ([\d.]+) dB at 30.0 m/s", fast[1])
    assert float(told) == pytest.approx(integral_db, abs=0.06)
    # 8 cells within the 10 ms: 20 log10 8 dB, and 1 dB of ripple.
    assert "19 dB weaker where detection looks for it" in fast[2]
    (stepped,) = (line for line in load_radar("prototype").warnings(0, 1.0) if "steps" in line)
    assert "shift an echo's range by 0.63 m" in stepped  # fc T / B: 2.5 GHz, 5.06 ms, 20 MHz
    assert not any("steps" in line for line in load_radar("prototype").warnings(0, 0.01))
    short = changed(radar, waveform__prefix_s=0.4e-6).warnings()
    assert "protects 60.0 m of 153.5 m" in short[0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[waveform]\nrepeats = 39", "slot_period_s"),
        ("[waveform]\nn_slots = 0", "waveform.n_slots.value = 0"),
        ("[waveform]\ncarrier_hz = '79 m'", "waveform.carrier_hz = '79 m'"),
        ("[waveform]\nsymbols = 'qam'", "waveform.symbols"),
        ("[antenna]\ngain_dbi = 1.0", "antenna.gain_dbi"),
        ("[waveform", "no valid TOML"),
    ],
)
def test_malformed_waveform_files(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "hybrid-79"\n{text}\n')
    with pytest.raises(InputError) as caught:
        load_radar(path)
    assert str(path) in str(caught.value)
    assert expected in str(caught.value)


# Propagation.


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("distance_m", "rate"), [(10.0, 2.0), (50.0, 2.0), (140.0, 2.0), (50.0, -20.0)]
)
def test_a_target_in_free_space_obeys_the_radar_equation(distance_m: float, rate: float) -> None:
    """10 m^2 receding at 2 m/s, and approaching at 20, where a slot loses 2.4 dB.

    Level within 0.2 dB after that loss, range and rate within 3 standard errors of the Cramer-Rao
    bound (rectangular window, so no window loss).
    """
    radar = load_radar("hybrid-79")
    scene = world(targets=(target((distance_m, 0, 0), (rate, 0, 0)),))
    taken = radar_capture(scene, radar, seed=4)
    received = channel(taken.record)
    image = range_doppler(received, radar.ofdm, "boxcar")
    found = detect(received, radar.ofdm, image, window="boxcar", at_most=1)[0]
    expected = radar.received_power_w(distance_m, 10.0)
    loss = float(radar.ofdm.slot_gain(np.array(2 * rate / radar.ofdm.wavelength_m))) ** 2
    assert 10 * np.log10(found.power_w / (expected * loss)) == pytest.approx(0, abs=0.2)
    per_root_snr = np.sqrt(6 / radar.image_snr(expected * loss)) / (4 * np.pi)
    range_bound = C / 976_562.5 * per_root_snr / np.sqrt(4096**2 - 1)
    rate_bound = radar.ofdm.wavelength_m / 39.0625e-6 * per_root_snr / np.sqrt(256**2 - 1)
    assert abs(found.range_m - distance_m) < 3 * range_bound
    assert abs(found.range_rate_m_per_s - rate) < 3 * rate_bound


def test_a_large_wall_is_a_mirror() -> None:
    """Image at twice the distance, weakened by Fresnel's coefficient of the half space."""
    radar = load_radar("hybrid-79")
    distance = 20.123456789
    (path,) = sionna_paths(world(plate("wall", distance, 40.0)), radar, max_depth=1).paths
    permittivity, conductivity, _ = radio_properties("concrete", MATERIALS["concrete"], 79e9)
    epsilon = permittivity - 1j * conductivity / (2 * np.pi * 79e9 * constants.epsilon_0)
    fresnel = (1 - np.sqrt(epsilon)) / (1 + np.sqrt(epsilon))
    gain = 100.0 * 10 ** (-6 / 20)
    expected = gain * abs(fresnel) * radar.ofdm.wavelength_m / (4 * np.pi * 2 * distance)
    assert path.via == ("wall",)
    assert 20 * np.log10(abs(path.amplitude) / expected) == pytest.approx(0, abs=0.05)
    assert path.range_m == pytest.approx(distance, abs=1e-9)


def test_sionnas_own_street_mirrors_the_radar() -> None:
    """Its shapes are called `mesh-...`: names must come back as the file has them."""
    import importlib.util

    spec = importlib.util.find_spec("sionna")  # that of sionna.rt would start it
    folder = Path(spec.submodule_search_locations[0]) / "rt/scenes/simple_street_canyon"
    scene = load_scene(folder / "simple_street_canyon.xml")
    paths = {p.via: p for p in sionna_paths(scene, load_radar("hybrid-79")).paths}
    wall = next(o for o in scene.objects if o.name == "mesh-building_6")
    across = scene.rig.position_m[1] - wall.vertices_m[:, 1].max()
    assert paths[("mesh-building_6",)].range_m == pytest.approx(across, abs=1e-6)


def test_small_plates_do_not_mirror() -> None:
    """A plate of the Fresnel zone's size would answer with pi d^2 under the image method."""
    radar = load_radar("hybrid-79")
    scene = world(plate("sign", 20.0, 0.3))
    (role,) = assign_scattering_models(scene, radar.ofdm.wavelength_m)
    assert role.role is ScatteringModel.OBSTACLE
    assert sionna_paths(scene, radar).paths == ()


def test_obstacles_and_walls_hide_targets() -> None:
    radar = load_radar("hybrid-79")
    far = (target((30.0, 0, 0)),)
    assert len(sionna_paths(world(targets=far), radar, max_depth=1).paths) == 1
    for item in (plate("sign", 20.0, 0.3), plate("wall", 20.0, 40.0)):
        paths = sionna_paths(world(item, targets=far), radar, max_depth=1).paths
        assert all(path.target is None for path in paths)


def test_delays_are_those_of_a_float64_trace_at_150_m() -> None:
    """Direct and over a wall beside the target: phase within 1e-3 rad of image theory in float64.

    Float32 alone would be off by 1.4 degrees per last digit here.
    """
    radar = load_radar("hybrid-79")
    wall = SceneObject(
        "wall",
        Geometry(
            [[0, 7.0, -20], [160, 7.0, -20], [160, 7.0, 20], [0, 7.0, 20]], [[0, 1, 2], [0, 2, 3]]
        ),
        "concrete",
        0.5,
    )
    point = np.array([149.123456, 0.654321, 0.3])
    paths = sionna_paths(world(wall, targets=(target(point),)), radar).paths
    mirrored = np.linalg.norm(point * [1, -1, 1] + [0, 14.0, 0])
    lengths = {
        ("t",): 2 * np.linalg.norm(point),
        ("wall", "t"): np.linalg.norm(point) + mirrored,
        ("t", "wall"): np.linalg.norm(point) + mirrored,
        ("wall", "t", "wall"): 2 * mirrored,
    }
    found = {path.via: path for path in paths}
    assert set(lengths) <= set(found)
    for via, length in lengths.items():
        phase = 2 * np.pi * 79e9 * (found[via].delay_s - length / C)
        assert abs(phase) < 1e-3, via
    # Reciprocity: there and back are the same way.
    one, other = found[("wall", "t")].amplitude, found[("t", "wall")].amplitude
    assert abs(one - other) < 1e-3 * abs(one)


def test_a_slowly_approaching_targets_phase_is_a_line() -> None:
    """Positions 20 um apart at 140 m, where float32 has steps of 15 um: no staircase."""
    radar = load_radar("hybrid-79")
    places = 140.0 - 20e-6 * np.arange(6)
    phases = []
    for place in places:
        found = sionna_paths(world(targets=(target((place, 0, 0)),)), radar, max_depth=1)
        echoes = radar.burst.seen(contributions(found, radar, Atmosphere()))
        cycles = radar.ofdm.carrier_hz * echoes.delay_s[0] % 1.0
        phases.append(np.angle(echoes.amplitude[0] * np.exp(-2j * np.pi * cycles)))
    line = np.unwrap(phases)
    expected = -4 * np.pi / radar.ofdm.wavelength_m * (places - places[0])
    np.testing.assert_allclose(line - line[0], expected, atol=1e-3)


def test_multipath_over_the_ground_keeps_the_rates_of_its_legs() -> None:
    """A target moving up: its image below the ground recedes at another rate."""
    radar = load_radar("hybrid-79")
    ground = SceneObject(
        "ground",
        Geometry(
            [[-50, -50, -1.0], [50, -50, -1.0], [50, 50, -1.0], [-50, 50, -1.0]],
            [[0, 1, 2], [0, 2, 3]],
        ),
        "concrete",
        0.5,
    )
    step = 1e-6
    found = [
        {p.via: p for p in sionna_paths(world(ground, targets=(t,)), radar).paths}
        for t in (
            target((20.0, 0, 0.5), (1.0, 0, 3.0)),
            target((20.0 + step, 0, 0.5 + 3 * step), (1.0, 0, 3.0)),
        )
    ]
    for via in (("t",), ("ground", "t"), ("ground", "t", "ground")):
        difference = (found[1][via].delay_s - found[0][via].delay_s) / step
        assert found[0][via].delay_rate == pytest.approx(difference, rel=1e-4)


def test_moving_reflectors_shift_every_path_over_them() -> None:
    """A wall closing in at 3 m/s: its own echo, and the target seen in it, against finite
    differences of the refined delays.
    """
    radar, step = load_radar("hybrid-79"), 1e-6

    def at(offset: float) -> dict:
        wall = replace(plate("wall", 30.0 + offset, 60.0), velocity_m_per_s=(-3.0, 0.0, 0.0))
        return {
            p.via: p
            for p in sionna_paths(world(wall, targets=(target((12.0, 4.0, 0)),)), radar).paths
        }

    here, moved = at(0.0), at(-3.0 * step)
    for via in (("wall",), ("wall", "t"), ("t", "wall"), ("t",)):
        difference = (moved[via].delay_s - here[via].delay_s) / step
        assert here[via].delay_rate == pytest.approx(difference, rel=1e-4, abs=1e-15)
    assert here[("wall",)].delay_rate == pytest.approx(-6.0 / C, rel=1e-6)


# Captures.


def test_a_static_scene_has_no_doppler() -> None:
    radar = load_radar("hybrid-79")
    places = ((12.0, 1.0, 0.0), (33.0, -2.0, 1.0))
    targets = tuple(target(p, name=f"t{i}") for i, p in enumerate(places))
    taken = radar_capture(world(plate("wall", 45.0, 40.0), targets=targets), radar, seed=1)
    evaluation = evaluate_radar(radar, taken)
    assert len(evaluation.detections) >= 3
    for found in evaluation.detections[:3]:
        # The window makes the bound 2.2 times as large; 6 is 2.7 sigma.
        assert abs(found.range_rate_m_per_s) < 6 * found.range_rate_error_m_per_s + 1e-6


@pytest.mark.thorough
@pytest.mark.parametrize(("rung", "off_m"), [("paths", 1e-4), ("optics", 2e-3)])
def test_yard_targets_are_found_where_they_are(rung, off_m) -> None:
    """Meshes have more than one echo, and other echoes beside them."""
    radar, scene = load_radar("hybrid-79"), load_scene("yard")
    taken = radar_capture(scene, radar, seed=0, fidelity=Fidelity(radar=rung))
    evaluation = evaluate_radar(radar, taken)
    matched = {
        t.name: d for d, t in zip(evaluation.detections, evaluation.matches, strict=True) if t
    }
    assert {t.name for t in evaluation.capture.truth} == set(matched)
    trihedral = next(t for t in evaluation.capture.truth if t.name == "trihedral")
    assert matched["trihedral"].range_m == pytest.approx(trihedral.range_m, abs=off_m)
    # The strongest echo may be of any part of the car, each of which has a rate of its own.
    cars = [item for item in scene.objects if item.name.startswith("car")]
    ways = np.vstack([item.vertices_m for item in cars]) - (0.0, 0.0, 0.9)
    rates = ways @ cars[0].velocity_m_per_s / np.linalg.norm(ways, axis=1)
    car = matched["car"].range_rate_m_per_s
    assert rates.min() - 0.01 < car < rates.max() + 0.01


@pytest.mark.whole
def test_two_runs_have_the_same_bits() -> None:
    radar, scene = load_radar("hybrid-79-slow"), load_scene("yard")
    a, again = radar_capture(scene, radar, seed=1), radar_echo(scene, radar, seed=1)
    other = again.reseeded(2)
    np.testing.assert_array_equal(a.record.iq, again.record().iq)
    assert (a.record.iq != other.record().iq).any()


def test_both_engines_share_one_process() -> None:
    """Optical, radar, optical again: the same light before and after, the same echoes."""
    from twin.camera.acquisition import capture
    from twin.system import load_system

    scene, radar, system = load_scene("table1"), load_radar("hybrid-79-slow"), load_system("paper")
    fidelity = Fidelity(4, 2)
    before = capture(scene, system, fidelity=fidelity).record.counts
    radar_capture(scene, radar)
    np.testing.assert_array_equal(capture(scene, system, fidelity=fidelity).record.counts, before)


def test_an_empty_scene_is_noise_only() -> None:
    radar = load_radar("hybrid-79-slow")
    taken = radar_capture(world(), radar, seed=3)
    assert any("noise only" in w for w in taken.warnings)
    iq = taken.record.iq.astype(float)
    rms = radar.front_end.noise_counts.value / np.sqrt(2)
    assert iq.std() == pytest.approx(np.hypot(rms, 1 / np.sqrt(12)), rel=0.01)
    assert len(evaluate_radar(radar, taken).detections) <= 2


def test_a_target_at_the_radar_is_named() -> None:
    near = (target((0.0, 0, 0.001), name="bug"), target((20.0, 0, 0), name="far"))
    with pytest.raises(InputError, match=r"target 'bug': is 0\.001 m from the radar"):
        radar_capture(world(targets=near), load_radar("hybrid-79-slow"))


@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (4096, 2)])
def test_tiny_maps_give_no_detections_instead_of_an_error(shape: tuple[int, int]) -> None:
    radar = changed(
        load_radar("hybrid-79-slow"), waveform__n_subcarriers=shape[0], waveform__n_slots=shape[1]
    )
    evaluation = evaluate_radar(radar, radar_capture(world(targets=(target((20.0, 0, 0)),)), radar))
    assert isinstance(evaluation.detections, tuple)


def test_impossible_sizes_and_bands_are_refused() -> None:
    radar = load_radar("hybrid-79")
    for change in (
        {"waveform__n_subcarriers": 65536, "waveform__n_slots": 65536},
        {"front_end__noise_figure_db": 4000.0},
        {"band__low_hz": 90e9},
    ):
        with pytest.raises(ValueError, match=r"n_subcarriers|noise_figure_db|low_hz"):
            changed(radar, **change)


@pytest.mark.whole
def test_a_radar_inside_a_mesh_is_warned_of() -> None:
    import trimesh

    box = trimesh.creation.box((2.0, 2.0, 2.0))
    item = SceneObject("box", Geometry(box.vertices, box.faces), "concrete", 0.5)
    taken = radar_capture(world(item), load_radar("hybrid-79-slow"))
    assert any("the radar stands inside box" in w for w in taken.warnings)


def test_a_target_beyond_the_unambiguous_range_wraps_to_where_the_warning_says() -> None:
    radar = load_radar("hybrid-79-slow")
    taken = radar_capture(world(targets=(target((160.0, 0, 0), rcs_m2=1e4),)), radar, seed=1)
    assert any("appears at 6.5 m" in w for w in taken.warnings)
    found = evaluate_radar(radar, taken).detections[0]
    assert found.range_m == pytest.approx(160.0 - radar.ofdm.max_range_m, abs=0.01)


def test_a_carrier_without_material_data_names_the_material() -> None:
    radar = changed(load_radar("hybrid-79"), waveform__carrier_hz=60e9)
    scene = world(plate("road", 20.0, 40.0, "asphalt"))
    with pytest.raises(InputError, match=r"'asphalt': no radio properties at 60 GHz .*76-81 GHz"):
        radar_capture(scene, radar)


def test_a_strong_echo_clips_and_is_flagged() -> None:
    radar = load_radar("hybrid-79-slow")
    taken = radar_capture(world(targets=(target((0.5, 0, 0), rcs_m2=1e3),)), radar)
    assert taken.record.flags.all()
    assert any("clip" in w for w in taken.warnings)


def test_a_converter_of_two_bits_that_reads_nothing_is_told() -> None:
    """Its step of 2^14 counts is above all that comes: summaries divided by the map's noise, 0."""
    radar = changed(load_radar("hybrid-79-slow"), front_end__adc_bits=2)
    scene = world(targets=(target((20.0, 0, 0)),))
    taken = radar_capture(scene, radar)
    assert not taken.record.iq.any()
    assert [w.kind for w in taken.warnings if w.void] == ["underexposed"]
    found = evaluate_radar(radar, taken)
    assert "missed: t (the map is empty)" in str(found)
    figures = summary(scene, None, [], found)["figures"]
    [hit] = [f for f in figures if f["name"] == "targets detected"]
    assert (hit["value"], hit["noise"]) == (0, 0)
    assert "a higher gain" in str(radar_finding(found))
