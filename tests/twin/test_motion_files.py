"""Motion in scene.toml: CSV files, logs, parents, and what is refused before any work."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.recording import Log, ros
from hardware.records.state import QuaternionPose
from twin.digest import digest
from twin.files import InputError
from twin.scene import Scene, load_scene

XML = """<scene version="3.0.0">
<shape type="cube" id="car"><transform name="to_world">
<translate x="6" z="1"/></transform><bsdf type="diffuse" id="car_paint"/></shape>
<shape type="sphere" id="wheel"><point name="center" x="6" y="1" z="0.3"/>
<float name="radius" value="0.3"/><bsdf type="diffuse" id="rubber"/></shape>
<shape type="sphere" id="lamp"><point name="center" x="6" y="0" z="2"/>
<float name="radius" value="0.1"/><bsdf type="diffuse" id="glass"/></shape>
</scene>"""
RIG = "[rig]\nposition_m = [0.0, 0.0, 1.2]\n"
SUN = "[sun]\nazimuth_deg = 160.0\nelevation_deg = 38.0\nilluminance_lx = 1e5\n"
CSV = "time_s,x_m,y_m,z_m,yaw_deg\n0,6,0,1,0\n1,8,0,1,20\n2,10,1,1,40\n3,11,3,1,60\n"
DRIVEN = "[objects.car.motion.trajectory]\nfile = 'car.csv'\n"


def scene(folder: Path, toml: str = DRIVEN, *, rig: str = RIG, **files: str) -> Scene:
    folder.joinpath("scene.xml").write_text(XML)
    folder.joinpath("scene.toml").write_text(rig + SUN + toml)
    for name, text in {"car": CSV, **files}.items():
        folder.joinpath(f"{name}.csv").write_text(text)
    return load_scene(folder)


def named(world: Scene, name: str):
    return next(item for item in world.objects if item.name == name)


def test_a_trajectory_has_the_objects_own_frame(tmp_path: Path) -> None:
    world = scene(tmp_path)
    for time, row in enumerate(np.loadtxt(CSV.splitlines()[1:], delimiter=",")):
        pose = named(world.after(float(time)), "car").pose
        np.testing.assert_allclose(pose.translation, row[1:4], atol=1e-12)
        assert pose.rotation.as_euler("ZYX", degrees=True)[0] == pytest.approx(row[4])
    with pytest.raises(InputError, match=r"time 3\.5 s .* cover 0 to 3 s"):
        world.after(3.5)


@pytest.mark.parametrize(
    "text",
    [
        CSV.replace("time_s", "time_ms")
        .replace("\n1,", "\n1000,")
        .replace("\n2,", "\n2e3,")
        .replace("\n3,", "\n3000,"),
        CSV.replace("x_m", " x [cm]")
        .replace(",6,", ",600,")
        .replace(",8,", ",800,")
        .replace(",10,", ",1000,")
        .replace(",11,", ",1100,"),
        "# a comment\n\n" + CSV.replace("yaw_deg", "yaw (deg)"),
        "\ufeff" + CSV.replace("time_s,", "note,time_s,").replace("\n", "\nx,")[:-2],
    ],
)
def test_units_and_columns_are_those_of_the_header(tmp_path: Path, text: str) -> None:
    text = text.replace("\nx,note", "\nnote") if text.startswith("\ufeff") else text
    expected = scene(tmp_path).after(1.7)
    found = scene(tmp_path, car=text)
    assert digest(found.after(1.7).objects) == digest(expected.objects)
    assert any("car.csv: not read: note" in w for w in found.warnings) == ("note" in text)


def test_quaternions_say_the_same_as_angles(tmp_path: Path) -> None:
    rows = np.loadtxt(CSV.splitlines()[1:], delimiter=",")
    turns = Rotation.from_euler("z", rows[:, 4:], degrees=True).as_quat(scalar_first=True)
    lines = ["time_s,x_m,y_m,z_m,qw,qx,qy,qz"]
    lines += [",".join(map(repr, row)) for row in np.hstack([rows[:, :4], turns]).tolist()]
    expected = named(scene(tmp_path).after(1.7), "car").pose
    found = named(scene(tmp_path, car="\n".join(lines)).after(1.7), "car").pose
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-12)


def test_seconds_since_1970_keep_their_nanoseconds(tmp_path: Path) -> None:
    """A double of 1.7e9 s has steps of 0.24 us: 5 um at the 20 m/s of this car."""
    rows = [f"1764000000{k}.{k}00000001,{20 * k},0,1" for k in range(4)]
    rows = [f"{1764000000 + k}.100000{k:03d},{20 * k * (1 + 1e-9)},0,1" for k in range(4)]
    toml = DRIVEN + "start_s = 0.0\n"
    world = scene(tmp_path, toml, car="time_s,x_m,y_m,z_m\n" + "\n".join(rows))
    x = named(world.after(1.5), "car").pose.translation[0]
    assert x == pytest.approx(30.0, abs=1e-8)


def test_poses_without_rotations_leave_the_object_as_drawn(tmp_path: Path) -> None:
    text = "time_s,x_m,y_m,z_m\n0,6,0,1\n1,9,1,1\n"
    car = named(scene(tmp_path, car=text).after(1.0), "car")
    np.testing.assert_allclose(car.pose.as_matrix()[:3, 3], [9, 1, 1], atol=1e-12)
    assert car.pose.rotation.magnitude() < 1e-12


def test_poses_may_stand_in_the_file_itself(tmp_path: Path) -> None:
    toml = (
        "[objects.car.motion.trajectory]\ntimes_s = [0.0, 1.0, 2.0, 3.0]\n"
        "positions_m = [[6.0, 0.0, 1.0], [8.0, 0.0, 1.0], [10.0, 1.0, 1.0], [11.0, 3.0, 1.0]]\n"
        "yaw_deg = [0.0, '20 deg', 40.0, 60.0]\n"
    )
    assert digest(scene(tmp_path, toml).after(2.2)) == digest(scene(tmp_path).after(2.2))


def test_what_is_drawn_at_another_place_moves_as_the_poses_do(tmp_path: Path) -> None:
    """A frame that turns about z by 90 deg while it goes 2 m: the car, 6 m ahead of it, swings."""
    text = "time_s,x_m,y_m,z_m,yaw_deg\n0,0,0,0,0\n1,2,0,0,90\n"
    world = scene(tmp_path, DRIVEN + "as_drawn = true\n", car=text)
    start, end = (named(w, "car") for w in (world, world.after(1.0)))
    np.testing.assert_allclose(start.pose.translation, [6, 0, 1], atol=1e-12)
    np.testing.assert_allclose(end.pose.translation, [2, 6, 1], atol=1e-12)


def test_children_keep_their_place_on_what_carries_them(tmp_path: Path) -> None:
    """Lamp and wheel where the car's frame has them, turned with it; the wheel rolls besides."""
    toml = (
        DRIVEN
        + "[objects.lamp]\nparent = 'car'\n[objects.wheel]\nparent = 'car'\n"
        + "motion.rolling = { radius_m = 0.3, centre_m = [6.0, 1.0, 0.3] }\n"
        + "[[targets]]\nname = 'lamp'\nobject = 'lamp'\nposition_m = [6.1, 0.0, 2.0]\n"
        + "rcs_m2 = 1.0\nrcs_assumed = 'x'\n"
    )
    world = scene(tmp_path, toml)
    later = world.after(2.0)
    car = named(later, "car").pose
    np.testing.assert_allclose(named(later, "lamp").middle_m, car.apply([0, 0, 1]), atol=1e-12)
    np.testing.assert_allclose(named(later, "wheel").middle_m, car.apply([0, 1, -0.7]), atol=1e-12)
    np.testing.assert_allclose(later.targets[0].position_m, car.apply([0.1, 0, 1]), atol=1e-12)
    state, wheel = named(later, "car").state, named(later, "wheel").state
    speed = state.at_world(named(later, "wheel").middle_m)[0] @ car.rotation.apply([1, 0, 0])
    rolling = wheel.angular_velocity_rad_per_s - state.angular_velocity_rad_per_s
    np.testing.assert_allclose(rolling, speed / 0.3 * car.rotation.apply([0, 1, 0]), atol=1e-10)
    np.testing.assert_allclose(
        later.targets[0].velocity_m_per_s,
        state.at_world(later.targets[0].position_m)[0],
        atol=1e-10,
    )


