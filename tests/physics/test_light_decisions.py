"""What light to a tolerance leaves out: its bounds hold, and are told."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tests.still import still_yard
from twin.accuracy import Decision
from twin.camera import Capture, capture
from twin.camera.chain import Chain
from twin.camera.light import render
from twin.camera.mounting import light_problem
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.devices import Device
from twin.optics.interreflection import Body
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.radiometry import collection
from twin.optics.transport import gather
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

SQUARE = trimesh.Trimesh(
    [[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1.0]], [[0, 2, 1], [0, 3, 2]], process=False
)
CORNER = trimesh.Trimesh(
    [[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1.0], [-1, -1, -1], [-1, 1, -1]],
    [[0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4]],
    process=False,
)
BODIES = (
    SQUARE,
    CORNER,
    trimesh.creation.box((1, 1, 1)),
    trimesh.creation.icosphere(subdivisions=2),
    trimesh.creation.box((0.05, 0.05, 3)),
)
EMITTER = Device(np.zeros(3), np.eye(3), 0.35)
DETECTOR = Device(np.array([0, 0.1, 0]), np.eye(3), 0.4, outline="disc")


def body(mesh: trimesh.Trimesh, reflectance: float = 0.8, *, at: object = (4, 0, 0)) -> SceneObject:
    geometry = Geometry(mesh.vertices + np.asarray(at), mesh.faces)
    return SceneObject("body", geometry, "white", reflectance)


def problem(*objects: SceneObject, sun: Sun | None = None) -> LightProblem:
    sun = sun or Sun(0.0, 30.0, 1e4)
    scene = Scene("bodies", Path(), "", objects, Rig(Pose((0.0, 0.0, 0.0))), sun)
    bodies = [Body(o.geometry, o.vertices_m, float(o.reflectance)) for o in objects]  # type: ignore[arg-type]
    return LightProblem(
        mitsuba_scene(scene), EMITTER, DETECTOR, sun.direction, bodies=lambda: bodies
    )


def bounds(case: LightProblem) -> tuple[float, float]:
    """Of the emitter's and of the sun's indirect light, of 8 x 8 cells."""
    few = TracingQuality(1)
    tracers = case.from_emitter((8, 8), few, 1), case.from_sun((8, 8), few, 1)
    return case.largest_indirect(tracers[0]), case.largest_indirect(tracers[1])


@pytest.mark.parametrize("mesh", [SQUARE, *BODIES[2:]], ids=["wall", "box", "ball", "post"])
def test_what_bends_outwards_has_no_indirect_light(mesh: trimesh.Trimesh) -> None:
    assert bounds(problem(body(mesh))) == (0, 0)


def test_patches_side_by_side_have_no_indirect_light() -> None:
    assert bounds(problem(body(SQUARE), body(SQUARE, at=(4, 2.5, 0)))) == (0, 0)


def test_a_concave_corner_and_the_inside_of_a_box_have_indirect_light() -> None:
    for case in (problem(body(CORNER)), problem(body(BODIES[2], at=(0, 0.1, 0.2)))):
        assert min(bounds(case)) > 0


@pytest.mark.parametrize("seed", range(24))
def test_indirect_light_of_random_bodies_is_below_its_bound(seed: int) -> None:
    """One or two bodies, at times through each other. Without what a body sends to itself some are
    above it, as with the wrong side of faces, or with a thirtieth of the form factors.
    """
    rng, objects = np.random.default_rng(seed), []
    for _ in range(rng.integers(1, 3)):
        mesh = BODIES[rng.choice([0, 1, 1, 2, 3])].copy()
        mesh.apply_scale(10 ** rng.uniform(-0.7, 0.3))
        mesh.vertices = mesh.vertices @ Rotation.random(rng=rng).as_matrix().T
        place = (rng.uniform(2, 5), *rng.uniform(-0.7, 0.7, 2))
        objects.append(body(mesh, float(rng.uniform(0.05, 0.95)), at=place))
    case = problem(*objects, sun=Sun(rng.uniform(-180, 180), rng.uniform(5, 80), 1e4))
    quality = TracingQuality(1, 30, 256)
    for bound, tracer in zip(
        bounds(case),
        (case.from_emitter((8, 8), quality, 1), case.from_sun((8, 8), quality, 1)),
        strict=True,
    ):
        assert gather(tracer).indirect.max() <= bound


def test_no_bound_is_known_of_a_body_that_absorbs_nothing_or_of_scattering_air() -> None:
    assert bounds(problem(body(CORNER, 1.0))) == (math.inf, math.inf)
    foggy_design = load_system("workable").with_({"weather.part": "fog-200m"})
    foggy = light_problem(load_scene("table1"), foggy_design)
    assert math.isinf(foggy.largest_indirect(foggy.from_emitter((4, 4), TracingQuality(), 1)))


def taken(scene: str, system: str, **knobs: float) -> Capture:
    small = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}
    design = load_system(system).with_(small)
    world = still_yard() if scene == "yard" else load_scene(scene)
    return capture(world, design, seed=1, fidelity=Fidelity(**knobs))


def test_decisions_are_told() -> None:
    """A cylinder by itself has no indirect light; a yard has, and keeps it."""
    lone, yard = (taken(name, "workable", light_tolerance=0.2) for name in ("fig3a", "yard"))
    for found, is_taken in ((lone, False), (yard, True)):
        by_effect = {decision.effect: decision for decision in found.decisions}
        indirect = by_effect["indirect light"]
        assert indirect.taken == is_taken == (indirect.bound > indirect.permitted)
        assert indirect.permitted == pytest.approx(0.02)
        assert (indirect.cost_s > 0) == is_taken
        assert any("sun" in effect for effect in by_effect)
        # Nothing but the rounding of float32 rays is left.
        noise_e = found.noise.pixel_noise_e(found.record.patterns)
        assert np.median(found.light_systematic_e) < 1e-4 * noise_e
    fixed = capture(load_scene("fig3a"), load_system("workable"), seed=1, fidelity="standard")
    assert not fixed.decisions


def test_the_bound_of_what_is_left_out_is_in_electrons() -> None:
    """Where the noise hides the light itself, light between patches is left out, and told."""
    found = taken("table1", "paper", light_tolerance=0.2)
    decision = next(d for d in found.decisions if d.effect == "indirect light")
    assert not decision.taken
    bound = found.light_systematic_e
    assert bound.shape == found.cells_e.shape
    share = np.sqrt(np.mean((bound / found.noise.pixel_noise_e(found.record.patterns)) ** 2))
    assert share == pytest.approx(decision.bound, rel=0.05)


def test_what_is_taken_adds_no_more_than_its_paths_say() -> None:
    """The bound that decides knows no paths: 0.24 of the noise at 64 x 64 cells, of which its paths
    leave a tenth. The smaller of both is told.
    """
    found = capture(load_scene("table1"), load_system("workable"), seed=1)
    decision = next(d for d in found.decisions if d.effect == "indirect light")
    assert decision.taken
    assert decision.permitted < decision.bound < 0.05


def test_a_tolerance_may_be_a_share_of_the_light_itself() -> None:
    """5 % of each cell's light, or of their mean where that is more: error against more paths."""
    fine = taken("yard", "workable", samples=1024, max_depth=12, indirect_samples=1024).cells_e
    errors = []
    for seed in range(3):
        design = load_system("workable").with_(
            {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}
        )
        knobs = Fidelity(light_tolerance_relative=0.05)
        found = capture(still_yard(), design, seed=seed, fidelity=knobs)
        permitted = 0.05 * np.maximum(found.cells_e, found.cells_e.mean())
        errors.append(np.mean(((found.cells_e - fine) / permitted) ** 2))
        assert np.sqrt(np.mean((found.cells_error_e / permitted) ** 2)) <= 1.02
    assert np.sqrt(np.mean(errors)) <= 1


