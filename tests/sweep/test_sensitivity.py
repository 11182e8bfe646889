"""Sensitivities: shares of variance that are known in closed form, inside their intervals."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

from twin import cli
from twin.files import InputError
from twin.sweep import load_study, open_sweep, run_sweep
from twin.sweep.dataset import Progress, dataset
from twin.sweep.sensitivity import (
    Share,
    incomplete_sample,
    sensitivities,
    values_without_number,
)
from twin.sweep.show import plot_sensitivities

REFLECTANCE, DISTANCE, NOTHING = (
    "link.reflectance",
    "link.distance_m",
    "system.readout.read_noise_e",
)
#: The signal is reflectance over distance squared, and knows nothing of the readout.
STUDY = """
model = "closed-form"
metrics = ["signal_e_per_s"]
[sample]
method = "{method}"
n = {n}
seed = {seed}
[sample.ranges]
"link.reflectance" = {{ low = 0.2, high = 0.8 }}
"link.distance_m" = {{ low = 1.0, high = 2.0, log = true }}
"system.readout.read_noise_e" = {{ low = 1.0, high = 1e4 }}
"""


def exact() -> dict[str, tuple[float, float]]:
    """First and total order of a product of independent factors: with c = var / mean^2 of each,
    the variance is (1 + a)(1 + b) - 1 of the mean squared.
    """
    a = (0.6**2 / 12) / 0.5**2
    # z^-2 with ln z uniform in 0 to L: mean (1 - e^-2L) / 2L, mean square (1 - e^-4L) / 4L.
    length = np.log(2.0)
    mean, square = (1 - 1 / 4) / (2 * length), (1 - 1 / 16) / (4 * length)
    b = square / mean**2 - 1
    v = a + b + a * b
    return {
        REFLECTANCE: (a / v, a * (1 + b) / v),
        DISTANCE: (b / v, b * (1 + a) / v),
        NOTHING: (0, 0),
    }


def run(folder: Path, method: str, n: int, seed: int = 0, extra: str = "") -> xarray.Dataset:
    path = folder / "study.toml"
    path.write_text(STUDY.format(method=method, n=n, seed=seed) + extra)
    out = folder / f"{method}-{n}-{seed}"
    run_sweep(path, out=out)
    return open_sweep(out).load()


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["latin-hypercube", "sobol", "saltelli"])
@pytest.mark.parametrize("n", [64, 128])
def test_shares_of_a_product(tmp_path: Path, method: str, n: int) -> None:
    """Of 8 draws at most 2 of 24 intervals of 95 % miss their share (each misses at 5 %, so by
    chance more do in 12 % of tests were they independent; seeds are fixed), and in the mean every
    share is right to 0.06: of the parameter without effect too, which binning gave 0.24 at 64
    points. Sobol points lie more evenly than chance has them, so that the correction for chance
    takes too much, at most 2 M / (n - 2 M) with M harmonics: 0.14 and 0.18.
    """
    found, missed = [], 0
    for seed in range(8):
        shares = sensitivities(run(tmp_path, method, n, seed), "signal_e_per_s")
        assert shares.keys() == exact().keys()
        found.append([share.first for share in shares.values()])
        for name, (first, total) in exact().items():
            share = shares[name]
            missed += abs(share.first - first) > share.first_error + 1e-12
            if method == "saltelli":
                missed += abs(share.total - total) > share.total_error + 1e-12
            else:
                assert np.isnan(share.total)
    assert missed <= 2
    truth = [first for first, _ in exact().values()]
    low = {64: 0.14, 128: 0.18}[n] if method == "sobol" else 0.06
    error = np.mean(found, axis=0) - truth
    assert (error < 0.06).all()
    assert (error > -low).all()


@pytest.mark.parametrize(("method", "n", "least"), [("sobol", 31, 32), ("saltelli", 8, 80)])
def test_too_few_points_are_refused(tmp_path: Path, method: str, n: int, least: int) -> None:
    """RBD-FAST draws halves of the points for its intervals, and divides by zero at 16 points."""
    with pytest.raises(InputError, match=f"drawn points are left, expected {least} or more"):
        sensitivities(run(tmp_path, method, n), "signal_e_per_s")
    if method == "sobol":
        shares = sensitivities(run(tmp_path, method, least), "signal_e_per_s")
        assert all(np.isfinite([share.first, share.first_error]).all() for share in shares.values())


def test_without_effect_is_zero_in_a_saltelli_sample(tmp_path: Path) -> None:
    """Crossings change such a parameter alone: not a bit of the metric moves."""
    share = sensitivities(run(tmp_path, "saltelli", 16), "signal_e_per_s")[NOTHING]
    assert share == Share(0.0, 0.0, 0.0, 0.0)


def ishigami(folder: Path, n: int) -> xarray.Dataset:
    """Values of sin x + 7 sin^2 y + 0.1 z^4 sin x over -pi to pi, as a sweep's dataset."""
    names = ("system.optics.f_number", DISTANCE, REFLECTANCE)
    ranges = "".join(f'"{name}" = {{ low = 0.25, high = 0.75 }}\n' for name in names)
    path = folder / "study.toml"
    path.write_text(
        'model = "closed-form"\nmetrics = ["snr"]\n'
        f'[sample]\nmethod = "saltelli"\nn = {n}\n[sample.ranges]\n{ranges}'
    )
    study = load_study(path)
    columns = study.columns(0, study.n_points)
    x, y, z = (4 * np.pi * (columns[name] - 0.5) for name in names)
    values = np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    plan = {"study": study.model_dump_json(exclude={"folder"})}
    return dataset(study, {"snr": values}, {"snr": ("1", "Ishigami")}, Progress(), plan)


