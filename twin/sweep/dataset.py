"""Results of a sweep, labelled: metrics over the study's dimensions, with what was said of them."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from hardware.units import unit_of
from twin.accuracy.interval import half_width as half_width_of
from twin.fidelity import Tolerance
from twin.files import InputError
from twin.sweep.accuracy_names import TOLERANCE
from twin.sweep.names import CLOSED_FORM, ERRORS, MODEL_ERRORS, RENDERED, error_of, is_own
from twin.sweep.refinement import coarse_study
from twin.sweep.study import Study

if TYPE_CHECKING:
    import xarray

#: Of the columns that say what points are worth nothing.
VOID = {"camera": "void", "radar": "radar_void"}
#: With its kind after it, of columns that say which points a warning was given of.
WARNED = "warned."
#: Of a study with a front: points that were computed to a coarse tolerance alone.
COARSE = "coarse"

#: Why a point is left out of a picture or of shares, one or the other.
WITHOUT_NUMBER = "void, failed, infinite or not a number"


@dataclass
class Progress:
    """What is known of the points that are done, beside their numbers.

    ``errors``: why points failed. ``warned``: by kind, points that a warning was given of, and in
    ``words`` the first of them. ``void``: by ``camera`` and ``radar``, points whose record is void.
    ``refined``: points that were computed anew as finely as asked, after a first coarse pass.
    ``scores``: what light was chosen for, as `Tolerance.of` reads it, or empty.
    """

    points_done: int = 0
    renders: int = 0
    errors: dict[int, str] = field(default_factory=dict)
    warned: dict[str, list[int]] = field(default_factory=dict)
    words: dict[str, str] = field(default_factory=dict)
    void: dict[str, list[int]] = field(default_factory=dict)
    refined: set[int] = field(default_factory=set)
    scores: str = ""

    def forget(self, points: Iterable[int]) -> None:
        """What was said of points that are computed anew."""
        gone = set(points)
        self.errors = {i: text for i, text in self.errors.items() if i not in gone}
        for notes in (self.warned, self.void):
            for kind, marked in list(notes.items()):
                notes[kind] = [i for i in marked if i not in gone]


#: Unit and meaning of a metric, and whether more or less of it is better.
Label = tuple[str, str, str]


def labels(study: Study, own: Mapping[str, Any]) -> dict[str, Label]:
    """Labels of each metric; ``own``: a user's own functions by name, which say theirs by
    attributes ``unit`` and ``better`` ("more" or "less") and the first line of their docstring.
    """
    known = CLOSED_FORM if study.model == "closed-form" else RENDERED
    found = {
        name: (known[name].unit, known[name].meaning, str(known[name].better))
        for name in study.metrics
        if name in known
    }
    for name, function in own.items():
        meaning = (function.__doc__ or name).strip().splitlines()[0]
        better = getattr(function, "better", "more")
        if better not in ("more", "less"):
            raise InputError(f"metrics: {name}: better = {better!r}, expected 'more' or 'less'")
        found[name] = getattr(function, "unit", "1"), meaning, better
    return found


def dataset(
    study: Study,
    arrays: Mapping[str, NDArray[np.float64]],
    labels: Mapping[str, Label],
    progress: Progress,
    attributes: Mapping[str, str],
) -> "xarray.Dataset":
    """Everything so far; points not done and points that failed are NaN.

    ``METRIC.standard_error`` and ``METRIC.systematic``: what the model may be off by;
    ``METRIC.noise``: what draws of the sensor's noise scatter by; a closed form has none.
    ``void`` and ``radar_void`` mark points whose record holds nothing that the metric could be of,
    ``warned.KIND`` those that a warning of that kind was given of, ``warned.score`` those whose
    scores are less exact than asked. Where the study's points are
    computed to a coarse tolerance first, ``coarse`` marks those that were left at it.
    """
    import xarray

    names, shape = [axis.name for axis in study.axes] or ["point"], study.shape or (1,)

    def marked(points: list[int]) -> NDArray[np.bool_]:
        flags = np.zeros(study.n_points, dtype=np.bool_)
        flags[points] = True
        return flags.reshape(shape)

    data: dict[str, Any] = {}
    for name, array in arrays.items():
        metric, kind = error_of(name) or (name, "")
        unit, meaning, *better = labels[metric]  # older sweeps do not say what is better
        long_name = f"{ERRORS[kind]}: {meaning}" if kind else meaning
        where_void = " ".join(_void_columns(study, metric))
        marks = {"units": unit, "long_name": long_name, "void": where_void}
        if better and not kind:
            marks["better"] = better[0]
        data[name] = (names, array.reshape(shape), marks)
    length = max((len(text) for text in progress.errors.values()), default=1)
    error = np.full(study.n_points, "", dtype=f"<U{length}")
    for index, text in progress.errors.items():
        error[index] = text
    data["error"] = (names, error.reshape(shape), {"long_name": "why a point failed"})
    for side, name in VOID.items():
        is_closed = study.model == "closed-form"
        if is_closed and name != VOID["camera"]:
            continue
        why = "all cells lit saturate" if is_closed else f"the {side}'s record is void"
        data[name] = (names, marked(progress.void.get(side, [])), {"long_name": why})
    if (coarse := coarse_study(study)) is not None:
        left = np.ones(study.n_points, np.bool_)
        left[list(progress.refined)] = False
        front, said = " and ".join(study.front or ()), coarse.set[TOLERANCE]
        marks = {"long_name": f"to a tolerance of {said}: cannot be on the front of {front}"}
        data[COARSE] = (names, left.reshape(shape), marks)
    for kind, points in sorted(progress.warned.items()):
        if not points:
            continue
        marks = {"long_name": f"warned: {kind}", "first": progress.words[kind]}
        data[WARNED + kind] = (names, marked(points), marks)
    coords = {}
    for axis in study.axes:
        for name, column in axis.columns.items():
            axis_unit = unit_of(name)
            told = column.astype(str) if column.dtype.kind in "USO" else column
            coords[name] = (axis.name, told, {"units": axis_unit} if axis_unit else {})
    counts = {
        "seed": study.seed,
        "points": study.n_points,
        "points_done": progress.points_done,
        "points_failed": len(progress.errors),
        "points_void": len({i for points in progress.void.values() for i in points}),
    }
    if COARSE in data:
        counts["points_coarse"] = progress.points_done - len(progress.refined)
    found = xarray.Dataset(data, coords, attrs={**attributes, **counts})
    if progress.scores:
        over, text = _less_exact(found, Tolerance.of(progress.scores))
        if over.any():
            marks = {"long_name": "less exact than asked", "first": text}
            found[f"{WARNED}score"] = (names, over.reshape(shape), marks)
    return found


def _void_columns(study: Study, metric: str) -> list[str]:
    """Columns that say where a metric means nothing; a user's own may be of both devices."""
    if study.model == "closed-form":  # rates are those of the light, times of another exposure
        return [VOID["camera"]] if metric == "snr" else []
    if is_own(metric):
        return list(VOID.values())
    return [VOID["radar" if RENDERED[metric].of_radar else "camera"]]


