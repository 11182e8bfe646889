"""Laws that hold for whole systems whatever their numbers: scaling, superposition, monotonicity,
reciprocity.

Examples are drawn by hypothesis, the same in every run. Array shapes are the same throughout, so
that kernels are compiled once. Tests without a random part are exact to rounding; where paths are
drawn, both sides draw the same ones, or the bound is 5 standard errors (false alarms 6e-7 each).
"""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from twin.camera import Capture
from twin.camera.acquisition import measure
from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.devices import Device
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.radar import load_radar
from twin.radar.acquisition import channel as received
from twin.radar.propagation.free_space import straight_paths
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, Target
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

ONCE = Fidelity(samples=16, max_depth=1, noise="none")
# Those that render take the first failure as it comes: shrinking would render for minutes.
FEW = settings(
    derandomize=True,
    deadline=None,
    max_examples=12,
    phases=(Phase.explicit, Phase.generate),
)
MANY = settings(derandomize=True, deadline=None, max_examples=50)
# A few numbers apart from each other by design; logarithms spread them.
factors = st.floats(-1.0, 1.0).map(lambda x: 10.0**x)
distances_m = st.floats(0.0, 3.0).map(lambda x: 10.0**x)
reflectances = st.floats(0.01, 0.5)


def wall(name: str, distance_m: float, reflectance: float, shift: float = 0.0) -> SceneObject:
    """A facing square as wide as its distance, moved sideways by a share of that."""
    corners = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    placed = (corners + [0, shift, 0]) * distance_m
    return SceneObject(name, Geometry(placed, faces), "stuff", reflectance)


def world(*objects: SceneObject, sun_lx: float = 1e5, baseline_m: float = 0.0) -> Scene:
    rig = Rig(Pose((0.0, 0.0, 0.0)), detector=Pose((0.0, baseline_m, 0.0)))
    return Scene("laws", Path(), "", objects, rig, Sun(180.0, 30.0, sun_lx))


@lru_cache(maxsize=256)
def camera(**changes: float) -> System:
    """`workable` with 16 x 16 cells, the scene's sun, changed by ``section__field``."""
    content = load_system("workable").model_dump()
    content["sky"] = None
    cells = {"emitter__rows": 16, "emitter__columns": 16, "acquisition__n_patterns": 256}
    for name, value in {**cells, **changes}.items():
        section, field = name.split("__")
        content[section][field] = value
    return System.model_validate(content)


def rendered(scene: Scene, system: System, fidelity: Fidelity = ONCE) -> RenderedLight:
    return render(scene, system, fidelity=fidelity, seed=np.random.SeedSequence(1))


def taken(scene: Scene, system: System, light: RenderedLight | None = None) -> Capture:
    light = light or rendered(scene, system)
    return measure(scene, system, light, rng=np.random.default_rng(1), noise="none")


@lru_cache(maxsize=1)
def before_a_wall() -> tuple[Scene, RenderedLight]:
    scene = world(wall("wall", 5.0, 0.5))
    return scene, rendered(scene, camera())


# Scaling.


@FEW
@given(distance_m=distances_m, factor=factors)
def test_light_falls_with_the_square_of_the_distance(distance_m: float, factor: float) -> None:
    """The whole scene and the baseline scaled alike: paths are the same, light falls as 1/z^2.

    A float32 step of each coordinate is granted.
    """
    near, far = (
        rendered(world(wall("w", z, 0.3), baseline_m=0.02 * z), camera()).light.cells
        for z in (distance_m, factor * distance_m)
    )
    assert near.sum() > 0
    np.testing.assert_allclose(far * factor**2, near, rtol=2e-5, atol=2e-4 * near.max())


@MANY
@given(factor=factors)
def test_signal_and_sun_scale_with_the_detectors_area(factor: float) -> None:
    scene, light = before_a_wall()
    width = camera().detector.width_m.value
    one = taken(scene, camera(), light)
    other = taken(scene, camera(detector__width_m=width * factor), light)
    np.testing.assert_allclose(other.cells_e, one.cells_e * factor**2, rtol=1e-12)
    assert other.background_w == pytest.approx(one.background_w * factor**2, rel=1e-12)


@MANY
@given(first=st.floats(0.5, 22.0), second=st.floats(0.5, 22.0))
def test_at_a_fixed_field_light_goes_as_1_over_4_n_squared_plus_1(
    first: float, second: float
) -> None:
    """Field and detector fix the focal length; the f-number alone sets the pupil."""
    scene, light = before_a_wall()
    a, b = (taken(scene, camera(optics__f_number=n), light) for n in (first, second))
    ratio = (4 * first**2 + 1) / (4 * second**2 + 1)
    np.testing.assert_allclose(b.cells_e, a.cells_e * ratio, rtol=1e-12)
    assert b.background_w == pytest.approx(a.background_w * ratio, rel=1e-12)


