"""Two reflections on a leg: image theory gives every path between perpendicular mirrors exactly."""

from itertools import product

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    GAIN,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    world,
)
from twin.fidelity import Fidelity, Tolerance
from twin.radar import radar_capture
from twin.radar.propagation.facets.convergence import band_of
from twin.radar.propagation.physical_optics import scattered
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, SceneObject, Target
from twin.trade.bodies import echoes_by_body

TWICE = OPTICS.with_(radar_images=2)
K = 2 * np.pi / WAVELENGTH_M
AHEAD = plate("ahead", (20.0, 0, 0), 40.0)
SIDE = quad("side", [[-20, 7, -20], [20, 7, -20], [20, 7, 20], [-20, 7, 20]])
LEVEL = ground(-1.0)
#: A point of each mirror and its normal.
PLANES = {"ahead": (20.0, 0), "side": (7.0, 1), "ground": (-1.0, 2)}


def mirrored(point: np.ndarray, name: str) -> np.ndarray:
    at, axis = PLANES[name]
    image = point.copy()
    image[axis] = 2 * at - point[axis]
    return image


def field(departure: np.ndarray, sequence: tuple[str, ...]) -> np.ndarray:
    """V of Ludwig's third definition, reflected by conductors: E' = 2 (n.E) n - E each time."""
    up, ahead = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    e = up - departure @ up / (1 + departure @ ahead) * (departure + ahead)
    for name in sequence:
        e = np.where(np.arange(3) == PLANES[name][1], e, -e)
    return e


def leg_by(target: np.ndarray, sequence: tuple[str, ...]) -> tuple[float, np.ndarray, np.ndarray]:
    """Length from the radar at the origin, departure, and direction of arrival at the target."""
    image = np.zeros(3)
    for name in sequence:
        image = mirrored(image, name)
    way = target - image
    length = float(np.linalg.norm(way))
    back = target
    for name in sequence[::-1]:
        back = mirrored(back, name)
    return length, back / length, way / length


@pytest.mark.parametrize(
    ("mirrors", "target"),
    [
        ((AHEAD, SIDE), (12.0, 3.0, 0.0)),
        ((AHEAD, SIDE), (5.0, 5.5, 0.7)),
        ((LEVEL, AHEAD), (11.0, 0.5, 0.4)),
        ((LEVEL, SIDE), (9.0, 4.0, -0.3)),
    ],
)
def test_a_point_between_two_mirrors(mirrors: tuple[SceneObject, ...], target) -> None:
    """Sixteen paths over none, one, the other or both, out and home: amplitude, delay and its rate.

    The image in both is one place, whichever mirror comes first; a path runs by one order only.
    """
    place, velocity = np.array(target), (3.0, -2.0, 1.0)
    point = Target("t", target, velocity, 10.0, "declared")
    found = {
        p.via: p for p in trace(world(*mirrors, targets=(point,)), RADAR, fidelity=TWICE).paths
    }
    found = {via: p for via, p in found.items() if "t" in via}
    first, second = (m.name for m in mirrors)
    both = {via[:2] for via in found if via[2:3] == ("t",)}
    assert len(both) == 1
    assert both <= {(first, second), (second, first)}
    legs = [(), (first,), (second,), *both]
    assert set(found) == {(*out, "t", *home[::-1]) for out in legs for home in legs}
    for out in legs:
        for home in legs:
            path = found[(*out, "t", *home[::-1])]
            (there, away, onto), (back, heard, off) = leg_by(place, out), leg_by(place, home)
            gains = RADAR.antenna.gain(np.array([away, heard]))
            expected = np.sqrt(10.0 * gains.prod()) * GAIN / 100 * WAVELENGTH_M
            expected *= field(away, out) @ field(heard, home) / ((4 * np.pi) ** 1.5 * there * back)
            assert path.amplitude == pytest.approx(expected, rel=1e-9, abs=1e-15)
            assert path.delay_s == pytest.approx((there + back) / speed_of_light, rel=1e-13)
            rate = np.array(velocity) @ (onto + off) / speed_of_light
            assert path.delay_rate == pytest.approx(rate, rel=1e-9)
            np.testing.assert_allclose([path.departure, path.arrival], [away, heard], atol=1e-12)


@pytest.mark.parametrize("mirrors", [(AHEAD, SIDE), (LEVEL, AHEAD)])
def test_the_radar_sees_itself_in_a_corner(mirrors: tuple[SceneObject, ...]) -> None:
    """As an endless dihedral: both orders together are one image, G lambda / (4 pi 2 R); the
    polarisation is that of a half turn. Sums over a few places: rounding does not decide.
    """
    names = {m.name for m in mirrors}
    for shift in np.linspace(0, 1, 5):
        place = np.array([shift, 0.3 * shift, 0.2 * shift])
        rig = Rig(Pose(tuple(place)), radar=Pose((0.0, 0.0, 0.0)))
        found = trace(world(*mirrors, rig=rig), RADAR, fidelity=OPTICS).paths
        twice = [p for p in found if set(p.via) == names]
        assert {p.via for p in twice} == {tuple(names), tuple(names)[::-1]}
        way = place.copy()
        for name in names:
            way = mirrored(way, name)
        way -= place
        length = np.linalg.norm(way)
        up = field(way / length, ()) @ field(way / length, tuple(names))
        gain = RADAR.antenna.gain((way / length)[None])[0] * GAIN / 100
        expected = gain * WAVELENGTH_M / (4 * np.pi * length) * up
        # Of a knife edge on the line the phase is 1e-12, and the factor 1e-6 off one half.
        assert sum(p.amplitude for p in twice) == pytest.approx(expected, rel=2e-6)
        for path in twice:
            assert path.delay_s == pytest.approx(length / speed_of_light, rel=1e-12)