def test_both_tolerances_hold_together() -> None:
    both = Fidelity(light_tolerance=0.2) | Fidelity(light_tolerance_relative=0.5)
    assert (both.light_tolerance, both.light_tolerance_relative) == (0.2, 0.5)
    assert both.has_light_tolerance
    assert not Fidelity().has_light_tolerance


@pytest.mark.thorough
def test_a_wire_across_the_field_is_met() -> None:
    """1 mm wide at 3 m, of which no cell but the outermost has a corner, before a dark wall: light
    of the image is within its tolerance, a tenth of that of the wire, in every one of 10 runs.
    """
    from twin.camera.mounting import _corners
    from twin.optics.adaptive import gather_within

    wire = SQUARE.copy()
    wire.vertices *= (0, 5.0, 0.0005)
    objects = (body(SQUARE, 1e-4, at=(3.5, 0, 0)), body(wire, 0.9, at=(3, 0, 0.1)))
    scene = Scene("wire", Path(), "", objects, Rig(Pose((0.0, 0.0, 0.0))), Sun(0.0, 30.0, 0.0))
    device = Device(np.zeros(3), np.eye(3), 0.2)
    case = LightProblem(
        mitsuba_scene(scene), device, device, corners=lambda: _corners(scene), bodies=None
    )
    fine = gather(case.from_emitter((16, 16), TracingQuality(256**2, 1), 1)).total
    limit = np.sqrt(np.mean(fine**2)) / 10
    for seed in range(10):
        tracer = case.from_emitter((16, 16), TracingQuality(), seed)
        facets = case.facet_light((16, 16))
        light = gather_within(tracer, lambda cells: np.full_like(cells, limit), facets).light
        assert np.sqrt(np.mean((light.total - fine) ** 2)) < limit


