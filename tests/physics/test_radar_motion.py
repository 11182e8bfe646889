"""Moving targets, plates and mirrors against the distances |x(t)| that they really have.

A burst lasts 10 ms and what moves in it moves uniformly, so lengths of ways are square roots of
parabolas in time. The reference is that square root in float64 at every time, in a sum of
exponentials; the twin has each way's length, rate and acceleration at the burst's middle.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import (
    AT_ORIGIN,
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ground,
    paths_of,
    plate,
    quad,
    trihedral,
    world,
)
from twin.radar.acquisition import channel, radar_capture
from twin.radar.device.burst import Burst, burst_channel
from twin.radar.evaluation import evaluate_radar
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions, direct_sum
from twin.scene import Pose, Target

WAVE = RADAR.ofdm
ENDS_S = np.array([-5e-3, -2.5e-3, 0.0, 2.5e-3, 5e-3])


def target(position, velocity) -> Target:
    return Target("t", tuple(position), tuple(velocity), 10.0, "declared")


def turned(lengths_m, frequency_hz: float = CARRIER_HZ):
    """exp(-j k L)."""
    return np.exp(-2j * np.pi * (np.asarray(lengths_m) * frequency_hz / speed_of_light % 1.0))


def off(found, exact) -> float:
    """Error of one over the other's rms."""
    return float(np.sqrt(np.mean(np.abs(found - exact) ** 2) / np.mean(np.abs(exact) ** 2)))


def at(echoes: Contributions, times_s=ENDS_S):
    """What is received at the carrier at some times."""
    return direct_sum(echoes, np.zeros(1), times_s, CARRIER_HZ)[0]


@pytest.mark.parametrize(
    ("distance", "speed"), [(10.0, 15.0), (5.0, 25.0), (0.1, 0.5), (5.0, 1e-9), (5.0, 0.0)]
)
@pytest.mark.parametrize("rung", ["targets", "optics", "paths"])
def test_a_crossing_point(rung: str, distance: float, speed: float) -> None:
    """At every slot and over all of 4 GHz: within 1 % rms of exp(-j k 2 |x(t)|). A delay to first
    order is off by 0.93 rad at the ends of 10 ms where 15 m/s cross in 10 m, 42 % rms, and by
    5.2 rad where 25 m/s cross in 5 m.
    """
    scene = world(targets=(target((distance, 0, 0), (0, speed, 0)),))
    found = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung))
    received = channel(found, RADAR, Atmosphere())[0, :, 0].T
    rows, t = np.linspace(0, WAVE.n_subcarriers - 1, 5).astype(int), WAVE.slot_times_s
    lengths = 2 * np.hypot(distance, speed * t)
    f = CARRIER_HZ + WAVE.frequency_offsets_hz[rows]
    exact = abs(found.paths[0].amplitude) * turned(lengths, f[:, None])
    assert off(received[rows], exact) < 0.01


def test_a_target_on_the_line_of_sight_has_no_acceleration() -> None:
    """Receding, at rest, a kilometre off the world's origin: rounding errors at most."""
    for place, velocity in (
        ((7, 2, 1), (7, 2, 1)),
        ((7, 2, 1), (0, 0, 0)),
        ((0.1, 0, 0), (9, 0, 0)),
    ):
        for rung in ("targets", "optics", "paths"):
            scene = world(targets=(target(place, velocity),))
            (path,) = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung)).paths
            assert abs(path.delay_acceleration_per_s) * speed_of_light < 1e-24
            assert path.delay_rate * speed_of_light == pytest.approx(2 * np.linalg.norm(velocity))


def test_a_crossing_point_a_thousand_kilometres_from_the_worlds_origin() -> None:
    there = np.array([1e6, -1e6, 500.0])
    rig = replace(AT_ORIGIN, pose=Pose(tuple(there)))
    scene = world(targets=(target(there + [10, 0, 0], (0, 15, 0)),), rig=rig)
    for rung in ("targets", "optics", "paths"):
        (path,) = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung)).paths
        acceleration = path.delay_acceleration_per_s * speed_of_light
        assert acceleration == pytest.approx(2 * 15.0**2 / 10, rel=1e-9)


def length_at(time: float, mirrors, place, velocity):
    """Of the leg from the origin over moving planes (point, normal, velocity) to a point."""
    image = np.zeros(3)
    for start, normal, moving in mirrors:
        height = (image - start - np.multiply(moving, time)) @ normal
        image = image - 2 * height * normal
    return np.linalg.norm(np.add(place, np.multiply(velocity, time)) - image)


