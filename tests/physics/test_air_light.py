"""Light from the air itself against closed forms and adaptive quadrature: backscatter of the
emitter's own, and the sun's.
"""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy import integrate

from tests.physics.devices_in_fog import AHEAD, EMITTER, FOG, TAN, beside
from twin.engine import mitsuba
from twin.optics.backscatter import _along, _in_field, airlight, backscatter, cell_rays
from twin.optics.devices import Device
from twin.optics.lost_airlight import lost_airlight
from twin.optics.problem import LightProblem
from twin.optics.radiometry import mean_cos_power
from twin.optics.weather import Air

FOG_OF_WALKS = Air(0.05, 0.04, 0.85)


def scattered_back(
    detector: Device, shape: tuple[int, int], distance_m: Any, air: Air = FOG, **knobs: Any
) -> np.ndarray:
    """Of the emitter's light, whatever the scene."""
    return backscatter(
        LightProblem(None, EMITTER, detector, air=air), shape, distance_m, **knobs
    ).light


def sunlit(
    camera: Device, shape: tuple[int, int], distance_m: float, direction: np.ndarray, air: Air = FOG
) -> np.ndarray:
    return airlight(LightProblem(None, camera, camera, direction, air), shape, distance_m)


# Backscatter of the emitter's own light.


@pytest.mark.parametrize("outline", ["square", "disc"])
def test_rays_enter_and_leave_the_field_where_points_do(outline: str) -> None:
    """Against points tested one by one, devices turned and shifted at random: no exception."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        axes = np.linalg.qr(np.eye(3) + 0.5 * rng.normal(size=(3, 3)))[0]
        axes *= np.sign(np.diag(axes))[:, None]
        detector = Device(rng.normal(size=3), axes, rng.uniform(0.1, 1.5), outline)
        directions, _ = cell_rays(EMITTER, (3, 3), 2)
        low, high = _in_field(EMITTER.origin_m, directions, detector, (-1, 1))
        s = rng.uniform(0, 20, 200)
        points = s[:, None] * directions[..., None, :] - detector.origin_m
        ahead, left, up = np.moveaxis(points @ axes.T, -1, 0)
        t = detector.tan_half_field * ahead
        seen = np.maximum(abs(left), abs(up)) <= t
        if outline == "disc":
            seen = np.hypot(left, up) <= t
        np.testing.assert_array_equal(seen, (s >= low[..., None]) & (s <= high[..., None]))


def test_the_line_integral_is_the_closed_form_without_extinction() -> None:
    """Isotropic, extinction 1e-12: integral of (A + c q) / (q^2 + h^2)^1.5, elementary."""
    air = Air(1e-12, 1e-12, 0.0)
    offset = np.array([0.0, 0.1, 0.02])
    direction = np.array([1.0, 0.05, -0.1]) / math.sqrt(1 + 0.05**2 + 0.1**2)
    start, stop = 0.7, 40.0
    nearest = direction @ offset
    h2 = offset @ offset - nearest**2
    a, c = -offset[0] + nearest * direction[0], direction[0]

    def primitive(s: float) -> float:
        q = s - nearest
        return (a * q / h2 - c) / math.sqrt(q * q + h2)

    expected = 1e-12 / (4 * math.pi) * (primitive(stop) - primitive(start))
    found = _along(
        np.zeros(3), direction[None], beside(*offset), np.array([start]), np.array([stop]), air, 24
    )
    assert found[0].sum() == pytest.approx(expected, rel=1e-9, abs=0)


@pytest.mark.parametrize(("nodes", "error"), [(24, 1e-9), (16, 1e-6)])
def test_quadrature_keeps_its_promise(nodes: int, error: float) -> None:
    """Adaptive quadrature from SciPy, piecewise over decades, along rays of every kind."""
    rng = np.random.default_rng(5)
    directions, _ = cell_rays(EMITTER, (8, 8), 1)
    for baseline in ((0, 0.1, 0), (0, 0.02, 0.3), (0.05, -0.5, 0), (-1, 0.1, 0)):
        detector = beside(*baseline, outline=rng.choice(["square", "disc"]))
        low, high = _in_field(EMITTER.origin_m, directions, detector, (-1, 1))
        for distance, extinction, share in ((3.0, 0.3, 0.01), (30.0, 0.02, 0.0), (1e3, 0.3, 0.01)):
            air = Air(extinction, 0.9 * extinction, 0.85, share)
            stop = np.minimum(np.minimum(high, distance), low + 50 / extinction)
            ray = tuple(rng.choice(np.argwhere(stop > low)))
            way, begin, end = directions[ray], low[ray], stop[ray]

            def from_air(s: float, air=air, way=way, detector=detector) -> float:
                to = s * way - detector.origin_m
                r = float(np.linalg.norm(to))
                sent = air.scattering_per_m * float(air.phase(-way @ to / r))
                return sent * math.exp(-air.extinction_per_m * (s + r)) * to[0] / r**3

            edges = begin + np.geomspace(1e-3, 1 + end - begin, 30) - 1e-3
            edges = np.append(edges[edges < end], end)
            pieces = itertools.pairwise(edges)
            expected = sum(integrate.quad(from_air, *p, epsabs=0, epsrel=1e-12)[0] for p in pieces)
            one = (way[None], detector, np.array([begin]), np.array([end]))
            found = _along(EMITTER.origin_m, *one, air, nodes)[0][0].sum()
            assert found == pytest.approx(expected, rel=error), (baseline, distance)


def test_far_away_backscatter_is_the_lidar_equation() -> None:
    """A gate far from a small baseline: beta exp(-2 sigma R) dR / R^2 per solid angle."""
    near, far = (scattered_back(beside(0, 0.1, 0), (4, 4), d) for d in (50.0, 50.1))
    _, cosine = cell_rays(EMITTER, (4, 4), 8)
    area = (2 * TAN) ** 2 / 16
    solid = area * (cosine**4).mean(axis=(2, 3))
    two_way = math.exp(-2 * FOG.extinction_per_m * 50.05)
    expected = FOG.backscatter_per_m_sr * two_way * 0.1 / 50.05**2 * solid
    np.testing.assert_allclose(far - near, expected, rtol=2e-3)


def test_backscatter_is_seen_only_where_the_fields_overlap() -> None:
    """Detector 0.3 m to the left, surface at 0.5 m: cells on the right are not yet seen."""
    from_air = scattered_back(beside(0, 0.3, 0), (8, 8), 0.5)
    assert not from_air.any()
    from_air = scattered_back(beside(0, 0.3, 0), (8, 8), 1.2)
    assert (from_air[:, 0] > 0).all()
    assert not from_air[:, -1].any()
    mirrored = scattered_back(beside(0, -0.3, 0), (8, 8), 1.2)
    np.testing.assert_allclose(mirrored[:, ::-1], from_air, rtol=1e-9)
    below = scattered_back(beside(0, 0, 0.3), (8, 8), 1.2)
    np.testing.assert_allclose(below, from_air.T, rtol=1e-9)


def test_each_cell_has_its_own_distance() -> None:
    """One cell with a near surface; the others see to infinity, which is finite."""
    distance = np.full((4, 4), np.inf)
    distance[1, 2] = 2.0
    from_air = scattered_back(beside(0, 0.1, 0), (4, 4), distance)
    near = scattered_back(beside(0, 0.1, 0), (4, 4), 2.0)
    free = scattered_back(beside(0, 0.1, 0), (4, 4), 1e6)
    assert from_air[1, 2] == near[1, 2] < free[1, 2]
    from_air[1, 2] = free[1, 2]
    np.testing.assert_allclose(from_air, free, rtol=1e-9)


def test_air_that_does_not_scatter_sends_nothing_back() -> None:
    assert not scattered_back(beside(0, 0.1, 0), (4, 4), 9.0, Air(0.1, 0.0, 0.0)).any()
    assert not sunlit(EMITTER, (4, 4), 9.0, np.array([0, 0, 1.0]), Air(0.0, 0.0, 0.0)).any()


def test_two_pinholes_at_one_place_are_refused() -> None:
    with pytest.raises(ValueError, match="baseline"):
        scattered_back(beside(0, 0, 0), (4, 4), 9.0)


# The sun's.


@pytest.mark.parametrize("distance_m", [10.0, 1e3, np.inf])
def test_airlight_is_the_closed_form(distance_m: float) -> None:
    """Isotropic: albedo / (4 pi) (1 - exp(-sigma d)) over the field's <cos^4>."""
    air = Air(0.02, 0.01, 0.0)
    found = sunlit(EMITTER, (16, 16), distance_m, np.array([0.0, 0.0, 1.0]), air).sum()
    field = 4 * TAN**2 * mean_cos_power(4, TAN, "square")
    expected = 0.5 / (4 * math.pi) * -math.expm1(-0.02 * distance_m) * field
    assert found == pytest.approx(expected, rel=1e-3)


