"""Images of what moves while it is measured: operators against sums over exposures of scenes in
closed form, limits, and what compensation gains.
"""

from dataclasses import replace

import numpy as np
import pytest
from moving_scenes import AnalyticScene, moving_record, psnr

from hardware import (
    CellMotion,
    Compensation,
    Flag,
    Homography,
    InputError,
    Motion,
    PatternSet,
    QuaternionPose,
    RigMotion,
    Search,
    Shift,
    ShiftTrack,
    reconstruct,
    write_record,
)
from hardware.patterns import hadamard_rows
from hardware.reconstruction.cosine import filtered
from hardware.reconstruction.motion import estimated_shift, solvers, twist_between
from hardware.reconstruction.motion.fitting import fitted_prior
from hardware.reconstruction.motion.knobs import STANDARD
from hardware.reconstruction.motion.operators import moving_patterns
from hardware.reconstruction.motion.solvers import Prior
from hardware.reconstruction.motion.timing import exposure_times_s, middle_ns, timed_rows

N, DOWN, RIGHT = 32, 4.0, 10.0
SCENE = AnalyticScene.of(3, N, 12.0)
MODES = ("differential", "plain", "reference", "s-matrix", "complementary")
SHIFT = Shift(DOWN, RIGHT)
#: Without standard errors, and with fewer measurements that tell the prior: a third of the time.
QUICK = Compensation(error_samples=0, prior_rows=160)
AS_HOMOGRAPHY = Homography(np.array([[0, 0, DOWN], [0, 0, RIGHT], [0, 0, 0]]))
TURN = Homography(np.array([[0, -0.3, 4.5], [0.3, 0, -4.5], [0, 0, 0]]))


def moving(time_s: float) -> np.ndarray:
    return SCENE.cells(N, DOWN * time_s, RIGHT * time_s).ravel()


def resting(_: float) -> np.ndarray:
    return SCENE.cells(N, 0.0, 0.0).ravel()


def timed(mode: str, n: int = 16, *, apart: bool = False, order: str = "sequency", count: int = 60):
    patterns = PatternSet(n, n, count, order, mode)
    time_s = np.linspace(-0.5, 0.5, patterns.n_exposures)
    arms = np.zeros((patterns.n_exposures, patterns.n_arms))
    return timed_rows(patterns, arms, time_s, pairs_apart=apart), patterns, time_s


@pytest.mark.parametrize("motion", [SHIFT, AS_HOMOGRAPHY, TURN])
@pytest.mark.parametrize("mode", MODES)
def test_the_adjoint_is_the_transpose(motion: Motion, mode: str, path: None) -> None:
    """<A x, y> = <x, A^T y> for random x and y, to roundoff."""
    rows, _, _ = timed(mode, apart=mode == "differential")
    operator = moving_patterns(rows, motion, (16, 16), STANDARD)
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=operator.grid.shape), rng.normal(size=rows.count)
    ahead, back = float(operator.forward(x) @ y), float(np.vdot(x, operator.adjoint(y)))
    assert ahead == pytest.approx(back, rel=1e-10)


@pytest.mark.parametrize("mode", ["differential", "plain", "s-matrix"])
def test_shifts_measure_what_each_exposure_lights(mode: str) -> None:
    """Squares of constant light, a cell and a half in size, moved: the overlap of each with every
    lit cell, exposure by exposure, in closed form. Exact to roundoff.
    """
    rows, patterns, time_s = timed(mode, apart=True)
    operator = moving_patterns(rows, SHIFT, (16, 16), Compensation(oversampling=2))
    grid = operator.grid
    rng = np.random.default_rng(1)
    x = rng.random(grid.shape)
    top = -grid.above - 0.5 + np.arange(grid.shape[0] + 1) / 2
    left = -grid.left - 0.5 + np.arange(grid.shape[1] + 1) / 2
    edges = np.arange(17) - 0.5

    def overlaps(sources: np.ndarray) -> np.ndarray:
        low, high = (
            np.maximum.outer(edges[:-1], sources[:-1]),
            np.minimum.outer(edges[1:], sources[1:]),
        )
        return np.maximum(high - low, 0.0)

    masks = patterns.masks().reshape(-1, 16, 16)
    light = np.array(
        [
            np.vdot(mask, overlaps(top + DOWN * t) @ x @ overlaps(left + RIGHT * t).T)
            for mask, t in zip(masks, time_s, strict=True)
        ]
    )
    pairs = mode == "differential"
    expected = light[0::2] - light[1::2] if pairs else 2 * (light - light.mean())
    np.testing.assert_allclose(operator.forward(x), expected, atol=1e-9)


