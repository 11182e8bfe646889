"""Two passes over a study that names its front: the same front as of all points as asked for."""

import json
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import xarray
from studies import CLOSED
from typer.testing import CliRunner

from twin.cli import app
from twin.fidelity import Tolerance
from twin.files import InputError
from twin.sweep import Study, Summary, load_study, open_sweep, run_sweep
from twin.sweep.evaluate import Chunk
from twin.sweep.front import designs_on_front
from twin.sweep.names import columns_of
from twin.sweep.refinement import coarse_study, largest_errors, may_be_on_front
from twin.sweep.study import Value

FRONT = ("psnr_db", "minimum_time_s")


Point = tuple[np.ndarray, np.ndarray]


def _beats(one: Point, other: Point) -> bool:
    """Whether the first surely beats the second: two gains, and the errors of each."""
    if not np.isfinite([one[0], other[0]]).all():
        return False
    low, high = one[0] - one[1], other[0] + other[1]
    return bool((low >= high).all() and (low > high).any())


def test_points_that_may_be_on_the_front_against_every_pair() -> None:
    """Brute force over draws with ties, unknown numbers, unknown errors and void points."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        n = int(rng.integers(1, 12))
        gains = rng.integers(0, 6, (2, n)).astype(float)
        errors = rng.choice([0.0, 0.0, 0.5, 1.0, 3.0, np.inf], (2, n))
        gains[rng.random((2, n)) < 0.05] = rng.choice([np.nan, np.inf, -np.inf])
        counts = rng.random(n) < 0.9

        points = list(zip(gains.T, errors.T, strict=True))
        others = [point for point, beats_others in zip(points, counts, strict=True) if beats_others]
        expected = [not any(_beats(other, point) for other in others) for point in points]
        assert may_be_on_front(gains, errors, counts).tolist() == expected


def test_no_point_of_a_sweep_is_beyond_its_largest_error_but_in_one_of_twenty() -> None:
    rng = np.random.default_rng(5)
    error = largest_errors(np.ones((2, 450)), np.zeros((2, 450)))
    beyond = np.mean([(np.abs(rng.standard_normal((2, 450))) > error).any() for _ in range(2000)])
    assert 0.03 < beyond < 0.07
    assert largest_errors(np.array([np.nan]), np.zeros(1)) == np.inf


@pytest.mark.parametrize(
    ("said", "coarse"),
    [
        ({}, "1.0"),
        ({"fidelity.tolerance": 0.05}, "1.0"),
        ({"fidelity.tolerance": "0.1, 2 %, 0.5 dB"}, "1.0, 10.0 %, 2.5 dB"),
        ({"fidelity.tolerance": 0.1, "fidelity.noise": "none"}, "1.0"),
        ({"fidelity.tolerance": 1.0}, None),
        ({"fidelity.tolerance": 3}, None),
        ({"fidelity.preset": "draft"}, None),
        ({"fidelity.max_depth": 1}, None),
    ],
)
def test_what_the_first_pass_computes(said: dict[str, Value], coarse: str | None) -> None:
    """A tolerance of all that the study sets, its knobs as they are; else there is one pass."""
    study = Study(name="s", metrics=FRONT, front=FRONT, set=said)
    first = coarse_study(study)
    assert (first and first.set) == (coarse and {**said, "fidelity.tolerance": coarse})
    assert coarse_study(Study(name="s", metrics=FRONT, set=said)) is None


class Simulated:
    """Points whose values are known: to a tolerance they are off by draws that their columns state,
    the same ones at each tolerance, as light of common paths is.
    """

    def __init__(self, truth: np.ndarray, rng: np.random.Generator) -> None:
        self.truth, self.off = truth, rng.standard_normal(truth.shape)
        self.scale = rng.uniform(0.05, 1.0, truth.shape) * truth.std(axis=1, keepdims=True) / 3
        self.points: list[tuple[float, int]] = []

    def __call__(self, study: Study, points: np.ndarray, inputs: object) -> Chunk:
        share = Tolerance.of(str(study.set["fidelity.tolerance"])).noise_share
        values = {}
        for row, name in enumerate(FRONT):
            error = share * self.scale[row, points]
            values[name] = self.truth[row, points] + self.off[row, points] * error
            values[f"{name}.standard_error"] = error
            values[f"{name}.systematic"] = np.zeros(len(points))
            values[f"{name}.noise"] = np.full(len(points), np.inf)  # all points draw the same
        assert set(values) == set(columns_of(FRONT, "rendered"))
        self.points += [(share, int(point)) for point in points]
        void = [int(p) for p in points if p % 17 == 3]
        failed = {int(p): "InputError: no" for p in points if p % 29 == 5}
        for name in values:
            values[name][[i for i, p in enumerate(points) if int(p) in failed]] = np.nan
        return Chunk(points, values, failed, void={"camera": void})


def _simulated(
    monkeypatch: pytest.MonkeyPatch, out: Path, front: tuple[str, str] | None, seed: int
) -> tuple[Summary, Simulated]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 20)), int(rng.integers(1, 20))
    points = Simulated(rng.standard_normal((2, n[0] * n[1])), np.random.default_rng(seed + 1))
    monkeypatch.setattr("twin.sweep.run.evaluate_points", points)
    study = Study(
        name="s",
        metrics=FRONT,
        front=front,
        set={"fidelity.tolerance": 0.1},
        grid={
            "scene.rig.x_m": [float(x) for x in range(n[0])],
            "system.readout.read_noise_e": [1e3 + i for i in range(n[1])],
        },
    )
    return run_sweep(study, out=out, workers=0), points


@pytest.mark.quick(2)
@pytest.mark.parametrize("seed", range(8))
def test_the_front_is_that_of_all_points_as_asked_for(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On random studies with void and failed points: the same designs, with the same bits."""
    done, points = _simulated(monkeypatch, tmp_path / "two", FRONT, seed)
    two = open_sweep(done.out)
    full, _ = _simulated(monkeypatch, tmp_path / "one", None, seed)
    one = open_sweep(full.out)
    assert designs_on_front(two, *FRONT).rows == designs_on_front(one, *FRONT).rows
    assert done.n_failed == full.n_failed
    assert done.n_void == full.n_void
    assert full.n_coarse is None
    coarse = two["coarse"].to_numpy()
    assert done.n_coarse == coarse.sum() == two.attrs["points_coarse"]
    assert (
        sorted(p for share, p in points.points if share == 0.1)
        == np.flatnonzero(~coarse.ravel()).tolist()
    )
    ratio = two["psnr_db.standard_error"] / one["psnr_db.standard_error"]
    np.testing.assert_allclose(ratio.to_numpy()[coarse], 10)
    for name in columns_of(FRONT, "rendered"):
        np.testing.assert_array_equal(two[name].to_numpy()[~coarse], one[name].to_numpy()[~coarse])
    if done.n_points > 100:
        assert done.n_coarse > done.n_points / 3


