"""Weather against published tables, closed forms, adaptive quadrature and Mitsuba's volpath."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import integrate, stats

from twin.camera import capture
from twin.camera.light import render
from twin.camera.mounting import field_points
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.geometry import Geometry
from twin.optics.backscatter import _along, _in_field, airlight, backscatter, cell_rays
from twin.optics.devices import Device
from twin.optics.problem import LightProblem
from twin.optics.radiometry import mean_cos_power
from twin.optics.reference import PatternRenderer
from twin.optics.weather import (
    Air,
    air_of,
    air_of_system,
    extinction_per_m,
    fog_extinction_per_m,
    kim_exponent,
    kruse_exponent,
    rain_extinction_per_m,
    snow_extinction_per_m,
)
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, Weather, load_part, load_system, part_names
from twin.system.environment import backward_phase, most_backward_share

TAN = math.tan(math.radians(10))
AHEAD = np.eye(3)
EMITTER = Device(np.zeros(3), AHEAD, TAN)
FOG = Air(0.02, 0.0198, 0.85, 0.0142)
DB_PER_KM = 1e4 / math.log(10)
WEATHERS = [name for name in part_names() if load_part(name).weather is not None]


def beside(*baseline_m: float, outline: str = "square") -> Device:
    return Device(np.array(baseline_m), AHEAD, TAN, outline)  # type: ignore[arg-type]


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


# Extinction.


@pytest.mark.parametrize(
    ("visibility_m", "kruse", "kim"),
    [(50, 272, 340), (200, 60, 85), (500, 21, 34), (1000, 9, 10), (2000, 4, 4)],
)
def test_fog_is_the_printed_table_at_1550_nm(visibility_m, kruse, kim) -> None:
    """Tables of Kim, McArthur and Korevaar (2001), dB/km, as printed: whole numbers."""
    for exponent, printed in ((kruse_exponent, kruse), (kim_exponent, kim)):
        found = fog_extinction_per_m(visibility_m, 1550e-9, exponent(visibility_m))
        assert round(float(found) * DB_PER_KM) == printed


def test_fog_in_the_visible_is_what_visibility_means() -> None:
    """2 % are left at 550 nm, in whatever model."""
    weather = load_part("haze").weather
    assert math.exp(-extinction_per_m(weather, 550e-9) * 4e3) == pytest.approx(0.02, rel=5e-3)


def test_rain_and_snow_are_the_recommendations_figures() -> None:
    """ITU-R P.1814 at 1550 nm, dB/km at 1 mm/h: 1.08 of rain, 3.94 of wet and 5.58 of dry snow."""
    assert float(rain_extinction_per_m(1.0)) * DB_PER_KM == pytest.approx(1.076)
    assert float(rain_extinction_per_m(25.0)) * DB_PER_KM == pytest.approx(9.3, abs=0.05)
    assert float(snow_extinction_per_m(1.0, 1550e-9, wet=True)) * DB_PER_KM == pytest.approx(
        3.944, abs=1e-3
    )
    assert float(snow_extinction_per_m(1.0, 1550e-9, wet=False)) * DB_PER_KM == pytest.approx(
        5.580, abs=1e-3
    )


def test_what_a_weather_names_adds_up() -> None:
    haze, rain = load_part("haze").weather, load_part("rain-10").weather
    both = haze.model_copy(update={"rain_mm_per_h": rain.rain_mm_per_h})
    parts = extinction_per_m(haze, 1550e-9) + extinction_per_m(rain, 1550e-9)
    assert extinction_per_m(both, 1550e-9) == pytest.approx(parts)


def test_smoke_stops_short_waves_more() -> None:
    """8.7 m^2/g at 633 nm (Mulholland and Croarkin 2000), as 1 / wavelength."""
    smoke = load_part("smoke").weather
    assert extinction_per_m(smoke, 633e-9) == pytest.approx(50e-6 * 8.7e3)
    assert extinction_per_m(smoke, 1266e-9) == pytest.approx(50e-6 * 8.7e3 / 2)


# Phase function.


@pytest.mark.parametrize("name", WEATHERS)
def test_bundled_air_scatters_what_its_numbers_say(name: str) -> None:
    """Phase function of integral 1 and the stated mean cosine; backscatter by the lidar ratio."""
    weather = load_part(name).weather
    air = air_of(weather, 1550e-9)
    whole, mean = (
        integrate.quad(lambda c, k=k: 2 * math.pi * c**k * float(air.phase(c)), -1, 1)[0]
        for k in (0, 1)
    )
    assert whole == pytest.approx(1, abs=1e-7)
    assert mean == pytest.approx(weather.asymmetry.value, abs=1e-7)
    ratio = air.extinction_per_m / air.backscatter_per_m_sr
    assert ratio == pytest.approx(weather.lidar_ratio_sr.value, rel=1e-9)


def test_without_a_lidar_ratio_it_is_henyey_greenstein() -> None:
    weather = Weather.model_validate(
        {"visibility_m": 200.0, "single_scattering_albedo": 1.0, "asymmetry": 0.5}
    )
    air = air_of(weather, 1550e-9)
    assert float(air.phase(-1.0)) == pytest.approx(0.5 / (4 * math.pi * 1.5**2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("visibility_m = -1.0", r"weather\.visibility_m\.value = -1\.0"),
        ("snow_mm_per_h = 1.0", "both snow_mm_per_h and snow_kind"),
        ("single_scattering_albedo = 1.5", r"weather\.single_scattering_albedo\.value = 1\.5"),
        ("visibility_model = 'mie'", r"weather\.visibility_model"),
    ],
)
def test_a_wrong_weather_names_its_field(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "paper"\n[weather]\npart = "fog-200m"\n{text}\n')
    with pytest.raises(InputError, match=expected):
        load_system(path)


def test_a_system_has_the_air_of_its_part(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "paper"\n[weather]\npart = "fog-200m"\n')
    assert air_of_system(load_system(path)) == air_of(load_part("fog-200m").weather, 1550e-9)
    assert air_of_system(load_system("paper")) is None


def test_an_impossible_lidar_ratio_says_what_is_possible() -> None:
    fog = load_part("fog-200m").weather
    for wrong in (0.1, 1e5):
        ratio = type(fog.lidar_ratio_sr)(value=wrong, source="test")
        with pytest.raises(InputError, match=r"lidar_ratio_sr = .*expected .* to "):
            fog.model_copy(update={"lidar_ratio_sr": ratio})
    for asymmetry in (-0.85, -0.8, 0.999):
        with pytest.raises(InputError, match=r"weather: lidar_ratio_sr = 18.8: expected"):
            load_system("workable").with_(
                {"weather.part": "fog-200m", "weather.asymmetry": asymmetry}
            )


@pytest.mark.parametrize("asymmetry", [-0.9, -0.5, 0.0, 0.85, 0.99])
def test_every_lidar_ratio_that_is_taken_has_a_phase_function(asymmetry: float) -> None:
    """Both ends of what the error says, and between: the air scatters back what the ratio says."""
    fog = load_part("fog-200m").weather
    low, high = (
        1 / backward_phase(asymmetry, share) / fog.single_scattering_albedo.value
        for share in (most_backward_share(asymmetry), 0.0)
    )
    low, high = min(low, high), max(low, high)
    for ratio in (1.01 * low, (low * high) ** 0.5, high * (1 - 1e-9)):
        given = {"asymmetry": asymmetry, "lidar_ratio_sr": ratio}
        air = air_of(fog.model_copy(update=given), 1550e-9)
        assert air.extinction_per_m / air.backscatter_per_m_sr == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("values", [(1.0, 2.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_air_refuses_what_no_air_has(values) -> None:
    with pytest.raises(ValueError, match=r"scattering_per_m|asymmetry"):
        Air(*values)


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


# Against Mitsuba.


def test_wall_in_fog_agrees_with_volpath_at_single_scattering() -> None:
    """Beer-Lambert and single backscatter against Mitsuba's `volpath` cut at one scattering.

    Rationale: another integrator and phase function sampling, light followed the other way.
    Expected: Student's t for a false-alarm rate of 1e-4 over six comparisons, with a 0.05 %
    allowance for the projector's texture. Fails (checked below) without backscatter, and with the
    pattern mirrored.
    """
    distance, size, renders = 10.0, 16, 16
    bound = stats.t.isf(1e-4 / 6 / 2, df=renders - 1)
    detector = beside(0, 0.3, 0)
    left = np.zeros((size, size))
    left[:, : size // 2] = 1
    top = left.T
    for air in (FOG, Air(0.1, 0.09, 0.0)):
        light, from_air = wall_and_backscatter(detector, size, distance, air)
        reference = PatternRenderer(before_wall(detector, distance, air), max_depth=1)
        for pattern in (np.ones_like(left), left, top):
            got = [reference.render(pattern, samples=64, seed=i) for i in range(renders)]
            error = np.std(got, ddof=1) / math.sqrt(renders)

            def off(expected: float, got=got, error=error) -> float:
                return (abs(np.mean(got) - expected) - 5e-4 * expected) / error

            expected = float((pattern * (light + from_air)).sum())
            assert off(expected) < bound
            assert off(float((pattern * light).sum())) > 10 * bound
            if pattern is left:
                assert off(float((pattern[:, ::-1] * (light + from_air)).sum())) > 10 * bound


@pytest.mark.slow
def test_dense_air_agrees_with_volpath_to_a_third_of_a_percent() -> None:
    """Extinction 1 per m: only backscatter is left. Student's t, false-alarm rate 1e-4.

    Fails where the camera's rays begin at Mitsuba's default of 1 cm: 1 % too bright.
    """
    air, detector, renders = Air(1.0, 0.9, 0.0), beside(0, 0.3, 0), 16
    light, from_air = wall_and_backscatter(detector, 16, 10.0, air)
    reference = PatternRenderer(before_wall(detector, 10.0, air), max_depth=1)
    lit = np.ones((16, 16))
    got = [reference.render(lit, samples=2048, seed=i) for i in range(renders)]
    bound = stats.t.isf(1e-4 / 2, df=renders - 1) * np.std(got, ddof=1) / math.sqrt(renders)
    expected = float((light + from_air).sum())
    assert bound < 4e-3 * expected
    assert abs(np.mean(got) - expected) < bound + 5e-4 * expected


def wall(distance_m: float) -> Scene:
    h = 50.0
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]]) + [distance_m, 0, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    flat = SceneObject("wall", Geometry(corners, faces), "white", 0.5)
    return Scene("wall", Path(), "", (flat,), Rig(Pose((0.0, 0.0, 0.0))), Sun(180.0, 30.0, 1e5))


def before_wall(detector: Device, distance_m: float, air: Air) -> LightProblem:
    return LightProblem(mitsuba_scene(wall(distance_m)), EMITTER, detector, air=air)


def wall_and_backscatter(
    detector: Device, size: int, distance_m: float, air: Air
) -> tuple[np.ndarray, np.ndarray]:
    """Closed form of the wall's light with Beer-Lambert, 8 x 8 rays a cell; and backscatter."""
    directions, cosine = cell_rays(EMITTER, (size, size), 8)
    s = distance_m / cosine
    point = s[..., None] * directions - detector.origin_m
    r = np.linalg.norm(point, axis=-1)
    seen = (abs(point[..., 1:]) <= TAN * point[..., :1]).all(axis=-1)
    value = 0.5 / math.pi * (point[..., 0] / r) ** 2 / r**2 * seen * air.transmission(s + r)
    area = (2 * TAN) ** 2 / size**2
    light = area * (value * cosine**3).mean(axis=(2, 3))
    from_air = scattered_back(detector, (size, size), s.mean(axis=(2, 3)), air)
    return light, from_air


