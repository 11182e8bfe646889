"""Whole captures: tracks, arrays, carrier steps, weather, against closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import c as light_speed

from hardware.radar import channel
from hardware.records import read_radar_record, write_radar_record
from hardware.records.state import positions
from twin.fidelity import Fidelity
from twin.files import InputError, scenes_folder
from twin.geometry import Geometry
from twin.radar import load_radar, radar_capture
from twin.radar.device.design import RadarDesign
from twin.radar.evaluation import evaluate_radar
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, Target, Track, parse_track
from twin.scene.materials import load_materials
from twin.system import load_part

QUIET = Fidelity(radar="targets", noise="none", nufft_tolerance=1e-9)
FREE = Fidelity(radar="targets")


def world(*targets: Target, track: Track | None = None) -> Scene:
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    return Scene("free", Path("free"), "", (), rig, Sun(0.0, 0.0, 0.0), targets, track=track)


def target(position, velocity=(0.0, 0.0, 0.0), rcs_m2: float = 10.0, name: str = "t") -> Target:
    return Target(name, tuple(position), tuple(velocity), rcs_m2, "declared")


def ideal(name: str, **changes: object) -> RadarDesign:
    """A radar without faults, high above its own quantisation."""
    content = load_radar(name).model_dump()
    content |= {"leakage": None, "oscillator": None}
    for fault in ("adc_bits", "iq_gain_db", "iq_phase_deg"):
        content["front_end"][fault] = None
    for key, value in changes.items():
        section, field = key.split("__")
        content[section][field] = value
    return RadarDesign.model_validate(content)


# Tracks.


def test_a_track_sees_a_target_from_every_stop() -> None:
    """Phase of a target over 9 stops across: -4 pi R / lambda of the true ranges, to 1e-3 rad."""
    radar = ideal("hybrid-79-slow", front_end__noise_counts=100.0)
    track = Track((0.0, 0.015, 0.0), 9)
    point = np.array([20.0, 1.0, 0.3])
    scene = world(target(point, rcs_m2=1e4), track=track)
    record = radar_capture(scene, radar, fidelity=QUIET).record
    assert record.iq.shape[0] == 9
    np.testing.assert_allclose(positions(record.pose)[:, 1], 0.015 * np.arange(9), atol=1e-12)
    middle = radar.ofdm.n_subcarriers // 2
    seen = [channel(record, burst=b)[middle].mean() for b in range(9)]
    ranges = np.linalg.norm(point - positions(record.pose), axis=1)
    exact = np.exp(-4j * np.pi * (ranges / radar.ofdm.wavelength_m % 1.0))
    assert np.abs(np.angle(np.array(seen) / exact)).max() < 3e-3


def test_between_bursts_targets_move_on_and_the_clock_runs() -> None:
    radar = ideal("hybrid-79-slow")
    scene = world(target((20.0, 0, 0), (2.0, 0, 0)), track=Track((0.0, 0.0, 0.0), 3, 0.5))
    taken = radar_capture(scene, radar, fidelity=FREE)
    delays = [burst.paths[0].delay_s for burst in taken.bursts]
    np.testing.assert_allclose(np.diff(delays), 2 * 1.0 / light_speed, rtol=1e-9)
    np.testing.assert_array_equal(np.diff(taken.record.device_time_ns[:, 0, 0]), 500_000_000)


def test_the_rigs_heading_turns_the_track() -> None:
    poses = Track((1.0, 0.0, 0.0), 3).poses(Pose((5.0, 0.0, 1.0), yaw_deg=90.0))
    assert [p.position_m[1] for p in poses] == pytest.approx([0, 1, 2])
    assert all(p.yaw_deg == 90.0 for p in poses)


def test_poses_may_be_any(tmp_path: Path) -> None:
    """A list of poses, written and read back; the same seed gives the same bits."""
    radar = ideal("hybrid-79-slow", waveform__n_subcarriers=64, waveform__n_slots=4)
    poses = [Pose((0.0, 0.0, 0.0)), Pose((1.0, 2.0, 0.0), yaw_deg=10.0)]
    a, b = (
        radar_capture(world(target((20.0, 0, 0))), radar, fidelity=FREE, poses=poses, seed=3).record
        for _ in range(2)
    )
    np.testing.assert_array_equal(a.iq, b.iq)
    write_radar_record(a, tmp_path / "two.h5")
    np.testing.assert_array_equal(read_radar_record(tmp_path / "two.h5").pose, a.pose)


@pytest.mark.parametrize(
    ("track", "expected"),
    [
        (Track((0.0, 0.1, 0.0), 2, 1e-3), "interval_s = 0.001 is shorter than a burst"),
        (Track((0.0, 1e-9, 0.0), 2**20), "cells, expected at most"),
        (Track((10.0, 0.0, 0.0), 3), "target 't': is 0 m from the radar"),
    ],
)
def test_impossible_tracks_are_refused(track: Track, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        radar_capture(
            world(target((20.0, 0, 0)), track=track), load_radar("hybrid-79-slow"), fidelity=FREE
        )


@pytest.mark.parametrize("text", ["", "1,2,3", "0,1,0,0", "0,1,0,2.5", "0,nan,0,3", "0,1,0,3,-1"])
def test_malformed_tracks_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected dx,dy,dz,count"):
        parse_track(text)


def test_a_track_is_read() -> None:
    assert parse_track("0,0.015,0,65") == Track((0.0, 0.015, 0.0), 65)
    assert parse_track("0 0.015 0 65 0.2") == Track((0.0, 0.015, 0.0), 65, 0.2)


# Arrays and steps.


def test_an_array_finds_a_targets_azimuth() -> None:
    """Beam of the 12 virtual elements, transmitters' turns undone at the target's own Doppler."""
    radar = ideal("hybrid-79-mimo")
    azimuth = np.radians(-23.0)
    place = 30.0 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    record = radar_capture(world(target(place)), radar, seed=1, fidelity=FREE).record
    delay = 2 * 30.0 / light_speed
    beams = np.radians(np.arange(-60, 60, 0.1))
    steer = 2 * np.pi * np.sin(beams) / radar.ofdm.wavelength_m
    undo = np.exp(2j * np.pi * radar.ofdm.frequency_offsets_hz * delay)[:, None]
    total = np.zeros(len(beams), dtype=complex)
    for receiver, at in enumerate(record.front_end.receivers_m):
        seen = channel(record, receiver=receiver) * undo
        for sender, there in enumerate(record.front_end.transmitters_m):
            value = seen[:, record.transmitter == sender].mean()
            total += value * np.exp(-1j * steer * (at[1] + there[1]))
    assert np.degrees(beams[np.argmax(np.abs(total))]) == pytest.approx(-23.0, abs=0.15)


def test_an_arrays_record_says_who_sends() -> None:
    taken = radar_capture(world(target((20.0, 0, 0))), load_radar("hybrid-79-mimo"), fidelity=FREE)
    assert taken.record.transmitter[:7].tolist() == [0, 1, 2, 0, 1, 2, 0]
    assert taken.record.iq.shape == (1, 1, 255, 4, 4096, 2)
    assert taken.record.front_end.leakage_delay_s == 0.3e-9
    assert any("take turns by slot" in a and "8.1 m/s" in a for a in taken.assumptions)
    assert not taken.record.flags.any()


def test_too_near_for_plane_wavefronts_is_warned_of() -> None:
    """Of 7.6 mm to either side at 10 cm, not at 30."""
    radar = ideal("hybrid-79-mimo", waveform__n_subcarriers=64)
    for distance_m, is_told in ((0.1, True), (0.3, False)):
        near = radar_capture(world(target((distance_m, 0, 0))), radar, fidelity=FREE)
        assert any("wavefronts bend" in w for w in near.warnings) == is_told


def test_steps_stitch_to_the_whole_band() -> None:
    """Without retune phases, 25 steps are one channel of 1600 subcarriers: a still target's peak
    in its transform lies at the true range, 0.3 m cells refined to a hundredth.
    """
    radar = ideal("prototype", steps__random_phase=False)
    record = radar_capture(world(target((7.3, 0, 0))), radar, fidelity=FREE, seed=2).record
    whole = np.concatenate([channel(record, step=s).mean(axis=1) for s in range(25)])
    fine = 64
    image = np.abs(np.fft.ifft(whole, fine * len(whole)))
    cell = light_speed / 2 / 500e6 / fine
    assert np.argmax(image[: len(image) // 2]) * cell == pytest.approx(7.3, abs=0.02)


def test_a_target_moves_on_between_steps() -> None:
    """Phase of every step: the carrier's own delay over the way covered until then, to 0.02 rad of
    rounded counts.
    """
    radar = ideal("prototype", steps__random_phase=False, front_end__noise_counts=100.0)
    speed = 1.5
    scene = world(target((9.0, 0, 0), (speed, 0, 0)))
    record = radar_capture(scene, radar, fidelity=QUIET).record
    assert not record.flags.any()
    middle = radar.ofdm.n_subcarriers // 2
    times = 1e-9 * (record.device_time_ns[0, :, 0] - record.device_time_ns[0, :, 0].mean())
    seen = np.array([channel(record, step=s)[middle].mean() for s in range(25)])
    distance = 9.0 + speed * times
    exact = np.exp(-4j * np.pi * (record.carriers_hz * distance / light_speed % 1.0))
    assert np.abs(np.angle(seen / exact)).max() < 0.02
    # Constant cross-section, constant gain: amplitude in proportion to the wavelength.
    ratio = np.abs(seen[-1] / seen[0]) / (record.carriers_hz[0] / record.carriers_hz[-1])
    assert ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("name", ["prototype", "hybrid-79-mimo"])
def test_a_record_comes_back_from_its_file(name: str, tmp_path: Path) -> None:
    radar = ideal(name, waveform__n_subcarriers=64)
    taken = radar_capture(world(target((20.0, 0, 0))), radar, fidelity=FREE)
    write_radar_record(taken.record, tmp_path / "radar.h5")
    again = read_radar_record(tmp_path / "radar.h5")
    np.testing.assert_array_equal(again.iq, taken.record.iq)
    np.testing.assert_array_equal(again.carriers_hz, taken.record.carriers_hz)
    evaluation = evaluate_radar(radar, taken)
    assert evaluation.image.power_w.shape == (
        evaluation.waveform.n_subcarriers,
        evaluation.waveform.n_slots,
    )


def test_a_target_beyond_the_arrays_ambiguity_has_its_own_rate() -> None:
    """10 m/s where turns of three transmitters fold at 8.1: one span is 16 m/s, 1.2 cells here."""
    radar = ideal("hybrid-79-mimo", waveform__n_subcarriers=1024)
    taken = radar_capture(world(target((20.0, 0, 0), (10.0, 0, 0))), radar, fidelity=FREE)
    assert any("beyond the unambiguous +/- 8.10" in w for w in taken.warnings)
    evaluation = evaluate_radar(radar, taken)
    assert evaluation.detections[0].range_rate_m_per_s == pytest.approx(10.0, abs=0.02)
    assert evaluation.detections[0].range_rate_alternatives_m_per_s == ()
    assert evaluation.matches[0] is taken.truth[0]


# Traced, and reported.


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ["prototype", "hybrid-79-mimo"])
def test_a_traced_scene_is_measured_and_reported(name: str) -> None:
    """A concrete wall behind a target, from three stops: every burst finds both."""
    from twin.report.radar_figures import radar_cuts, radar_map
    from twin.report.radar_summary import radar_summary

    wall = np.array([[20.0, -8, -8], [20, 8, -8], [20, 8, 8], [20, -8, 8]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    table = load_materials(scenes_folder() / "materials.toml")
    scene = replace(
        world(target((12.0, 2.0, 0)), track=Track((0.0, 0.1, 0.0), 3)),
        objects=(SceneObject("wall", Geometry(wall, faces), "concrete", 0.5),),
        materials={"concrete": table["concrete"]},
    )
    radar = load_radar(name)
    content = radar.model_dump()
    content["waveform"]["n_subcarriers"] = min(512, radar.ofdm.n_subcarriers)
    radar = RadarDesign.model_validate(content)
    taken = radar_capture(scene, radar, seed=1, fidelity=Fidelity(radar="paths"))
    for burst in taken.bursts:
        assert {path.via for path in burst.paths} >= {("wall",), ("t",)}
    evaluation = evaluate_radar(radar, taken)
    rows = dict(radar_summary(evaluation)["waveform"])
    assert rows["bursts"].startswith("3 along 200 mm")
    assert ("carrier steps" in rows) == (name == "prototype")
    assert ("transmitters x receivers" in rows) == (name == "hybrid-79-mimo")
    assert radar_map(evaluation).axes
    assert radar_cuts(evaluation).axes


# Extremes.


def test_a_target_that_crosses_the_radar_is_named_not_aliased() -> None:
    """Bursts in which the target passes through the radar's place are refused by name."""
    scene = world(
        target((1.0, 0, 0), (-1.0, 0, 0), name="ball"), track=Track((0.0, 0.0, 0.0), 3, 1.0)
    )
    with pytest.raises(InputError, match="target 'ball'"):
        radar_capture(scene, load_radar("hybrid-79-slow"), fidelity=FREE)


