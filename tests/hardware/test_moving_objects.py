"""Objects with motions of their own before a background: what is covered and uncovered, in a scene
drawn cell by cell without the code under test.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_scenes import AnalyticScene, moving_record, psnr

from hardware import (
    CellMotion,
    Compensation,
    InputError,
    Layers,
    MovingBox,
    PatternSet,
    PlaneMotion,
    QuaternionPose,
    Shift,
    SpiRecord,
    box_in_view,
    reconstruct,
    tracked_boxes,
)
from hardware.commands.motions import motion_of
from hardware.patterns import hadamard_rows
from hardware.radar.tracking import TargetTrack
from hardware.reconstruction.motion.knobs import STANDARD
from hardware.reconstruction.motion.operators import moving_patterns
from hardware.reconstruction.motion.timing import timed_rows
from hardware.words_of_motion import motion_in_words

N = 32
WALL, CAR = AnalyticScene.of(11, N, 16.0), AnalyticScene.of(12, N, 16.0)
BACKGROUND, OBJECT = Shift(1.0, 3.0), Shift(-2.0, -9.0)
#: Edges of the object at the reference time: top, left, bottom, right.
EDGES = (9.5, 11.5, 21.5, 23.5)
QUICK = Compensation(error_samples=0, prior_rows=160)


def share_of_the_object(time_s: float, box: tuple[float, ...] = EDGES) -> np.ndarray:
    """Of each cell, by overlaps of its edges."""
    edges = np.arange(N + 1) - 0.5
    parts = (
        np.diff(np.clip(edges, low + speed * time_s, high + speed * time_s))
        for low, high, speed in ((box[0], box[2], -2.0), (box[1], box[3], -9.0))
    )
    return np.outer(*parts).ravel()


def seen(time_s: float) -> np.ndarray:
    """The wall, and the car's texture within its edges in front of it, by shares of each cell."""
    wall = WALL.cells(N, *(time_s * v for v in (1.0, 3.0)))
    car = CAR.cells(N, *(time_s * v for v in (-2.0, -9.0))) + 1.0
    share = share_of_the_object(time_s)
    return wall.ravel() * (1 - share) + car.ravel() * share


TRUTH = seen(0.0).reshape(N, N)
LAYERS = Layers(BACKGROUND, (MovingBox(*EDGES, OBJECT),))


def record(count: int, mode: str = "differential") -> SpiRecord:
    return moving_record(seen, PatternSet(N, N, count, "interleaved", mode), noise=0.03)


@pytest.mark.parametrize("count", [256, N * N])
def test_an_object_of_its_own_motion(count: int) -> None:
    """Against the background's motion alone, the object's alone, and none."""
    moving = record(count)
    motions = (LAYERS, BACKGROUND, OBJECT, None)
    found, *others = (
        psnr(reconstruct(moving, motion=m, compensation=QUICK).image[0] / 1e5, TRUTH)
        for m in motions
    )
    assert found > max(others) + 3


@pytest.mark.quick(1)
@pytest.mark.parametrize("box", [EDGES, (9.31, 11.02, 21.87, 23.4)])
@pytest.mark.parametrize("oversampling", [2, 4])
def test_a_bright_object_is_measured_where_it_is(oversampling: int, box: tuple[float, ...]) -> None:
    """Light of 1 on the object and none elsewhere: each measurement is its overlap with a pattern,
    to the interpolation between instants.
    """
    patterns = PatternSet(N, N, 200, "interleaved")
    time_s = np.linspace(-0.5, 0.5, patterns.n_exposures)
    timed = timed_rows(patterns, np.zeros((len(time_s), 1)), time_s, pairs_apart=False)
    shares = np.array([share_of_the_object(t, box) for t in timed.time_s[0]])
    expected = np.einsum("ki,ki->k", hadamard_rows(timed.rows[0], N * N), shares)
    layers = Layers(BACKGROUND, (MovingBox(*box, OBJECT),))
    for step_cells, bound in ((0.25, 0.02), (0.05, 1e-3)):
        knobs = Compensation(oversampling=oversampling, step_cells=step_cells)
        operator = moving_patterns(timed, layers, (N, N), knobs)
        on_grid = np.arange(operator.grid.shape[0]) // oversampling - operator.grid.above
        light = np.where(on_grid[:, None] > N + 2, 1.0, 0.0) * np.ones(operator.grid.shape)
        error = operator.forward(light) - expected
        assert np.sqrt(np.mean(error**2)) < bound * np.sqrt(np.mean(expected**2))
        np.testing.assert_allclose(
            operator.image(light).ravel(), share_of_the_object(0.0, box), atol=1e-9
        )


