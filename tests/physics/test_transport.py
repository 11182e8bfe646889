"""Light transport against closed forms, against Mitsuba's own projector, and at the extremes."""

import math
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from scipy import stats

from hardware import PatternSet
from tests.extremes import oracle
from twin.camera.mounting import light_problem
from twin.geometry import Geometry
from twin.optics.devices import Device, disc_error
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.radiometry import collection, mean_cos_power, wall_power_w
from twin.optics.ray_sets import RowRays
from twin.optics.reference import PatternRenderer
from twin.optics.transport import sunlight, transport
from twin.optics.weather import Air
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import load_system

TAN = math.tan(math.radians(10))
AHEAD = np.eye(3)


def wall_scene(distance_m: float, half_size_m: float = 50.0, origin=(0.0, 0.0, 0.0)) -> Scene:
    """A white wall facing the rig; everything moved by ``origin``."""
    h = half_size_m
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]], dtype=np.float64)
    wall = SceneObject(
        name="wall",
        geometry=Geometry(
            corners + [distance_m, 0, 0] + np.asarray(origin), [[0, 2, 1], [0, 3, 2]]
        ),
        material="white",
        reflectance=0.5,
    )
    rig = Rig(Pose((origin[0], origin[1], origin[2])))
    return Scene("wall", None, "", (wall,), rig, Sun(180.0, 30.0, 1e5))  # type: ignore[arg-type]


def on_wall(distance_m: float, baseline_m: float, quality: TracingQuality, **scene) -> np.ndarray:
    world = mitsuba_scene(wall_scene(distance_m, **scene))
    emitter = Device(np.zeros(3), AHEAD, TAN)
    detector = Device(np.array([0, baseline_m, 0]), AHEAD, TAN)
    problem = LightProblem(world, emitter, detector)
    return transport(problem, (32, 32), quality=quality, seed=1).total


@pytest.mark.parametrize("distance_m", [2.0, 5.0, 10.0])
def test_watts_from_a_wall_are_the_closed_form(distance_m: float) -> None:
    """Within 0.3 %: rho I tau A / ((4 N^2 + 1) z^2) x <cos^7> = 0.93191 over the square field."""
    system = load_system("paper")
    lens = collection(system)
    cells = on_wall(distance_m, 0.0, TracingQuality(16, 1))
    intensity = system.emitter.radiant_intensity_w_per_sr.value
    watts = intensity * lens.transmission * lens.pupil_area_m2 * cells.sum()
    assert watts == pytest.approx(wall_power_w(system, 0.5, distance_m), rel=3e-3)
    bare = intensity * 0.5 * 0.9 * system.detector.area_m2 / 5 / distance_m**2
    assert watts / bare == pytest.approx(0.93191, rel=3e-3)


@pytest.mark.parametrize("distance_m", [1.0, 2.0, 10.0])
def test_a_baseline_loses_the_field_that_geometry_says(distance_m: float) -> None:
    """10 cm to the left; the lost strip is on the right of the emitter's image."""
    system = load_system("paper")
    cells = on_wall(distance_m, 0.1, TracingQuality(64, 1))
    expected = wall_power_w(system, 0.5, distance_m, 0.1) / wall_power_w(system, 0.5, distance_m)
    assert cells.sum() / on_wall(distance_m, 0.0, TracingQuality(64, 1)).sum() == pytest.approx(
        expected, rel=3e-3
    )
    lost = 0.1 / (2 * distance_m * TAN) * 32
    assert (cells[:, : 32 - math.ceil(lost)] > 0).all()
    assert not cells[:, 32 - math.floor(lost) :].any()


_total, _stated = attrgetter("total"), attrgetter("standard_error")