def test_echoes_over_two_mirrors_are_those_of_a_world_mirrored_twice() -> None:
    """A ball, out and home over both: level and phase of the ball in its place behind both.

    Behind the corner both orders stand at one place; it is seen over one of them alone. Over both
    comes a twentieth of the ball's whole echo, of which the tolerance is a share.
    """
    knobs = TWICE.with_(radar_bounces=1, radar_tolerance=0.003)
    here = np.array([12.0, 3.0, 0.0])
    there = mirrored(mirrored(here, "ahead"), "side")
    scene = world(AHEAD, SIDE, ball("b", here))
    prepared = prepare_scene(
        scene, RADAR, assign_scattering_models(scene, WAVELENGTH_M, with_optics=True), 2
    )
    twice = [n for n in range(len(prepared.images)) if len(prepared.via(n)) == 2]
    assert {prepared.via(n) for n in twice} == {("side", "ahead")}
    rays = scattered(prepared, RADAR, knobs).contributions
    over = rays.take(np.isin(rays.source, twice) & np.isin(rays.receiver, twice))
    alone = world(ball("b", there))
    free = prepare_scene(
        alone, RADAR, assign_scattering_models(alone, WAVELENGTH_M, with_optics=True), 0
    )
    found, expected = (
        np.sum(r.amplitude * np.exp(-1j * K * 299792458.0 * r.delay_s))
        for r in (over, scattered(free, RADAR, knobs).contributions)
    )
    assert found == pytest.approx(expected, rel=0.02)


#: Hears to all sides ahead.
WIDE = RADAR.with_({"antenna.gain_dbi": 3.0103})
#: Walls on both sides, which face each other.
WALLS = {"left": 1.0, "right": -1.5}
CORRIDOR = tuple(
    quad(name, [[-4, y, -6], [14, y, -6], [14, y, 6], [-4, y, 6]]) for name, y in WALLS.items()
)