def test_turning_swinging_and_rolling_on_a_velocity(tmp_path: Path) -> None:
    toml = (
        "[objects.wheel]\nvelocity_m_per_s = [1.5, 0.0, 0.0]\n"
        "motion.rolling = { radius_m = 0.3, centre_m = [6.0, 1.0, 0.3] }\n"
        "[objects.car.motion.turning]\ncentre_m = [6.0, 0.0, 1.0]\nrate_deg_per_s = '1 rad/s'\n"
        "[objects.lamp.motion.swinging]\naxis = [0.0, 1.0, 0.0]\ncentre_m = [6.0, 0.0, 3.0]\n"
        "amplitude_deg = 10.0\nperiod_s = 2.0\n"
    )
    world = scene(tmp_path, toml)
    assert named(world, "wheel").state.angular_velocity_rad_per_s[1] == pytest.approx(5.0)
    assert named(world, "car").state.angular_velocity_rad_per_s[2] == pytest.approx(1.0)
    lamp = named(world.after(0.5), "lamp").middle_m
    angle = np.radians(10)
    np.testing.assert_allclose(lamp, [6 - np.sin(angle), 0, 3 - np.cos(angle)], atol=1e-12)


def test_a_motion_of_nothing_is_none(tmp_path: Path) -> None:
    still = scene(tmp_path, "")
    toml = "[objects.lamp.motion.turning]\ncentre_m = [6.0, 0.0, 2.0]\nrate_deg_per_s = 0.0\n"
    given = scene(tmp_path, toml)
    assert given.at_rest
    assert digest(given) == digest(still)


