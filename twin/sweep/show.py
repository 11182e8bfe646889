"""Pictures of a sweep: a metric over any two dimensions, a Pareto front, sensitivities."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from twin.files import InputError
from twin.report.style import BLUE, GREY, ORANGE, new_figure

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]

#: Metrics of which less is better.
_COSTS = ("minimum_time_s", "noise_e", "background_e", "saturated", "range_error_m")


def plot_plane(data: "xarray.Dataset", metric: str, x: str, y: str | None = None) -> Figure:
    """A metric over one parameter (a line), or over two (a map); medians over all others."""
    values = _metric(data, metric)
    axes = [_axis(data, name) for name in (x, y) if name is not None]
    others = [name for name in values.dims if name not in [a.dims[0] for a in axes]]
    values = values.median(others) if others else values
    figure = new_figure((6.4, 4.2))
    axis = figure.subplots()
    rest = f", median over {', '.join(map(str, others))}" if others else ""
    axis.set_title(f"{_label(data[metric])}{rest}", fontsize=9, wrap=True)
    if len(axes) == 1:
        axis.plot(*_places(axes[0]), values.to_numpy(), ".-", color=BLUE)
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


def plot_front(data: "xarray.Dataset", first: str, second: str) -> Figure:
    """All points in the plane of two metrics, and those that no other point beats in both."""
    one, two = (_metric(data, name).to_numpy().ravel() for name in (first, second))
    front = pareto_front(np.stack([_gain(first, one), _gain(second, two)]))
    figure = new_figure((6.0, 4.2))
    axis = figure.subplots()
    axis.plot(one, two, ".", color=GREY, markersize=4, label="points")
    order = front[np.argsort(one[front])]
    axis.plot(one[order], two[order], "o-", color=ORANGE, markersize=5, label="Pareto front")
    axis.set_xlabel(_label(data[first]))
    axis.set_ylabel(_label(data[second]))
    axis.set_title(f"{len(front)} of {np.isfinite(one + two).sum()} points are beaten by none")
    axis.legend(frameon=False)
    return figure


def plot_sensitivities(data: "xarray.Dataset", metric: str) -> Figure:
    """How much of a metric's variance each parameter explains by itself."""
    shares = sensitivities(data, metric)
    names = sorted(shares, key=shares.__getitem__)
    figure = new_figure((6.4, 0.35 * len(names) + 1.2))
    axis = figure.subplots()
    axis.barh(names, [shares[name] for name in names], color=BLUE)
    axis.set_xlim(0, 1)
    axis.set_xlabel(f"share of the variance of {metric}")
    axis.set_title(f"{names[-1]} moves {metric} most")
    return figure


def sensitivities(data: "xarray.Dataset", metric: str) -> dict[str, float]:
    """First-order sensitivity of a metric to each parameter: variance of the conditional mean over
    all variance (Sobol, Math. Comput. Simul. 55, 2001). Sampled parameters by bins of equal count.

    Raises InputError where the metric does not vary.
    """
    values = _metric(data, metric)
    flat = values.to_numpy().ravel()
    finite = np.isfinite(flat)
    total = flat[finite].var() if finite.any() else 0.0
    if total == 0:
        raise InputError(f"{metric}: is the same in every point")
    found = {}
    for name, coordinate in data.coords.items():
        dimension = values.dims.index(coordinate.dims[0])
        shape = [-1 if i == dimension else 1 for i in range(values.ndim)]
        place = np.broadcast_to(_bins(coordinate.to_numpy()).reshape(shape), values.shape)
        groups = place.ravel()[finite]
        count = np.bincount(groups)
        mean = np.bincount(groups, flat[finite]) / np.maximum(count, 1)
        spread = (count * (mean - flat[finite].mean()) ** 2).sum() / count.sum()
        found[str(name)] = float(spread / total)
    return found


def pareto_front(gains: Array) -> NDArray[np.intp]:
    """Indices of points (2, n) that no other point equals or beats in both, one of them truly."""
    known = np.flatnonzero(np.isfinite(gains).all(axis=0))
    order = known[np.lexsort((-gains[1, known], -gains[0, known]))]
    best = np.maximum.accumulate(np.concatenate([[-np.inf], gains[1, order[:-1]]]))
    return np.asarray(order[gains[1, order] > best])


def _bins(column: NDArray[np.generic], most: int = 16) -> NDArray[np.intp]:
    values, place = np.unique(column, return_inverse=True)
    if len(values) <= most:
        return np.asarray(place)
    return np.asarray(place * most // len(values))


def _gain(name: str, values: Array) -> Array:
    return -values if name in _COSTS else values


def _metric(data: "xarray.Dataset", name: str) -> "xarray.DataArray":
    known = [str(n) for n in data.data_vars if n != "error"]
    if name not in known:
        raise InputError(f"metric: {name!r} is none of {', '.join(known)}")
    return data[name]


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
    return f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)