class _KilledError(Exception):
    pass


def _kill_after(monkeypatch: pytest.MonkeyPatch, lines: int) -> None:
    """Of the journal."""
    from twin.sweep.store import Store

    append, budget = Store._append, iter([None] * lines)

    def killed(self: Store, entry: dict) -> None:
        if next(budget, "end") == "end":
            raise _KilledError
        append(self, entry)

    monkeypatch.setattr(Store, "_append", killed)


@pytest.mark.thorough
def test_a_sweep_killed_while_it_refines_goes_on_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever it is killed: after numbers are written and before the journal says so, too."""
    from twin.sweep.store import Store

    monkeypatch.setattr("twin.sweep.run._RENDERED_CHUNK", 4)
    _simulated(monkeypatch, tmp_path / "whole", FRONT, 3)
    whole = open_sweep(tmp_path / "whole")
    append = Store._append
    for left in range(1, 40, 3):
        _kill_after(monkeypatch, left)
        out = tmp_path / f"killed{left}"
        try:
            _simulated(monkeypatch, out, FRONT, 3)
        except _KilledError:
            monkeypatch.setattr(Store, "_append", append)
            _simulated(monkeypatch, out, FRONT, 3)
        else:
            break
        assert open_sweep(out).drop_attrs().identical(whole.drop_attrs())
    assert left > 10


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::twin.sweep.DamagedWarning")
def test_numbers_that_were_damaged_after_they_were_refined_are_computed_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of both passes, and killed at any line meanwhile: the first pass writes over the second."""
    from twin.sweep.store import Store

    monkeypatch.setattr("twin.sweep.run._RENDERED_CHUNK", 4)
    _simulated(monkeypatch, tmp_path / "whole", FRONT, 3)
    whole = open_sweep(tmp_path / "whole").load()
    refined = int(np.flatnonzero(~whole["coarse"].to_numpy().ravel())[0])
    append = Store._append
    for left in range(6):
        out = tmp_path / f"damaged{left}"
        shutil.copytree(tmp_path / "whole", out)
        shutil.rmtree(out / "results.zarr")
        numbers = out / "points" / f"{FRONT[0]}.npy"
        content = bytearray(numbers.read_bytes())
        content[8 * (refined - whole["coarse"].size) + 6] ^= 16
        numbers.write_bytes(content)
        with pytest.raises(InputError, match="points: is damaged"):
            open_sweep(out)
        _kill_after(monkeypatch, left)
        with suppress(_KilledError):
            _simulated(monkeypatch, out, FRONT, 3)
        monkeypatch.setattr(Store, "_append", append)
        _simulated(monkeypatch, out, FRONT, 3)
        xarray.testing.assert_identical(open_sweep(out).drop_attrs(), whole.drop_attrs())