def test_interactions_are_told_by_the_total_order(tmp_path: Path) -> None:
    """Ishigami and Homma (1990), where z acts through x alone: first order 0.3139, 0.4424, 0;
    total order 0.5576, 0.4424, 0.2437.
    """
    shares = list(sensitivities(ishigami(tmp_path, 1024), "snr").values())
    for share, first, total in zip(
        shares, (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437), strict=True
    ):
        assert abs(share.first - first) < share.first_error
        assert abs(share.total - total) < share.total_error
        assert share.total_error < 0.1
    assert shares[2].first + shares[2].first_error < shares[2].total - shares[2].total_error


def test_blocks_left_out_for_void_points_are_said_with_the_shares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """SNR over f-number and distance, near walls saturated, all points known over a grid too: the
    first order of the f-number of all points is in its interval with void points, and beyond it
    where their blocks are left out, which is said.
    """
    head = 'model = "closed-form"\nmetrics = ["snr"]\n[set]\n"link.reflectance" = 0.8\n'
    middles = (np.arange(40) + 0.5) / 40
    grid, drawn = tmp_path / "grid.toml", tmp_path / "drawn.toml"
    f_numbers, distances = (0.8 + 1.2 * middles).tolist(), (1 + 3 * middles).tolist()
    f_number = "system.optics.f_number"
    grid.write_text(f'{head}[grid]\n"{f_number}" = {f_numbers}\n"{DISTANCE}" = {distances}\n')
    drawn.write_text(
        f'{head}[sample]\nmethod = "saltelli"\nn = 512\n[sample.ranges]\n'
        f'"{f_number}" = {{ low = 0.8, high = 2.0 }}\n"{DISTANCE}" = {{ low = 1.0, high = 4.0 }}\n'
    )
    run_sweep(grid, out=tmp_path / "grid")
    run_sweep(drawn, out=tmp_path / "drawn")
    all_points = open_sweep(tmp_path / "grid")["snr"].to_numpy()
    truth = all_points.mean(axis=1).var() / all_points.var()
    data = open_sweep(tmp_path / "drawn").load()
    kept = sensitivities(data, "snr", void=True)[f_number]
    assert abs(kept.first - truth) < kept.first_error
    assert incomplete_sample(data, "snr", void=True) == ""
    left = sensitivities(data, "snr")[f_number]
    assert abs(left.first - truth) > left.first_error
    n = data["void"].to_numpy().reshape(512, 4).any(axis=1).sum()
    said = f"approximate: {n} of 512 blocks have points that are void; --void keeps them"
    assert incomplete_sample(data, "snr") == said
    picture = plot_sensitivities(data, "snr", sensitivities(data, "snr"))
    assert said in picture.axes[0].get_title()
    monkeypatch.setattr(sys, "argv", ["twin", "show", str(tmp_path / "drawn"), "-q", "--json"])
    with pytest.raises(SystemExit):
        cli.main()
    told = capsys.readouterr()
    assert f"warning: variance of snr: {said}" in told.err
    assert json.loads(told.out)["approximate"] == said
    text = drawn.read_text().replace('"saltelli"\nn = 512', '"latin-hypercube"\nn = 100')
    drawn.write_text(text)
    run_sweep(drawn, out=tmp_path / "even")
    data = open_sweep(tmp_path / "even").load()
    n = int(data["void"].sum())
    assert n > 0
    assert incomplete_sample(data, "snr").startswith(f"approximate: {n} of 100 drawn points are")