def test_nothing_but_leakage_and_noise() -> None:
    taken = radar_capture(world(), load_radar("prototype"), seed=1)
    assert any("the record holds noise and leakage only" in w for w in taken.warnings)
    assert not taken.record.flags.any()


def test_a_lone_subcarrier_slot_and_step() -> None:
    radar = ideal("prototype", waveform__n_subcarriers=1, waveform__n_slots=1, steps__count=1)
    taken = radar_capture(world(target((9.0, 0, 0))), radar, fidelity=FREE)
    assert taken.record.iq.shape == (1, 1, 1, 1, 1, 2)


# Weather.


def test_rain_takes_its_decibels_from_an_echo() -> None:
    """10 mm/h at 79 GHz: 12.7 dB/km and gases, twice 140 m; truth says the same."""
    radar = ideal("hybrid-79-slow", front_end__noise_counts=100.0)
    scene, rain = world(target((140.0, 0, 0), rcs_m2=1e6)), load_part("rain-10").weather
    dry, wet = (
        radar_capture(scene, radar, fidelity=QUIET, weather=weather) for weather in (None, rain)
    )
    power = [np.mean(np.abs(channel(t.record)) ** 2) for t in (dry, wet)]
    lost = 10 * np.log10(power[0] / power[1])
    truth = 10 * np.log10(dry.truth[0].received_w / wet.truth[0].received_w)
    assert lost == pytest.approx(truth, abs=1e-3)
    assert lost == pytest.approx(0.28 * (1.1668 * 10**0.7021 + 0.36), rel=0.03)
    assert any("rain of 10 mm/h" in a for a in wet.assumptions)
    assert "air is clear and does not attenuate" in dry.assumptions