def test_stated_errors_hold_where_few_paths_miss_what_is_bright() -> None:
    """The yard at 8 x 8 cells, 64 paths: every cell of 40 seeds within 25 stated errors of the mean
    of 200, at most 0.3 % beyond 5; what is stated is at most 1.5 times the true error, in the mean
    square over cells, and small in the median of the image.

    From a cell's own paths alone 2.2 % were beyond 5, up to 80: cells whose paths all miss an edge,
    or the bright bounces beside it. Seeds are fixed, so nothing alarms by chance.
    """
    system = load_system("workable")
    problem = light_problem(load_scene("yard"), system)
    lights = [
        transport(problem, (8, 8), quality=TracingQuality(64, 4), seed=seed) for seed in range(200)
    ]
    total, stated = (np.array([pick(g) for g in lights]) for pick in (_total, _stated))
    off = np.abs(total - total.mean(axis=0))[:40]
    assert (stated > 0).all()
    beyond = off / stated[:40]
    assert beyond.max() < 25
    assert np.mean(beyond > 5) < 3e-3
    assert np.sqrt((stated**2).mean() / total.var(axis=0, ddof=1).mean()) < 1.5
    assert np.median(stated) < 0.075 * total.mean()


@pytest.mark.parametrize("radii", [1e-3, 0.3, 1.0, 5.0, 30.0])
def test_no_more_light_than_is_sent_reaches_a_pupil_near_a_wall(radii: float) -> None:
    """A wall facing the pupil at this many of its radii: within the stated error of quadrature over
    field and pupil, from either start, and no more than is reflected. As a point the pupil takes
    (R / d)^2 too much, a million times at a thousandth of its radius.
    """
    radius_m = 4e-3
    world = mitsuba_scene(wall_scene(radii * radius_m, half_size_m=1.0))
    pupil = Device(np.zeros(3), AHEAD, TAN, disc_radius_m=radius_m)
    problem = LightProblem(world, Device(np.zeros(3), AHEAD, TAN), pupil)
    quality, shape = TracingQuality(64, 1), (8, 8)
    light = transport(problem, shape, quality=quality, seed=1).total.sum()
    dual, scatter = (
        transport_matrix(problem, shape, shape, quality=quality, seed=1, start=start)[0].sum()
        for start in ("dual", "scatter")
    )
    assert dual == pytest.approx(light, rel=1e-3)
    assert scatter == pytest.approx(light, rel=1e-3)
    sent = 4 * TAN**2 * mean_cos_power(3, TAN, "square")
    assert light * math.pi * radius_m**2 < 0.5 * sent
    expected = 0.5 * float(oracle.facing_light(radii * radius_m, 20.0, radius_m))
    cos2 = mean_cos_power(2, TAN, "square")
    bound = disc_error(radius_m, np.array(radii * radius_m / cos2**0.5), np.array(cos2))
    assert abs(light / expected - 1) < max(float(bound), 1e-3)


@pytest.mark.parametrize(("distance_m", "aside_m"), [(2e-3, 1e-3), (4e-3, 0.0), (0.1, 0.02)])
def test_the_form_factor_of_a_disc_is_that_of_quadrature(distance_m: float, aside_m: float) -> None:
    """What the oracle of near walls rests on, and 1 / (d^2 + R^2) on the axis."""
    big = 4e-3**2
    d = distance_m**2 + aside_m**2
    exact = (1 - (d - big) / math.sqrt((d + big) ** 2 - 4 * big * aside_m**2)) / 2
    assert oracle.disc_form_factor(distance_m, aside_m, 4e-3) == pytest.approx(exact, rel=1e-6)
    if not aside_m:
        assert exact == pytest.approx(big / (d + big))


@pytest.mark.parametrize(
    ("distance_m", "half_size_m"), [(0.01, 1.0), (1.0, 50.0), (150.0, 1e4), (1e4, 1e5)]
)
def test_inverse_square_holds_from_a_centimetre_to_ten_kilometres(distance_m, half_size_m) -> None:
    near = on_wall(1.0, 0.0, TracingQuality(16, 1)).sum()
    here = on_wall(distance_m, 0.0, TracingQuality(16, 1), half_size_m=half_size_m).sum()
    assert here * distance_m**2 == pytest.approx(near, rel=4e-3)


def test_a_scene_in_map_coordinates_gives_the_same_light() -> None:
    """1e6 m from the origin float32 has 6 cm steps; recentring in float64 keeps the geometry."""
    here = on_wall(5.0371, 0.1, TracingQuality(16, 1))
    there = on_wall(5.0371, 0.1, TracingQuality(16, 1), origin=(1e6 + 0.3, -2e6 + 0.7, 300.1))
    np.testing.assert_allclose(there, here, rtol=1e-4, atol=1e-9)


