"""A scene at other times: rotations, what carries what, the rig's way, and what stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tests.physics.radar_worlds import ball, world
from twin.digest import digest
from twin.files import InputError
from twin.motion import Rolling, Still, Straight, Swinging, Turning
from twin.motion.trajectory import through
from twin.scene import Pose, Scene, SceneObject, Target, load_scene
from twin.scene.moving import carrier_of, moving

WHEEL = (5.0, 1.0, 0.3)
IN_PLACE = Still(RigidTransform.identity())


def placed(name: str, place: tuple[float, float, float], radius: float = 0.3) -> SceneObject:
    """A ball about its own origin, drawn elsewhere and turned."""
    turn = Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    pose = RigidTransform.from_components(place, turn)
    return replace(ball(name, (0, 0, 0), radius, level=2), pose=pose)


def driving(speed: float = 6.0) -> Scene:
    """A car that goes straight on, a wheel that rolls, and a target on its rim."""
    car = replace(placed("car", (6.0, 0.0, 0.8)), velocity_m_per_s=(speed, 0.0, 0.0))
    carrier = carrier_of(car)
    wheel = moving(placed("wheel", WHEEL), Rolling(carrier, (0, 1, 0), WHEEL, 0.3), carrier)
    tip = Target("tip", (5.0, 1.0, 0.6), (0.0, 0.0, 0.0), 1.0, "assumed", "wheel")
    tip = tip.carried(wheel, wheel)
    return world(car, wheel, ball("post", (9, 2, 1), level=1), targets=(tip,))


def test_a_wheel_turns_on_a_driving_car_and_its_target_with_it() -> None:
    scene = driving()
    _, wheel, post = scene.objects
    assert wheel.velocity_m_per_s == pytest.approx((6.0, 0.0, 0.0))
    assert scene.targets[0].velocity_m_per_s == pytest.approx((12.0, 0.0, 0.0))
    seconds = 0.3 * np.pi / 6.0  # half a turn
    later = scene.after(seconds)
    np.testing.assert_allclose(later.objects[1].middle_m, [5.0 + 0.3 * np.pi, 1.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(
        later.targets[0].position_m, [5.0 + 0.3 * np.pi, 1.0, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(later.targets[0].velocity_m_per_s, 0, atol=1e-11)
    turned = later.objects[1].pose.rotation * wheel.pose.rotation.inv()
    np.testing.assert_allclose(turned.magnitude(), np.pi, rtol=1e-12)
    assert later.objects[2] is post
    assert not scene.at_rest


def test_times_add_up() -> None:
    scene = driving()
    once, twice = scene.after(0.75), scene.after(0.5).after(0.25)
    for a, b in zip(once.objects, twice.objects, strict=True):
        np.testing.assert_allclose(a.pose.as_matrix(), b.pose.as_matrix(), atol=1e-13)
    assert scene.after(0) is scene
    back = scene.after(0.75).after(-0.75)
    np.testing.assert_allclose(
        back.objects[1].pose.as_matrix(), scene.objects[1].pose.as_matrix(), atol=1e-13
    )


@pytest.mark.parametrize("time", [float("inf"), float("nan"), 1e30, None, "3"])
def test_a_time_that_is_none_is_refused(time: object) -> None:
    with pytest.raises(InputError, match=r"scene\.after = .*: expected -1e\+09 to 1e\+09"):
        driving().after(time)  # type: ignore[arg-type]


def test_the_rig_follows_its_way_and_stands_without_one() -> None:
    scene = driving()
    assert scene.after(3.0).rig is scene.rig
    turns = Rotation.from_euler("z", [[0], [30], [60]], degrees=True)
    way = through([0, 2, 4], [[0, 0, 1], [4, 0, 1], [8, 1, 1]], turns)
    on_way = replace(scene, rig=scene.rig.following(way))
    later = on_way.after(2.0)
    assert later.rig.pose.position_m == pytest.approx((4.0, 0.0, 1.0))
    assert later.rig.pose.yaw_deg == pytest.approx(30.0)
    assert later.rig.state.angular_velocity_rad_per_s[2] == pytest.approx(np.radians(15))
    assert on_way.rig.moves
    assert on_way.span_s == (0.0, 4.0)
    assert later.span_s == (-2.0, 2.0)
    with pytest.raises(
        InputError, match=r"time 4\.5 s from now on: its trajectories cover 0 to 4 s"
    ):
        on_way.after(4.5)
    with pytest.raises(InputError, match=r"time 2\.5 s from now on: .* -2 to 2 s"):
        later.after(2.5)
    stopped = on_way.at(Pose((1.0, 0.0, 1.0)))
    assert not stopped.rig.moves
    assert stopped.after(9.0).rig.pose == Pose((1.0, 0.0, 1.0))
    moved = on_way.with_({"rig.x_m": 10.0})
    assert moved.after(2.0).rig.pose.position_m == pytest.approx((14.0, 0.0, 1.0))


def test_nothing_that_moves_not_makes_a_scene_move() -> None:
    still = [
        moving(placed("a", (3, 0, 1)), Turning((0, 0, 1), (0, 0, 0), 0.0)),
        moving(placed("b", (4, 0, 1)), Swinging((0, 0, 1), (0, 0, 0), 0.0, 1.0)),
        moving(placed("c", (5, 0, 1)), Straight((0.0, 0.0, 0.0))),
    ]
    scene = world(*still)
    assert scene.at_rest
    later = scene.after(100.0)
    assert all(a is b for a, b in zip(scene.objects, later.objects, strict=True))
    assert digest(later) == digest(scene)
    slow = world(moving(placed("c", (5, 0, 1)), Straight((1e-9, 0.0, 0.0))))
    assert not slow.at_rest
    assert slow.after(1.0).objects[0].pose.translation[0] - 5 == pytest.approx(1e-9, rel=1e-6)


def test_what_an_object_carries_takes_its_new_velocity_and_place() -> None:
    """Changed now or changed before: the same wheel, at another time of the scene too."""
    changed = driving().with_({"objects.car.velocity_m_per_s": (3.0, 0.0, 0.0)})
    expected = driving(3.0)
    for t in (0.0, 0.4):
        for a, b in zip(changed.after(t).objects, expected.after(t).objects, strict=True):
            np.testing.assert_allclose(a.pose.as_matrix(), b.pose.as_matrix(), atol=1e-12)
            np.testing.assert_allclose(a.velocity_m_per_s, b.velocity_m_per_s, atol=1e-12)
    scene = driving().after(0.3)
    slower = scene.with_({"objects.car.velocity_m_per_s": (3.0, 0.0, 0.0)})
    for a, b in zip(slower.objects, scene.objects, strict=True):
        np.testing.assert_allclose(a.pose.translation, b.pose.translation, atol=1e-12)
    way = slower.after(0.2).objects[1].pose.translation - slower.objects[1].pose.translation
    np.testing.assert_allclose(way, [0.6, 0, 0], atol=1e-12)
    shifted = scene.with_({"objects.car.shift_y_m": 2.0})
    for a, b in zip(shifted.after(0.2).objects, scene.after(0.2).objects, strict=True):
        off = 0.0 if a.name == "post" else 2.0
        np.testing.assert_allclose(a.middle_m - b.middle_m, [0, off, 0], atol=1e-12)
    (target,), (before,) = shifted.targets, scene.targets
    np.testing.assert_allclose(
        np.subtract(target.position_m, before.position_m), [0, 2.0, 0], atol=1e-12
    )


def test_a_shift_of_what_is_carried_turns_with_what_carries_it() -> None:
    table = moving(placed("table", (5, 0, 1)), Turning((0, 0, 1), (5, 0, 0), np.pi / 2))
    cup = moving(placed("cup", (5.5, 0, 1.2), 0.05), IN_PLACE, carrier_of(table))
    scene = world(table, cup).after(1.0)  # a quarter of a turn: the cup is at (5, 0.5)
    shifted = scene.with_({"objects.cup.shift_y_m": 0.1})
    np.testing.assert_allclose(shifted.objects[1].middle_m, [5, 0.6, 1.2], atol=1e-12)
    np.testing.assert_allclose(shifted.after(1.0).objects[1].middle_m, [4.4, 0, 1.2], atol=1e-12)
    assert shifted.objects[0] is scene.objects[0]
    assert shifted.objects[1].velocity_m_per_s == pytest.approx((-0.3 * np.pi, 0.0, 0.0))


@pytest.mark.parametrize("name", ["wheel", "*"])
def test_a_velocity_of_what_moves_by_other_means_is_refused(name: str) -> None:
    scene = driving()
    if name == "*":
        turning = moving(placed("fan", (3, 0, 1)), Turning((0, 0, 1), (3, 0, 1), 1.0))
        scene = replace(scene, objects=(*scene.objects, turning))
    with pytest.raises(InputError, match=r"velocity_m_per_s: it moves by its (parent|own motion)"):
        scene.with_({f"objects.{name}.velocity_m_per_s": (1.0, 0.0, 0.0)})


def test_a_motion_beyond_all_speeds_is_refused() -> None:
    with pytest.raises(InputError, match=r"objects\.c\.velocity_m_per_s"):
        moving(placed("c", (5, 0, 1)), Straight((2e5, 0.0, 0.0)))


def test_scenes_of_constant_velocities_are_what_they_were() -> None:
    """Digests of poses and targets after 0.3 s, as they were before anything could turn."""
    for name, expected in (
        ("yard", "308279fc02c85fb741fcbbce2e15d2d8a5346385e22370103984ce5a5ce99afb"),
        ("street", "b53d85b9ea17bd44c86ee90279f20a2a17afb5f14483e86e91a226f4b549bafe"),
    ):
        later = load_scene(name).after(0.3)
        assert digest(later) == expected
        car = next(item for item in load_scene(name).objects if item.name == "car")
        moved = car.pose.translation + 0.3 * np.array(car.velocity_m_per_s)
        here = next(item for item in later.objects if item.name == "car")
        assert np.array_equal(here.pose.translation, moved)
        np.testing.assert_allclose(
            car.course.pose_at(0.3).as_matrix(), here.pose.as_matrix(), atol=1e-15
        )