@pytest.mark.parametrize("rung", ["optics", "paths"])
def test_over_mirrors_that_move(rung: str) -> None:
    """A point before a sinking floor and a wall that drifts aside and nearer: every way over none,
    one or both of them is within 1.5e-6 m (2.5 mrad) of the image method at any time in the burst;
    to first order it would be off by 0.2 mm and more.
    """
    sinking, drifting, velocity = (0.5, 2.0, -3.0), (1.0, 4.0, 2.0), (3.0, 12.0, -1.0)
    corners = [[-5, 6, -1.5], [40, 6, -1.5], [40, 6, 30], [-5, 6, 30]]
    floor = ground(-1.5, velocity_m_per_s=sinking)
    wall = quad("wall", corners, velocity_m_per_s=drifting)
    planes = {
        "ground": (np.array([0, 0, -1.5]), np.array([0, 0, 1.0]), sinking),
        "wall": (np.array([0, 6.0, 0]), np.array([0, 1.0, 0]), drifting),
    }
    place = (10.0, 1.0, 0.5)
    scene = world(floor, wall, targets=(target(place, velocity),))
    paths = trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung, radar_images=2)).paths
    paths = [p for p in paths if "t" in p.via]
    assert len(paths) >= 9
    bent = []
    for path in paths:
        end = path.via.index("t")
        out, home = path.via[:end], path.via[:end:-1]
        for time in ENDS_S:
            exact = sum(
                length_at(time, [planes[name] for name in way], place, velocity)
                for way in (out, home)
            )
            first = path.delay_s + path.delay_rate * time
            second = first + path.delay_acceleration_per_s * time**2 / 2
            assert second * speed_of_light == pytest.approx(exact, abs=1.5e-6)
            bent.append(abs(first * speed_of_light - exact))
    assert max(bent) > 2e-4


def test_the_radars_own_image_in_a_corner_that_moves() -> None:
    """Both mirrors drift across the way: the image does, too."""
    velocity = (2.0, 6.0, -5.0)
    corners = [[10, -20, -1.5], [10, 20, -1.5], [10, 20, 20], [10, -20, 20]]
    scene = world(
        ground(-1.5, velocity_m_per_s=velocity), quad("wall", corners, velocity_m_per_s=velocity)
    )
    planes = {
        "ground": (np.array([0, 0, -1.5]), np.array([0, 0, 1.0]), velocity),
        "wall": (np.array([10.0, 0, 0]), np.array([1.0, 0, 0]), velocity),
    }
    paths = [p for p in trace(scene, RADAR, fidelity=OPTICS).paths if len(p.via) == 2]
    assert paths
    for path in paths:
        assert path.delay_acceleration_per_s > 1e-8
        for time in ENDS_S:
            exact = length_at(time, [planes[name] for name in path.via], np.zeros(3), np.zeros(3))
            found = (
                path.delay_s + (path.delay_rate + path.delay_acceleration_per_s / 2 * time) * time
            )
            assert found * speed_of_light == pytest.approx(exact, abs=3e-7)


@pytest.mark.thorough
@pytest.mark.parametrize("tolerance", [0.1, 0.03])
def test_a_plate_that_slides_in_its_own_plane(tolerance: float) -> None:
    """25 m/s in 5 m: what it sends back hardly changes while the foot of the perpendicular stays on
    it. Against a sum over a grid of its points, a quarter of a wavelength apart, each at its
    distance: rms within the tolerance. To first order the sum turns by 5.2 rad.
    """
    side, distance, speed = 0.6, 5.0, 25.0
    item = plate("p", (distance, 0, 0), side, velocity_m_per_s=(0.0, speed, 0.0))
    knobs = OPTICS.with_(radar_tolerance=tolerance)
    found = at(trace(world(item), RADAR, fidelity=knobs).surfaces)
    gone = np.array([gathered(distance, speed * t, side) for t in ENDS_S])
    assert off(found / found[2], gone / gone[2]) < tolerance


def gathered(distance: float, moved_m: float, side: float) -> complex:
    """Sum over a square plate that has slid so far, with gains and spreading as in the middle."""
    count = int(np.ceil(side / (WAVELENGTH_M / 4)))
    y = side * ((np.arange(count) + 0.5) / count - 0.5)
    began = np.sqrt(distance**2 + y[:, None] ** 2 + y**2)
    gain = (distance / began) ** (10**2 / 2 - 1)
    r = np.sqrt(distance**2 + (y[:, None] + moved_m) ** 2 + y**2)
    return complex(np.sum(gain * distance / began**3 * turned(2 * r)))


def test_a_corner_reflector_that_crosses() -> None:
    """Its triple bounces have the length 2 |apex(t)|, from any distance."""
    speed, apex = 15.0, np.array([8.0, 0, 0])
    item = trihedral("t", apex, velocity_m_per_s=(0.0, speed, 0.0))
    found = at(trace(world(item), RADAR, fidelity=OPTICS).surfaces)
    exact = turned(2 * np.hypot(apex[0], speed * ENDS_S))
    assert off(found / found[2], exact / exact[2]) < 0.03