@pytest.mark.parametrize("motion", [SHIFT, TURN])
@pytest.mark.parametrize("mode", ["differential", "plain"])
def test_rows_are_those_of_the_operator(motion: Motion, mode: str) -> None:
    """Rows of the matrix, times an image, are its measurements."""
    rows, _, _ = timed(mode, apart=mode == "differential")
    operator = moving_patterns(rows, motion, (16, 16), STANDARD)
    some = np.array([0, 7, 31, rows.count - 1])
    x = np.random.default_rng(2).normal(size=operator.grid.shape)
    by_rows = np.tensordot(operator.rows(some), x, axes=2)
    np.testing.assert_allclose(by_rows, operator.forward(x)[some], atol=1e-9)


@pytest.mark.parametrize("mode", ["differential", "plain"])
def test_both_solvers_agree(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the measurements' covariance, and by conjugate gradients to a small residual."""
    rows, _, _ = timed(mode)
    operator = moving_patterns(rows, SHIFT, (16, 16), STANDARD)
    values = operator.forward(np.random.default_rng(3).normal(size=operator.grid.shape))
    prior, knobs = Prior(1.0, 1.3), Compensation(residual=1e-9, most_iterations=4000)
    direct = solvers.linear_solver(operator, prior, rows.count, knobs)(values).unknowns
    monkeypatch.setattr(solvers, "_MOST_PRODUCTS", 0.0)
    by_steps = solvers.linear_solver(operator, prior, rows.count, knobs)(values).unknowns
    np.testing.assert_allclose(direct, by_steps, atol=1e-4 * np.ptp(direct))


@pytest.mark.parametrize("noise_known", [True, False])
@pytest.mark.parametrize("exponent", [0.7, 1.3, 1.9])
def test_the_prior_that_an_image_was_drawn_from_is_found(
    exponent: float, noise_known: bool
) -> None:
    """Its steepness to a step, its scale to a factor of two; without the noise to two steps, and of
    four: medians of six draws, where noise and detail are both seen.
    """
    rows, _, _ = timed("differential", count=256, order="interleaved")
    operator, noise = moving_patterns(rows, SHIFT, (16, 16), STANDARD), 4.0
    steps = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        deviation = np.sqrt(operator.grid.spectrum(exponent))
        truth = filtered(rng.normal(size=deviation.size), deviation).reshape(deviation.shape)
        found = fitted_prior(
            operator,
            rows,
            operator.forward(truth) + np.sqrt(noise) * rng.normal(size=rows.count),
            noise_variance=noise if noise_known else None,
            first=Prior(noise),
            least_ratio=1e-6,
            most_rows=512,
        ).prior
        steps.append((abs(found.exponent - exponent) / 0.3, abs(np.log2(found.ratio / noise))))
    step, ratio = np.median(steps, axis=0)
    assert step < (1.5 if noise_known else 2.5)
    assert ratio < (1.5 if noise_known else 2.5)


def test_warps_that_are_shifts_are_shifts() -> None:
    """Sparse matrices and interpolation in time, against the exact operator, of a smooth image:
    step^2 / 8 of its second difference, and what is linear between unknowns.
    """
    rows, _, _ = timed("differential", n=32)
    knobs = Compensation(step_cells=0.1)
    one = moving_patterns(rows, SHIFT, (N, N), knobs)
    other = moving_patterns(rows, AS_HOMOGRAPHY, (N, N), knobs)
    assert one.grid == other.grid
    down, along = (np.arange(size)[:, None] for size in one.grid.shape)
    x = np.sin(down / 9) @ np.cos(along.T / 11)
    np.testing.assert_allclose(one.forward(x), other.forward(x), atol=2e-3 * N * N)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "motion", [SHIFT, AS_HOMOGRAPHY, CellMotion(np.zeros((N, N, 2)) + (DOWN, RIGHT))]
)
def test_known_motion_is_taken_out(motion: Motion) -> None:
    """A moving full set, 10 cells a frame, noise of 3 % of a cell: 70 % of the loss is regained."""
    patterns = PatternSet(N, N, N * N)
    truth = resting(0.0).reshape(N, N)
    moved = moving_record(moving, patterns, noise=0.03)
    images = [
        reconstruct(moved, motion=motion, compensation=QUICK).image[0],
        reconstruct(moved).image[0],
        reconstruct(moving_record(resting, patterns, noise=0.03)).image[0],
    ]
    found, as_static, static = (psnr(image / 1e5, truth) for image in images)
    assert static - as_static > 15
    assert (found - as_static) / (static - as_static) > 0.7