def test_the_rig_drives(tmp_path: Path) -> None:
    rig = "[rig.motion.trajectory]\nfile = 'car.csv'\noutside = 'hold'\n"
    world = scene(tmp_path, "", rig=rig)
    assert world.rig.moves
    assert world.at_rest
    assert world.after(1.0).rig.pose.position_m == pytest.approx((8.0, 0.0, 1.0))
    assert world.after(9.0).rig.pose.yaw_deg == pytest.approx(60.0)
    assert world.after(1.0).objects[0] is world.objects[0]
    straight = scene(tmp_path, "", rig=RIG + "velocity_m_per_s = [5.0, 0.0, 0.0]\n")
    assert straight.after(2.0).rig.pose.position_m == pytest.approx((10.0, 0.0, 1.2))
    on_car = scene(tmp_path, rig=RIG + "parent = 'car'\n").after(3.0)
    car = named(on_car, "car").pose
    assert on_car.rig.pose.position_m == pytest.approx(tuple(car.apply([-6.0, 0, 0.2])))
    assert on_car.rig.pose.yaw_deg == pytest.approx(60.0)


def logged(path: Path, child: str = "rig", times_ns: tuple[int, ...] = (0, 10**8, 2 * 10**8)):
    with Log(path) as log:
        for k, stamp in enumerate(times_ns):
            turn = Rotation.from_euler("z", 10.0 * k, degrees=True)
            pose = QuaternionPose.of((0.5 * k, 0.0, 1.0), turn)
            begun = 1764 * 10**15 + stamp
            message = ros.transform(pose, begun, "world", child)
            for _ in range(2):  # two sensors tell the rig's pose of the same time
                log.message("/tf", ros.TRANSFORMS, message, begun, begun)