def test_nothing_in_the_field_is_dark() -> None:
    world = mitsuba_scene(wall_scene(5.0))
    backwards = Device(np.zeros(3), np.diag([-1.0, -1.0, 1.0]), TAN)
    problem = LightProblem(world, backwards, backwards)
    cells = transport(problem, (8, 8), quality=TracingQuality(4, 2), seed=1)
    assert not cells.total.any()


def test_a_disc_shaped_field_sees_its_share_of_the_square() -> None:
    """Area pi/4 of the square, weighted by cos^7: closed form over the disc."""
    world = mitsuba_scene(wall_scene(5.0))
    camera = Device(np.zeros(3), AHEAD, TAN)
    disc = replace(camera, outline="disc")
    seen, whole = (
        transport(
            LightProblem(world, camera, detector), (64, 64), quality=TracingQuality(64, 1), seed=1
        ).total.sum()
        for detector in (disc, camera)
    )
    expected = math.pi / 4 * mean_cos_power(7, TAN, "disc") / mean_cos_power(7, TAN, "square")
    assert seen / whole == pytest.approx(expected, rel=3e-3)


def test_sun_on_a_wall_is_the_closed_form() -> None:
    """E rho / pi cos(sun) seen through a flat pupil: <cos^4> of the field times its area."""
    scene = wall_scene(5.0)
    world = mitsuba_scene(scene)
    camera = Device(np.zeros(3), AHEAD, TAN)
    problem = LightProblem(world, camera, camera, scene.sun.direction)
    seen = sunlight(problem, quality=TracingQuality(16, 2), seed=1).total.sum()
    facing = math.cos(math.radians(30))
    expected = 0.5 / math.pi * facing * mean_cos_power(4, TAN, "square") * 4 * TAN**2
    assert seen == pytest.approx(expected, rel=1e-3)


def test_sun_casts_shadows_and_does_not_shine_through() -> None:
    """Sun behind the wall: the two-sided wall is lit on its other side only."""
    world = mitsuba_scene(wall_scene(5.0))
    camera = Device(np.zeros(3), AHEAD, TAN)
    behind = np.array([1.0, 0.0, 0.0])
    problem = LightProblem(world, camera, camera, behind)
    assert not sunlight(problem, quality=TracingQuality(4, 2), seed=1).total.any()
    with pytest.raises(ValueError, match="sun_direction"):
        sunlight(replace(problem, sun_direction=None), quality=TracingQuality(4, 2), seed=1)


def test_interreflection_in_a_corner_grows_with_depth_and_reflectance() -> None:
    """In a closed white sphere of reflectance r, bounces add r^k: a furnace with a known sum.

    Emitter and detector at the centre of a sphere of radius R: the direct light is
    r / pi / R^2 per direction, and each further bounce adds (r)^k x (pupil's mean cosine / R^2 pi),
    the same for every cell.
    """
    import trimesh

    from twin.scene.mitsuba import _assemble

    ball = trimesh.creation.icosphere(6, radius=3.0)
    r = 0.5
    world = _assemble([(np.array(ball.vertices), np.array(ball.faces), None, r)])
    camera = Device(np.zeros(3), AHEAD, TAN)
    problem = LightProblem(world, camera, camera)
    light = transport(problem, (8, 8), quality=TracingQuality(1024, 8), seed=3)
    solid = 4 * math.asin(math.sin(math.radians(10)) ** 2)
    # A diffuse bounce inside a sphere lands uniformly on it: the share that lands where the
    # pupil's field sees it is the integral of cos over the field / (4 pi).
    seen = mean_cos_power(4, TAN, "square") * 4 * TAN**2 / (4 * math.pi)
    bounces = sum(r**k for k in range(2, 9))
    expected = solid * bounces / math.pi / 3.0**2 * seen
    error = np.sqrt((light.standard_error**2).sum())
    assert abs(light.indirect.sum() - expected) < 5 * error + 5e-3 * expected


