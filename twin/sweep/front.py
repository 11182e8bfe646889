"""Points of a sweep as rows, those on a Pareto front of two metrics or all: printed, as CSV and as
JSON.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hardware.files import whole_file
from hardware.formatting import setting_text, with_error
from twin.sweep.dataset import COARSE, column, gain, half_width, metrics_of, warned_points
from twin.sweep.names import ERRORS, RENDERED, check_two
from twin.sweep.show import pareto_front

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class FrontDesigns:
    """Designs that no other point beats in both metrics, by the first metric.

    Parameters
    ----------
    metrics, parameters
        Names.
    rows
        Of each design its ``point``, parameters, metrics, and of each metric's interval
        (`twin.accuracy.Interval`) ``METRIC.half_width`` and what it holds,
        ``METRIC.standard_error``, ``METRIC.systematic`` and ``METRIC.noise``, NaN where the sweep
        has none; and kinds of warnings that were given of it, as ``warned``.
    units
        Of the metrics.
    n_points
        Points with a number of both metrics.
    n_coarse
        Designs that were computed to a coarse tolerance alone: the study names another front.
    n_equal
        Points beside them that equal one of them in both metrics.
    """

    metrics: tuple[str, str]
    parameters: tuple[str, ...]
    rows: list[dict[str, Any]]
    units: dict[str, str]
    n_points: int
    n_coarse: int = 0
    n_equal: int = 0

    @property
    def verdict(self) -> str:
        """How many there are."""
        if not self.n_points:
            return f"no point has a number of both {self.metrics[0]} and {self.metrics[1]}"
        coarse = ""
        if self.n_coarse:
            coarse = (
                f"; {self.n_coarse} of them were computed coarsely: name this front in the study"
            )
        equal = f"; {self.n_equal} more equal one of them in both metrics" if self.n_equal else ""
        return f"{len(self.rows)} of {self.n_points} points are on the Pareto front{coarse}{equal}"

    @property
    def title(self) -> str:
        """Of the table."""
        return f"Pareto front of {self.metrics[0]} and {self.metrics[1]}"

    @property
    def heads(self) -> tuple[str, ...]:
        """Of the table's columns."""
        return ("point", *self.parameters, *self.metrics, *(["warned"] if self._is_warned else []))

    @property
    def _is_warned(self) -> bool:
        return any(row["warned"] for row in self.rows)

    @property
    def cells(self) -> list[tuple[str, ...]]:
        """Texts under the heads."""
        return [
            (
                str(row["point"]),
                *(setting_text(name, row[name]) for name in self.parameters),
                *(
                    _figure(row[name], row[f"{name}.half_width"], self.units[name])
                    for name in self.metrics
                ),
                *([row["warned"]] if self._is_warned else []),
            )
            for row in self.rows
        ]


def designs_on_front(
    data: "xarray.Dataset", first: str, second: str, *, void: bool = False
) -> FrontDesigns:
    """Designs on the front of a sweep's dataset; ``void``: points of void records count too.

    Raises InputError for a metric that was not measured, and for the same one twice.
    """
    check_two(first, second)
    names = (first, second)
    columns = [column(data, name, void=void) for name in names]
    values = [each.to_numpy().ravel() for each in columns]
    gains = np.stack([gain(each).to_numpy().ravel() for each in columns])
    front = pareto_front(gains)
    front = front[np.argsort(values[0][front], kind="stable")]
    known = np.isfinite(gains).all(axis=0)
    as_one, on_front = (one + 1j * two for one, two in (gains[:, known], gains[:, front]))
    n_equal = int(np.isin(as_one, on_front).sum()) - len(front)
    rows = _rows(data, names, front, void=void)
    units = {name: _unit(data[name]) for name in names}
    n_coarse = int(data[COARSE].to_numpy().ravel()[front].sum()) if COARSE in data else 0
    return FrontDesigns(names, _parameters(data), rows, units, int(known.sum()), n_coarse, n_equal)


def all_points(data: "xarray.Dataset", *, void: bool = False) -> list[dict[str, Any]]:
    """Every point of a sweep's dataset as a row like those of `FrontDesigns`, with all metrics and,
    as ``error``, why it failed.
    """
    errors = data["error"].to_numpy().ravel()
    rows = _rows(data, metrics_of(data), np.arange(len(errors)), void=void)
    return [row | {"error": str(error)} for row, error in zip(rows, errors, strict=True)]


def write_rows(rows: list[dict[str, Any]], path: Path, heads: Sequence[str] = ()) -> None:
    """A CSV file, one row per point, under the rows' own heads or, where there are none, those
    given; unknown values are empty.
    """
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else heads)
        writer.writeheader()
        for row in rows:
            writer.writerow({name: "" if value != value else value for name, value in row.items()})


def _rows(
    data: "xarray.Dataset", metrics: Sequence[str], points: NDArray[np.intp], *, void: bool
) -> list[dict[str, Any]]:
    """Number, parameters, metrics, their intervals and warnings of some points."""
    like = data[metrics[0]]
    found: dict[str, list[Any]] = {"point": points.tolist()}
    for name in _parameters(data):
        # A parameter varies along its own dimension alone.
        settings = data[name].broadcast_like(like).transpose(*like.dims)
        found[name] = settings.to_numpy().ravel()[points].tolist()
    values = {name: _values(data, name, void=void)[points] for name in metrics}
    for name in metrics:
        found[name] = values[name].tolist()
    for name in metrics:
        parts = {kind: data[f"{name}.{kind}"] for kind in ERRORS if f"{name}.{kind}" in data}
        for kind in ("half_width", *ERRORS):
            figures = half_width(data, name) if kind == "half_width" else parts.get(kind)
            known = np.full(like.size, np.nan) if figures is None else figures.to_numpy().ravel()
            told = np.where(np.isnan(values[name]), np.nan, known[points])
            found[f"{name}.{kind}"] = told.tolist()
    marked = {one.kind: set(one.points) for one in warned_points(data)}
    found["warned"] = [
        " ".join(kind for kind, some in marked.items() if point in some)
        for point in points.tolist()
    ]
    return [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]


def _values(data: "xarray.Dataset", metric: str, *, void: bool) -> NDArray[np.float64]:
    """A metric of all points; NaN where the record is void, unless it says why it is."""
    says_why = metric in RENDERED and RENDERED[metric].why_void
    return column(data, metric, void=void or says_why).to_numpy().ravel()


def _parameters(data: "xarray.Dataset") -> tuple[str, ...]:
    return tuple(sorted(str(name) for name in data.coords))


def _unit(metric: "xarray.DataArray") -> str:
    unit = str(metric.attrs.get("units", ""))
    return "" if unit == "1" else unit


def _figure(value: float, width: float, unit: str) -> str:
    return with_error(value, 0.0 if np.isnan(width) else width, unit)
