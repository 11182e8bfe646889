"""The bundled crossing: what its files say is a drive of ten minutes and more that can be."""

import numpy as np
import pytest

from twin.scene import Scene, SceneObject, load_scene

LAP_S = 60.0
WHEELS = [f"tyre_{end}_{side}" for end in ("rear", "front") for side in ("left", "right")]


@pytest.fixture(scope="module")
def crossing() -> Scene:
    return load_scene("crossing")


def item(scene: Scene, name: str) -> SceneObject:
    return next(o for o in scene.objects if o.name == name)


def test_the_files_draw_time_0(crossing: Scene) -> None:
    """Stock Mitsuba's view of scene.xml is that of the twin at time 0, but for swung limbs."""
    import xml.etree.ElementTree as ET

    drawn = {}
    for shape in ET.parse(crossing.path).getroot().iter("shape"):
        move = shape.find("transform/translate")
        drawn[shape.get("id")] = (
            np.zeros(3) if move is None else [float(move.get(axis)) for axis in "xyz"]
        )
    for name in ("ground", "car", "car_windows", *WHEELS, "person", "head", "post_near"):
        place = item(crossing, name).pose.translation
        np.testing.assert_allclose(place, drawn[name], atol=1e-9)
    assert crossing.rig.pose.position_m == (0.0, 0.0, 1.2)
    assert crossing.warnings == ()


def test_speeds_are_what_the_description_says(crossing: Scene) -> None:
    times = np.linspace(0, LAP_S, 2001)
    for course, speed in (
        (crossing.rig.course, 5.0),
        (item(crossing, "car").course, 1.4),
        (item(crossing, "person").course, 1.3),
    ):
        state = course.at(times)
        way = state.velocity_m_per_s
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), speed, rtol=2e-3)
        ahead = state.pose.rotation.apply([1, 0, 0])  # nothing drifts sideways
        np.testing.assert_allclose(way, speed * ahead, atol=6e-3 * speed)


def test_ten_minutes_and_an_hour_come_round(crossing: Scene) -> None:
    for seconds in (600.0, 3600.0):
        later = crossing.after(seconds)
        assert later.rig.pose.position_m == pytest.approx((0.0, 0.0, 1.2), abs=1e-9)
        for name in ("car", "person", "head"):
            np.testing.assert_allclose(
                item(later, name).pose.as_matrix(),
                item(crossing, name).pose.as_matrix(),
                atol=1e-9,
            )
    np.testing.assert_allclose(
        item(crossing.after(1234.5), "tyre_rear_left").middle_m,
        item(crossing.after(1234.5 - 20 * LAP_S), "tyre_rear_left").middle_m,
        atol=1e-9,
    )


@pytest.mark.parametrize("name", WHEELS)
def test_wheels_turn_without_slipping(crossing: Scene, name: str) -> None:
    """What of the wheel touches the road rests on it along the wheel's heading; of the rear wheels
    sideways too. Front wheels do not steer: in a bend they scrub sideways at the rate of the bend
    times the wheelbase of 2.2 m.
    """
    wheel, car = item(crossing, name).course, item(crossing, "car").course
    for time in np.linspace(0, LAP_S, 25):
        state, body = wheel.at(time), car.at(time)
        axle = state.pose.translation
        assert axle[2] == pytest.approx(0.3, abs=1e-9)
        touching = state.at_world((axle - [0, 0, 0.3])[None])[0][0]
        ahead, left = body.pose.rotation.apply(np.eye(3)[:2])
        assert touching @ ahead == pytest.approx(0.0, abs=1e-9)
        scrub = body.angular_velocity_rad_per_s[2] * (2.2 if "front" in name else 0.0)
        assert touching @ left == pytest.approx(scrub, abs=0.01)


def test_the_foot_that_bears_the_person_holds_still(crossing: Scene) -> None:
    """At time 0 the left leg stands straight below the hip; the right foot swings forward."""
    ankle = np.array([[0.0, 0.095, 0.0]])
    other = np.array([[0.0, -0.095, 0.0]])
    at_rest = item(crossing, "shin_left").state.of_points(ankle)[1][0]
    assert np.linalg.norm(at_rest) < 0.01
    assert item(crossing, "shin_right").state.of_points(other)[1][0][0] > 2.0
    times = np.arange(0, 1.1, 0.1)
    heights = [
        shin.course.at(times).of_points(shin.geometry.vertices_m)[0][..., 2].min(axis=1)
        for shin in (item(crossing, "shin_left"), item(crossing, "shin_right"))
    ]
    lowest = np.min(heights, axis=0)
    assert lowest.min() > -0.01
    assert lowest.max() < 0.05


def gaps(outline: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distances in the plane of points (n, 2) from an upright box, its least and largest corner."""
    beside = np.maximum(outline[0] - places, places - outline[1])
    return np.linalg.norm(np.maximum(beside, 0), axis=-1)


def test_nothing_drives_through_anything(crossing: Scene) -> None:
    """Over one lap rig and person stay off the car, and all three off walls and posts and one
    another.
    """
    times = np.arange(0, LAP_S, 0.1)
    car = item(crossing, "car")
    outline = np.array([car.geometry.used_m.min(axis=0), car.geometry.used_m.max(axis=0)])[:, :2]
    still = [o.box_m[:, :2] for o in crossing.objects if not o.moves and o.name != "ground"]
    rig = crossing.rig.course.pose_at(times).translation
    person = item(crossing, "person").course.pose_at(times).translation
    poses = car.course.pose_at(times)
    for places, least in ((rig, 0.5), (person, 0.3)):
        on_road = places * [1, 1, 0]
        own = np.array([pose.inv().apply(p) for pose, p in zip(poses, on_road, strict=True)])
        assert gaps(outline, own[:, :2]).min() > least
        assert min(gaps(box, places[:, :2]).min() for box in still) > least
    assert np.linalg.norm((rig - person)[:, :2], axis=1).min() > 0.9
    corners = [[x, y, 0.0] for x in outline[:, 0] for y in outline[:, 1]]
    reach = car.course.at(times).of_points(corners)[0][..., :2]
    low, high = reach.min(axis=1), reach.max(axis=1)
    for box in still:
        assert np.maximum(box[0] - high, low - box[1]).max(axis=1).min() > 0


def test_both_sensors_look_at_car_and_person(crossing: Scene) -> None:
    """At time 0: within the 20 deg of `workable`, in front of the wall."""
    for name in ("car", "person", "rim_rear_left", "shin_left"):
        x, y, z = item(crossing, name).middle_m - crossing.rig.position_m
        assert 5 < x < 17
        assert abs(np.degrees(np.arctan2(y, x))) < 10
        assert abs(np.degrees(np.arctan2(z, x))) < 10