def test_airlight_is_brightest_towards_the_sun() -> None:
    """Sun low ahead against low behind: the phase function's ratio at those angles; and the cell
    nearest to the sun is the brightest.
    """
    ahead, behind = np.array([1.0, 0.0, 0.3]), np.array([-1.0, 0.0, 0.3])
    ahead, behind = ahead / np.linalg.norm(ahead), behind / np.linalg.norm(behind)
    narrow = Device(np.zeros(3), AHEAD, 1e-3)
    ratio = (sunlit(narrow, (1, 1), 50.0, ahead) / sunlit(narrow, (1, 1), 50.0, behind))[0, 0]
    assert ratio == pytest.approx(float(FOG.phase(ahead[0]) / FOG.phase(behind[0])), rel=1e-3)
    cells = sunlit(EMITTER, (4, 4), 50.0, ahead)
    assert cells[0].min() > cells[-1].max()


@pytest.mark.parametrize(
    ("azimuth_deg", "asymmetry", "extinction", "distance_m", "walked"),
    [
        (180.0, 0.85, 0.08, math.inf, 3.28e-3),
        (180.0, 0.85, 0.2, 10.0, 2.50e-3),
        (180.0, 0.5, 0.1, 10.0, 4.66e-3),
        (90.0, 0.5, 0.1, 10.0, 6.09e-3),
    ],
)
def test_sunlight_scattered_more_than_once_is_that_of_another_walk(
    azimuth_deg: float, asymmetry: float, extinction: float, distance_m: float, walked: float
) -> None:
    """Sun at 30 degrees, albedo 0.99, an open view or a wall at 10 m: another walk of 300 000
    paths, none of them forced, in a layer from 1.5 m below the sensor to the lesser of 10 m above
    it and 0.5 / extinction, has these (+- 2 %). Mean of four draws, which scatter by 2 to 12 %.
    """
    up, across = math.sin(math.radians(30)), math.cos(math.radians(30))
    turn = math.radians(azimuth_deg)
    sun = np.array([across * math.cos(turn), across * math.sin(turn), up])
    air = Air(extinction, 0.99 * extinction, asymmetry)
    problem = LightProblem(None, EMITTER, EMITTER, sun, air)
    draws = [
        lost_airlight(
            problem, (8, 8), np.full((8, 8), distance_m), rng=np.random.default_rng(seed)
        ).sum()
        for seed in range(4)
    ]
    assert np.mean(draws) == pytest.approx(walked, rel=0.2)