@pytest.mark.parametrize("mode", ["plain", "reference", "s-matrix"])
def test_light_that_enters_and_leaves_is_no_noise(mode: str) -> None:
    """Full sets that show nothing twice, in which each value holds the light of all cells: with
    the scale of what enters and leaves, and the solver's residual of pairs, they end at 23 dB.
    """
    patterns = PatternSet(N, N, N * N, "interleaved", mode)
    truth = resting(0.0).reshape(N, N)
    record = moving_record(moving, patterns, noise=0.03)
    found = reconstruct(record, motion=SHIFT, compensation=QUICK).image[0]
    seen = np.isfinite(found)
    assert psnr(found[seen] / 1e5, truth[seen]) > 30


@pytest.mark.parametrize("mode", MODES[:4])
@pytest.mark.parametrize("method", ["lmmse", "tv", "zero-fill", "fista"])
def test_all_modes_and_methods_gain(mode: str, method: str) -> None:
    """128 of 1024 patterns."""
    patterns = PatternSet(N, N, 128, "sequency", mode)
    record = moving_record(moving, patterns, noise=0.03)
    truth = resting(0.0).reshape(N, N)
    with_motion, without = (
        reconstruct(record, method, motion=m, compensation=QUICK).image[0] for m in (SHIFT, None)
    )
    seen = np.isfinite(without)
    assert psnr(with_motion[seen] / 1e5, truth[seen]) > 2 + psnr(without[seen] / 1e5, truth[seen])


@pytest.mark.parametrize("velocity", [0.0, 1e-9])
def test_no_motion_gives_the_bits_of_none(velocity: float) -> None:
    record = moving_record(moving, PatternSet(N, N, 64), noise=0.03)
    for motion in (Shift(velocity, velocity), Homography(np.full((3, 3), velocity / 1e3))):
        found, without = (reconstruct(record, motion=m) for m in (motion, None))
        np.testing.assert_array_equal(found.image, without.image)
        np.testing.assert_array_equal(found.standard_error, without.standard_error)
        assert found.motion is None


def test_hardly_any_motion_is_nearly_none() -> None:
    """Just above the knob: the same image within the solver's residual, of one unknown a cell."""
    record = moving_record(resting, PatternSet(N, N, N * N), noise=0.03)
    knobs = Compensation(oversampling=1, residual=1e-4, error_samples=0, prior_rows=0)
    found = reconstruct(record, motion=Shift(1e-4, 1e-4), compensation=knobs)
    without = reconstruct(record)
    assert found.motion is not None
    np.testing.assert_allclose(found.image, without.image, atol=0.02 * np.ptp(without.image))