@pytest.fixture
def foggy(tmp_path: Path):
    """`workable` on 16 x 16 cells in a weather, by TOML text of the section and others."""

    def build(section: str, more: str = "") -> System:
        (tmp_path / "s.toml").write_text(
            'base = "workable"\n[emitter]\nrows = 16\ncolumns = 16\n'
            "[acquisition]\nn_patterns = 256\n"
            f"{more}\n{section}"
        )
        return load_system(tmp_path / "s.toml")

    return build


FOG_200_M = '[weather]\npart = "fog-200m"\n'


def test_fog_dims_the_scene_and_lifts_its_darkest_cells(foggy) -> None:
    """Through the camera: the yard is wide against the fog's lobe, so most cells lose what delta
    scaling takes, and gain backscatter; cells that see the sky get a little of their neighbours'
    light besides. Light scattered into ground and objects on its way is lost: 0.6 % of the median
    on the way out, 0.4 % more on the way back, where shadows were once those of the straight line.
    """
    scene = load_scene("yard")
    fidelity = Fidelity(1024, 1)
    seed = np.random.SeedSequence(3)
    clear = render(scene, foggy(""), fidelity=fidelity, seed=seed)
    system = foggy(FOG_200_M)
    foggy_light = render(scene, system, fidelity=fidelity, seed=np.random.SeedSequence(3))
    air = air_of_system(system)
    assert air is not None
    assert foggy_light.backscatter is not None
    from_air = foggy_light.backscatter.light
    # Way there and back through the middle of the cell: on smooth ground and walls.
    depth = clear.truth.depth_m.ravel()
    left, up = field_points((16, 16), clear.emitter.tan_half_field)
    way = 2 * depth * np.sqrt(1 + left**2 + up**2).ravel()
    expected = clear.light.cells[0] * np.exp(-air.surface_extinction_per_m * way) + from_air[0]
    seen = np.isfinite(depth) & (clear.light.cells[0] > 0)
    ratio = foggy_light.light.cells[0][seen] / expected[seen]
    assert np.median(ratio) == pytest.approx(0.99, abs=0.01)
    sky = foggy_light.light.cells[0][~seen] / from_air[0][~seen]
    assert (sky > 1).all()
    assert sky.max() < 1.1
    assert (from_air > 0).all()
    assert foggy_light.sun.sum() > 0


