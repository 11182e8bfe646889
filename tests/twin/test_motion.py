"""Motion of rigid bodies against closed forms, SciPy's own splines and differences of the pose."""

import math
import pickle
import time

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation, RotationSpline, Slerp

from twin.digest import digest
from twin.files import InputError
from twin.motion import (
    Kinematics,
    Motion,
    Parent,
    Product,
    Rolling,
    Still,
    Straight,
    Swinging,
    Trajectory,
    Turning,
)
from twin.motion.polynomials import Polynomials
from twin.motion.trajectory import Outside, through

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(4, 3))
TIMES = np.arange(12.0)
TURNS = Rotation.from_rotvec(np.cumsum(0.4 * RNG.normal(size=(12, 3)), axis=0))
PLACES = np.cumsum(RNG.normal(size=(12, 3)), axis=0)
CLOSED = np.concatenate([PLACES[:-1], PLACES[:1]]), Rotation.concatenate([TURNS[:-1], TURNS[:1]])
AXIS, CENTRE = (0.0, 0.6, 0.8), (1.0, -2.0, 0.5)


def drive(outside: Outside = "continue") -> Trajectory:
    places, turns = CLOSED if outside == "repeat" else (PLACES, TURNS)
    return through(TIMES, places, turns, outside)


def wheel_on(carrier: Motion, radius_m: float = 0.3) -> Product:
    place = Still(RigidTransform.from_translation((1.2, 0.8, radius_m)))
    wheel = Rolling(carrier, (0.0, 1.0, 0.0), (1.2, 0.8, radius_m), radius_m)
    return Product((carrier, wheel, place))


ALL = {
    "straight": Straight((1.0, -2.0, 0.3)),
    "turning": Turning(AXIS, CENTRE, 2.5, 0.3),
    "swinging": Swinging(AXIS, CENTRE, 0.7, 1.3, 0.2, 0.1),
    "trajectory": drive(),
    "repeated": drive("repeat"),
    "tree": Product((drive(), Turning(AXIS, CENTRE, 0.5), Swinging(AXIS, CENTRE, 0.7, 1.3))),
    "wheel": wheel_on(Product((Parent("car", drive()), Turning(AXIS, CENTRE, 0.5)))),
    "later": wheel_on(drive("repeat")).later(2.25),
}


@pytest.mark.parametrize("name", [*ALL, "held"])
def test_polynomials_between_breaks_are_the_motion_to_rounding(name: str) -> None:
    """Also where two breaks are a rounding apart; where it stands still, to the last bit."""
    motion = drive("hold") if name == "held" else ALL[name]
    breaks = motion.breaks_s(-1.3, 14.7)
    breaks = np.union1d(breaks, np.nextafter(breaks[1:-1], np.inf))
    found = Polynomials(breaks, lambda times: motion.pose_at(times).as_matrix())
    times = np.concatenate([breaks, RNG.uniform(-1.3, 14.7, 200)])
    true = motion.pose_at(times).as_matrix()
    np.testing.assert_allclose(found.at(times), true, rtol=0, atol=1e-9)
    assert found.last < 1e-9
    if name == "held":
        after = found.at(np.linspace(TIMES[-1] + 0.1, 14.7, 7))
        assert (after == after[0]).all()


def test_a_wheel_that_goes_forth_and_back_breaks_as_often_as_its_angle_asks_for() -> None:
    """Of 10 m to and fro between two poses nothing is left at its end."""
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-2.1, 0.0, 0.0]])
    wheel = wheel_on(through([0.0, 4.0, 4.2], places, TURNS[[0, 0, 0]], "error"))
    found = Polynomials(wheel.breaks_s(0.0, 4.2), lambda t: wheel.pose_at(t).as_matrix())
    times = np.linspace(0, 4.2, 101)
    true = wheel.pose_at(times).as_matrix()
    np.testing.assert_allclose(found.at(times), true, rtol=0, atol=1e-9)