def test_a_drive_is_replayed_from_its_log(tmp_path: Path) -> None:
    logged(tmp_path / "drive.mcap")
    rig = "[rig.motion.trajectory]\nfile = 'drive.mcap'\n"
    world = scene(tmp_path, "", rig=rig)
    assert world.span_s == pytest.approx((0.0, 0.2))
    assert world.after(0.1).rig.pose.position_m == pytest.approx((0.5, 0.0, 1.0))
    assert world.after(0.2).rig.pose.yaw_deg == pytest.approx(20.0)
    assert world.rig.state.velocity_m_per_s[0] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("child", "times_ns", "more", "message"),
    [
        ("rig", (0, 0, 10), "", r"drive\.mcap: message 2 on /tf: time 0 s repeats"),
        ("rig", (0, 10, 5), "", r"drive\.mcap: message 4 on /tf: time 5e-09 s runs backwards"),
        ("base", (0, 10, 20), "", r"no pose of 'rig' on /tf; frames: base"),
        ("rig", (0, 10, 20), "topic = '/pose'\n", r"no pose of 'rig' on /pose; topics .*: /tf"),
        ("rig", (0, 10, 500), "", r"message 4 on /tf: 4\.9e-07 s after the pose before: .*"),
    ],
)
def test_a_log_that_says_no_way_is_refused(
    tmp_path: Path, child: str, times_ns: tuple[int, ...], more: str, message: str
) -> None:
    times = (*times_ns, *(times_ns[-1] + 10 * k for k in range(1, 4)))
    logged(tmp_path / "drive.mcap", child, times if times_ns[-1] > 400 else times_ns)
    with pytest.raises(InputError, match=message):
        scene(tmp_path, "", rig="[rig.motion.trajectory]\nfile = 'drive.mcap'\n" + more)