def test_a_set_faster_than_a_cell_per_exposure() -> None:
    """32 patterns, 100 cells: pattern and complement at their own times; it is an image of what
    stood there, better than as static.
    """
    scene = AnalyticScene.of(5, N, 60.0, finest=4.0)
    patterns = PatternSet(N, N, 32)
    record = moving_record(lambda t: scene.cells(N, 0.0, 100 * t).ravel(), patterns, noise=0.003)
    truth = scene.cells(N, 0.0, 0.0)
    found, without = (reconstruct(record, motion=m).image[0] for m in (Shift(0, 100), None))
    assert psnr(found / 1e5, truth) > 1 + psnr(without / 1e5, truth)


def test_exposures_that_are_lost_keep_the_times_of_the_others() -> None:
    patterns = PatternSet(N, N, 256)
    record = moving_record(moving, patterns, noise=0.01)
    lost = np.random.default_rng(0).random(len(record.flags)) < 0.1
    lost[:2] = False
    counts = np.where(lost[:, None], 0, record.counts).astype(np.int32)
    gappy = replace(record, counts=counts, flags=np.where(lost, Flag.LOST, 0).astype(np.uint8))
    truth = resting(0.0).reshape(N, N)
    whole, part, static = (
        psnr(reconstruct(r, motion=m, compensation=QUICK).image[0] / 1e5, truth)
        for r, m in ((record, SHIFT), (gappy, SHIFT), (gappy, None))
    )
    assert whole - 6 < part < whole + 0.5  # a fifth of the pairs are gone
    assert part > static + 4


def test_one_pattern_is_its_level() -> None:
    record = moving_record(moving, PatternSet(N, N, 1), noise=0.0)
    found = reconstruct(record, motion=SHIFT).image[0]
    assert np.ptp(found) < 1e-6 * found.mean()
    assert found.mean() == pytest.approx(1e5 * resting(0.0).mean(), rel=0.01)


@pytest.mark.quick(1)
@pytest.mark.parametrize("mode", ["differential", "plain", "reference", "s-matrix"])
def test_standard_errors_hold_the_cells(mode: str) -> None:
    """Pooled over scenes: 93 to 99.9 % of all cells within `errors_in_95` of them, and a mean
    square of errors over their standard errors of about 1 (bounded well beyond its scatter).
    """
    inside, squares = [], []
    for seed in range(4):
        scene = AnalyticScene.of(seed, N, 12.0)
        record = moving_record(
            lambda t, s=scene: s.cells(N, DOWN * t, RIGHT * t).ravel(),
            PatternSet(N, N, 256, "interleaved", mode),
            electrons=1e4,
            noise=0.1,
            seed=seed,
            background=1e6,
        )
        found = reconstruct(record, motion=SHIFT)
        assert found.standard_error is not None
        share = (found.image[0] - 1e4 * scene.cells(N, 0, 0)) / found.standard_error[0]
        share = share[np.isfinite(share)]
        inside.append(np.abs(share) < found.errors_in_95)
        squares.append(np.mean(share**2))
    assert 0.93 < np.mean(np.concatenate(inside)) < 0.999
    assert 0.4 < np.mean(squares) < 1.6


@pytest.mark.parametrize("cells", [0.1, 0.2, 0.5, 1.0])
def test_standard_errors_hold_of_sharp_scenes_that_hardly_move(cells: float) -> None:
    """Boxes alone, noise of 1/460 of their range: by the prior's errors alone the mean square was
    2.4 to 3.5, and 82 to 89 % of cells within `errors_in_95`.
    """
    inside, squares = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        first, extent = rng.uniform(-8, 16, (14, 2)), rng.uniform(1.4, 10, (14, 2))
        last, height = first + extent, rng.uniform(0.05, 0.3, 14)
        boxes = np.column_stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1], height])
        scene = AnalyticScene(np.zeros((0, 4)), boxes, 0.05)
        truth = scene.cells(16, 0, 0)
        record = moving_record(
            lambda t, s=scene: s.cells(16, cells * t, 0.7 * cells * t).ravel(),
            PatternSet(16, 16, 256, "interleaved"),
            noise=float(np.ptp(truth)) / 460,
            seed=seed,
        )
        found = reconstruct(record, motion=Shift(cells, 0.7 * cells))
        assert found.standard_error is not None
        share = (found.image[0] - 1e5 * truth) / found.standard_error[0]
        inside.append(np.abs(share) < found.errors_in_95)
        squares.append(np.mean(share**2))
    assert 0.93 < np.mean(inside) < 0.999
    assert 0.4 < np.mean(squares) < 1.8


