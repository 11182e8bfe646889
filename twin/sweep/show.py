"""Pictures of a sweep: a metric over any two dimensions, a Pareto front, sensitivities.

Points whose record is void are left out, unless ``void``; the title says how many.
"""

import warnings
from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hardware.formatting import number
from twin.files import InputError
from twin.report.style import BLUE, GREY, ORANGE, new_figure
from twin.sweep.dataset import WITHOUT_NUMBER, column, gain, half_width
from twin.sweep.names import check_two
from twin.sweep.sensitivity import Share, incomplete_sample

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]


def plot_plane(
    data: "xarray.Dataset", metric: str, x: str, y: str | None = None, *, void: bool = False
) -> Figure:
    """A metric over one parameter (a line; with bars of the 95 % intervals where nothing else
    varies), or over two (a map); medians over all others.
    """
    values = column(data, metric, void=void)
    left_out = _left_out(data, values)
    axes = [_axis(data, name) for name in (x, y) if name is not None]
    others = [name for name in values.dims if name not in [a.dims[0] for a in axes]]
    values = _median(values, others) if others else values
    figure = new_figure((6.4, 4.2))
    axis = figure.subplots()
    rest = f", median over {', '.join(map(str, others))}" if others else ""
    axis.set_title(f"{_label(data[metric])}{rest}{left_out}", fontsize=9, wrap=True)
    if len(axes) == 1:
        width = None if others else half_width(data, metric)
        bars = None if width is None else np.where(np.isfinite(width), width, 0.0)
        (places,) = _places(axes[0])
        axis.errorbar(places, values.to_numpy(), bars, fmt=".-", color=BLUE, capsize=2)
        axis.set_xlabel(_label(axes[0]))
        axis.set_ylabel(_label(data[metric]))
        return figure
    if axes[0].dims == axes[1].dims:  # two columns of one sample
        points = axis.scatter(axes[0], axes[1], c=values.to_numpy(), cmap="cividis", s=12)
        axis.set_xlabel(_label(axes[0]))
        axis.set_ylabel(_label(axes[1]))
        figure.colorbar(points, label=_label(data[metric]))
        return figure
    plane = values.transpose(axes[1].dims[0], axes[0].dims[0]).to_numpy()
    image = axis.imshow(plane, origin="lower", aspect="auto", cmap="cividis")
    for set_ticks, coordinate in ((axis.set_xticks, axes[0]), (axis.set_yticks, axes[1])):
        shown = np.unique(np.linspace(0, len(coordinate) - 1, 8).astype(int))
        set_ticks(shown, [_short(coordinate.to_numpy()[i]) for i in shown])
    axis.set_xlabel(_label(axes[0]))
    axis.set_ylabel(_label(axes[1]))
    figure.colorbar(image, label=_label(data[metric]))
    return figure


def _median(values: "xarray.DataArray", over: Sequence[Hashable]) -> "xarray.DataArray":
    """Median over dimensions; no number where none of the points has one."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
        return values.median(over).compute()


def plot_front(data: "xarray.Dataset", first: str, second: str, *, void: bool = False) -> Figure:
    """All points in the plane of two metrics, and those that no other point beats in both. Raises
    InputError for the same metric twice.
    """
    check_two(first, second)
    columns = [column(data, name, void=void) for name in (first, second)]
    one, two = (values.to_numpy().ravel() for values in columns)
    front = pareto_front(np.stack([gain(each).to_numpy().ravel() for each in columns]))
    figure = new_figure((6.0, 4.2))
    axis = figure.subplots()
    axis.plot(one, two, ".", color=GREY, markersize=4, label="points")
    order = front[np.argsort(one[front])]
    axis.plot(one[order], two[order], "o-", color=ORANGE, markersize=5, label="Pareto front")
    axis.set_xlabel(_label(data[first]))
    axis.set_ylabel(_label(data[second]))
    left_out = _left_out(data, columns[0] + columns[1])
    known = np.isfinite(one + two).sum()
    axis.set_title(f"{len(front)} of {known} points are on the Pareto front{left_out}", fontsize=10)
    axis.legend(frameon=False)
    return figure


def plot_sensitivities(
    data: "xarray.Dataset", metric: str, shares: Mapping[str, Share], *, void: bool = False
) -> Figure:
    """How much of a metric's variance each parameter explains by itself, and with others; bars of
    95 % confidence.
    """
    names = sorted(shares, key=lambda name: shares[name].first)
    figure = new_figure((6.4, 0.45 * len(names) + 1.5))
    axis = figure.subplots()
    place = np.arange(len(names))
    error = {"capsize": 2, "elinewidth": 1}
    for order, shift, color in (("first", 0.19, BLUE), ("total", -0.19, ORANGE)):
        widths = np.array([getattr(shares[name], order) for name in names])
        errors = np.array([getattr(shares[name], f"{order}_error") for name in names])
        if np.isfinite(widths).any():
            label = "by itself (first order)" if order == "first" else "with others (total order)"
            axis.barh(
                place + shift, widths, 0.36, xerr=errors, color=color, error_kw=error, label=label
            )
    axis.axvline(0, color=GREY, linewidth=0.8)
    axis.set_yticks(place, names)
    axis.set_xlabel(f"share of the variance of {metric}, 95 % confidence")
    left_out = _left_out(data, column(data, metric, void=void))
    if approximate := incomplete_sample(data, metric, void=void):
        left_out += f"\n{approximate}"
    axis.set_title(f"{names[-1]} moves {metric} most{left_out}", fontsize=10)
    axis.legend(frameon=False, fontsize=8)
    return figure


def _left_out(data: "xarray.Dataset", values: "xarray.DataArray") -> str:
    """How many points have no number, or none that counts: a second line of a title."""
    n = int((~np.isfinite(values.to_numpy())).sum())
    return f"\n{n} of {values.size} points left out: {WITHOUT_NUMBER}" if n else ""


def pareto_front(gains: Array) -> NDArray[np.intp]:
    """Indices of points (2, n) that no other point equals or beats in both, one of them truly."""
    known = np.flatnonzero(np.isfinite(gains).all(axis=0))
    order = known[np.lexsort((-gains[1, known], -gains[0, known]))]
    best = np.maximum.accumulate(np.concatenate([[-np.inf], gains[1, order[:-1]]]))
    return np.asarray(order[gains[1, order] > best])


def _axis(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    known = [str(n) for n in data.coords]
    if name not in known:
        raise InputError(f"parameter: {name!r} is none of {', '.join(known)}")
    return data[name]


def _places(coordinate: "xarray.DataArray") -> Sequence[NDArray[np.generic]]:
    values = coordinate.to_numpy()
    return [values.astype(str) if values.dtype.kind in "UOT" else values]


def _label(array: "xarray.DataArray") -> str:
    unit = array.attrs.get("units")
    name = array.attrs.get("long_name", array.name)
    return f"{name}, {unit}" if unit and unit != "1" else str(name)


def _short(value: object) -> str:
    return number(float(value)) if isinstance(value, float | np.floating) else str(value)