def test_weather_where_its_laws_do_not_reach_is_refused() -> None:
    radar = ideal("hybrid-79-slow", waveform__carrier_hz=5e8, waveform__n_subcarriers=64)
    with pytest.raises(InputError, match=r"waveform\.carrier_hz: 5e"):
        radar_capture(world(), radar, weather=load_part("clear-air").weather)


def test_scenes_with_tracks_keep_them(tmp_path: Path) -> None:
    """``[track]`` of a scene.toml, and a malformed one."""
    import shutil

    from twin.scene import load_scene

    shutil.copytree(scenes_folder() / "table1", tmp_path / "mine")
    shutil.copy(scenes_folder() / "materials.toml", tmp_path / "mine" / "materials.toml")
    settings = tmp_path / "mine" / "scene.toml"
    text = settings.read_text()
    settings.write_text(text + "\n[track]\nstep_m = [0.0, 0.015, 0.0]\ncount = 65\n")
    assert load_scene(tmp_path / "mine").track == Track((0.0, 0.015, 0.0), 65)
    settings.write_text(text + "\n[track]\nstep_m = [0.0, 0.015]\ncount = 0\n")
    with pytest.raises(InputError, match=r"track\.count = 0"):
        load_scene(tmp_path / "mine")


def test_a_scene_moves_on() -> None:
    scene = world(target((20.0, 0, 0), (2.0, -1.0, 0.5)))
    assert scene.after(2.0).targets[0].position_m == (24.0, -2.0, 1.0)
    assert replace(scene, track=None).after(0.0) == scene
