"""The designs on a Pareto front of two metrics, as rows: printed, as CSV and as JSON."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.files import whole_file
from hardware.formatting import setting_text, with_error
from twin.sweep.dataset import COARSE, column, gain, half_width
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
        Of each design its ``point``, parameters, metrics, and ``METRIC.half_width`` of the interval
        that holds the true value in 95 of 100 cases, NaN where the sweep has none.
    units
        Of the metrics.
    n_points
        Points with a number of both metrics.
    n_coarse
        Designs that were computed to a coarse tolerance alone: the study names another front.
    """

    metrics: tuple[str, str]
    parameters: tuple[str, ...]
    rows: list[dict[str, Any]]
    units: dict[str, str]
    n_points: int
    n_coarse: int = 0

    @property
    def verdict(self) -> str:
        """How many there are."""
        if not self.n_points:
            return f"no point has a number of both {self.metrics[0]} and {self.metrics[1]}"
        coarse = ""
        if self.n_coarse:
            coarse = (
                f"; {self.n_coarse} of them to a coarse tolerance: name this front in the study"
            )
        return f"{len(self.rows)} of {self.n_points} points are beaten by none{coarse}"

    @property
    def title(self) -> str:
        """Of the table."""
        return f"{self.metrics[0]} and {self.metrics[1]}: designs that no other beats in both"

    @property
    def heads(self) -> tuple[str, ...]:
        """Of the table's columns."""
        return ("point", *self.parameters, *self.metrics)

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
            )
            for row in self.rows
        ]


def designs_on_front(
    data: "xarray.Dataset", first: str, second: str, *, void: bool = False
) -> FrontDesigns:
    """Designs on the front of a sweep's dataset; ``void``: points of void records count too.

    Raises InputError for a metric that was not measured.
    """
    names = (first, second)
    columns = [column(data, name, void=void) for name in names]
    values = [each.to_numpy().ravel() for each in columns]
    front = pareto_front(np.stack([gain(each).to_numpy().ravel() for each in columns]))
    front = front[np.argsort(values[0][front], kind="stable")]
    shape = columns[0].shape
    parameters = tuple(sorted(str(name) for name in data.coords))
    # Of two metrics one may vary along fewer dimensions than the points do.
    settings = {
        name: np.broadcast_to(
            data[name].broadcast_like(columns[0]).transpose(*columns[0].dims).to_numpy(), shape
        ).ravel()
        for name in parameters
    }
    widths = {name: half_width(data, name) for name in names}
    rows = [
        {
            "point": int(point),
            **{name: settings[name][point].item() for name in parameters},
            **{name: float(v[point]) for name, v in zip(names, values, strict=True)},
            **{
                f"{name}.half_width": float("nan")
                if width is None
                else float(width.to_numpy().ravel()[point])
                for name, width in widths.items()
            },
        }
        for point in front
    ]
    units = {name: _unit(data[name]) for name in names}
    n_points = int(np.isfinite(sum(values)).sum())
    n_coarse = int(data[COARSE].to_numpy().ravel()[front].sum()) if COARSE in data else 0
    return FrontDesigns(names, parameters, rows, units, n_points, n_coarse)


def write_designs(designs: FrontDesigns, path: Path) -> None:
    """A CSV file, one row per design; unknown values are empty."""
    heads = list(designs.rows[0]) if designs.rows else list(designs.heads)
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, heads)
        writer.writeheader()
        for row in designs.rows:
            writer.writerow({name: "" if value != value else value for name, value in row.items()})


def _unit(metric: "xarray.DataArray") -> str:
    unit = str(metric.attrs.get("units", ""))
    return "" if unit == "1" else unit


def _figure(value: float, width: float, unit: str) -> str:
    return with_error(value, 0.0 if np.isnan(width) else width, unit)