@pytest.mark.thorough
def test_a_tolerance_that_is_not_kept_is_in_the_verdict() -> None:
    """A room's light to a hundred thousandth takes more paths than a cell may have."""
    room = body(trimesh.creation.box((4, 4, 4)), 0.5, at=(0.3, 0.2, 0.1))
    scene = replace(load_scene("fig3a"), objects=(room,), rig=Rig(Pose((0.0, 0.0, 0.0))))
    design = load_system("workable").with_(
        {"emitter.rows": 2, "emitter.columns": 2, "acquisition.n_patterns": 4}
    )
    found = capture(scene, design, seed=1, fidelity=Fidelity(light_tolerance_relative=1e-5))
    (warning,) = (w for w in found.warnings if w.kind == "tolerance")
    assert "1e-05 are allowed" in warning
    assert found.verdict.not_within == (warning,)
    assert found.void or str(warning) in str(found.verdict)


SMALL = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}


def change_in_noise(found: Capture, one: Capture, other: Capture) -> float:
    """Root mean square over the cells, over the noise of a pixel of what was found."""
    noise_e = found.noise.pixel_noise_e(found.record.patterns)
    return float(np.sqrt(np.mean((one.cells_e - other.cells_e) ** 2)) / noise_e)


def with_and_without(scene: Scene, design: System, left_out: dict) -> tuple[Capture, ...]:
    """To a tolerance; and by the same paths with the design as it is and with less in it."""
    knobs = Fidelity(samples=256, max_depth=1)
    designs = (design, System.model_validate({**dict(design), **left_out}))
    found = capture(scene, design, seed=1, fidelity=Fidelity(light_tolerance=0.2))
    return found, *(capture(scene, each, seed=1, fidelity=knobs) for each in designs)


def told(found: Capture, beginning: str) -> Decision:
    (decision,) = (d for d in found.decisions if d.effect.startswith(beginning))
    return decision


@pytest.mark.quick(1)
@pytest.mark.parametrize("field_deg", [20.0, 70.0, 120.0])
def test_the_shift_of_a_filter_is_told_as_large_as_it_is(field_deg: float) -> None:
    """Also where at the edge of the field the filter passes next to nothing, so that noise in the
    unit of those cells' light is large beyond measure.
    """
    fields = {f"{side}.field_of_view_deg": field_deg for side in ("emitter", "optics")}
    design = load_system("workable").with_({**SMALL, **fields})
    band = design.filter.model_copy(update={"effective_index": None, "place": None})
    found, shifted, straight = with_and_without(still_yard(), design, {"filter": band})
    decision = told(found, "the filter's shift with angle")
    assert decision.taken
    assert decision.bound > 1e-3
    assert decision.cost_s == 0
    assert decision.effect.endswith("at no cost")
    assert decision.bound == pytest.approx(change_in_noise(found, shifted, straight), rel=0.05)
    assert 1e-3 < decision.permitted < 0.1 * 0.2 * 1.01
    without = capture(
        still_yard(),
        System.model_validate({**dict(design), "filter": band}),
        seed=1,
        fidelity=Fidelity(light_tolerance=0.2),
    )
    assert not any("filter" in d.effect for d in without.decisions)


