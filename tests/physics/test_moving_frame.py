"""A frame in which things move: every exposure against closed forms, and against stock renders of
the scene as it stands at its own time.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from hardware.reconstruction import reconstruct
from tests.physics.moving_worlds import (
    EXACT,
    FINE,
    SIDE,
    anew,
    exposed,
    going,
    passed,
    plate,
    small,
    world,
)
from tests.physics.radar_worlds import ball
from twin.camera import capture
from twin.camera.assumptions import MOVING_ASSUMPTION, STILL_ASSUMPTION
from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.camera.intervals import ScoreIntervals, score_intervals
from twin.camera.motion import WorldInMotion
from twin.camera.mounting import light_problem
from twin.engine import mitsuba
from twin.fidelity import DEFAULT, Fidelity
from twin.files import InputError
from twin.motion import Product, Still, Straight, Turning
from twin.motion.trajectory import through
from twin.optics.paths import TracingQuality
from twin.optics.ray_sets import RowRays
from twin.optics.transport import path_moments
from twin.scene import Pose, Rig, Scene, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def system() -> System:
    """16 x 16 cells, 512 exposures in 51.2 ms."""
    return small()


def off(
    scene: Scene,
    system: System,
    which: NDArray[np.int64],
    fidelity: Fidelity = FINE,
    reference: Fidelity = EXACT,
) -> Array:
    """Errors of exposures' signals, over an exposure's noise, (n, n_shutters, n_detectors)."""
    frame, noise = exposed(scene, system, fidelity)
    chain, n_shutters = Chain.of(system, scene.sun), frame.signal_w.shape[1]
    middles = Exposures.of(system).middles_s.reshape(-1, n_shutters)
    errors = []
    for row in which:
        for shutter in range(n_shutters):
            (power,) = anew(scene, system, middles[row, shutter : shutter + 1], reference)
            true = chain.mean_signal(power)[row, shutter]
            errors.append((frame.signal_w[row, shutter] - true) / noise)
    return np.array(errors).reshape(len(which), n_shutters, -1)


# -- closed form: an edge that moves across the image ---------------------------------------------


def covered(edge: Array, distance: float, system: System) -> Array:
    """Light of all cells, (n, n_cells), of a plate of reflectance 0.5 that faces the rig and lies
    to the left of an edge at each y (n,): the integral of rho cos^7 / (pi d^2) over the field.
    """
    half = np.tan(np.radians(system.emitter.field_of_view_deg.value / 2))
    borders = half * (1 - 2 * np.arange(SIDE + 1) / SIDE)
    points, weights = leggauss(12)
    ups = (borders[:-1] + borders[1:])[:, None] / 2 + half / SIDE * points
    right = np.maximum(borders[1:], np.asarray(edge)[:, None] / distance)
    wide = np.maximum(borders[:-1] - right, 0)
    lefts = right[..., None] + wide[..., None] / 2 * (1 + points)
    square = 1 + lefts[:, None, :, None, :] ** 2 + ups[None, :, None, :, None] ** 2
    value = 0.5 / np.pi / distance**2 * square**-3.5
    inner = np.einsum("nrcab,a,b->nrc", value, weights, weights)
    return (inner * (wide / 2)[:, None] * half / SIDE).reshape(len(edge), -1)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "speed",
    [
        20.0,  # 9 cells in the frame
        pytest.param(0.4, marks=pytest.mark.thorough),  # a fifth of a cell
        pytest.param(-20.0, marks=pytest.mark.thorough),
        # 2.2 cells within each exposure: it is blurred, and gone after 6 of them
        pytest.param(3000.0, marks=pytest.mark.thorough),
    ],
)
def test_an_edge_that_moves_across_the_image_is_the_closed_form(
    speed: float, system: System
) -> None:
    """A plate that moves sideways: each cell's light is known at any time, and its mean over each
    exposure by quadrature.
    """
    start, distance = (-0.3, 5.0) if speed > 0 else (0.4, 5.0)
    scene = world(going(plate("plate", (start, 60.0), (-9, 9), distance), 0.0, speed, 0.0))
    frame, noise = exposed(scene, system)
    exposures = Exposures.of(system)
    chain = Chain.of(system, scene.sun)
    watt = system.emitter.radiant_intensity_w_per_sr.value * chain.lens.transmission
    watt *= chain.lens.pupil_area_m2
    which = np.unique(np.r_[0:10, np.linspace(10, 511, 25).astype(int)])
    share = (np.arange(64) + 0.5) / 64
    times = exposures.starts_s[which, None] + share * exposures.integration_s
    cells = covered(start + speed * times.ravel(), distance, system).reshape(len(which), 64, -1)
    lit = np.array([system.patterns.masks(slice(k, k + 1))[0].ravel() for k in which])
    true = watt * np.einsum("nc,nc->n", lit, passed(system, chain) * cells.mean(axis=1))
    error = (frame.signal_w[which, 0, 0] - true) / noise
    assert np.sqrt(np.mean(error**2)) < 0.07
    assert np.abs(error).max() < 0.2
    assert speed > 1000 or not frame.warnings


# -- stock renders at each time -------------------------------------------------------------------


def many() -> Scene:
    """A wall, a turning plate and a ball that crosses, seen from a rig that drives and turns."""
    spin = Turning((0.2, 0.1, 1.0), (4.0, -0.5, 0.0), 12.0)
    pose = RigidTransform.identity()
    turning = plate("turning", (-0.9, -0.1), (-0.4, 0.4), 4.0).following(
        Product((spin, Still(pose)))
    )
    turning = replace(turning, reflectance=0.1)
    crossing = going(
        replace(ball("ball", (3.5, 0.6, 0.2), 0.15, level=2), reflectance=0.1), 0.0, -9.0, 0.0
    )
    wall = replace(plate("wall", (-9, 9), (-9, 9), 6.0), reflectance=0.05)
    way = through(
        [0.0, 0.03, 0.06],
        [[0, 0, 0], [0.1, 0.02, 0], [0.25, 0.0, 0.01]],
        Rotation.from_euler("z", [[0.0], [2.0], [3.0]], degrees=True),
    )
    rig = Rig(Pose((0.0, 0.0, 0.0))).following(way)
    return world(wall, turning, crossing, rig=rig)


def test_rays_of_many_instants_meet_what_stock_scenes_at_these_instants_have(
    system: System,
) -> None:
    scene, mi = many(), mitsuba()
    times = np.array([0.0, 0.013, 0.05])
    moving = WorldInMotion(scene, 0.06)
    assert moving.turns
    assert len(moving.bodies) == 3
    looked = moving.scene_at(times)
    rng = np.random.default_rng(1)
    along = rng.normal([1.0, 0.0, 0.0], [0, 0.2, 0.2], (3000, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    number = rng.integers(0, 3, len(along))
    ray = mi.Ray3f(mi.Point3f(0.1, 0.05, 0.0), mi.Vector3f(*along.T))
    ray.time = mi.Float(number.astype(np.float32))
    hit, blocked = looked.ray_intersect(ray), np.array(looked.ray_test(ray))
    distance, normal = np.array(hit.t), np.array(hit.n).T
    place, n_found = np.array(hit.p).T, 0
    for i, seconds in enumerate(times):
        later, mine = scene.after(seconds), number == i
        back = (scene.rig.pose.rotation * later.rig.pose.rotation.inv()).inv()
        stock = mitsuba_scene(later)
        there = mi.Ray3f(
            mi.Point3f(*back.apply([0.1, 0.05, 0.0]).tolist()),
            mi.Vector3f(*back.apply(along[mine]).T),
        )
        true = stock.ray_intersect(there)
        is_hit = np.array(true.is_valid())
        same = np.isclose(distance[mine], np.array(true.t), rtol=1e-4)
        assert np.mean(same | ~is_hit) > 0.998  # rays through edges
        assert np.mean(blocked[mine] == is_hit) > 0.998
        facing = np.abs(np.sum(back.apply(normal[mine]) * np.array(true.n).T, axis=1))
        assert facing[same & is_hit].min() > 1 - 1e-4
        apart = back.apply(place[mine]) - np.array(true.p).T
        assert np.abs(apart[same & is_hit]).max() < 1e-3
        n_found += int(is_hit.sum())
    assert n_found > 2500


@pytest.mark.thorough
def test_every_exposure_is_a_stock_render_at_its_own_time(system: System) -> None:
    error = off(many(), system, np.array([0, 77, 311, 511]))
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert np.abs(error).max() < 0.25


@pytest.mark.slow
def test_a_fast_rig_with_few_paths_says_what_they_err_by(system: System) -> None:
    """At 30 m/s with 16 paths of a cell: what paths and interpolation are said to err by, together,
    against stock renders of 10 exposures. A root mean square of 10 is within a factor of 2 of the
    true one but in a case of 1000; paths of neighbouring exposures are the same, hence 3.
    """
    rig = Rig(Pose((0.0, 0.0, 0.0))).following(Product((Straight((30.0, 0, 0)), Still(IDENTITY))))
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), plate("post", (-0.4, 0.1), (-0.5, 0.3)))
    scene = replace(scene, rig=rig)
    fidelity = Fidelity(16, 1, motion_tolerance=0.1)
    which = np.linspace(3, 508, 10).astype(int)
    error = off(scene, system, which, fidelity, Fidelity(128**2, 1))
    frame, _ = exposed(scene, system, fidelity)
    said = re.search(r"err by up to ([\d.e+]+)", frame.decision.effect)
    assert said is not None
    stated = np.hypot(float(said[1]), frame.decision.bound)
    assert stated / 3 < np.sqrt(np.mean(error**2)) < stated * 1.5


@pytest.mark.thorough
def test_the_suns_light_moves_too(system: System) -> None:
    """A plate's shadow passes over the wall, and the wall turns bright: differences of exposures
    between which that happens.
    """
    shade = going(plate("shade", (-3.0, 0.0), (-3, 3), 4.0), 0.0, 40.0, 0.0)
    wall = plate("wall", (-9, 9), (-9, 9), 6.0)
    shade = replace(shade, reflectance=0.05)
    scene = replace(world(wall, shade), sun=Sun(180.0, 20.0, 1e5))
    frame, _ = exposed(scene, system)
    times = Exposures.of(system).middles_s[[0, 255, 511]]
    true = np.array([power.sun_w[0] for power in anew(scene, system, times)])
    assert np.ptp(true) > 0.2 * true.max()
    np.testing.assert_allclose(frame.sun_w[[0, 255, 511], 0, 0], true, rtol=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["shadow", "cover"])
def test_what_the_middle_does_not_show_is_no_rest(system: System, kind: str) -> None:
    """A shadow of what the camera never sees, thrown by a sun behind it; and a black plate that
    fills the field in the middle of the frame alone: both change counts by their light, and the
    exposures at the start, in the middle and at the end are those of stock renders.
    """
    duration = Exposures.of(system).duration_s
    if kind == "shadow":
        passing = going(plate("p", (-2.0, -1.6), (0.97, 1.37), 3.0), 0.0, 3.0 / duration, 0.0)
    else:
        passing = going(plate("p", (-6.0, -2.0), (-2, 2), 3.0), 0.0, 8.0 / duration, 0.0)
    scene = world(plate("wall", (-9, 9), (-9, 9), 5.0), replace(passing, reflectance=0.0))
    scene = replace(scene, sun=Sun(180.0, 30.0, 1000.0))
    frame, noise = exposed(scene, system)
    assert frame.decision.taken
    assert frame.sun_w is not None
    assert frame.signal_w is not None
    rows = np.array([0, 256, 511])
    powers = anew(scene, system, Exposures.of(system).middles_s[rows])
    chain = Chain.of(system, scene.sun)
    true = np.array(
        [chain.mean_signal(p)[i, 0, 0] + p.sun_w[0] for i, p in zip(rows, powers, strict=True)]
    )
    got = (frame.signal_w + frame.sun_w)[rows, 0, 0]
    assert np.ptp(true) > 20 * noise
    assert np.abs(got - true).max() < 1.0 * noise


@pytest.mark.slow
def test_what_appears_for_a_part_of_the_frame_is_seen(system: System) -> None:
    """A ball that is in the field for 4 ms of 51."""
    passing = going(ball("ball", (3.0, 6.0, 0.0), 0.15, level=2), 0.0, -250.0, 0.0)
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), passing)
    frame, noise = exposed(scene, system)
    error = off(scene, system, np.array([100, 238, 400]))
    assert np.abs(error).max() < 0.3
    # Both exposures to a pattern and its complement have it.
    total = frame.signal_w[0::2, 0, 0] + frame.signal_w[1::2, 0, 0]
    seen = np.abs(total - total[0]) > 20 * noise
    assert set(np.flatnonzero(seen).tolist()) <= set(range(105, 136))
    assert seen[118:122].all()


@pytest.mark.slow
def test_what_passes_through_the_rig_leaves_finite_light(system: System) -> None:
    through_it = going(ball("ball", (2.0, 0.0, 0.0), 0.5, level=2), -100.0, 0.0, 0.0)
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), through_it)
    got = capture(scene, system, fidelity=Fidelity(light_tolerance=0.2, motion_tolerance=0.1))
    assert np.isfinite(got.signal_w).all()
    assert got.signal_w.min() >= 0
    before, inside = got.signal_w[:100].max(), got.signal_w[160:240].max()
    assert inside > 10 * before  # surfaces are two-sided: from inside it is bright and near


# -- rest, and next to it -------------------------------------------------------------------------


def test_at_rest_the_bits_are_those_of_a_still_frame(system: System) -> None:
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), plate("plate", (0.0, 1.0), (-1, 1)))
    for moving in (Fidelity(16, 1), DEFAULT):
        still = replace(moving, motion_tolerance=None)
        one, other = (capture(scene, system, seed=4, fidelity=knobs) for knobs in (still, moving))
        assert np.array_equal(one.record.counts, other.record.counts)
        assert STILL_ASSUMPTION in other.assumptions
        assert MOVING_ASSUMPTION not in other.assumptions


def test_next_to_no_motion_is_next_to_no_difference(system: System) -> None:
    """Of a cell of light 1e-9 m/s move 1e-11: the light of the middle is that of all exposures."""
    slow = going(plate("plate", (0.0, 1.0), (-1, 1)), 0.0, 1e-9, 0.0)
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), slow)
    frame, _ = exposed(scene, system)
    assert frame.signal_w is None
    assert not frame.decision.taken
    assert 0 < frame.decision.bound < 1e-6


@pytest.mark.whole
def test_a_capture_says_what_it_took_and_has_the_truth_of_the_middle(system: System) -> None:
    frozen = replace(DEFAULT, motion_tolerance=None)
    got = capture(many(), system, seed=2)
    middle = many().after(Exposures.of(system).duration_s / 2)
    still = capture(middle, system, seed=2, fidelity=frozen)
    assert np.array_equal(got.truth.depth_m, still.truth.depth_m)
    assert np.array_equal(got.record.pose.position_m, [0, 0, 0])
    assert MOVING_ASSUMPTION in got.assumptions
    assert STILL_ASSUMPTION not in got.assumptions
    (told,) = [d for d in got.decisions if "motion" in d.effect]
    assert told.taken
    assert 0 < told.bound <= told.permitted == 0.1
    again = capture(many(), system, seed=2)
    assert np.array_equal(got.record.counts, again.record.counts)
    without = capture(many(), system, seed=2, fidelity=frozen)
    assert STILL_ASSUMPTION in without.assumptions


def test_a_trajectory_that_ends_before_the_frame_does_is_an_error(system: System) -> None:
    way = through([0.0, 0.02], [[0, 0, 0], [0.1, 0, 0]], Rotation.identity(2))
    scene = world(plate("wall", (-9, 9), (-9, 9), 6.0), rig=Rig(Pose((0.0,) * 3)).following(way))
    with pytest.raises(InputError, match=r"0\.02"):
        capture(scene, system)


@pytest.mark.thorough
def test_scores_of_a_moving_frame_hold_what_its_paths_err_by(system: System) -> None:
    """Exposures have light of other paths than the truth: images do not follow the truth's errors.
    They were taken to, and four frames of coarse light differed from fine light by up to 13 times
    the model's part of their interval.
    """
    wall = plate("wall", (-9, 9), (-9, 9), 6.0)
    scene = world(wall, going(plate("plate", (-0.4, 0.1), (-0.3, 0.3)), 0.0, 0.3, 0.0))
    exact = system.with_({"readout.adc_bits": 24})  # other light has no other rounding

    def scores(share: float, seed: int) -> ScoreIntervals:
        knobs = replace(DEFAULT, light_tolerance=share, motion_tolerance=0.02)
        found = capture(scene, exact, seed=seed, fidelity=knobs)
        return score_intervals(found, reconstruct(found.record, "lmmse"))

    over = []
    for seed in range(4):
        coarse, fine = scores(1.0, seed), scores(0.1, seed)
        for name in ("psnr_db", "ssim"):
            one, other = getattr(coarse, name), getattr(fine, name)
            widths = one.of_model.half_width + other.of_model.half_width
            over.append(abs(one.value - other.value) / widths)
    assert max(over) < 1.5
    assert max(over) > 0.05


# -- light that does not change -------------------------------------------------------------------


def test_cells_away_from_what_moves_keep_their_light(system: System) -> None:
    """With the same paths, to the last bit; and those that change are among those said to."""
    moving = going(ball("ball", (3.0, 0.1, 0.1), 0.1, level=2), 0.0, -4.0, 1.0)
    scene = replace(
        world(plate("wall", (-9, 9), (-9, 9), 6.0), moving),
        rig=Rig(Pose((0.0, 0.0, 0.0)), detector=Pose((0.0, -0.3, 0.0))),
    )
    in_motion = WorldInMotion(scene, 0.02)
    whole = light_problem(scene, system, in_motion)
    times = np.linspace(0, 0.02, 3)
    said = in_motion.changes(times, whole.emitter, whole.detector, (SIDE, SIDE))
    assert 0.02 < said.mean() < 0.4
    looked = in_motion.scene_at(np.linspace(0, 0.02, 5))
    light = []
    for number in range(5):
        problem = replace(whole, scene=looked.at(number))
        tracer = problem.from_emitter((SIDE, SIDE), TracingQuality(256, 1), 5)
        light.append(path_moments(tracer.direct(RowRays(0, SIDE, 256)).value, 256, 16)[0])
    changes = [np.any([light[i + j] != light[i] for j in (1, 2)], axis=0) for i in (0, 2)]
    assert all(change.sum() > 4 for change in changes)
    assert not any((change & ~allowed).any() for change, allowed in zip(changes, said, strict=True))


def test_light_that_does_not_change_is_not_rendered_again(
    system: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twin.camera import light_by_cell

    drawn: list[int] = []
    follow = light_by_cell.light_over_time

    def spied(*args: object) -> object:
        found = follow(*args)  # type: ignore[arg-type]
        drawn.append(found.looks)
        return found

    monkeypatch.setattr(light_by_cell, "light_over_time", spied)
    moving = going(ball("ball", (3.0, 0.4, 0.1), 0.1, level=1), 0.0, -20.0, 0.0)
    wall = plate("wall", (-9, 9), (-9, 9), 6.0)
    fidelity = Fidelity(16, 1, motion_tolerance=0.1)
    exposed(world(wall, moving), system, fidelity)
    rig = Rig(Pose((0.0,) * 3)).following(Product((Straight((0, 20.0, 0)), Still(IDENTITY))))
    exposed(world(wall, moving, rig=rig), system, fidelity)
    ball_alone, rig_too = drawn[0], drawn[2]
    assert ball_alone < 0.5 * rig_too


def test_the_suns_light_has_no_more_paths_than_it_needs(
    system: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A weak sun: its first paths, 8 of a part, are far more than its shot noise asks for."""
    from twin.camera import light_by_cell

    drawn: list[float] = []
    follow = light_by_cell.light_over_time

    def spied(*args: object) -> object:
        found = follow(*args)  # type: ignore[arg-type]
        drawn.append(found.paths / found.looks)
        return found

    monkeypatch.setattr(light_by_cell, "light_over_time", spied)
    shade = going(plate("shade", (-3.0, 0.0), (-3, 3), 4.0), 0.0, 40.0, 0.0)
    scene = replace(world(plate("wall", (-9, 9), (-9, 9), 6.0), shade), sun=Sun(180.0, 20.0, 1e5))
    exposed(scene, system, DEFAULT)
    emitter, sun = drawn
    assert emitter >= 16
    assert sun == 8


