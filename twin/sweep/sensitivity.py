"""Which parameter moves a metric: shares of its variance, with confidence intervals.

First order: the share that a parameter explains by itself; total order: with all interactions that
it takes part in (Sobol, Math. Comput. Simul. 55, 2001). The estimators are SALib's.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import setting_text, with_error
from twin.files import InputError
from twin.sweep.dataset import WITHOUT_NUMBER, column

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]

#: Drawn points, of `saltelli` blocks, below which nothing is estimated. RBD-FAST estimates errors
#: from halves of the points, which have to be many more than twice its harmonics (4).
_LEAST_BLOCKS, _LEAST = 16, 32
_MANY = 10_000  # from here on the interval is so narrow that a rough one does
_Z95 = 1.96
_ROUNDING = 1e-12  # shares below it are those of sums of doubles


@dataclass(frozen=True)
class Share:
    """Shares of a metric's variance, each with half the width of its 95 % confidence interval.

    The width is 0 for a grid, which is the whole of what it describes. ``total`` is NaN where the
    sample does not tell it: that needs ``method = "saltelli"``.
    """

    first: float
    first_error: float
    total: float
    total_error: float

    def __str__(self) -> str:
        """Both orders with their errors."""
        told = f"first order {_text(self.first, self.first_error)}"
        if np.isnan(self.total):
            return f'{told}, total: needs method = "saltelli"'
        return f"{told}, total {_text(self.total, self.total_error)}"


def _text(share: float, error: float) -> str:
    return "0" if max(abs(share), error) < _ROUNDING else with_error(share, error)


@dataclass(frozen=True)
class _Design:
    """How the points of the last dimension were drawn, and (n, d) where, from 0 to 1."""

    method: str
    names: tuple[str, ...]
    unit: Array

    @property
    def block(self) -> int:
        """Rows that belong together: A, A with each column of B, and B."""
        return len(self.names) + 2 if self.method == "saltelli" else 1


def sensitivities(
    data: "xarray.Dataset", metric: str, *, void: bool = False, seed: int = 0
) -> dict[str, Share]:
    """Shares of a metric's variance, by parameter; those of a ``zip`` together, joined by ``+``.

    Points without a number, and without ``void`` those whose record is void, are left out; of a
    Saltelli sample with their whole block, which makes its shares approximate by more than their
    intervals say: `incomplete_sample`. Beside a sample a drawn point counts that has a number at
    all values of the grid, but for `values_without_number`. Grid: exact. ``saltelli``: both
    orders (Saltelli et al., Comput. Phys. Commun. 181, 2010, and Jansen's estimator of the total).
    ``latin-hypercube``, ``sobol``: first order by RBD-FAST without its bias (Tissot and Prieur,
    Reliab. Eng. Syst. Saf. 107, 2012); Sobol points are more even than that takes them to be, so
    theirs are up to 0.1 too low at 100 points. ``seed``: of the bootstrap.

    Raises InputError where the metric does not vary, or too few points are left.
    """
    values = _with_numbers(column(data, metric, void=void))
    design = _design(data)
    grid = _grid_of(values)
    drawn = ["sample"] if design else []
    table = values.transpose(*grid, *drawn).to_numpy().astype(np.float64)
    table = np.where(np.isfinite(table), table, np.nan)
    if design is None:
        return _of_grid(values, grid, table)
    table, design = _whole_rows(table, design)
    least = _LEAST_BLOCKS * design.block if design.method == "saltelli" else _LEAST
    if (n := table.shape[-1]) < least:
        raise InputError(
            f"{values.name}: {n} drawn points are left, expected {least} or more{_gaps(values)}"
        )
    independent = _independent(table, design)
    variance = _varying(values, independent)
    shares = _of_sample(table, design, variance, seed)
    return _of_grid(values, grid, independent, seed) | shares


def values_without_number(data: "xarray.Dataset", metric: str, *, void: bool = False) -> list[str]:
    """Values of a grid at which no point has a number, as text: shares are of the others."""
    values = column(data, metric, void=void)
    known = _known(values)
    return [
        _level(values, name, int(i))
        for name in _grid_of(values)
        for i in np.flatnonzero(~_along(known, name).any(axis=1))
    ]


def _with_numbers(values: "xarray.DataArray") -> "xarray.DataArray":
    """Without the values of a grid at which no point has a number; of none, as they are."""
    known = _known(values)
    if not known.any():
        return values
    return values[{name: _along(known, name).any(axis=1) for name in _grid_of(values)}]


def _known(values: "xarray.DataArray") -> "xarray.DataArray":
    return values.copy(data=np.isfinite(values.to_numpy()))


def _grid_of(values: "xarray.DataArray") -> list[str]:
    """Dimensions that were not drawn."""
    return [str(name) for name in values.dims if name != "sample"]


def _along(known: "xarray.DataArray", name: str) -> NDArray[np.bool_]:
    """Points (levels of a dimension, others)."""
    first = known.transpose(name, ...).to_numpy()
    return first.reshape(len(first), -1)


def _level(values: "xarray.DataArray", name: str, i: int) -> str:
    """A level of a dimension by all its parameters."""
    told = [
        f"{parameter} = {setting_text(str(parameter), coordinate.to_numpy()[i])}"
        for parameter, coordinate in values.coords.items()
        if coordinate.dims == (name,)
    ]
    return " with ".join(told)


def _gaps(values: "xarray.DataArray") -> str:
    """How many points have no number, and at which value of a grid most are: end of an error."""
    lacks = ~_known(values)
    if not lacks.any():
        return ""
    told = f": {int(lacks.sum())} of {lacks.size} points are {WITHOUT_NUMBER}"
    shares = [
        (_along(lacks, name)[i].mean(), _level(values, name, i))
        for name in _grid_of(values)
        for i in range(values.sizes[name])
    ]
    if shares:
        share, level = max(shares)
        told += f", most at {level} ({100 * share:.0f} %)"
    return f"{told}; --void takes void ones too"


def _design(data: "xarray.Dataset") -> _Design | None:
    sample = json.loads(data.attrs.get("study", "{}")).get("sample")
    if sample is None:
        return None
    names = tuple(str(name) for name in sample["ranges"])
    columns = []
    for name in names:
        drawn = data[name].to_numpy().astype(np.float64)
        drawn = np.log(drawn) if sample["ranges"][name]["log"] else drawn
        columns.append((drawn - drawn.min()) / max(np.ptp(drawn), 1e-300))
    return _Design(sample["method"], names, np.stack(columns, axis=1))


def _whole_rows(table: Array, design: _Design) -> tuple[Array, _Design]:
    """Drawn points that have a number everywhere, in whole blocks."""
    whole = np.repeat(_are_whole(table, design), design.block)
    return table[..., whole], _Design(design.method, design.names, design.unit[whole])


def _are_whole(table: Array, design: _Design) -> NDArray[np.bool_]:
    """Whether each block has a number everywhere."""
    known = np.isfinite(table.reshape(-1, table.shape[-1])).all(axis=0)
    return np.asarray(known.reshape(-1, design.block).all(axis=1))


def incomplete_sample(data: "xarray.Dataset", metric: str, *, void: bool = False) -> str:
    """How many drawn points, of a Saltelli sample how many blocks of them, are left out, in words;
    empty where none is.

    Those that stay are no sample of independent parameters: what is void is so for values that go
    together. Nor are blocks one of what is not void: the nearer a block's points are to those that
    are void, the likelier one of them is, so that it is left out as a whole.
    """
    design = _design(data)
    if design is None:
        return ""

    def are_whole(with_void: bool) -> NDArray[np.bool_]:
        values = _with_numbers(column(data, metric, void=with_void)).transpose(..., "sample")
        return _are_whole(values.to_numpy().astype(np.float64), design)

    whole = are_whole(void)
    if whole.all():
        return ""
    blocks = "blocks have points that are" if design.block > 1 else "drawn points are"
    told = f"approximate: {np.sum(~whole)} of {whole.size} {blocks}"
    if are_whole(True).all():
        return f"{told} void; --void keeps them"
    return f"{told} failed, infinite or not a number" + ("" if void else ", or void")


def _independent(table: Array, design: _Design) -> Array:
    """The points that are a plain sample: of each block A and B."""
    if design.block == 1:
        return table
    blocks = table.reshape(*table.shape[:-1], -1, design.block)
    return np.concatenate([blocks[..., 0], blocks[..., -1]], axis=-1)


def _varying(values: "xarray.DataArray", table: Array) -> float:
    variance = float(np.nanvar(table)) if np.isfinite(table).any() else 0.0
    if variance == 0:
        raise InputError(f"{values.name}: is the same in every point")
    return variance


def _of_grid(
    values: "xarray.DataArray", grid: list[str], table: Array, seed: int | None = None
) -> dict[str, Share]:
    """Analysis of variance over every dimension of a grid; ``seed``: the last dimension was drawn,
    and is drawn again for the intervals.
    """
    _varying(values, table)
    if not grid:
        return {}
    shares = _anova(table, len(grid))
    error = np.zeros_like(shares)
    if seed is not None:
        rng, n = np.random.default_rng(seed), table.shape[-1]
        again = [_anova(table[..., rng.integers(0, n, n)], len(grid)) for _ in range(_resamples(n))]
        error = _Z95 * np.std(again, axis=0)
    found = {}
    for dimension, (first, total), (first_error, total_error) in zip(
        grid, shares, error, strict=True
    ):
        names = [str(n) for n, c in values.coords.items() if c.dims == (dimension,)]
        share = Share(float(first), float(first_error), float(total), float(total_error))
        found[" + ".join(names) or dimension] = share
    return found


def _anova(table: Array, grid: int) -> Array:
    """First and total order (grid, 2) of the first dimensions of a table; others are repetitions.

    First: variance of a main effect over all variance. Total: first, and the mean variance along
    lines of what main effects leave, over all variance. Effects are fitted together, so that in a
    table with gaps, too, none takes another's for its own. The variance along lines of the table
    itself is the same sum where the table is whole; where it has gaps it weights the levels of an
    effect otherwise than first order does, and may come out below it.
    """
    known = np.isfinite(table)
    places = np.nonzero(known)[:grid]
    effects, left = _main_effects(table[known], places, table.shape[:grid])
    first = np.array([effect.var() for effect in effects])
    interactions = np.full(table.shape, np.nan)
    interactions[known] = left
    total = first.copy()
    for axis in range(grid):
        lines = np.moveaxis(interactions, axis, 0)
        n = np.isfinite(lines).sum(axis=0)
        several = n > 1
        mean = np.nansum(lines, axis=0)[several] / n[several]
        square = np.nansum((lines[:, several] - mean) ** 2)
        # Of a line with gaps the variance is estimated; of a whole one it is that of its points.
        free = float((n[several] - 1).sum())
        total[axis] += square / free * (1 - 1 / len(lines)) if free else 0.0
    return np.stack([first, total], axis=1) / (first.sum() + np.mean(left**2))


def _main_effects(
    y: Array, places: Sequence[NDArray[np.intp]], shape: Sequence[int]
) -> tuple[list[Array], Array]:
    """Effect of each level of each parameter that has points, by least squares, and what they leave
    of each point.
    """
    from scipy.sparse import csr_array, hstack

    row, one = np.arange(len(y)), np.ones(len(y))
    columns = [
        csr_array((one, (row, place)), shape=(len(y), n))
        for place, n in zip(places, shape, strict=True)
    ]
    indicator = hstack(columns, format="csr")
    centred = y - y.mean()
    normal = (indicator.T @ indicator).toarray()
    fitted = np.linalg.lstsq(normal, indicator.T @ centred, rcond=1e-10)[0]
    seen = normal.diagonal() > 0
    ends = np.cumsum(shape)[:-1]
    levels = zip(np.split(fitted, ends), np.split(seen, ends), strict=True)
    return [effect[some] for effect, some in levels], centred - indicator @ fitted


def _of_sample(table: Array, design: _Design, variance: float, seed: int) -> dict[str, Share]:
    """Drawn parameters. What a grid beside them adds to all variance is in none of their shares."""
    cells = table.reshape(-1, table.shape[-1])
    mean = cells.mean(axis=0)
    first, first_error = np.array(_analyse(mean, design, seed)[:2]) * (
        _independent(mean, design).var() / variance
    )
    total = total_error = np.full(len(design.names), np.nan)
    if design.method == "saltelli":
        each = [np.array(_analyse(cell, design, seed)[2:]) for cell in cells]
        weight = _independent(cells, design).var(axis=1) / (len(cells) * variance)
        # Cells share their points: that their errors add up is the worst case.
        total, total_error = np.tensordot(weight, each, axes=1)
    columns = zip(first, first_error, total, total_error, strict=True)
    return {n: Share(*map(float, row)) for n, row in zip(design.names, columns, strict=True)}


def _analyse(y: Array, design: _Design, seed: int) -> tuple[Any, Any, Any, Any]:
    """First order, its error, total order and its error (d,), as SALib finds them."""
    from SALib.analyze import rbd_fast, sobol

    d = len(design.names)
    nothing = np.full(d, np.nan)
    if np.ptp(y) == 0:
        return np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d)
    problem = {"num_vars": d, "names": list(design.names), "bounds": [[0.0, 1.0]] * d}
    if design.method == "saltelli":
        found = sobol.analyze(
            problem,
            y,
            calc_second_order=False,
            num_resamples=_resamples(len(y)),
            seed=seed + 1,  # SALib takes 0 for none
        )
        return found["S1"], found["S1_conf"], found["ST"], found["ST_conf"]
    harmonics = 10 if len(y) >= 100 else 4
    found = rbd_fast.analyze(
        problem, design.unit, y, M=harmonics, num_resamples=_resamples(len(y)), seed=seed + 1
    )
    return found["S1"], found["S1_conf"], nothing, nothing


def _resamples(n: int) -> int:
    return 200 if n < _MANY else 20