@pytest.mark.parametrize("time", [0.3, -3.2, 5.55, 30.1])
@pytest.mark.parametrize("name", ALL)
def test_velocity_and_acceleration_are_the_derivatives_of_the_pose(name: str, time: float) -> None:
    """Fourth-order differences over 0.1 ms are off by rounding, 1e-16 m / (h, h^2), and by what
    they cut off of the fastest wheel's 60 rad/s, (60 h)^4 / 30 = 4e-11 of its velocity.
    """
    motion, h = ALL[name], 1e-4
    steps = motion.at(time + h * np.arange(-2, 3)).of_points(POINTS)[0]
    _, velocity, acceleration = motion.at(time).of_points(POINTS)
    first = np.tensordot([1, -8, 0, 8, -1], steps, axes=1) / (12 * h)
    second = np.tensordot([-1, 16, -30, 16, -1], steps, axes=1) / (12 * h**2)
    size = 1 + np.abs(steps).max() + np.abs(velocity).max()
    np.testing.assert_allclose(velocity, first, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(acceleration, second, rtol=1e-6, atol=1e-6 * size)


def test_a_rolling_wheels_rim_draws_a_cycloid() -> None:
    """Over the angle a: x = r (a - sin a), z = r (1 - cos a); at rest on
    the road, at twice the speed on top.
    """
    speed, radius = 7.0, 0.3
    motion = wheel_on(Straight((speed, 0.0, 0.0)), radius)
    times = np.linspace(-2.0, 3.0, 1001)
    place, velocity, acceleration = motion.at(times).of_points([[0.0, 0.0, -radius]])
    angle = speed * times / radius
    x, z = radius * (angle - np.sin(angle)), radius * (1 - np.cos(angle))
    np.testing.assert_allclose(place[:, 0, 0], 1.2 + x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(place[:, 0, 2], z, rtol=0, atol=1e-12)
    rate = np.linalg.norm(velocity[:, 0], axis=1)
    np.testing.assert_allclose(rate, 2 * speed * np.abs(np.sin(angle / 2)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        np.linalg.norm(acceleration[:, 0], axis=1), speed**2 / radius, rtol=1e-12
    )
    turn = 2 * np.pi * radius / speed
    np.testing.assert_allclose(motion.at(turn).of_points([[0, 0, -radius]])[1], 0, atol=1e-11)
    on_top = motion.at(turn / 2).of_points([[0, 0, -radius]])[1][0]
    np.testing.assert_allclose(on_top, [2 * speed, 0, 0], atol=1e-11)


def test_a_wheel_that_rolls_straight_on_for_years_is_right_and_takes_no_time() -> None:
    """Angle 1.4 m/s x 1e8 s / 0.3 m; the remainder of the whole turns by mpmath with 40 digits."""
    motion = wheel_on(Straight((1.4, 0.0, 0.0)), 0.3)
    begun_s = time.process_time()
    turned = motion.at(1e8).pose.rotation.as_matrix()
    assert time.process_time() - begun_s < 1.0
    with mpmath.workdps(40):
        angle = mpmath.mpf(1.4) * 10**8 / mpmath.mpf(0.3)
        sine, cosine = float(mpmath.sin(angle)), float(mpmath.cos(angle))
    np.testing.assert_allclose(
        turned, [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], atol=3e-7
    )  # of 4.7e8 rad in double precision


@pytest.mark.parametrize("speed", [0.0, 1e-9, 1e3])
def test_a_wheel_rolls_at_any_speed(speed: float) -> None:
    motion = wheel_on(Straight((speed, 0.0, 0.0)))
    state = motion.at(600.0)
    assert motion.moves == (speed > 0)
    assert state.angular_velocity_rad_per_s[1] == pytest.approx(speed / 0.3, rel=1e-15)
    angle = Rotation.from_rotvec([0, 600 * speed / 0.3, 0])
    off = (state.pose.rotation * angle.inv()).magnitude()
    assert off < 1e-15 * (1 + 600 * speed / 0.3)


def test_inner_wheels_of_a_bend_turn_slower() -> None:
    """A car that circles a point at 10 m: each wheel by its own distance from it, for an hour."""
    circling = Turning((0.0, 0.0, 1.0), (0.0, 10.0, 0.0), 0.5)
    for y in (0.8, -0.8):
        wheel = Rolling(circling, (0.0, 1.0, 0.0), (0.0, y, 0.3), 0.3)
        state = wheel.at([-10.0, 3600.0])
        np.testing.assert_allclose(
            state.angular_velocity_rad_per_s[:, 1], 0.5 * (10 - y) / 0.3, rtol=1e-13
        )
        angle = np.array([-10.0, 3600.0]) * 0.5 * (10 - y) / 0.3
        turned = Rotation.from_rotvec(angle[:, None] * [0, 1, 0]).inv() * state.pose.rotation
        assert turned.magnitude().max() < 1e-8  # of 27 600 rad


def test_a_wheels_angle_does_not_depend_on_what_else_is_asked_for() -> None:
    wheel = ALL["wheel"]
    alone = wheel_on(Product((Parent("car", drive()), Turning(AXIS, CENTRE, 0.5)))).pose_at(5.5)
    beside = wheel.at([500.0, 5.5, -70.0, 3.0])[1].pose
    assert np.array_equal(alone.as_matrix(), beside.as_matrix())


def test_a_pendulum_swings_as_its_closed_form() -> None:
    """Length 2 about y: x = l sin a, z = -l cos a, a = A sin(w t); 1e9 periods later too."""
    amplitude, period, length = 0.5, 1.6, 2.0
    motion = Swinging((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), amplitude, period)
    times = np.linspace(0, 4, 101)
    angle = amplitude * np.sin(2 * np.pi * times / period)
    place = motion.at(times).of_points([[0, 0, -length]])[0][:, 0]
    expected = length * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    np.testing.assert_allclose(place, expected, rtol=0, atol=1e-14)
    far = motion.at(1e9 * period + 0.25).pose.rotation.magnitude()
    assert far == pytest.approx(amplitude * abs(math.sin(2 * np.pi * 0.25 / period)), abs=1e-6)


def test_a_rotation_within_a_rotation() -> None:
    """About parallel axes the rates add; a gimbal's second axis goes round with the first."""
    outer = Turning((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 2.0)
    alike = Product((outer, Turning((0.0, 0.0, 1.0), (5.0, 0.0, 0.0), 3.0))).at(0.7)
    np.testing.assert_allclose(alike.angular_velocity_rad_per_s, [0, 0, 5], atol=1e-15)
    gimbal = Product((outer, Turning((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 3.0))).at(0.7)
    way = np.array([math.cos(1.4), math.sin(1.4), 0])
    np.testing.assert_allclose(gimbal.angular_velocity_rad_per_s, 3 * way + [0, 0, 2], atol=1e-15)
    np.testing.assert_allclose(
        gimbal.angular_acceleration_rad_per_s2, np.cross([0, 0, 2], 3 * way), atol=1e-14
    )


def test_rotations_follow_scipys_spline_and_two_poses_its_slerp() -> None:
    times = np.linspace(0, 11, 200)
    off = drive("error").pose_at(times).rotation.inv() * RotationSpline(TIMES, TURNS)(times)
    assert off.magnitude().max() < 1e-14
    two = through([0, 2], PLACES[:2], TURNS[:2])
    off = two.pose_at(times[:30]).rotation.inv() * Slerp([0, 2], TURNS[:2])(times[:30])
    assert off.magnitude().max() < 1e-14
    expected = PLACES[0] + times[:30, None] / 2 * (PLACES[1] - PLACES[0])
    np.testing.assert_allclose(two.pose_at(times[:30]).translation, expected, atol=1e-14)


def test_an_even_turn_is_followed_exactly() -> None:
    """Poses of a uniform rotation: the spline of rotations is that rotation."""
    turns = Rotation.from_rotvec(0.3 * TIMES[:, None] * np.array(AXIS))
    state = through(TIMES, np.zeros((12, 3)), turns).at(np.linspace(0, 11, 50))
    np.testing.assert_allclose(
        state.angular_velocity_rad_per_s, np.tile(0.3 * np.array(AXIS), (50, 1)), atol=1e-9
    )


def test_a_repeated_way_has_no_step_in_velocity_or_acceleration() -> None:
    motion, length = drive("repeat"), 11.0
    state = motion.at(np.array([0.0, length * (1 - 1e-12), 3 * length + 2.5, 2.5, 2.5 - length]))
    for name in (
        "velocity_m_per_s",
        "angular_velocity_rad_per_s",
        "acceleration_m_per_s2",
        "angular_acceleration_rad_per_s2",
    ):
        values = getattr(state, name)
        np.testing.assert_allclose(values[1], values[0], atol=1e-8)
        np.testing.assert_allclose(values[2:4], values[[3, 4]], atol=1e-12)


def test_what_is_beyond_the_ends_is_as_stated() -> None:
    with pytest.raises(InputError, match=r"time 11\.5 s: expected 0 to 11 s"):
        drive("error").at(11.5)
    held = drive("hold").at([-1.0, 12.0])
    np.testing.assert_allclose(held.pose.translation, PLACES[[0, -1]], atol=1e-14)
    assert not held.velocity_m_per_s.any()
    assert not held.angular_acceleration_rad_per_s2.any()
    end, on = drive().at(11.0), drive().at(13.0)
    assert np.array_equal(on.velocity_m_per_s, end.velocity_m_per_s)
    np.testing.assert_allclose(
        on.pose.translation, end.pose.translation + 2 * end.velocity_m_per_s, atol=1e-14
    )
    spin = Rotation.from_rotvec(2 * end.angular_velocity_rad_per_s)
    assert (on.pose.rotation.inv() * spin * end.pose.rotation).magnitude() < 1e-14


def test_far_from_the_origin_nothing_is_lost() -> None:
    """The same motion 1000 km away: rounding of the coordinates is 0.1 nm."""
    far = np.array([1e6, -1e6, 1e3])
    there = through(TIMES, PLACES + far, TURNS).at(4.3)
    here = through(TIMES, PLACES, TURNS).at(4.3)
    np.testing.assert_allclose(there.velocity_m_per_s, here.velocity_m_per_s, atol=1e-8)
    x, y, z = far.tolist()
    turning = Turning(AXIS, (x, y, z), 2.0).at(0.4)
    own = Turning(AXIS, (0.0, 0.0, 0.0), 2.0).at(0.4)
    place, velocity, _ = (part[0] for part in turning.of_points([far + [1, 0, 0]]))
    expected = own.of_points([[1, 0, 0]])
    np.testing.assert_allclose(place - far, expected[0][0], atol=1e-9)
    np.testing.assert_allclose(velocity, expected[1][0], atol=1e-8)


def test_no_point_of_a_sphere_moves_farther_than_the_bound() -> None:
    centre, radius = np.array([0.3, 0.1, -0.2]), 0.7
    ways = RNG.normal(size=(200, 3))
    points = centre + radius * ways / np.linalg.norm(ways, axis=1)[:, None]
    for name, motion in ALL.items():
        bound = motion.path_bound_m(centre, radius, 0.4, 1.6)
        place = motion.at(np.linspace(0.4, 1.6, 60)).of_points(points)[0]
        farthest = np.linalg.norm(place[:, None] - place[None], axis=-1).max()
        assert farthest <= bound * (1 + 1e-9), name
    straight = Straight((3.0, 0.0, 4.0))
    assert straight.path_bound_m(centre, radius, -1.0, 1.0) == pytest.approx(10.0, rel=1e-14)


def test_a_motion_counted_from_later_on_is_the_same() -> None:
    for motion in ALL.values():
        for by in (0.0, 1.25, -2.0):
            moved = motion.later(by).later(-0.5).pose_at(0.75).as_matrix()
            np.testing.assert_allclose(
                moved, motion.pose_at(by + 0.25).as_matrix(), atol=1e-9, rtol=0
            )
    span = drive("error").later(4.0).span_s
    assert span == (-4.0, 7.0)


def test_another_parent_carries_the_same_child() -> None:
    """A wheel of a car that now drives elsewhere: as if it had been made on that car, at any time
    that it is counted from.
    """
    ways = Straight((3.0, 0.0, 0.0)), Straight((5.0, 1.0, 0.0))
    one, other = (wheel_on(Parent("car", way)) for way in ways)
    changed = one.later(2.0).with_parent("car", ways[1].later(2.0))
    np.testing.assert_allclose(
        changed.pose_at(1.0).as_matrix(), other.pose_at(3.0).as_matrix(), atol=1e-12
    )
    assert one.with_parent("lorry", ways[1]).pose_at(1.0).translation[0] == pytest.approx(4.2)


def test_what_carries_no_motion_does_not_move() -> None:
    assert not Straight((0.0, -0.0, 0.0)).moves
    assert not Turning(AXIS, CENTRE, 0.0).moves
    assert not Swinging(AXIS, CENTRE, 0.0, 1.0).moves
    assert not through([0, 1], PLACES[[0, 0]], TURNS[[0, 0]]).moves
    assert through([0, 1], PLACES[[0, 0]], TURNS[[0, 1]]).moves
    still = wheel_on(Straight((0.0, 0.0, 0.0)))
    assert not still.moves
    assert still.later(5.0) is still


def test_motions_are_told_apart_by_content_and_survive_pickling() -> None:
    digests = {name: digest(motion) for name, motion in ALL.items()}
    assert len(set(digests.values())) == len(ALL)
    for name, motion in ALL.items():
        motion.at(1.0)
        again = pickle.loads(pickle.dumps(motion))
        assert digest(again) == digests[name]
        assert np.array_equal(again.pose_at(1.5).as_matrix(), motion.pose_at(1.5).as_matrix())


def test_points_of_a_body_at_one_time_and_at_several() -> None:
    state = ALL["tree"].at(TIMES[:3])
    for number in range(3):
        one: Kinematics = state[number]
        for several, alone in zip(state.of_points(POINTS), one.of_points(POINTS), strict=True):
            np.testing.assert_allclose(several[number], alone, atol=1e-13)
        place, velocity, acceleration = one.of_points(POINTS)
        again = one.at_world(place)
        np.testing.assert_allclose(again[0], velocity, atol=1e-12)
        np.testing.assert_allclose(again[1], acceleration, atol=1e-12)


@pytest.mark.parametrize(
    ("times", "change", "message"),
    [
        ([0, 1, 1], {}, "pose 2: time 1 s repeats: expected more than 1 s"),
        ([0, 2, 1], {}, "pose 2: time 1 s runs backwards: expected more than 2 s"),
        ([0, 1, math.nan], {}, "pose 2: .*nan.*: expected numbers"),
        ([0, 1, 2], {"places": math.inf}, "pose 1: .*inf.*: expected numbers"),
        ([0, 1, 2], {"norm": 1.01}, "pose 1: quaternion of norm 1.01: expected 1"),
        ([0, 1, 2], {"norm": 0.0}, "pose 1: quaternion of norm 0: expected 1"),
        ([0, 1, 2], {"turn": 180.0}, "pose 1: turned by 180.00 deg .* both ways round"),
        ([0, 1, 2], {"turn": -179.95}, "pose 1: turned by 179.95 deg .* both ways round"),
        ([0, 1, 2], {"outside": "repeat"}, "pose 2: to repeat, .* it is 2 m and 0 deg off"),
        ([0, 1, 2], {"outside": "bounce"}, "outside = 'bounce': expected one of error, hold"),
        ([0], {}, r"\(1,\) times, .*: expected n, n x 3 and n x 4 with n of at least 2"),
    ],
)
def test_a_wrong_trajectory_is_refused(times: list[float], change: dict, message: str) -> None:
    places = np.arange(len(times))[:, None] * [1.0, 0, 0]
    quaternions = np.tile([1.0, 0, 0, 0], (len(times), 1))
    if "places" in change:
        places[1, 1] = change["places"]
    if "norm" in change:
        quaternions[1] *= change["norm"]
    if "turn" in change:
        half = math.radians(change["turn"]) / 2
        quaternions[1] = math.cos(half), 0, 0, math.sin(half)
    with pytest.raises(InputError, match=message):
        Trajectory(np.array(times, float), places, quaternions, change.get("outside", "error"))


def test_the_shorter_way_round_is_taken() -> None:
    """170 deg to the left is 170 deg to the left; 190 deg is 170 deg to the right."""
    for asked, turned in ((170.0, 85.0), (190.0, -85.0)):
        turns = Rotation.from_rotvec([[0, 0, 0], [0, 0, asked]], degrees=True)
        half = through([0, 1], np.zeros((2, 3)), turns).pose_at(0.5).rotation
        assert half.as_euler("zyx", degrees=True)[0] == pytest.approx(turned)


def test_a_time_that_is_no_number_is_refused() -> None:
    with pytest.raises(InputError, match="time nan s"):
        ALL["straight"].at([0.0, math.nan])