def test_a_grid_is_the_whole_of_what_it_describes() -> None:
    """Analysis of variance by hand: y = a + b + a b over two levels each of -1 and 1, so each term
    holds a third of the variance; no interval, for nothing was drawn.
    """
    a, b = np.array([[-1.0], [1.0]]), np.array([[-1.0, 1.0]])
    grid = xarray.Dataset({"m": (("a", "b"), a + b + a * b)}, {"a": [0, 1], "b": [0, 1]})
    for share in sensitivities(grid, "m").values():
        assert share == Share(pytest.approx(1 / 3), 0.0, pytest.approx(2 / 3), 0.0)
    with pytest.raises(InputError, match="is the same in every point"):
        sensitivities(grid * 0, "m")


def test_gaps_in_a_grid_confuse_nothing() -> None:
    """Y = 10 a with the highest a missing at the highest b: b moves nothing, though its conditional
    means differ; and an effect of b alone is b's.
    """
    a, b = np.arange(3.0)[:, None], np.arange(4.0)
    for y, cause, other in ((10 * a + 0 * b, "a", "b"), (0 * a + 10 * b, "b", "a")):
        table = y.copy()
        table[2, 3] = np.nan
        grid = xarray.Dataset({"m": (("a", "b"), table)}, {"a": np.arange(3), "b": np.arange(4)})
        shares = sensitivities(grid, "m")
        assert shares[other].first == pytest.approx(0.0, abs=1e-12)
        assert shares[other].total == pytest.approx(0.0, abs=1e-12)
        assert shares[cause].first == pytest.approx(1.0)
        assert shares[cause].total == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(8))
def test_total_order_is_first_order_and_interactions_in_a_grid_with_gaps(seed: int) -> None:
    """Void and failed points leave gaps, here a fifth. Of a sum without interactions both orders
    are the same; of any table total order is at least first order. In a whole table total order is
    the mean variance along its lines.
    """
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(5, 1, 1)), rng.normal(size=(4, 1)), rng.normal(size=3)
    gaps = rng.random((5, 4, 3)) < 0.2
    levels = {name: np.arange(n) for name, n in (("a", 5), ("b", 4), ("c", 3))}

    def shares_of(table):
        grid = xarray.Dataset({"m": (("a", "b", "c"), table)}, levels)
        return sensitivities(grid, "m").values()

    for share in shares_of(np.where(gaps, np.nan, a + b + c)):
        assert share.total == pytest.approx(share.first, abs=1e-12)
    table = a + b + c + rng.normal(size=gaps.shape)
    for share in shares_of(np.where(gaps, np.nan, table)):
        assert share.first <= share.total
    for axis, share in enumerate(shares_of(table)):
        assert share.total == pytest.approx(table.var(axis=axis).mean() / table.var())


def test_a_grid_beside_a_sample(tmp_path: Path) -> None:
    """Reflectance on a grid of 0.2, 0.5, 0.8 (variance 0.06) instead of drawn; the rest as before:
    shares follow from the same product, and sum to less than one by the interaction.
    """
    text = STUDY.format(method="saltelli", n=128, seed=0)
    text = "".join(line for line in text.splitlines(True) if REFLECTANCE not in line)
    path = tmp_path / "study.toml"
    path.write_text(text + f'[grid]\n"{REFLECTANCE}" = [0.2, 0.5, 0.8]\n')
    run_sweep(path, out=tmp_path / "out")
    shares = sensitivities(open_sweep(tmp_path / "out").load(), "signal_e_per_s")
    a, length = 0.06 / 0.5**2, np.log(2.0)
    b = ((1 - 1 / 16) / (4 * length)) / ((1 - 1 / 4) / (2 * length)) ** 2 - 1
    v = a + b + a * b
    for name, first, total in (
        (REFLECTANCE, a / v, a * (1 + b) / v),
        (DISTANCE, b / v, b * (1 + a) / v),
        (NOTHING, 0.0, 0.0),
    ):
        assert abs(shares[name].first - first) <= shares[name].first_error + 1e-12
        assert abs(shares[name].total - total) <= shares[name].total_error + 1e-12


