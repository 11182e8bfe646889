"""Transport between emitter cells and detector pixels, in both roles."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hardware import PatternSet
from twin.geometry import Geometry
from twin.optics.devices import Device
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.reference import PatternRenderer
from twin.optics.transport import transport
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene

TAN = math.tan(math.radians(10))
AHEAD = np.eye(3)
HERE = Device(np.zeros(3), AHEAD, TAN)


def wall(distance_m: float):
    corners = np.array([[0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, 9.0]]) + [distance_m, 0, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    item = SceneObject("wall", Geometry(corners, faces), "white", 0.5)
    rig = Rig(Pose((0.0, 0.0, 0.0)))
    return mitsuba_scene(Scene("wall", None, "", (item,), rig, Sun(0.0, 0.0, 0.0)))  # type: ignore[arg-type]


@pytest.mark.parametrize("start", ["dual", "scatter"])
def test_without_a_baseline_each_cell_meets_its_own_pixel(start) -> None:
    """Emitter and detector at one point: the matrix is diagonal, and its sum the closed form."""
    problem, shape, quality = LightProblem(wall(5.0), HERE, HERE), (8, 8), TracingQuality(256, 1)
    matrix = transport_matrix(problem, shape, shape, quality=quality, seed=1, start=start)[0]
    off = matrix - np.diag(np.diag(matrix))
    assert np.abs(off).sum() < 1e-5 * matrix.sum()
    expected = transport(problem, shape, quality=quality, seed=2).total
    np.testing.assert_allclose(np.diag(matrix), expected.ravel(), rtol=1e-3)


@pytest.mark.parametrize("start", ["dual", "scatter"])
def test_a_baseline_moves_pixels_the_way_geometry_says(start) -> None:
    """Detector to the left by one column's width on the wall: it sees everything one to the right.

    Tells rows from columns, left from right, and the emitter's axis from the detector's.
    """
    n, z = 8, 5.0
    left = Device(np.array([0, z * 2 * TAN / n, 0]), AHEAD, TAN)
    problem = LightProblem(wall(z), HERE, left)
    matrix = transport_matrix(
        problem, (4, n), (4, n), quality=TracingQuality(64, 1), seed=1, start=start
    )[0].reshape(4, n, 4, n)
    for row in range(4):
        for column in range(n):
            pixel = matrix[:, :, row, column]
            if column == n - 1:
                assert pixel.sum() < 1e-4 * matrix.sum()
            else:
                assert pixel[row, column + 1] > 0.999 * pixel.sum() > 0


@pytest.mark.thorough
@pytest.mark.parametrize("depth", [1, pytest.param(5, marks=pytest.mark.whole)])
def test_line_sensor_is_what_mitsuba_renders_pattern_by_pattern(depth: int) -> None:
    """16 LED rows x 16 columns of the yard, four patterns, both roles, against `projector` and
    `path`: Student's t over 12 renders each, 1e-4 over all 128 comparisons of a depth; columns in
    reverse order fail it. A projector's texture has steps: 0.3 % is granted.
    """
    scene = load_scene("yard")
    emitter = Device(*scene.rig.device("emitter"), TAN)
    detector = Device(*scene.rig.device("detector"), TAN)
    problem, renders = LightProblem(mitsuba_scene(scene), emitter, detector), 12
    reference = PatternRenderer(problem, max_depth=depth)
    bound = stats.t.isf(1e-4 / 128 / 2, df=renders - 1)
    patterns = PatternSet(16, 1, 4, "sequency", "plain").masks().astype(float)
    brute = np.array(
        [
            [
                reference.render_columns(
                    np.repeat(p.reshape(16, 1), 16, axis=1), samples=64, seed=100 * i + s
                )
                .reshape(16, 4)
                .sum(axis=1)
                for s in range(renders)
            ]
            for i, p in enumerate(patterns)
        ]
    )
    for start, samples in (("dual", 64**2), ("scatter", 48**2)):
        ours = np.array(
            [
                transport_matrix(
                    problem,
                    (16, 1),
                    (1, 16),
                    quality=TracingQuality(samples, depth),
                    seed=s,
                    start=start,
                )[0]
                @ patterns.reshape(4, 16).T
                for s in range(renders)
            ]
        )
        ours = ours.transpose(2, 0, 1)  # pattern, seed, column
        error = np.hypot(brute.std(axis=1, ddof=1), ours.std(axis=1, ddof=1)) / math.sqrt(renders)
        mean = brute.mean(axis=1)

        def worst(of: np.ndarray, mean: np.ndarray = mean, error: np.ndarray = error) -> float:
            off = np.abs(of.mean(axis=1) - mean) - 3e-3 * mean
            return float((off / error).max())

        assert worst(ours) < bound
        assert worst(ours[:, :, ::-1]) > 10 * bound


@pytest.mark.thorough
def test_both_roles_and_the_plain_transport_agree_on_the_yard() -> None:
    """16 LED rows x 32 columns, two bounces, 24 seeds each: element by element and in sum.

    Student's t of the difference over its estimated error; bounds for a false-alarm rate of 1e-4
    over all elements that carry light. Elements near the edge of an object hold few paths and are
    not normal: only those with at least 1 % of the largest are tested.
    """
    scene = load_scene("yard")
    emitter = Device(*scene.rig.device("emitter"), TAN)
    detector = Device(*scene.rig.device("detector"), TAN)
    problem = LightProblem(mitsuba_scene(scene), emitter, detector)
    draws = {
        start: np.stack(
            [
                transport_matrix(
                    problem,
                    (16, 1),
                    (1, 32),
                    quality=TracingQuality(samples, 2),
                    seed=s,
                    start=start,
                )[0]
                for s in range(24)
            ]
        )
        for start, samples in (("dual", 4096), ("scatter", 2025))
    }
    mean = {start: d.mean(axis=0) for start, d in draws.items()}
    error = {start: d.std(axis=0, ddof=1) / math.sqrt(24) for start, d in draws.items()}
    lit = mean["dual"] > 0.01 * mean["dual"].max()
    t = (mean["dual"] - mean["scatter"])[lit] / np.hypot(error["dual"], error["scatter"])[lit]
    assert np.abs(t).max() < stats.t.isf(1e-4 / lit.sum() / 2, df=23)
    plain = transport(problem, (16, 1), quality=TracingQuality(65536, 2), seed=5)
    for d in draws.values():
        rows = d.sum(axis=1)
        off = rows.mean(axis=0) - plain.total.ravel()
        spread = np.hypot(rows.std(axis=0, ddof=1) / math.sqrt(24), plain.standard_error.ravel())
        assert np.abs(off / spread).max() < stats.t.isf(1e-4 / 16 / 2, df=23)


BLURRED = replace(HERE, blur_tan=0.02)
WIDE = replace(HERE, tan_half_field=2 * TAN)
BESIDE = np.array([0, -0.05, 0])


@pytest.mark.parametrize(
    ("emitter", "detector", "shape", "columns", "roles"),
    [
        (BLURRED, WIDE, (8, 8), (4, 4), ("dual", "scatter")),
        (BLURRED, replace(HERE, origin_m=BESIDE), (16, 1), (1, 32), ("dual", "scatter")),
        (replace(HERE, pitch_m=1e-3, lobe_exponent=5.0), WIDE, (4, 4), (4, 4), ("dual",)),
        (HERE, replace(HERE, outline="disc", blur_tan=0.05), (8, 8), (4, 4), ("dual", "scatter")),
        (
            HERE,
            replace(HERE, pupil_radius_m=0.02, focus_m=1.0),
            (8, 8),
            (4, 4),
            ("dual", "scatter"),
        ),
    ],
    ids=["wide detector", "line sensor", "bare elements", "round detector", "out of focus"],
)
def test_all_pixels_together_are_the_plain_transport(
    emitter: Device, detector: Device, shape, columns, roles
) -> None:
    """Whatever lenses do to the edge of a field, the sum of the matrix is `transport`.

    Light that a blur sends beyond the emitter's own field, light of elements without a lens, the
    edge of a round field, an image out of focus. 2.6e5 paths, stratified but for edges: 0.1 % of
    the whole, 1.6 % of a cell in which 4096 of them fall at random. Bounds at three and five of
    these standard deviations; masked by the start's field, 0.6 to 66 % were lost.
    """
    problem = LightProblem(wall(5.0), emitter, detector)
    plain = transport(problem, shape, quality=TracingQuality(4096, 1), seed=2).total
    for start in roles:
        ends = math.prod(shape if start == "dual" else columns)
        quality = TracingQuality(math.isqrt(4096 * math.prod(shape) // ends) ** 2, 1)
        matrix = transport_matrix(problem, shape, columns, quality=quality, seed=3, start=start)[0]
        summed = matrix.sum(axis=0)
        assert summed.sum() == pytest.approx(plain.sum(), rel=3e-3)
        np.testing.assert_allclose(summed, plain.ravel(), atol=0.08 * plain.max())


def test_same_seed_same_bits_and_roles_by_name() -> None:
    problem, shape, quality = LightProblem(wall(3.0), HERE, HERE), (4, 4), TracingQuality(16, 2)
    a, b = (transport_matrix(problem, shape, shape, quality=quality, seed=7)[0] for _ in range(2))
    np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match="start: 'both' is none of dual, scatter"):
        transport_matrix(problem, shape, shape, quality=quality, seed=1, start="both")[0]


def test_an_empty_view_gives_zeros() -> None:
    backwards = Device(np.zeros(3), np.diag([-1.0, -1.0, 1.0]), TAN)
    problem = LightProblem(wall(3.0), backwards, backwards)
    matrix = transport_matrix(problem, (4, 4), (4, 4), quality=TracingQuality(4, 3), seed=1)[0]
    assert matrix.shape == (16, 16)
    assert not matrix.any()


@pytest.mark.parametrize("start", ["dual", "scatter"])
def test_blocks_of_rows_land_where_they_belong(start, monkeypatch: pytest.MonkeyPatch) -> None:
    """Traced two rows at a time, the diagonal of a wall is the same but for noise."""
    import twin.optics.tracer as module

    problem, shape, quality = LightProblem(wall(5.0), HERE, HERE), (8, 8), TracingQuality(256, 1)
    whole = transport_matrix(problem, shape, shape, quality=quality, seed=1, start=start)[0]
    monkeypatch.setattr(module, "RAYS_AT_ONCE", 2 * 8 * 256)
    parts = transport_matrix(problem, shape, shape, quality=quality, seed=1, start=start)[0]
    np.testing.assert_allclose(np.diag(parts), np.diag(whole), rtol=1e-3)
    assert np.abs(parts - np.diag(np.diag(parts))).sum() < 1e-5 * parts.sum()