@pytest.mark.parametrize("noise", [0.4, 1.0])
def test_standard_errors_hold_of_faint_scenes(noise: float) -> None:
    """Noise of a cell of 0.4 and 1 times the scene's range, which tells next to nothing of a prior:
    by the errors of the most likely one 97 and 81 % of cells were within `errors_in_95`, and mean
    squares of single images up to 3.1 and 30.
    """
    inside, squares = [], []
    for seed in range(10):
        scene = AnalyticScene.of(seed, 16, 8.0)
        truth = scene.cells(16, 0, 0)
        record = moving_record(
            lambda t, s=scene: s.cells(16, t, 8 * t).ravel(),
            PatternSet(16, 16, 256, "interleaved"),
            electrons=1e4,
            noise=noise * float(np.ptp(truth)),
            seed=seed,
            background=2e6,
        )
        found = reconstruct(record, motion=Shift(1.0, 8.0))
        assert found.standard_error is not None
        share = (found.image[0] - 1e4 * truth) / found.standard_error[0]
        inside.append(np.abs(share) < found.errors_in_95)
        squares.append(np.mean(share**2))
    assert np.mean(inside) > 0.95
    assert max(squares) < 3.0


def test_the_same_seed_gives_the_same_bits() -> None:
    record = moving_record(moving, PatternSet(N, N, 64), noise=0.03)
    one, two = (reconstruct(record, motion=SHIFT) for _ in range(2))
    np.testing.assert_array_equal(one.image, two.image)
    np.testing.assert_array_equal(one.standard_error, two.standard_error)


def test_the_reference_time_is_a_choice() -> None:
    """The image at the frame's end stands where the scene stands then."""
    record = moving_record(moving, PatternSet(N, N, 512), noise=0.01)
    end_ns = int(record.device_time_ns[-1])
    found = reconstruct(record, motion=SHIFT, reference_ns=end_ns, compensation=QUICK).image[0]
    assert psnr(found / 1e5, moving(0.5).reshape(N, N)) > 6 + psnr(
        found / 1e5, resting(0.0).reshape(N, N)
    )