@FEW
@given(reflectance=reflectances, factor=st.floats(0.1, 2.0))
def test_light_that_bounces_once_is_linear_in_the_albedo(reflectance: float, factor: float) -> None:
    """Each object apart: the one behind keeps its light."""
    dark, bright = (
        rendered(world(wall("a", 5.0, r, 0.4), wall("b", 9.0, 0.2)), camera())
        for r in (reflectance, factor * reflectance)
    )
    near = dark.truth.depth_m < 6
    ratio = np.where(near, factor, 1.0).ravel()
    # Cells across the edge hold both.
    edge = np.abs(np.diff(near.astype(int), axis=1, prepend=near[:, :1])).astype(bool)
    pure = ~(edge | np.roll(edge, -1, axis=1)).ravel()
    assert pure.sum() > 200
    assert len(set(ratio[pure])) == 2 or factor == 1
    np.testing.assert_allclose(
        bright.light.cells[0, pure], (dark.light.cells[0] * ratio)[pure], rtol=1e-5
    )


@MANY
@given(factor=factors)
def test_electrons_scale_with_radiant_intensity_and_time(factor: float) -> None:
    scene, light = before_a_wall()
    system = camera()
    power = system.emitter.radiant_intensity_w_per_sr.value
    time = system.acquisition.integration_time_s.value
    one = taken(scene, system, light)
    brighter = camera(emitter__radiant_intensity_w_per_sr=power * factor)
    longer = camera(
        acquisition__integration_time_s=time * factor, acquisition__pattern_period_s=1e-2
    )
    for other in (brighter, longer):
        np.testing.assert_allclose(
            taken(scene, other, light).cells_e, one.cells_e * factor, rtol=1e-12
        )


# Superposition.


@MANY
@given(seed=st.integers(0, 2**32 - 1))
def test_a_pattern_is_the_sum_of_its_cells(seed: int) -> None:
    """Signal of every exposure of a capture against the masks times the cells, one by one."""
    scene, light = before_a_wall()
    system = camera()
    frame = taken(scene, system, light)
    which = np.random.default_rng(seed).integers(0, system.patterns.n_exposures, 4)
    to_e = frame.cells_e.sum() / frame.signal_w[0, 0]  # the first pattern lights all cells
    for exposure in which:
        mask = system.patterns.masks(slice(exposure, exposure + 1))[0]
        np.testing.assert_allclose(
            frame.signal_w[exposure, 0] * to_e,
            frame.cells_e[mask > 0].sum(),
            rtol=1e-9,
            atol=1e-12 * frame.cells_e.sum(),
        )


@MANY
@given(lux=st.floats(0, 130e3), power=st.floats(0, 10), offset=st.floats(0.0, 0.05))
def test_sun_and_emitter_add(lux: float, power: float, offset: float) -> None:
    """Counts of both together are those of each alone, less the dark level, within rounding."""
    scene, light = before_a_wall()
    loud = {"readout__transimpedance_ohm": 1e4, "readout__adc_offset_v": offset}

    def counts(lux: float, power: float) -> np.ndarray:
        lit = replace(scene, sun=replace(scene.sun, illuminance_lx=lux))
        system = camera(emitter__radiant_intensity_w_per_sr=power, **loud)
        return taken(lit, system, light).record.counts.astype(float)

    both, sun, emitter, dark = (counts(*x) for x in ((lux, power), (lux, 0), (0, power), (0, 0)))
    assert np.abs(both - sun - emitter + dark).max() <= 2  # four roundings


@FEW
@given(first=reflectances, second=reflectances)
def test_objects_that_do_not_hide_each_other_add(first: float, second: float) -> None:
    """Two squares side by side: light of both is the sum of each alone."""
    left, right = wall("left", 5.0, first, 0.501), wall("right", 5.0, second, -0.501)
    both, one, other = (
        rendered(world(*objects), camera()).light.cells
        for objects in ((left, right), (left,), (right,))
    )
    assert one.any()
    assert other.any()
    np.testing.assert_allclose(both, one + other, rtol=1e-5, atol=1e-6 * both.max())


@FEW
@given(rate=st.floats(-5, 5), other=st.floats(-5, 5), range_m=st.floats(1, 140))
def test_echoes_add(rate: float, other: float, range_m: float) -> None:
    """The channel of two targets is the sum of their channels, to the NUFFT's tolerance."""
    radar = load_radar("hybrid-79-slow")
    targets = [
        Target("a", (range_m, 0.5, 0.0), (rate, 0.0, 0.0), 10.0, "declared"),
        Target("b", (30.0, -1.0, 0.0), (other, 0.0, 0.0), 1.0, "declared"),
    ]

    def channel(*chosen: Target) -> np.ndarray:
        scene = replace(world(), targets=chosen)
        return received(straight_paths(scene, radar), radar, Atmosphere())

    both, one, two = channel(*targets), channel(targets[0]), channel(targets[1])
    rms = math.sqrt(np.mean(np.abs(both) ** 2))
    assert np.abs(both - one - two).max() < 2e-5 * rms