@pytest.mark.quick(1)
@pytest.mark.parametrize("edges", [(3.5, 4.5, 9.5, 10.5), (3.25, 4.8, 9.7, 10.15)])
@pytest.mark.parametrize("noise", [0.3, 0.03])
def test_standard_errors_hold_beside_a_bright_box(edges: tuple[float, ...], noise: float) -> None:
    """Nine times as bright as the wall at rest behind it, of which it covers and uncovers 8 columns
    of cells. By edges rounded to half-cells the mean square was 1.6 and 19.
    """
    n, box = 16, MovingBox(*edges, Shift(0.0, 8.0))

    def light(time_s: float, wall: AnalyticScene, board: AnalyticScene) -> np.ndarray:
        ends = np.arange(n + 1) - 0.5
        down = np.diff(np.clip(ends, edges[0], edges[2]))
        along = np.diff(np.clip(ends, edges[1] + 8 * time_s, edges[3] + 8 * time_s))
        share = np.outer(down, along)
        front = board.cells(n, 0.0, 8 * time_s) / 8 + 9.0
        return (wall.cells(n, 0.0, 0.0) / 8 * (1 - share) + front * share).ravel()

    inside, squares = [], []
    for seed in range(6):
        scenes = AnalyticScene.of(seed, n, 12.0, 2.0), AnalyticScene.of(90 + seed, n, 12.0, 2.0)
        moving = moving_record(
            lambda t, s=scenes: light(t, *s),
            PatternSet(n, n, n * n, "interleaved"),
            electrons=1e4,
            noise=noise,
            seed=seed,
            background=1e6,
        )
        found = reconstruct(moving, motion=Layers(Shift(0.0, 0.0), (box,)))
        share = (found.image[0].ravel() - 1e4 * light(0.0, *scenes)) / found.standard_error.ravel()
        inside.append(np.abs(share) < found.errors_in_95)
        squares.append(np.mean(share**2))
    assert 0.93 < np.mean(inside) < 0.999
    assert 0.4 < np.mean(squares) < 1.6


@pytest.mark.parametrize("mode", ["differential", "plain"])
def test_the_adjoint_and_the_rows_are_those_of_the_operator(mode: str) -> None:
    patterns = PatternSet(16, 16, 60, "interleaved", mode)
    time_s = np.linspace(-0.5, 0.5, patterns.n_exposures)
    timed = timed_rows(patterns, np.zeros((patterns.n_exposures, 1)), time_s, pairs_apart=False)
    boxes = (MovingBox(3.0, 2.0, 9.0, 8.0, OBJECT), MovingBox(5.0, 5.0, 14.0, 11.0, Shift(3.0, 0)))
    operator = moving_patterns(timed, Layers(BACKGROUND, boxes), (16, 16), STANDARD)
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=operator.grid.shape), rng.normal(size=timed.count)
    ahead, back = float(operator.forward(x) @ y), float(np.vdot(x, operator.adjoint(y)))
    assert ahead == pytest.approx(back, rel=1e-10)
    some = np.array([0, 5, 59 if mode == "plain" else 30])
    by_rows = np.tensordot(operator.rows(some), x, axes=2)
    np.testing.assert_allclose(by_rows, operator.forward(x)[some], atol=1e-9)


def test_no_object_is_the_background_alone() -> None:
    moving = record(128)
    knobs = Compensation(error_samples=0, prior_rows=0)
    alone = reconstruct(moving, motion=BACKGROUND, compensation=knobs).image
    none, outside = (
        reconstruct(moving, motion=Layers(BACKGROUND, boxes), compensation=knobs).image
        for boxes in ((), (MovingBox(90.0, 90.0, 95.0, 95.0, OBJECT),))
    )
    for found in (none, outside):  # warps are linear between unknowns, shifts exact
        np.testing.assert_allclose(found, alone, atol=0.05 * np.ptp(alone))


