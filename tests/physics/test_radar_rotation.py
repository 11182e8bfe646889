"""Micro-Doppler: what turns, rolls, swings and accelerates, against closed forms in mpmath.

References know places alone: lengths of ways at every slot, in 30 digits. The twin has each way's
length with two derivatives, by the velocities and accelerations of rigid bodies.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics import micro_doppler as exact
from tests.physics.radar_worlds import (
    AT_ORIGIN,
    CARRIER_HZ,
    OPTICS,
    RADAR,
    ball,
    ground,
    plate,
    quad,
    thing,
    world,
)
from twin.motion import Product, Rolling, Still, Straight, Swinging, Turning
from twin.radar.acquisition import channel
from twin.radar.propagation.meshes.grouping import bodies_of
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import direct_sum
from twin.scene import Pose, Scene, SceneObject, Target

WAVE = RADAR.ofdm
ENDS_S = np.array([-5e-3, -2.5e-3, 0.0, 2.5e-3, 5e-3])
ROWS = np.linspace(0, WAVE.n_subcarriers - 1, 5).astype(int)
STILL = exact.on_rotor((0, 0, 0), (0, 0, 0), 0.0)


def off(found, reference) -> float:
    """Error of one over the other's rms."""
    return float(np.sqrt(np.mean(abs(found - reference) ** 2) / np.mean(abs(reference) ** 2)))


def carried(name: str, place, item: SceneObject) -> Target:
    """A declared target on an object, which moves with it."""
    velocity = tuple(item.state.at_world(np.array([place], float))[0][0].tolist())
    return Target(name, tuple(map(float, place)), velocity, 10.0, "declared", item.name)


def at_slots(scene: Scene, rung: str) -> np.ndarray:
    found = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung))
    received = channel(found, RADAR, Atmosphere())[0, :, 0].T[ROWS]
    (path,) = found.paths
    # Within a slot it moves on: symbols that are averaged have different phases.
    averaged = RADAR.ofdm.slot_gain(CARRIER_HZ * np.array(path.delay_rate))
    return received / (path.amplitude * averaged)


ROTOR = (exact.on_rotor((10, 0, 0), (0, 0.4, 0), 6.0), Turning((0, 0, 1), (10, 0, 0), 6.0))
PENDULUM = (
    exact.on_pendulum((10, 0, 1), 1.0, 0.4, 0.9),
    Swinging((0, 1, 0), (10, 0, 1), 0.4, 0.9),
)
AHEAD = Straight((1.4, 0.0, 0.0))
WHEEL = (
    exact.on_rolling_wheel((10, 0, 0.3), 0.3, 1.4, 0.7),
    Product((AHEAD, Rolling(AHEAD, (0, 1, 0), (10, 0, 0.3), 0.3))),
)


@pytest.mark.parametrize("rung", ["targets", "paths"])
@pytest.mark.parametrize("motion", [ROTOR, PENDULUM, WHEEL], ids=["rotor", "pendulum", "wheel"])
def test_a_point_that_a_turning_body_carries(motion, rung: str) -> None:
    """At every slot and over all of 4 GHz within 1 % rms of exp(-j k 2 |x(t)|), 30 digits; with the
    point's velocity alone the rotor's would be off by 1.5 rad at the ends.
    """
    reference, course = motion
    place = np.array([float(x) for x in reference(exact.mpmath.mpf(0))])
    # Far from the way to the point, so that it hides nothing.
    item = ball("hub", (12.0, 3.0, 0.0), 0.05, 1).following(course)
    moving = world(item, targets=(carried("t", place, item),))
    times = WAVE.slot_times_s
    phases = exact.two_way(reference, STILL, times, CARRIER_HZ + WAVE.frequency_offsets_hz[ROWS])
    assert off(at_slots(moving, rung), phases) < 0.01


def test_speeds_on_a_rolling_wheel() -> None:
    """Where it touches the road the rim stands still; at the top it goes at twice the axle's."""
    for angle, speed in ((0.0, 2.8), (np.pi / 2, 1.4 * np.sqrt(2)), (np.pi, 0.0)):
        place = exact.on_rolling_wheel((10, 0, 0.3), 0.3, 1.4, angle)(exact.mpmath.mpf(0))
        item = ball("wheel", (10, 0, 0.3), 0.3, 2).following(WHEEL[1])
        velocity = carried("t", [float(x) for x in place], item).velocity_m_per_s
        assert np.linalg.norm(velocity) == pytest.approx(speed, abs=1e-12)