def test_grid_values_that_are_void_throughout_are_left_out_of_a_sample(tmp_path: Path) -> None:
    """One of three values is void in all its points: shares are those of a study without it. They
    had been refused, as no drawn point has a number everywhere.
    """
    lux = "system.sky.illuminance_lx"
    data = run(tmp_path, "saltelli", 16, extra=f'[grid]\n"{lux}" = [0, 400, 1e5]\n')
    metric = data["signal_e_per_s"]
    gaps = data.assign(signal_e_per_s=metric.where(data[lux] < 1e5).assign_attrs(metric.attrs))
    assert values_without_number(data, "signal_e_per_s") == []
    assert values_without_number(gaps, "signal_e_per_s") == [f"{lux} = 100 klx"]
    expected = sensitivities(data.isel({lux: [0, 1]}), "signal_e_per_s")
    assert sensitivities(gaps, "signal_e_per_s") == expected

    # Void in all but one point, which is one drawn point of a block of 5: too few, and why.
    seventh = xarray.DataArray(np.arange(metric.sizes["sample"]) == 7, dims="sample")
    one = metric.where((data[lux] < 1e5) | seventh)
    gaps = data.assign(signal_e_per_s=one.assign_attrs(metric.attrs))
    with pytest.raises(
        InputError,
        match=r"0 drawn points are left, expected 80 or more: 79 of 240 points are void, failed, "
        rf"infinite or not a number, most at {lux} = 100 klx \(99 %\); --void takes void ones too",
    ):
        sensitivities(gaps, "signal_e_per_s")
    gaps = data.assign(signal_e_per_s=(metric * np.nan).assign_attrs(metric.attrs))
    with pytest.raises(
        InputError, match="0 drawn points are left, expected 80 or more: 240 of 240"
    ):
        sensitivities(gaps, "signal_e_per_s")


def test_a_grid_without_one_value_is_the_grid_of_the_others() -> None:
    """Total order divides by the levels of a parameter: those that have points."""
    table = np.random.default_rng(0).normal(size=(4, 3))
    table[2] = np.nan
    grid = xarray.Dataset({"m": (("a", "b"), table)}, {"a": np.arange(4), "b": np.arange(3)})
    whole = grid.isel(a=[0, 1, 3])
    assert sensitivities(grid, "m") == sensitivities(whole, "m")
    assert sensitivities(whole, "m")["a"].total == pytest.approx(
        np.delete(table, 2, axis=0).var(axis=0).mean() / np.nanvar(table)
    )


def test_a_share_of_rounding_is_printed_as_0() -> None:
    assert str(Share(2e-33, 1.5e-32, -1e-16, 0.0)) == "first order 0, total 0"
    assert str(Share(2e-4, 1e-5, 0.5, 0.1)) == "first order 0.000200 ± 1.0e-5, total 0.50 ± 0.10"


def test_bars_carry_their_intervals(tmp_path: Path) -> None:
    data = run(tmp_path, "saltelli", 32)
    shares = sensitivities(data, "signal_e_per_s")
    axis = plot_sensitivities(data, "signal_e_per_s", shares).axes[0]
    drawn = [c for c in axis.containers if hasattr(c, "has_xerr") and c.has_xerr]
    assert len(drawn) == 2  # of both orders
    ends = drawn[0].lines[2][0].get_segments()
    widest = max(abs(end[1][0] - end[0][0]) for end in ends)
    assert widest == pytest.approx(2 * max(share.first_error for share in shares.values()))
    again = sensitivities(data, "signal_e_per_s")
    assert again == shares  # a bootstrap of the same seed