def rows(*lines: str) -> str:
    return "time_s,x_m,y_m,z_m,yaw_deg\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (rows("0,6,0,1,0", "1,7,0,1,0", "1,8,0,1,0"), r"car\.csv: line 4: time 1 s repeats"),
        (rows("0,6,0,1,0", "", "1,7,0,1,0", ".5,8,0,1,0"), r"line 5: time 0\.5 s runs backwards"),
        (rows("0,6,0,1,0", "1,nan,0,1,0"), r"line 3: x = 'nan': expected a number"),
        (rows("0,6,0,1,0", "1,7,0,one,0"), r"line 3: z = 'one': expected a number"),
        (rows("0,6,0,1,0", "1,7,0,inf,0"), r"line 3: z = 'inf': expected a number"),
        (rows("0,6,0,1,0", "1,7,0"), r"line 3: 3 columns, expected a number for 'z'"),
        (rows("0,6,0,1,0", "1,7_0,0,1,0"), r"line 3: x = '7_0': expected a number"),
        (rows("0,6,0,1,0", "1,7,0,1,0,3"), r"line 3: 6 columns, expected 5 as in the header"),
        (rows("0,6,0,1,0", "1e-300,7,0,1,0"), r"line 3: 1e-300 s after the pose before"),
        (rows("0,6,0,1,0", "1,7,0,1,180"), r"line 3: turned by 180\.00 deg .* a pose in between"),
        (rows("0,6,0,1,0"), r"car\.csv: 1 poses: expected at least two"),
        ("", r"car\.csv: empty: expected time_s"),
        ("t,x_m,y_m\n", r"line 1: t,x_m,y_m: expected time_s,x_m,y_m,z_m and"),
        ("time,x_m,y_m,z_m\n0,0,0,0\n1,1,1,1\n", r"column 'time': expected its unit"),
        ("time_s,x_kg,y_m,z_m\n0,0,0,0\n1,1,1,1\n", r"column 'x_kg': "),
        ("time_s,x_m,x_m,y_m,z_m\n0,0,0,0,0\n", r"line 1: column 'x' stands twice"),
        ("time_s,x_m,y_m,z_m,qw\n0,0,0,0,1\n1,0,0,0,1\n", r"line 1: .*expected time_s"),
        (
            "time_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,6,0,1,1,0,0,0\n1,6,0,1,1,0,0,1\n",
            r"line 3: quaternion of norm 1\.41421: expected 1",
        ),
        (rows(*(f"{k},6,0,1,0" for k in (0, 1, 2, 3, 15))), r"line 6: 12 s after .* at most 10 s"),
        (rows("1,6,0,1,0", "2,7,0,1,0"), r"time 0 s: expected 1 to 2 s"),
        (rows("0,6,0,1,0", "1,3e5,0,1,0"), r"objects\.car.*: expected .*100000"),
    ],
)
def test_a_wrong_file_is_refused_by_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        scene(tmp_path, car=text)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        (
            "[objects.car]\nparent = 'lamp'\n[objects.lamp]\nparent = 'car'\n",
            r"parent: each carries the next: car -> lamp -> car",
        ),
        ("[objects.car]\nparent = 'car'\n", "each carries the next: car -> car"),
        ("[objects.car]\nparent = 'lorry'\n", r"objects\.car\.parent: no shape has the id 'lorry'"),
        ("[objects.car.motion]\n", "nothing given: expected one of trajectory"),
        (
            DRIVEN + "[objects.car.motion.turning]\ncentre_m = [0.0, 0.0, 0.0]\n"
            "rate_deg_per_s = 1.0\n",
            "trajectory and turning given: expected one",
        ),
        (
            DRIVEN + "[objects.wheel]\nmotion.rolling = { radius_m = 0.3, "
            "centre_m = [6.0, 1.0, 0.3] }\n",
            "expected a parent or a velocity_m_per_s",
        ),
        (
            "[objects.car]\nvelocity_m_per_s = [1.0, 0.0, 0.0]\n"
            "motion.trajectory = { file = 'car.csv' }\n",
            "beside a trajectory, expected none",
        ),
        ("[objects.car.motion.trajectory]\nfile = 'car.txt'\n", "expected a .csv or .mcap file"),
        ("[objects.car.motion.trajectory]\nfile = 'none.csv'\n", r"none\.csv: can't be read"),
        ("[objects.car.motion.trajectory]\n", "needs either `file` or `times_s`"),
        (
            "[objects.car.motion.trajectory]\ntimes_s = [0.0, 1.0]\n"
            "positions_m = [[0.0, 0.0, 0.0]]\n",
            r"lists of \[1, 2\] poses: expected as many of each",
        ),
        (
            "[objects.car.motion.trajectory]\ntimes_s = [0.0, 0.0]\n"
            "positions_m = [[6.0, 0.0, 1.0], [6.0, 0.0, 1.0]]\n",
            r"objects\.car\.motion\.trajectory: pose 1: time 0 s repeats",
        ),
        (DRIVEN + "outside = 'repeat'\n", r"line 5: to repeat, expected the first pose again"),
        (
            "[objects.car.motion.turning]\naxis = [0.0, 0.0, 0.0]\ncentre_m = [0.0, 0.0, 0.0]\n"
            "rate_deg_per_s = 1.0\n",
            "expected a direction",
        ),
        *(
            (
                f"[objects.car.motion.turning]\naxis = [0.0, 0.0, {length}]\n"
                "centre_m = [0.0, 0.0, 0.0]\nrate_deg_per_s = 1.0\n",
                "expected a direction",
            )
            for length in (1e-300, 1e300)
        ),
        (
            "[objects.car.motion.turning]\ncentre_m = [6.0, 0.0, 1.0]\nrate_deg_per_s = 1e9\n",
            r"a point of it moves at .* m/s, expected at most 100000 m/s",
        ),
        (
            "[objects.car.motion.trajectory]\nfile = 'car.csv'\nas_drawn = \"yes\"\n",
            "as_drawn = 'yes': expected true or false",
        ),
        (
            "[objects.car]\nspeed = 3\n",
            "objects.car.speed = 3: no such field",
        ),
        (
            "[track]\nstep_m = [0.0, 0.1, 0.0]\ncount = 2\n",
            "track: the rig moves by itself",
        ),
    ],
)
def test_a_wrong_motion_is_refused(tmp_path: Path, toml: str, message: str) -> None:
    moving = RIG + "velocity_m_per_s = [1.0, 0.0, 0.0]\n" if "track" in toml else RIG
    with pytest.raises(InputError, match=message):
        scene(tmp_path, toml, rig=moving)


def test_a_rig_needs_one_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rig: needs `position_m`, or `motion.trajectory`"):
        scene(tmp_path, rig="[rig]\nvelocity_m_per_s = [1.0, 0.0, 0.0]\n")
    with pytest.raises(InputError, match=r"rig: its trajectory says where it is.* no `position_m`"):
        scene(tmp_path, rig=RIG + "[rig.motion.trajectory]\nfile = 'car.csv'\n")


def test_a_rig_beyond_all_speeds_is_refused(tmp_path: Path) -> None:
    fast = rows("0,0,0,1,0", "1,1e5,0,1,0", "2,4e5,0,1,0")
    rig = "[rig.motion.trajectory]\nfile = 'car.csv'\n"
    with pytest.raises(InputError, match=r"car\.csv: rig\.motion: a point .*100000 m/s"):
        scene(tmp_path, "", rig=rig, car=fast)