IDENTITY = RigidTransform.identity()


# -- other systems --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind",
    [
        "line",
        pytest.param("time of flight", marks=pytest.mark.whole),
        pytest.param("fog", marks=pytest.mark.whole),
        pytest.param("scan", marks=pytest.mark.whole),
    ],
)
def test_other_systems_see_what_moves_too(
    kind: str, other_systems: Callable[[str], System]
) -> None:
    scene = world(
        plate("wall", (-9, 9), (-9, 9), 6.0),
        going(plate("plate", (-3.0, 0.0), (-9, 9), 4.0), 0.0, 5.0, 0.0),
        rig=Rig(Pose((0.0, 0.0, 0.0))),
    )
    made = other_systems(kind)
    fidelity = Fidelity(32**2, 1, motion_tolerance=0.5)
    last = made.patterns.n_exposures - 1
    error = off(scene, made, np.array([0, last // 2, last]), fidelity, Fidelity(64**2, 1))
    assert np.sqrt(np.mean(error**2)) < 1.0


@pytest.fixture
def other_systems(tmp_path: Path) -> Callable[[str], System]:
    from twin.system import load_system

    texts = {
        "line": 'base = "line-256x16"\n[detector]\npixels = 8\n[acquisition]\ncolumns = 8\n',
        "time of flight": 'base = "workable"\n[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\n'
        "n_patterns = 64\n[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 0.8\n",
        "fog": 'base = "workable"\n[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\n'
        "n_patterns = 64\n[weather]\nvisibility_m = 200.0\nsingle_scattering_albedo = 0.95\n"
        "asymmetry = 0.85\n",
    }

    texts["scan"] = (
        'base = "lidar-scan"\n[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\nn_patterns = 64\n'
    )

    def made(kind: str) -> System:
        (tmp_path / "s.toml").write_text(texts[kind])
        return load_system(tmp_path / "s.toml")

    return made


# -- exposures ------------------------------------------------------------------------------------


def test_means_over_exposures_are_integrals_of_what_is_linear_between_instants() -> None:
    rng = np.random.default_rng(2)
    exposures = Exposures(np.arange(20) * 1e-3 + 2e-4, 8e-4, 1e-3, 20)
    times = np.unique(np.concatenate([[0.0, 0.02], rng.uniform(0, 0.02, 60)]))
    values = rng.normal(size=len(times))
    fine = exposures.starts_s[:, None] + exposures.integration_s * (np.arange(20000) + 0.5) / 20000
    true = np.interp(fine, times, values).mean(axis=1)
    np.testing.assert_allclose(exposures.means(times) @ values, true, atol=1e-6)
    coarse = np.array([0.0, 0.02])
    np.testing.assert_allclose(exposures.means(coarse) @ coarse, exposures.middles_s, rtol=1e-12)


@pytest.mark.thorough
def test_what_the_suns_light_scatters_by_is_told_where_it_counts() -> None:
    """Between two exposures of a pair it is next to nothing."""
    told = {
        mode: " ".join(str(w) for w in capture(load_scene("yard"), system, seed=1).warnings)
        for mode in ("plain", "differential")
        for system in (load_system("workable").with_({"acquisition.mode": mode}),)
    }
    assert "the sun's light scatters" in told["plain"]
    assert "the sun's light scatters" not in told["differential"]