def test_of_cells_that_the_filter_blocks_nothing_is_left_out() -> None:
    """However much that may be: infinite times none was no number."""
    fields = {f"{side}.field_of_view_deg": 120.0 for side in ("emitter", "optics")}
    system = load_system("workable").with_({**SMALL, **fields})
    seed, direct = np.random.SeedSequence(1), Fidelity(samples=1, max_depth=1)
    rendered = render(still_yard(), system, seed=seed, fidelity=direct)
    light = replace(rendered.light, left_out=math.inf)
    power = Chain.of(system, still_yard().sun).powers(replace(rendered, light=light))
    assert set(np.unique(power.left_out_w)) == {0.0, math.inf}


@pytest.mark.quick(1)
@pytest.mark.parametrize("weather", ["clear-air", "haze"])
def test_what_air_does_is_told_no_smaller_than_it_is(weather: str) -> None:
    """Extinction and veil against the same light without air: together no less than their change,
    and that of the veil, which adds, exactly.
    """
    design = load_system("workable").with_({**SMALL, "weather.part": weather})
    found, foggy, clear = with_and_without(still_yard(), design, {"weather": None})
    extinction, veil = (told(found, what) for what in ("the air's extinction", "veil of light"))
    noise_e = found.noise.pixel_noise_e(found.record.patterns)
    added = float(np.sqrt(np.mean(found.backscatter_e**2)) / noise_e)
    assert veil.bound == pytest.approx(added, rel=0.01)
    assert veil.taken
    assert veil.cost_s > 0
    darker = replace(foggy, cells_e=foggy.cells_e - foggy.backscatter_e)
    change = change_in_noise(found, darker, clear)
    assert 0 < change < 1.05 * extinction.bound
    assert extinction.bound < 1.3 * change
    scattered = told(found, "light that the air scatters into other cells")
    assert scattered.taken == (scattered.bound >= scattered.permitted)
    assert not any(
        "air" in d.effect for d in taken("fig3a", "workable", light_tolerance=0.2).decisions
    )


def test_the_area_of_a_near_pupil_is_told_no_smaller_than_it_is() -> None:
    """A wall at 40 radii of the pupil, whose area then counts, and one where it does not: there it
    is stated.
    """
    design = load_system("workable").with_(SMALL)
    radius_m = collection(design).pupil_diameter_m / 2
    for radii, is_taken in ((40.0, True), (400.0, False)):
        wall = body(SQUARE, at=(radii * radius_m, 0, 0))
        scene = replace(load_scene("fig3a"), objects=(wall,), rig=Rig(Pose((0.0, 0.0, 0.0))))
        found = capture(scene, design, seed=1, fidelity=Fidelity(light_tolerance=0.2))
        decision = told(found, "the area of the detector's pupil")
        assert decision.taken == is_taken == (decision.bound > decision.permitted)
        lights = []
        for disc_m in (0.0, radius_m):
            detector = replace(DETECTOR, origin_m=np.zeros(3), disc_radius_m=disc_m)
            case = replace(problem(wall), detector=detector)
            lights.append(gather(case.from_emitter((4, 4), TracingQuality(64, 1), 1)).total)
        changed = np.max(np.abs(lights[0] / lights[1] - 1))
        assert 0.5 * decision.bound < changed < 1.01 * decision.bound
        if not is_taken:
            assert (found.light_systematic_e >= changed * found.cells_e).all()


def test_blur_is_always_taken() -> None:
    """What of a cell's light it moves elsewhere is not bounded, and says so."""
    sharp = load_system("workable").with_(SMALL)
    blurred = sharp.with_({"optics.blur_rms_deg": 0.1})
    for design, is_told in ((sharp, sharp.optics.blur_rms_deg is not None), (blurred, True)):
        found = capture(load_scene("fig3a"), design, seed=1, fidelity=Fidelity(light_tolerance=0.2))
        blurs = [d for d in found.decisions if d.effect.startswith("blur of the detector")]
        assert len(blurs) == is_told
        for decision in blurs:
            assert decision.taken
            assert math.isinf(decision.bound)
            assert decision.effect.endswith("always taken, at no cost")