def test_boxes_that_hide_each_other() -> None:
    """The first is in front."""
    near, far = MovingBox(0, 0, 4, 4, Shift(0, 2)), MovingBox(0, 0, 8, 8, Shift(0, -2))
    sources = Layers(Shift(0, 0), (near, far)).sources(
        1.0, np.array([[1.0, 3.0], [1.0, 1.0], [6.0, 1.0], [9.0, 9.0]]), (N, N)
    )
    np.testing.assert_allclose(sources, [[1.0, 1.0], [1.0, 3.0], [6.0, 3.0], [9.0, 9.0]])


def test_a_box_that_comes_nearer_is_brighter_than_what_it_hides() -> None:
    """One at 10 m that comes 2 m nearer: (10 / 8)^2 times the light, in it alone."""
    nearer = PlaneMotion(10.0, (-2.0, 0.0, 0.0), FIELD)
    layers = Layers(Shift(0, 0), (MovingBox(4, 4, 28, 28, nearer),))
    places = np.array([[15.5, 15.5], [1.0, 1.0]])
    np.testing.assert_allclose(layers.brightness(1.0, places, (N, N)), [1.5625, 1.0])


def test_what_lies_far_beyond_the_field_takes_no_memory() -> None:
    """A box that covers all for ever is a shift of everything, however large it is."""
    time_s = np.linspace(-0.5, 0.5, 12)
    rows = timed_rows(
        PatternSet(8, 8, 12, mode="complementary"), np.zeros((12, 2)), time_s, pairs_apart=False
    )
    found = [
        moving_patterns(rows, Layers(BACKGROUND, (box,)), (8, 8), STANDARD)
        for box in (MovingBox(-e, -e, e, e, Shift(0.0, 2.0)) for e in (40.0, 1e4, 1e9))
    ]
    assert found[0].grid.shape == found[1].grid.shape == found[2].grid.shape
    for one in found[1:]:
        some = np.arange(12)
        np.testing.assert_allclose(one.rows(some), found[0].rows(some), atol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: MovingBox("a", 0, 4, 4, OBJECT), "motion: box: top, left"),
        (lambda: MovingBox(0, 0, 4, 4, None), "motion: box: moves by NoneType"),
        (
            lambda: MovingBox(0, 0, 4, 4, CellMotion(np.zeros((8, 8, 2)))),
            "motion: box: moves by CellMotion",
        ),
        (lambda: Layers(None, ()), "motion: background: NoneType"),
        (lambda: Layers(LAYERS, ()), "motion: background: Layers"),
        (lambda: Layers(BACKGROUND, ("a",)), "motion: objects: str"),
    ],
)
def test_wrong_layers_are_told(wrong, told: str) -> None:
    with pytest.raises(InputError, match=told):
        wrong()


def test_a_box_without_a_size_is_told() -> None:
    with pytest.raises(InputError, match=r"^motion: box: top, left, bottom, right"):
        MovingBox(4.0, 0.0, 4.0, 3.0, OBJECT)


FIELD = (np.deg2rad(20.0), np.deg2rad(24.0))


def pinhole(point: np.ndarray) -> np.ndarray:
    """Row and column in an image of N cells on a side."""
    focal = N / 2 / np.tan(np.array(FIELD) / 2)
    return (N - 1) / 2 - focal * np.array([point[2], point[1]]) / point[0]


def test_a_box_is_where_its_cuboid_is_seen() -> None:
    """Corners by the pinhole's equation; velocity by the difference of two places of the middle."""
    middle, velocity, size = (
        np.array([12.0, 1.5, -0.4]),
        np.array([-3.0, 2.0, 0.5]),
        (2.0, 1.0, 1.4),
    )
    box = box_in_view(middle, velocity, size, FIELD, (N, N))
    assert box is not None
    near = middle - [1.0, 0.0, 0.0]
    far = middle + [1.0, 0.0, 0.0]
    assert box.top == pytest.approx(pinhole(near + [0, 0, 0.7])[0])
    assert box.bottom == pytest.approx(pinhole(near - [0, 0, 0.7])[0])
    assert box.left == pytest.approx(pinhole(near + [0, 0.5, 0])[1])
    assert box.right == pytest.approx(pinhole(far - [0, 0.5, 0])[1])
    step = 1e-5
    moved = (pinhole(middle + step * velocity) - pinhole(middle - step * velocity)) / (2 * step)
    assert isinstance(box.motion, Shift)
    found = box.motion.down_cells_per_s, box.motion.right_cells_per_s
    np.testing.assert_allclose(found, moved, rtol=1e-6)
    assert box_in_view([0.9, 0, 0], velocity, size, FIELD, (N, N)) is None