@pytest.mark.whole
def test_rendered_points_far_from_the_front_are_left_coarse(
    study, a_worker: str, tmp_path: Path
) -> None:
    """One process, another one and the full sweep: the same front, the same bits. Of a scene at
    rest: motion that is taken as still leaves scores next to no bound.
    """
    head = """
scene = "table1"
metrics = ["snr_median", "psnr_db"]
{front}
[set]
"system.emitter.rows" = 16
"system.emitter.columns" = 16
"system.acquisition.n_patterns" = 256
"""
    grid = (
        '[grid]\n"scene.rig.x_m" = [0.0, 0.05]\n"system.readout.read_noise_e" = [1e4, 2e4]\n'
        '"system.acquisition.integration_time_s" = ["20 us", "50 us", "200 us", "300 us"]\n'
    )
    front = 'front = ["snr_median", "psnr_db"]'
    path = study(grid, head.replace("{front}", front))
    two = run_sweep(path, out=tmp_path / "two", workers=0)
    shared = run_sweep(path, out=tmp_path / "shared", scheduler=a_worker)
    full = run_sweep(study(grid, head.replace("{front}", ""), name="full"), out=tmp_path / "full",
                     workers=0)  # fmt: skip
    names = ("snr_median", "psnr_db")
    found = [designs_on_front(open_sweep(run.out), *names).rows for run in (two, shared, full)]
    assert found[0] == found[1] == found[2]
    assert two.n_coarse == shared.n_coarse
    assert 0 < two.n_coarse < two.n_points
    one, other = (open_sweep(run.out).drop_attrs() for run in (two, shared))
    assert one.identical(other)
    again = run_sweep(path, out=tmp_path / "two", workers=0)
    assert again == two


