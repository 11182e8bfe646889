"""What `twin check` says of motion, against geometry on paper."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from tests.physics.radar_worlds import ball, world
from twin.cli import app
from twin.motion import Still, Straight, Swinging, Turning
from twin.motion.trajectory import through
from twin.radar import load_radar
from twin.report.motion import MotionReport, headline, motion_reports
from twin.scene import Pose, Rig, Scene, SceneObject
from twin.scene.moving import carrier_of, moving
from twin.system import load_system

RIG = Rig(Pose((0.0, 0.0, 0.0)), detector=Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
SYSTEM, RADAR = load_system("workable"), load_radar("hybrid-79")
FRAME_S = SYSTEM.frame_time_s
CELL = np.tan(np.radians(10)) / 32  # of the image at 1 m
TINY = 1e-4


def scene(*items: SceneObject) -> Scene:
    return replace(world(*items), rig=RIG)


def report(world_: Scene, name: str) -> MotionReport:
    return next(r for r in motion_reports(world_, SYSTEM, RADAR) if r.name == name)


def test_a_point_that_crosses_moves_in_the_image() -> None:
    item = ball("b", (10.0, 0.0, 0.0), TINY, level=1, velocity_m_per_s=(0.0, 1.4, 0.0))
    found = report(scene(item), "b")
    assert found.cells_per_frame == pytest.approx(1.4 * FRAME_S / 10 / CELL, rel=1e-4)
    assert found.speed_m_per_s == found.fastest_m_per_s == pytest.approx(1.4)
    assert found.range_cells < 1e-3
    # At 10 m a crossing echo gains v^2 / R of rate a second.
    growing = 1.4**2 / 10 * RADAR.burst_s
    assert found.range_rates_m_per_s == pytest.approx((0.0, growing), abs=2e-5)


def test_a_point_that_recedes_crosses_range_cells() -> None:
    item = ball("b", (10.0, 0.0, 0.0), TINY, level=1, velocity_m_per_s=(20.0, 0.0, 0.0))
    found = report(scene(item), "b")
    wave = RADAR.channel_waveform
    assert found.range_cells == pytest.approx(20 * RADAR.burst_s / wave.range_cell_m, rel=1e-4)
    assert found.range_rates_m_per_s == pytest.approx((20.0, 20.0), abs=1e-3)
    assert found.cells_per_frame < 0.1


def test_range_cells_are_those_of_all_carrier_steps() -> None:
    """25 steps of 20 MHz resolve 0.2998 m: 1 m/s crosses 0.42 of it in 0.126 s, and 0.017 of the
    7.5 m that one step resolves.
    """
    item = ball("b", (10.0, 0.0, 0.0), TINY, level=1, velocity_m_per_s=(1.0, 0.0, 0.0))
    [found] = motion_reports(scene(item), None, load_radar("prototype"))
    assert found.range_cells == pytest.approx(0.1264 / 0.2998, rel=1e-3)


def test_a_body_that_turns_spreads_over_doppler_cells() -> None:
    turning = moving(ball("b", (10.0, 0, 0), 0.3, level=5), Turning((0, 0, 1), (10, 0, 0), 5.0))
    found = report(scene(turning), "b")
    assert found.speed_m_per_s == pytest.approx(0.0, abs=1e-12)
    assert found.turning_deg_per_s == pytest.approx(np.degrees(5.0))
    assert found.fastest_m_per_s == pytest.approx(1.5, rel=0.02)
    spread = 2 * 1.5 / RADAR.channel_waveform.velocity_cell_m_per_s
    assert found.doppler_cells == pytest.approx(spread, rel=0.03)


def test_the_fastest_point_is_sought_over_the_whole_motion() -> None:
    """A pendulum that starts at its end, at rest, swings through its middle at l a w."""
    swing = Swinging((0, 1, 0), (10.0, 0, 2.0), 0.1, 2.0, phase_rad=np.pi / 2)
    item = moving(ball("b", (10.0, 0, 0), TINY, level=1), swing)
    found = report(scene(item), "b")
    assert found.speed_m_per_s == pytest.approx(0.0, abs=1e-12)
    assert found.fastest_m_per_s == pytest.approx(2.0 * 0.1 * np.pi, rel=1e-3)


def test_what_stands_is_told_where_the_rig_moves() -> None:
    still = ball("still", (20.0, 0.0, 0.0), TINY, level=1)
    behind = ball("behind", (-5.0, 0.0, 0.0), TINY, level=1)
    way = RIG.following(Straight((5.0, 0.0, 0.0)))
    found = {
        r.name: r for r in motion_reports(replace(scene(still, behind), rig=way), SYSTEM, RADAR)
    }
    assert list(found) == ["rig", "still"]
    assert found["rig"].speed_m_per_s == pytest.approx(5.0)
    assert found["still"].range_rates_m_per_s == pytest.approx((-5.0, -5.0), abs=1e-3)
    assert found["still"].fastest_m_per_s == 0
    # A rig that turns moves all of the image.
    turning = RIG.following(Turning((0, 0, 1), (0, 0, 0), np.radians(2.0)))
    seen = report(replace(scene(still), rig=turning), "still")
    assert seen.cells_per_frame == pytest.approx(np.tan(np.radians(2 * FRAME_S)) / CELL, rel=1e-3)


def test_a_way_that_ends_within_a_frame_is_followed_to_its_end() -> None:
    turns = Rotation.identity(2)
    way = through([0.0, 0.1], [[10, 0, 0], [10, 0.2, 0]], turns)
    item = replace(ball("b", (0, 0, 0), TINY, level=1)).following(way)
    assert report(scene(item), "b").cells_per_frame == pytest.approx(0.02 / CELL, rel=1e-2)
    assert "trajectories end after 0.1 s" in headline(scene(item), SYSTEM, RADAR)


def test_without_sensors_only_the_motion_is_told() -> None:
    car = replace(ball("car", (10.0, 0, 0), 0.5, level=1), velocity_m_per_s=(0.0, 2.0, 0.0))
    lamp = moving(
        ball("lamp", (10, 0, 1), 0.1, level=1), Still(RigidTransform.identity()), carrier_of(car)
    )
    found = motion_reports(scene(car, lamp, ball("s", (5, 0, 0), level=1)), None, None)
    assert [r.cells for r in found] == [
        ("car", "", "2", "0", "2", "", "", "", ""),
        ("lamp", "car", "2", "0", "2", "", "", "", ""),
    ]


@pytest.mark.thorough
def test_check_prints_what_moves() -> None:
    told = CliRunner().invoke(app, ["check", "crossing"])
    assert told.exit_code == 0, told.output
    assert "a frame of workable: 0.819 s; an interval of hybrid-79: 0.01 s" in told.output
    lines = {line.split()[0]: line.split() for line in told.output.splitlines() if line.split()}
    assert lines["rim_rear_left"][1:4] == ["car", "1.4", "267"]  # 1.4 m/s over 0.3 m
    assert "fastest" not in CliRunner().invoke(app, ["check", "table1"]).output
    told = CliRunner().invoke(app, ["check", "yard", "--system", "none", "--radar", "none"])
    assert "a frame of" not in told.output
    told = CliRunner().invoke(app, ["check", "yard", "--radar", "nope"])
    assert "'nope' is neither" in str(told.exception)
    assert told.output == ""  # before anything is listed