def test_boxes_of_tracks() -> None:
    """A rig at (5, 0) that looks along the world's y and drives at 2 m/s: a target 10 m ahead that
    crosses to the world's x goes to the right; one behind, one beside and one without an azimuth
    have no box; the nearer of two comes first.
    """
    camera = QuaternionPose(5.0, 0.0, 1.0, np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))

    def track(*state: float) -> TargetTrack:
        return TargetTrack(1, np.array(state), np.eye(len(state)), 3, 0)

    found = tracked_boxes(
        [
            track(5.0, 20.0, 0.0, 2.0),
            track(5.0, 10.0, 3.0, 2.0),
            track(5.0, -10.0, 0.0, 0.0),
            track(40.0, 10.0, 0.0, 0.0),
            track(10.0, 1.0),
        ],
        camera,
        (0.0, 2.0, 0.0),
        height_m=1.0,
        size_m=(1.0, 1.0, 1.0),
        field_rad=FIELD,
        shape=(N, N),
    )
    assert len(found) == 2
    focal = N / 2 / np.tan(FIELD[1] / 2)
    assert isinstance(found[0].motion, Shift)
    assert found[0].motion.right_cells_per_s == pytest.approx(focal * 3.0 / 10.0)
    assert found[0].motion.down_cells_per_s == pytest.approx(0.0, abs=1e-9)
    assert found[0].right - found[0].left > found[1].right - found[1].left
    assert (found[0].left + found[0].right) / 2 == pytest.approx((N - 1) / 2)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"position_m": (1.0, np.nan, 0.0)}, "motion: position_m"),
        ({"size_m": (1.0, 0.0, 1.0)}, "motion: size_m"),
        ({"field_rad": (0.1, 4.0)}, "motion: field_rad"),
    ],
)
def test_wrong_cuboids_are_told(changed: dict[str, Any], expected: str) -> None:
    good: dict[str, Any] = {
        "position_m": (9.0, 0.0, 0.0),
        "velocity_m_per_s": (0.0, 1.0, 0.0),
        "size_m": (1.0, 1.0, 1.0),
        "field_rad": FIELD,
        "shape": (N, N),
    }
    with pytest.raises(InputError, match=expected):
        box_in_view(**(good | changed))


def test_objects_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "objects.toml"
    path.write_text(
        "background_cells_per_s = [1, 3.0]\n"
        "[[object]]\nbox_cells = [9.5, 11.5, 21.5, 23.5]\ncells_per_s = [-2, -9]\n"
    )
    assert motion_of(str(path)) == LAYERS
    assert motion_in_words(LAYERS) == (
        "background 1 cells/s down, 3 cells/s to the right; 1 object in front of it"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("backgroud = 1", "backgroud: no such key"),
        ("background_cells_per_s = [0.0, nan]", "background_cells_per_s: [0.0, nan], expected 2"),
        ("", "empty, expected background_cells_per_s or [[object]]"),
        ("object = 3", "object: expected tables"),
        ("[[object]]\nbox_cells = [0, 0, 1, 1]", "object[0].cells_per_s: missing, expected 2"),
        (
            "[[object]]\nbox_cells = [4, 0, 1, 1]\ncells_per_s = [0, 0]",
            "object[0]: motion: box: top, left, bottom, right (4.0, 0.0, 1.0, 1.0)",
        ),
        ("[[object", "objects.toml: "),
    ],
)
def test_wrong_objects_are_told(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "objects.toml"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        motion_of(str(path))
    assert f"{path}: " in str(raised.value)
    assert expected in str(raised.value)