def test_columns_of_a_line_sensor_share_backscatter(foggy) -> None:
    """Strips side by side make the whole field; each sees its own part of the air."""
    air = Air(0.02, 0.019, 0.8)
    here = Device(np.zeros(3), np.eye(3), TAN)
    beside_it = Device(np.array([0, -0.05, 0]), np.eye(3), TAN)
    problem = LightProblem(None, here, beside_it, air=air)
    whole = backscatter(problem, (4, 1), 20.0).light
    edges = np.linspace(-1, 1, 9)
    parts = [
        backscatter(problem, (4, 1), 20.0, strip=(a, b), rays=32).light
        for a, b in itertools.pairwise(edges)
    ]
    fine = backscatter(problem, (4, 1), 20.0, rays=32).light
    np.testing.assert_allclose(sum(parts), fine, rtol=1e-9)
    assert whole.sum() == pytest.approx(fine.sum(), rel=0.2)
    # The detector stands to the right: light close by crosses its field from the left edge on.
    assert parts[0].sum() > parts[-1].sum()


def test_time_of_flight_sees_backscatter_before_the_wall(foggy) -> None:
    """In fog the paths' light is the plain light, and the phase says too near."""
    tof = "[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 1.0\n"
    scene = load_scene("yard")
    rendered = {
        name: render(
            scene, foggy(text, tof), fidelity=Fidelity(256, 1), seed=np.random.SeedSequence(1)
        )
        for name, text in (("clear", ""), ("fog", FOG_200_M))
    }
    fog, clear = rendered["fog"], rendered["clear"]
    assert fog.paths is not None
    assert clear.paths is not None
    plain, kept = fog.light.cells.sum(), fog.paths.light().sum()
    assert kept == pytest.approx(plain, rel=0.02)
    phase = {k: -np.angle(r.paths.phasor(1e6)) for k, r in rendered.items() if r.paths}
    far = (clear.truth.depth_m > 8) & np.isfinite(clear.truth.depth_m) & (clear.paths.light() > 0)
    assert far.any()
    assert (phase["fog"][far] < phase["clear"][far]).all()
    capture(scene, foggy(FOG_200_M, tof), fidelity=Fidelity(4, 1))


def test_thick_air_is_said_to_be_beyond_the_model(foggy) -> None:
    scene, draft = load_scene("yard"), Fidelity(4, 1)
    thick = capture(scene, foggy('[weather]\npart = "smoke"\n'), fidelity=draft)
    thin = capture(scene, foggy('[weather]\npart = "haze"\n'), fidelity=draft)
    assert any("the real image has less contrast" in warning for warning in thick.warnings)
    assert not any("less contrast" in warning for warning in thin.warnings)