def metrics_of(data: "xarray.Dataset") -> list[str]:
    """Names of what was measured, in the order of the study: a file has them in any."""
    beside = ("error", COARSE, *VOID.values())
    found = [
        name
        for name in map(str, data.data_vars)
        if name not in beside and not name.startswith(WARNED) and error_of(name) is None
    ]
    order = json.loads(data.attrs.get("study", "{}")).get("metrics", [])
    return sorted(found, key=lambda name: order.index(name) if name in order else len(order))


def half_width(
    data: "xarray.Dataset", metric: str, *, of_model: bool = False
) -> "xarray.DataArray | None":
    """Half-width of a metric's interval, see `twin.accuracy.Interval`; None where the sweep has no
    errors. One of an older version has none of noise, which is then not in it.

    ``of_model``: without the noise, of which all points of a sweep draw the same.
    """
    if not all(f"{metric}.{kind}" in data for kind in MODEL_ERRORS):
        return None
    kinds = MODEL_ERRORS if of_model or f"{metric}.noise" not in data else ERRORS
    return half_width_of(**{"noise": 0.0, **{kind: data[f"{metric}.{kind}"] for kind in kinds}})


@dataclass(frozen=True)
class Warned:
    """Of points, by number, that a warning of one kind was given of, and what it says of the first;
    of ``score`` what holds of all.
    """

    kind: str
    points: tuple[int, ...]
    words: str

    def of(self, points: Iterable[int]) -> "Warned":
        """Of some points alone."""
        some = set(points)
        return Warned(self.kind, tuple(i for i in self.points if i in some), self.words)


def warned_points(data: "xarray.Dataset") -> list[Warned]:
    """All kinds of warnings that were given of a sweep's points, of the fewest points first: what
    is said of all of them must not hide what tells them apart.
    """
    found = []
    for name in map(str, data.data_vars):
        if name.startswith(WARNED):
            points = np.flatnonzero(data[name].to_numpy().ravel()).tolist()
            told = Warned(name.removeprefix(WARNED), tuple(points), data[name].attrs["first"])
            found.append(told)
    return sorted(found, key=lambda one: (len(one.points), one.kind))


def _less_exact(data: "xarray.Dataset", scores: Tolerance) -> tuple[NDArray[np.bool_], str]:
    """Points that know a score to less than asked, and that in words: light was chosen for the
    first point. Those left at a coarse tolerance do not count.
    """
    marked, told = np.zeros(data["error"].size, np.bool_), []
    asked = ~data[COARSE].to_numpy().ravel() if COARSE in data else ~marked
    for name, limit in (("psnr_db", scores.psnr_db), ("ssim", scores.ssim)):
        if limit is None or name not in metrics_of(data):
            continue
        width = half_width(data, name, of_model=True)
        assert width is not None  # of a rendered study
        widths = width.to_numpy().ravel()
        over = asked & (widths > limit)
        marked |= over
        if over.any():
            told.append(f"{name} to {number(float(widths[over].max()), 2)} at worst")
    return marked, f"{scores} asked, {', '.join(told)}: light was chosen for the first point"


def column(data: "xarray.Dataset", metric: str, *, void: bool = False) -> "xarray.DataArray":
    """A metric; NaN where the record that it is of is void, unless ``void`` points count.

    Raises InputError for a metric that was not measured.
    """
    if metric not in metrics_of(data):
        raise InputError(f"metric: {metric!r} is none of {', '.join(metrics_of(data))}")
    values = data[metric]
    for mark in () if void else values.attrs.get("void", "").split():
        values = values.where(~data[mark])
    return values.assign_attrs(data[metric].attrs)


def void_points(data: "xarray.Dataset") -> NDArray[np.bool_]:
    """Of each point, by number, whether the records of all its metrics are void."""
    void = np.ones(data["error"].size, np.bool_)
    for metric in metrics_of(data):
        marks = data[metric].attrs.get("void", "").split()
        void &= np.any([data[mark].to_numpy().ravel() for mark in marks], axis=0)
    return void


def gain(values: "xarray.DataArray") -> "xarray.DataArray":
    """A metric, as a sweep's dataset holds it, so that more is better."""
    name = str(values.name)
    known = RENDERED.get(name, CLOSED_FORM.get(name))  # datasets of older versions do not say
    better = values.attrs.get("better", known.better if known else "more")
    return -values if better == "less" else values