def test_a_sensor_high_above_the_ground_loses_more_sunlight() -> None:
    """20 m of air below it scatter as well, which 1.5 m do not: 2.8 times the light (asymmetry
    0.85, 0.08 per m, the sun behind the camera at 30 degrees), whose parts scatter by 2 to 12 %.
    """
    across, up = math.cos(math.radians(30)), math.sin(math.radians(30))
    sun, open_view = np.array([-across, 0.0, up]), np.full((8, 8), math.inf)
    lost = []
    for height_m in (1.5, 20.0, None):
        ground = square_below(height_m) if height_m else None
        problem = LightProblem(ground, EMITTER, EMITTER, sun, Air(0.08, 0.08, 0.85))
        draws = [
            lost_airlight(problem, (8, 8), open_view, rng=np.random.default_rng(seed)).sum()
            for seed in range(3)
        ]
        lost.append(np.mean(draws))
    assert lost[1] / lost[0] == pytest.approx(2.8, rel=0.2)
    assert lost[2] == pytest.approx(lost[0], rel=1e-6)


def square_below(height_m: float) -> Any:
    """A Mitsuba scene of one square."""
    mi = mitsuba()
    place = mi.ScalarTransform4f().translate([0, 0, -height_m])
    return mi.load_dict({"type": "scene", "ground": {"type": "rectangle", "to_world": place}})


def test_of_light_scattered_once_the_walk_finds_the_closed_form() -> None:
    """What walks have of all orders less that of two and more, before a wall at 5 m, so near that
    the layer's ends lie beside the field: 1 %, and what the sun's light gains and loses on its way
    between the heights of the field, which the closed form leaves out.
    """
    sun, far = np.array([-0.6, 0.0, 0.8]), np.full((8, 8), 5.0)
    problem = LightProblem(None, EMITTER, EMITTER, sun, FOG_OF_WALKS)
    every, many = (
        lost_airlight(problem, (8, 8), far, rng=np.random.default_rng(1), least_orders=n).sum()
        for n in (1, 2)
    )
    closed = sunlit(EMITTER, (8, 8), 5.0, sun, FOG_OF_WALKS).sum()
    assert every - many == pytest.approx(closed, rel=0.01)