def test_same_seed_same_bits() -> None:
    world = mitsuba_scene(load_scene("yard"))
    camera = Device(np.zeros(3), AHEAD, TAN)
    problem = LightProblem(world, camera, camera)
    a, b, other = (
        transport(problem, (16, 16), quality=TracingQuality(16, 3), seed=s).total for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(a, b)
    assert (a != other).any()


def test_blocks_of_rows_do_not_change_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large grids are traced in blocks; each has its own stream, so only noise may differ."""
    import twin.optics.tracer as module

    world = mitsuba_scene(load_scene("yard"))
    camera = Device(np.zeros(3), AHEAD, TAN)
    problem = LightProblem(world, camera, camera)
    whole = transport(problem, (16, 16), quality=TracingQuality(64, 2), seed=1)
    monkeypatch.setattr(module, "RAYS_AT_ONCE", 16 * 64 * 3)
    parts = transport(problem, (16, 16), quality=TracingQuality(64, 2), seed=1)
    z = (parts.total - whole.total) / np.maximum(
        np.hypot(parts.standard_error, whole.standard_error), 1e-12
    )
    assert np.abs(z).max() < 6
    assert parts.total.shape == (16, 16)


@pytest.mark.parametrize("kind", ["direct", "scattered", "indirect"])
def test_every_kind_of_light_is_that_of_its_rows(kind: str) -> None:
    """In fog, by row of the yard, whose upper rows see the sky: in blocks of four rows as at once.

    Bright corners leave bounced light noisy: the correlation over the rows is above 0.9, and is
    below 0.5 where every block traces the first rows.
    """
    camera = Device(np.zeros(3), AHEAD, TAN)
    problem = LightProblem(
        mitsuba_scene(load_scene("yard")), camera, camera, air=Air(0.08, 0.078, 0.85)
    )
    tracer = problem.from_emitter((16, 16), TracingQuality(256, 2, 256), 1)

    def rows(first: int, last: int) -> np.ndarray:
        light = getattr(tracer, kind)(RowRays(first, last, 256))
        return np.array(getattr(light, "value", light)).reshape(last - first, -1).mean(axis=1)

    whole, parts = rows(0, 16), np.concatenate([rows(i, i + 4) for i in range(0, 16, 4)])
    assert np.corrcoef(parts, whole)[0, 1] > 0.9


def test_quality_names_its_fault() -> None:
    with pytest.raises(ValueError, match="samples: 5"):
        TracingQuality(samples=5)
    with pytest.raises(ValueError, match="max_depth: 0"):
        TracingQuality(max_depth=0)


@pytest.mark.whole
def test_ten_patterns_agree_with_mitsubas_projector() -> None:
    """Sums of lit cells against ten renders with Mitsuba's `projector` and `path`: a z-test each.

    Rationale: another renderer's emitter, camera and integrator, in the forward direction.
    Expected: below the bound of Student's t for a false-alarm rate of 1e-4 over all ten, with a
    0.15 % allowance for the projector's texture (cos^3 in steps of a quarter cell). The same
    comparison with the transport mirrored or turned over must fail.
    """
    scene = load_scene("yard")
    size, renders = 16, 12
    emitter = Device(*scene.rig.device("emitter"), TAN)
    detector = Device(*scene.rig.device("detector"), TAN)
    quality = TracingQuality(128**2, 4)  # quick: fewer renders then show a difference as small
    problem = LightProblem(mitsuba_scene(scene), emitter, detector)
    cells = transport(problem, (size, size), quality=quality, seed=11)
    reference = PatternRenderer(problem, max_depth=quality.max_depth)
    patterns = PatternSet(size, size, 10, "sequency", "plain").masks().astype(float)
    bound = stats.t.isf(1e-4 / 10 / 2, df=renders - 1)  # the error is estimated from renders
    worst = dict.fromkeys(("as it is", "mirrored", "turned over"), 0.0)
    for number, pattern in enumerate(patterns):
        got = [reference.render(pattern, samples=16, seed=100 * number + i) for i in range(renders)]
        known = np.sqrt((pattern * cells.standard_error**2).sum())
        error = math.hypot(np.std(got, ddof=1) / math.sqrt(renders), known)
        seen = {"as it is": pattern, "mirrored": pattern[:, ::-1], "turned over": pattern[::-1]}
        for name, lit in seen.items():
            expected = float((lit * cells.total).sum())
            off = abs(np.mean(got) - expected) - 1.5e-3 * expected
            worst[name] = max(worst[name], off / error)
    assert worst["as it is"] < bound, worst
    assert worst["mirrored"] > 10 * bound, worst
    assert worst["turned over"] > 10 * bound, worst