#: 3 transmitters by turns and 2 receivers, over 4 cm and 2 cm across and upwards.
ARRAY = Burst(
    replace(WAVE, n_subcarriers=8),
    np.array([CARRIER_HZ]),
    np.zeros(1),
    np.array([[0, 0.02, 0], [0, 0, 0.01], [0, -0.02, 0]]),
    np.array([[0, 0.01, 0], [0, -0.01, 0.01]]),
)


def over_array(lengths_of) -> np.ndarray:
    """The burst's channel at the carrier by the length between two antennas at a time."""
    sent, times = ARRAY.transmitter, WAVE.slot_times_s
    return np.array(
        [
            [turned(lengths_of(ARRAY.transmitters_m[i], rx, t)) for rx in ARRAY.receivers_m]
            for i, t in zip(sent, times, strict=True)
        ]
    )


def off_over_time(found, exact) -> float:
    """Apart from one phase that all pairs share."""
    ratio = found / exact
    ratio /= ratio.mean()
    return float(np.sqrt(np.mean(np.abs(ratio - 1) ** 2)))


def test_every_element_of_an_array_hears_its_own_rate() -> None:
    """While a point crosses at 15 m/s in 10 m its direction turns by 15 mrad, and elements 4 cm
    apart hear it pass with rates 60 mm/s apart: within 1 % rms of the distances to each.
    """
    place, velocity = np.array([10.0, 1.0, 0.5]), np.array([2.0, 15.0, -8.0])
    exact = over_array(
        lambda tx, rx, t: sum(np.linalg.norm(place + velocity * t - p) for p in (tx, rx))
    )
    for rung in ("targets", "optics", "paths"):
        scene = world(targets=(target(place, velocity),))
        paths = paths_of(trace(scene, RADAR, fidelity=OPTICS.with_(radar=rung)))
        found = burst_channel(paths, ARRAY)[0, :, :, 4]
        assert off_over_time(found, exact) < 0.01


def test_a_corner_reflector_before_an_array() -> None:
    """Its triple bounces mirror a transmitter at the apex: |2 apex(t) - tx - rx|."""
    speed, apex = 15.0, np.array([8.0, 0, 0])
    item = trihedral("t", apex, velocity_m_per_s=(0.0, speed, 0.0))
    echoes = trace(world(item), RADAR, fidelity=OPTICS).surfaces
    found = burst_channel(echoes, ARRAY)[0, :, :, 4]
    moved = np.array([0, speed, 0])
    exact = over_array(lambda tx, rx, t: np.linalg.norm(2 * (apex + moved * t) - tx - rx))
    assert off_over_time(found, exact) < 0.03


@pytest.mark.parametrize("rung", ["optics", "paths"])
def test_directions_over_moving_mirrors_turn_as_the_traced_ones_do(rung: str) -> None:
    """By differences of what is traced 5 ms before and after."""
    scene = world(
        ground(-1.5, velocity_m_per_s=(0.5, 2.0, -3.0)),
        targets=(target((10.0, 1.0, 0.5), (3.0, 12.0, -4.0)),),
    )
    before, here, after = (
        {p.via: p for p in trace(s, RADAR, fidelity=OPTICS.with_(radar=rung)).paths}
        for s in (scene.after(-5e-3), scene, scene.after(5e-3))
    )
    assert {via for via in here if "t" in via} >= {("t",), ("ground", "t"), ("t", "ground")}
    for via, path in here.items():
        for name in ("departure", "arrival"):
            change = np.subtract(getattr(after[via], name), getattr(before[via], name)) / 10e-3
            np.testing.assert_allclose(getattr(path, f"{name}_per_s"), change, atol=2e-3)


def test_the_vehicle_finds_a_crossing_target_as_strong_as_is_expected() -> None:
    """40 m/s in 8 m spread its echo over 2 m/s, ten cells of rate: without the window 8.8 dB are
    lost, with it 2.1 dB. The map shows what the verdict expects, within what a target between cells
    loses; where the target is, the vehicle has one detection.
    """
    scene = world(targets=(target((8.0, 0, 0), (0, 40.0, 0)),))
    capture = radar_capture(scene, RADAR, seed=1, fidelity=OPTICS.with_(radar="targets"))
    evaluation = evaluate_radar(RADAR, capture)
    expected_db = float(evaluation.expectation(capture.truth[0]).split()[0])
    peak_db = 10 * np.log10(evaluation.image.power_w.max() / evaluation.image.noise_w)
    assert expected_db - 1.6 < peak_db < expected_db + 0.1
    alone = capture.truth[0].received_w / evaluation.image.noise_w
    assert expected_db < 10 * np.log10(alone) - 1.5
    assert evaluation.matches == capture.truth
    assert abs(evaluation.detections[0].range_m - 8) < 1e-3
    assert not capture.warnings