def test_a_parameter_without_effect_is_told_where_it_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of points of one accuracy, all with numbers. Between a coarse point and a fine one a step of
    the values is no effect, and none tells of no effect; nor does a point without a number. On
    43f3f9f7 such points counted as equal: a parameter was told to change nothing whose points were
    all of two accuracies, infinite, or failed.
    """
    from twin.sweep import effects

    done, _ = _simulated(monkeypatch, tmp_path / "out", FRONT, 3)
    data = open_sweep(done.out).load()
    coarse = data["coarse"].to_numpy()
    for name in FRONT:
        data[name][:] = np.where(coarse, 1.0, 1.1)
    data["void"][:] = False  # what decides it has an effect as well
    assert coarse.any()
    assert not coarse.all()
    assert not list(effects.without_effect(data))
    by_one = data["psnr_db"].dims.index("system.readout.read_noise_e")
    data["coarse"][:] = np.take(coarse, [0], axis=by_one)  # of one accuracy along read noises
    for name in FRONT:
        data[name][:] = np.where(data["coarse"], 1.0, 1.1)
    assert list(effects.without_effect(data)) == ["system.readout.read_noise_e"]
    data["coarse"][:] = False
    data["minimum_time_s"][:] = data["psnr_db"][:] = 1.0
    both = {"scene.rig.x_m", "system.readout.read_noise_e"}
    assert set(effects.without_effect(data)) == both
    for unknown in (np.nan, np.inf):
        some = data.copy(deep=True)
        some["psnr_db"][0, 0] = unknown
        assert not list(effects.without_effect(some))
        some["psnr_db"][:] = unknown
        assert not list(effects.without_effect(some))
    data["psnr_db"][0, 0] = 3.0
    assert not list(effects.without_effect(data))


def test_a_metric_of_ones_own_says_which_is_better(tmp_path: Path) -> None:
    """By an attribute, of which `show` knows too."""

    def brightest(outcome) -> float:
        """Light of the brightest cell."""
        return float(outcome.capture.scene_e.max())

    def frames(outcome) -> float:
        """Frames."""
        return 1.0

    brightest.better = "less"
    small = {
        "fidelity.samples": 4,
        "system.acquisition.n_patterns": 256,
        "fidelity.max_depth": 1,
        "system.emitter.rows": 16,
        "system.emitter.columns": 16,
    }
    grid = {"system.optics.f_number": [1.0, 2.0]}
    study = Study(
        name="own", metrics=[frames, brightest], front=[frames, brightest], set=small, grid=grid
    )
    data = open_sweep(run_sweep(study, out=tmp_path / "out", workers=0).out)
    rows = designs_on_front(data, *study.metrics).rows
    assert [row["system.optics.f_number"] for row in rows] == [2.0]
    assert "coarse" not in data
    brightest.better = "fewer"
    with pytest.raises(InputError, match="better = 'fewer', expected 'more' or 'less'"):
        run_sweep(Study(name="own", metrics=[brightest], set=small), out=tmp_path / "no", workers=0)


@pytest.mark.parametrize(
    ("front", "complaint"),
    [
        ('["snr", "psnr_db"]', "front: 'psnr_db' is none of the metrics snr"),
        ('["snr", "snr"]', "front: 'snr' stands twice"),
        ('["snr"]', "front"),
        ('"snr"', "front"),
    ],
)
def test_a_front_that_can_not_be_is_told(study, front: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        load_study(study("", f"{CLOSED}front = {front}\n"))


def test_the_command_and_the_list_of_designs_tell_of_coarse_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Designs on another front than the study's may be coarse, which is said."""
    done, _ = _simulated(monkeypatch, tmp_path / "out", FRONT, 3)
    words = ["show", str(done.out), "--metric", FRONT[0], "--front", FRONT[1], "--json"]
    verdict = json.loads(CliRunner().invoke(app, words).stdout)["verdict"]
    assert "coarse" not in verdict
    data = open_sweep(done.out).load()
    data["coarse"][:] = True
    told = designs_on_front(data, *FRONT).verdict
    assert "of them were computed coarsely: name this front in the study" in told