def test_a_track_is_followed() -> None:
    """Uneven motion: a spline through displacements, against the mean velocity."""

    def place(t: float) -> float:
        return 5 * np.sin(5 * t)

    record = moving_record(
        lambda t: SCENE.cells(N, 0.0, place(t)).ravel(), PatternSet(N, N, 512), noise=0.01
    )
    times = np.linspace(-0.6, 0.6, 25)
    track = ShiftTrack(times, np.column_stack([0 * times, [place(t) for t in times]]))
    truth = resting(0.0).reshape(N, N)
    found, mean = (
        psnr(reconstruct(record, motion=m, compensation=QUICK).image[0] / 1e5, truth)
        for m in (track, Shift(0.0, (place(0.5) - place(-0.5))))
    )
    assert found > mean + 3


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        (lambda: Shift(np.nan, 0.0), "motion: down_cells_per_s: nan, expected finite"),
        (lambda: CellMotion(np.zeros((4, 4, 2))), "motion: cells_per_s: of 4 x 4 cells"),
        (lambda: CellMotion(np.zeros((4, 4))), r"motion: cells_per_s: shape \(4, 4\)"),
        (
            lambda: CellMotion(np.zeros((4, 4, 2), complex)),
            "motion: cells_per_s: .*, expected finite",
        ),
        (lambda: CellMotion([[1.0, 2.0], [3.0]]), "motion: cells_per_s: .*, expected finite"),
        (lambda: Homography(np.full((3, 3), np.nan)), r"motion: rate: array\(\[\[nan, nan"),
        (lambda: Shift(0.0, 1e9), "motion: moves the image by 4.84e.08 cells"),
        (lambda: Homography(1e6 * np.eye(3)[::-1]), "motion: "),
        (lambda: ShiftTrack(np.zeros(2), np.zeros((2, 2))), "motion: time_s: do not ascend"),
        (lambda: ShiftTrack(np.arange(2) * 0.1, np.ones((2, 2))), "motion: time_s: 0 to 0.1 s"),
    ],
)
def test_bad_motion_is_named(motion, told: str) -> None:
    record = moving_record(moving, PatternSet(N, N, 16))
    with pytest.raises(InputError, match=f"^{told}"):
        reconstruct(record, motion=motion())


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: {"motion": "estimate"}, "motion: str, expected a motion, Search"),
        (lambda: {"motion": Shift("1", 0)}, "motion: down_cells_per_s: '1', expected finite"),
        (lambda: {"motion": Shift(1j, 0)}, "motion: down_cells_per_s: 1j, expected finite"),
        (lambda: {"motion": Shift(np.ones(2), 0)}, r"motion: down_cells_per_s: shape \(2,\)"),
        (lambda: {"motion": SHIFT, "reference_ns": 10**15}, "reference_ns: 10{15}, expected"),
        (lambda: {"motion": SHIFT, "reference_ns": -(10**25)}, "reference_ns: -10{25}, expected"),
        (lambda: {"motion": SHIFT, "reference_ns": "x"}, "reference_ns: 'x', expected a whole"),
        (lambda: {"reference_ns": "x"}, "reference_ns: 'x', expected a whole"),
        (lambda: {"compensation": Compensation(oversampling=1.5)}, "oversampling: 1.5, expected"),
        (lambda: {"compensation": Compensation(error_samples=1.5)}, "error_samples: 1.5, exp"),
        (lambda: {"compensation": Compensation(prior_rows=0.5)}, "prior_rows: 0.5, expected"),
        (lambda: {"compensation": Compensation(seed=-1)}, "seed: -1, expected a whole"),
        (lambda: {"compensation": Compensation(residual="a")}, "residual: 'a' is not"),
        (
            lambda: {"motion": CellMotion(np.full((N, N, 2), 1e8))},
            "motion: moves the image by 9.69e",
        ),
    ],
)
def test_wrong_arguments_are_named(wrong, told: str) -> None:
    record = moving_record(moving, PatternSet(N, N, 16))
    with pytest.raises(InputError, match=f"^{told}"):
        reconstruct(record, **wrong())


def test_a_record_in_the_place_of_its_path_is_named() -> None:
    record = moving_record(moving, PatternSet(N, N, 16))
    with pytest.raises(InputError, match=r"^record: .*r\.h5', expected a record"):
        write_record("r.h5", record)  # type: ignore[arg-type]