# Monotonicity.


@MANY
@given(lux=st.floats(0, 130e3), more=st.floats(0, 130e3))
def test_more_sun_never_helps(lux: float, more: float) -> None:
    scene, light = before_a_wall()
    little, much = (
        taken(replace(scene, sun=replace(scene.sun, illuminance_lx=x)), camera(), light).snr
        for x in (lux, lux + more)
    )
    assert (much <= little * (1 + 1e-12)).all()


@MANY
@given(
    time_s=st.floats(-9, 1).map(lambda x: 10.0**x),
    longer=st.floats(0, 2).map(lambda x: 10.0**x),
    lux=st.floats(0, 130e3),
)
def test_longer_integration_never_hurts_before_saturation(
    time_s: float, longer: float, lux: float
) -> None:
    """Signal grows with T, every noise but the quantisation's with its root at most; and one count
    of a transimpedance amplifier is worth ever more electrons: as many as there is signal more.
    """
    scene, light = before_a_wall()
    scene = replace(scene, sun=replace(scene.sun, illuminance_lx=lux))
    short, long = (
        taken(
            scene,
            camera(acquisition__integration_time_s=t, acquisition__pattern_period_s=t),
            light,
        ).snr
        for t in (time_s, time_s * longer)
    )
    assert (long >= short * (1 - 1e-12)).all()


@MANY
@given(read_e=st.floats(0, 1e5), more=st.floats(0, 1e5))
def test_more_read_noise_never_helps(read_e: float, more: float) -> None:
    scene, light = before_a_wall()
    quiet, loud = (
        taken(scene, camera(readout__read_noise_e=r), light).snr for r in (read_e, read_e + more)
    )
    assert (loud <= quiet * (1 + 1e-12)).all()


@FEW
@given(reflectance=reflectances, more=st.floats(0.01, 0.5))
def test_a_brighter_wall_is_never_darker(reflectance: float, more: float) -> None:
    """Further bounces included: same paths, more light on each."""
    deep = replace(ONCE, max_depth=3)
    corner = [wall("a", 5.0, reflectance), wall("b", 4.0, 0.5, 0.9)]
    dark, bright = (
        rendered(world(replace(corner[0], reflectance=r), corner[1]), camera(), deep).light.cells
        for r in (reflectance, reflectance + more)
    )
    assert (bright >= dark * (1 - 1e-5)).all()


# Reciprocity and mirrors.


@FEW
@given(
    baseline_m=st.floats(0.0, 0.5),
    yaw_deg=st.floats(-3.0, 3.0),
    reflectance=reflectances,
    depth=st.sampled_from([1, 3]),
)
def test_light_takes_the_same_way_back(
    baseline_m: float, yaw_deg: float, reflectance: float, depth: int
) -> None:
    """Paths from the emitter and paths from the detector give one matrix (Helmholtz).

    Before a wall and a second one that it lights: totals over 16 seeds each agree within 5 standard
    errors of their means.
    """
    scene = mitsuba_scene(world(wall("a", 5.0, reflectance), wall("b", 4.0, 0.5, 0.6)))
    tan = math.tan(math.radians(10))
    turned = Pose((0.0, 0.0, 0.0), yaw_deg=yaw_deg).rotation.as_matrix().T
    emitter = Device(np.zeros(3), np.eye(3), tan)
    detector = Device(np.array([0.0, baseline_m, 0.0]), turned, tan)
    problem = LightProblem(scene, emitter, detector)

    def totals(start: str) -> np.ndarray:
        return np.array(
            [
                transport_matrix(
                    problem, (4, 4), (4, 4), quality=TracingQuality(256, depth), seed=s, start=start
                )[0].sum()
                for s in range(16)
            ]
        )

    dual, scatter = totals("dual"), totals("scatter")
    error = math.hypot(dual.std(ddof=1), scatter.std(ddof=1)) / 4
    assert dual.mean() > 0
    # Student's t with 15 degrees of freedom, 6e-7: 8.2 standard errors; and float32 sums.
    assert abs(dual.mean() - scatter.mean()) < 8.2 * error + 1e-5 * dual.mean()


@MANY
@given(place=st.tuples(st.floats(1, 100), st.floats(-50, 50), st.floats(-5, 5)))
def test_the_radar_sees_a_mirrored_target_alike(place: tuple[float, float, float]) -> None:
    """One antenna at one place: left and right give the same echo."""
    radar = load_radar("hybrid-79-slow")
    x, y, z = place
    left, right = (
        straight_paths(
            replace(world(), targets=(Target("t", (x, side * y, z - 0.3), (0, 0, 0), 1.0, "d"),)),
            radar,
        ).paths[0]
        for side in (1, -1)
    )
    assert left.delay_s == pytest.approx(right.delay_s, rel=1e-12)
    assert abs(left.amplitude) == pytest.approx(abs(right.amplitude), rel=1e-9)