def mirrored(place, point, normal):
    """The image in a plane, in mpmath."""
    height = sum((place[i] - point[i]) * normal[i] for i in range(3))
    return place - 2 * height * normal


@pytest.mark.parametrize("rung", ["optics", "paths"])
def test_over_a_mirror_that_tilts_from_a_rig_that_turns_and_accelerates(rung: str) -> None:
    """A wall that turns about an upright axis, a point at rest before it, the radar on a rig that
    swings: each way is within 3e-7 m (0.5 mrad) of the image method at any time in the burst.
    """
    rate, pivot = 0.3, (0.0, 6.0, 0.0)
    corners = [[-5, 6, -9], [40, 6, -9], [40, 6, 9], [-5, 6, 9]]
    wall = quad("wall", corners).following(Turning((0, 0, 1), pivot, rate))
    swing = Swinging((0, 1, 0), (0.0, 0.0, 2.0), 0.5, 4.0)
    rig = replace(AT_ORIGIN, radar=Pose((0.1, 0.05, 0.0))).following(swing)
    place = (10.0, 1.0, 0.5)
    scene = world(wall, targets=(Target("t", place, (0, 0, 0), 10.0, "declared"),), rig=rig)
    found = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung, radar_images=1)).paths
    assert {path.via for path in found} >= {
        ("t",),
        ("wall", "t"),
        ("t", "wall"),
        ("wall", "t", "wall"),
    }

    def legs(t):
        angle = exact.mpmath.mpf("0.5") * exact.mpmath.sin(2 * exact.mpmath.pi * t / 4)
        here = exact.vector((0, 0, 2)) + exact.about_y(angle) * exact.vector((0.1, 0.05, -2))
        normal = exact.about_z(rate * t) * exact.vector((0, 1, 0))
        return here, mirrored(here, exact.vector(pivot), normal)

    for path in found:
        for time in ENDS_S:
            at = exact.mpmath.mpf(time)
            here, image = legs(at)
            if "t" not in path.via:
                length = exact.mpmath.norm(here - image)
            else:
                end = path.via.index("t")
                length = sum(
                    exact.mpmath.norm((image if way else here) - exact.vector(place))
                    for way in (path.via[:end], path.via[end + 1 :])
                )
            delay = (
                path.delay_s + (path.delay_rate + path.delay_acceleration_per_s / 2 * time) * time
            )
            assert delay * speed_of_light == pytest.approx(float(length), abs=3e-7), path.via


@pytest.mark.parametrize("rung", ["optics", "paths", "targets"])
def test_directions_from_a_rig_that_turns(rung: str) -> None:
    """In the antenna's own axes, over a wall that turns, too: by differences of what is traced 1 ms
    before and after.
    """
    corners = [[-5, 6, -9], [40, 6, -9], [40, 6, 9], [-5, 6, 9]]
    wall = quad("wall", corners).following(Turning((0, 0, 1), (0.0, 6.0, 0.0), 0.3))
    rig = AT_ORIGIN.following(Turning((0.1, 0.2, 1.0), (0.5, 0.3, 0), 2.0))
    scene = world(
        wall, targets=(Target("t", (10.0, 1.0, 0.5), (3, 9, 0), 10.0, "declared"),), rig=rig
    )
    knobs = OPTICS.with_(radar=rung)
    before, here, after = (
        {p.via: p for p in trace(s, RADAR, fidelity=knobs).paths}
        for s in (scene.after(-1e-3), scene, scene.after(1e-3))
    )
    assert set(here) >= ({("t",)} if rung == "targets" else {("t",), ("wall", "t")})
    for via, path in here.items():
        for name in ("departure", "arrival"):
            change = np.subtract(getattr(after[via], name), getattr(before[via], name)) / 2e-3
            np.testing.assert_allclose(getattr(path, f"{name}_per_s"), change, atol=2e-4)


def dihedral(name: str, apex, leg: float) -> SceneObject:
    """Two upright squares at right angles, open towards -x, their common edge at the apex."""
    h, w = leg / 2, leg / np.sqrt(2)
    corners = [[0, 0, -h], [0, 0, h], [-w, w, -h], [-w, w, h], [-w, -w, -h], [-w, -w, h]]
    return thing(name, np.add(corners, apex), [[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]])