def test_walsh_rows_of_products() -> None:
    """What `ShiftedPatterns` rests on: row i of n x m is the product of rows of n and of m."""
    rows = hadamard_rows(np.arange(32), 32).reshape(32, 4, 8)
    parts = hadamard_rows(np.arange(4), 4), hadamard_rows(np.arange(8), 8)
    np.testing.assert_array_equal(
        rows, [np.outer(parts[0][i // 8], parts[1][i % 8]) for i in range(32)]
    )


def test_a_rig_that_drives_and_turns() -> None:
    """Points before a wall at 10 m, seen again after 2 m ahead and a turn to the left of 0.02 rad:
    by the pinhole equations written out. Sources give back where they came from.
    """
    depth = np.full((N, N), 10.0)
    field = (np.deg2rad(20.0), np.deg2rad(20.0))
    rig = RigMotion(depth, np.array([5.0, 0, 0]), np.array([0, 0, 0.05]), field)
    middle, scale = (N - 1) / 2, N / 2 / np.tan(field[0] / 2)
    for row, column in ((16.0, 20.0), (3.0, 28.0), (10.0, 10.0)):
        y, z = -10 * (column - middle) / scale, -10 * (row - middle) / scale
        ahead, left = 10.0 - 2.0, y
        turned = (
            ahead * np.cos(0.02) + left * np.sin(0.02),
            left * np.cos(0.02) - ahead * np.sin(0.02),
        )
        seen = middle - scale * np.array([z, turned[1]]) / turned[0]
        source = rig.sources(0.4, seen[None], (N, N))[0]
        np.testing.assert_allclose(source, (row, column), atol=1e-4)


def test_velocities_between_poses() -> None:
    """A quarter turn to the left within 2 s, while the rig goes 3 m along the world's y, which it
    looked along: forward, and pi/4 rad/s about z.
    """
    looks_along_y = QuaternionPose(1.0, 2.0, 0.0, np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    then = QuaternionPose(1.0, 5.0, 0.0, 0.0, 0, 0, 1.0)
    velocity, turn = twist_between(looks_along_y, then, 2.0)
    np.testing.assert_allclose(velocity, [1.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn, [0, 0, np.pi / 4], atol=1e-12)
    with pytest.raises(InputError, match="elapsed_s: 0 "):
        twist_between(looks_along_y, then, 0)


@pytest.mark.parametrize("mode", ["differential", "reference"])
def test_motion_is_found_in_the_measurements(mode: str) -> None:
    """Low and high sequency in turn: to a cell a frame, far more likely than rest."""
    patterns = PatternSet(N, N, 256, "interleaved", mode)
    record = moving_record(moving, patterns, noise=0.03)
    found = reconstruct(record, motion=Search(most_cells=12), compensation=QUICK)
    assert isinstance(found.motion, Shift)
    assert found.motion.down_cells_per_s == pytest.approx(DOWN, abs=1)
    assert found.motion.right_cells_per_s == pytest.approx(RIGHT, abs=1)


@pytest.mark.parametrize("order", ["interleaved", "sequency"])
def test_a_scene_at_rest_keeps_its_bits(order: str) -> None:
    record = moving_record(resting, PatternSet(N, N, 256, order), noise=0.03)
    found, without = (reconstruct(record, motion=m) for m in (Search(most_cells=8), None))
    assert found.motion is None
    np.testing.assert_array_equal(found.image, without.image)
    in_order = [told for told in found.warnings if "`interleaved`" in told]
    assert len(in_order) == (order == "sequency")


def test_too_few_patterns_to_look_for_motion_are_told() -> None:
    record = moving_record(moving, PatternSet(N, N, 5, "interleaved"), noise=0.03)
    found = reconstruct(record, motion=Search())
    assert any("5 patterns do not tell it" in told for told in found.warnings)


def test_a_dark_scene_does_not_move() -> None:
    record = moving_record(lambda _: np.zeros(N * N), PatternSet(N, N, 64), background=0.0)
    assert reconstruct(record, motion=Search(most_cells=4)).motion is None


def test_detail_that_the_prior_does_not_expect_is_no_motion() -> None:
    """At 16 x 16 sharp scenes at rest are likelier in motion, but not better predicted by it."""
    still = AnalyticScene.of(6, 16, 4.0, 0.6)
    likelier = 0
    for speed in (0.0, 3.0):
        record = moving_record(
            lambda t, speed=speed: still.cells(16, 0.0, speed * t).ravel(),
            PatternSet(16, 16, 256, "interleaved"),
            noise=0.01,
        )
        taken = timed_rows(
            record.patterns,
            record.counts.astype(float),
            exposure_times_s(record, middle_ns(record)),
            pairs_apart=False,
        )
        found = estimated_shift(
            record.patterns, taken, np.array([256 * (1e5 * 0.01) ** 2]), Search(most_cells=4)
        )
        likelier += found.evidence > Search().evidence
        assert found.is_significant == (speed > 0)
    assert likelier == 2