def corridor_sum(center: np.ndarray, tilt_deg: float, half_m: float, most: int) -> complex:
    """Kirchhoff's integral of an upright plate between the walls, over all pairs of ways by up to
    so many reflections, times 4 pi: summed over points at a fifteenth of a wavelength.
    """
    tilt = np.radians(tilt_deg)
    across, normal = (
        np.array([np.sin(tilt), np.cos(tilt), 0]),
        np.array([-np.cos(tilt), np.sin(tilt), 0]),
    )
    n = int(2 * half_m / WAVELENGTH_M * 15)
    u = (np.arange(n) + 0.5) / n * 2 * half_m - half_m
    points = center + u[:, None, None] * across + u[None, :, None] * np.array([0, 0, 1.0])
    ways = [np.zeros(3)]
    for first, second in (WALLS.values(), [*WALLS.values()][::-1]):
        image = np.zeros(3)
        for k in range(most):
            image = image * [1, -1, 1] + [0, 2 * (first, second)[k % 2], 0]
            ways.append(image)
    seen = []
    for number, image in enumerate(ways):
        way = points - image
        length = np.linalg.norm(way, axis=-1)
        departure = (center - image) / np.linalg.norm(center - image)
        reflections = (number - 1) % most + 1 if number else 0
        departure = departure * [1, (-1) ** reflections, 1]
        gain = WIDE.antenna.gain(departure[None])[0]
        field = (-1) ** reflections * np.sqrt(gain) * np.exp(-1j * K * length) / length
        seen.append((-(way @ normal) / length, field))
    step = (2 * half_m / n) ** 2
    return sum(
        step * np.sum(np.abs(a + b) / 2 * there * back * (a * b > 0))
        for a, there in seen
        for b, back in seen
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    "tilt_deg", [40.0, *(pytest.param(t, marks=pytest.mark.thorough) for t in (0.0, -25.0))]
)
def test_a_plate_between_facing_walls_glints_in_whichever_image(tilt_deg: float) -> None:
    """Of 40 deg nearly all of the echo comes by three reflections and more on a way, of which none
    was followed: it was off by 6 times the stated error, at 55 deg by 21 times.
    """
    center, half_m = np.array([5.0, 0.2, 0.0]), 0.1
    tilt = np.radians(tilt_deg)
    across = half_m * np.array([np.sin(tilt), np.cos(tilt), 0])
    up = np.array([0, 0, half_m])
    corners = [center + a * across + b * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    scene = world(*CORRIDOR, quad("plate", corners))
    found = radar_capture(scene, WIDE, seed=1, fidelity=Tolerance().knobs().with_(radar_edges=0))
    (body,) = (b for b in found.propagation.bodies if "plate" in b.objects)
    echoes = found.propagation.contributions
    mine = (echoes.object == found.propagation.objects.index("plate")) & (
        np.arange(len(echoes)) >= len(found.propagation.names)
    )
    phase = 2 * np.pi * (CARRIER_HZ * echoes.delay_s[mine] % 1)
    level = abs(np.sum(echoes.amplitude[mine] * np.exp(-1j * phase)))
    expected = GAIN / 100 * abs(corridor_sum(center, tilt_deg, half_m, 16)) / (4 * np.pi)
    assert abs(level - expected) < body.estimated_error * body.level_amplitude
    assert level == pytest.approx(expected, rel=0.1)


@pytest.mark.thorough
def test_a_closed_room_of_metal_states_what_further_reflections_add() -> None:
    """Seen past a ball into a corner of the room, where three reflections return: each order of
    images adds as much as the one before, for nothing is lost. What up to five on a way add to
    those that are followed was 3 times what was stated.
    """
    size = np.array([10.0, 10.0, 5.0])
    walls = []
    for axis, low in product(range(3), (True, False)):
        first, second = (np.eye(3)[k] * size[k] for k in range(3) if k != axis)
        at = np.eye(3)[axis] * size[axis] * (not low) - size / 2
        corners = [at, at + first, at + first + second, at + second]
        walls.append(quad(f"wall {axis} {low}", corners))
    rig = Rig(Pose((-3.1, -2.06, -0.95), yaw_deg=38.0))
    ahead = Rotation.from_euler("z", 38, degrees=True).apply([1.83, -0.27, 0.14])
    scene = world(*walls, ball("ball", rig.position_m + ahead, 0.012, level=2), rig=rig)
    found = trace(scene, RADAR, fidelity=Tolerance().knobs())
    by_hand = Fidelity(radar_images=5, radar_tolerance=0.1, radar_shadowed=0)
    further = trace(scene, RADAR, fidelity=by_hand)
    (body,), band = found.bodies, band_of(RADAR.ofdm)
    one, other = (echoes_by_body(f, (("ball",),), RADAR, band) for f in (found, further))
    off = np.sqrt(np.mean(np.abs(one - other) ** 2))
    assert 0.5 * body.level_amplitude < off < body.estimated_error * body.level_amplitude


@pytest.mark.parametrize(("has_ceiling", "is_room"), [(False, False), (True, True)])
def test_orders_grow_by_places_not_by_ways_to_them(has_ceiling: bool, is_room: bool) -> None:
    """Walls at right angles give one place by several orders of reflections: between two walls over
    a floor each further order has as many places as the one before, between four walls more.
    """
    ceiling = quad("ceiling", [[-4, -6, 1.2], [14, -6, 1.2], [14, 6, 1.2], [-4, 6, 1.2]])
    thing = ball("ball", (5.0, 0.2, 0), level=1)
    scene = world(*CORRIDOR, LEVEL, *[ceiling] * has_ceiling, thing)
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    _, further = prepare_scene(scene, WIDE, roles, 4, many=40).up_to(3)
    assert further.objects.max() == (pytest.approx(1.5) if is_room else 1.0)


@pytest.mark.thorough
def test_declared_points_tell_that_more_reflections_lead_to_them() -> None:
    """Between four walls, of whose images of five reflections there are too many."""
    ceiling = quad("ceiling", [[-4, -6, 1.2], [14, -6, 1.2], [14, 6, 1.2], [-4, 6, 1.2]])
    point = Target("t", (5.0, 0.2, 0.0), (0, 0, 0), 0.1, "declared")
    scene = world(*CORRIDOR, LEVEL, ceiling, targets=(point,))
    told = trace(scene, WIDE, fidelity=Tolerance().knobs()).warnings
    assert any("t: reflections at large surfaces beyond 4 are not followed" in w for w in told)
    alone = world(CORRIDOR[0], LEVEL, targets=(point,))
    assert not trace(alone, WIDE, fidelity=Tolerance().knobs()).warnings


def test_where_images_are_cut_short_more_may_lead_to_all() -> None:
    """Of more than two images none of two reflections are looked for."""
    point = Target("t", (5.0, 0.2, 0.0), (0, 0, 0), 0.1, "declared")
    scene = world(*CORRIDOR, ball("b", (5.0, -0.5, 0), level=1), targets=(point,))
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    for many, is_cut in ((2, True), (32, False)):
        prepared = prepare_scene(scene, WIDE, roles, 2, many=many)
        assert prepared.has_more_images == is_cut
        _, further = prepared.up_to(2)
        assert further.points.tolist() == [is_cut]
        assert further.objects.all() == is_cut