@pytest.mark.parametrize(("rate", "arm"), [(2.0, 0.0), (2.0, 0.5), (-4.0, 0.5)])
def test_a_dihedral_that_turns(rate: float, arm: float) -> None:
    """Its double bounce by physical optics: of the phase of its corner line, from any side, and
    sqrt(2) cos(45 deg + |angle|) as strong (Knott, Radar Cross Section, 2004, ch. 6.3); 100 m away
    and turned by up to 1.2 deg about an axis 0.5 m behind. Within 1 % rms at every time.
    """
    apex, distance, leg = (100.0, 0.0, 0.0), 100.0, 0.1
    axis = (distance + arm, 0.0, 0.0)
    item = dihedral("d", apex, leg).following(Turning((0, 0, 1), axis, rate))
    knobs = OPTICS.with_(radar_tolerance=0.01)
    echoes = trace(world(item), RADAR, fidelity=knobs).surfaces
    times = np.linspace(-5e-3, 5e-3, 41)
    found = direct_sum(echoes, np.zeros(1), times, CARRIER_HZ)[0]
    phase = exact.two_way(
        exact.on_rotor(axis, (-arm, 0, 0), rate), STILL, times, np.array([CARRIER_HZ])
    )[0]
    closed = np.sqrt(2) * np.cos(np.pi / 4 + abs(rate * times)) * phase
    scale = np.vdot(closed, found) / np.vdot(
        closed, closed
    )  # of both, whose level is tested elsewhere
    assert off(found, scale * closed) < 0.01


def test_a_plate_that_flashes() -> None:
    """Turning through the perpendicular at 5 rad/s: sinc(k a angle) within 10 % rms of its rms,
    although each of its points is only followed to second order.
    """
    rate, side = 5.0, 0.2
    item = plate("p", (100.0, 0, 0), side).following(Turning((0, 0, 1), (100.0, 0, 0), rate))
    echoes = trace(world(item), RADAR, fidelity=OPTICS.with_(radar_tolerance=0.03)).surfaces
    times = np.linspace(-5e-3, 5e-3, 41)
    found = direct_sum(echoes, np.zeros(1), times, CARRIER_HZ)[0]
    angle = rate * times
    k = 2 * np.pi * CARRIER_HZ / speed_of_light
    closed = np.cos(angle) * np.sinc(k * side * np.sin(angle) / np.pi)
    assert off(found / found[20], closed) < 0.05


def test_parts_of_one_rigid_body_are_one_body_and_a_wheel_is_of_the_car_that_carries_it() -> None:
    course = Product((Straight((3.0, 0, 0)), Turning((0, 0, 1), (5.0, 1.0, 0), 0.7)))
    hull, door = (ball(name, (10.0, y, 0), 0.2, 1) for name, y in (("hull", 0.0), ("door", 0.35)))
    wheel = ball("wheel", (10.0, 0.0, -0.3), 0.15, 1)
    shifted = Product((course, Turning((0, 1, 0), (10.0, 0, -0.3), 20.0)))
    items = [hull.following(course), door.following(course), wheel.following(shifted)]
    assert bodies_of(items).tolist() == [0, 0, 1]
    assert bodies_of([item.after(0.3) for item in items]).tolist() == [0, 0, 1]
    carried_wheel = wheel.following(shifted, "hull")
    assert bodies_of([*items[:2], carried_wheel]).tolist() == [0, 0, 0]
    rim = ball("rim", (10.0, 0.0, -0.3), 0.1, 1).following(shifted, "wheel")
    assert bodies_of([*items[:2], carried_wheel, rim]).tolist() == [0, 0, 0, 0]


def test_rotation_of_zero_has_the_bits_of_none() -> None:
    item = ball("b", (8.0, 0.3, 0), 0.2, 3)
    scenes = [
        world(item, ground(-1.0)),
        world(item.following(Product((Straight((0.0, 0, 0)), Still(item.pose)))), ground(-1.0)),
    ]
    one, other = (trace(s, RADAR, fidelity=OPTICS).contributions for s in scenes)
    for name, values in vars(one).items():
        np.testing.assert_array_equal(values, getattr(other, name))
