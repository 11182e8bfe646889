"""A study: what is varied, over which values, and what is measured of each point."""

import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from hashlib import sha256
from numbers import Number
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    StrictBool,
    ValidationError,
    model_validator,
)

from twin.fidelity.knobs import NONE
from twin.files import InputError
from twin.sweep.accuracy_names import check_accuracy
from twin.sweep.methods import check_functions, check_methods
from twin.sweep.names import check_front, check_metrics
from twin.sweep.objects import named
from twin.sweep.parameters import check_value, full_name, is_optical
from twin.sweep.relevance import check_effects
from twin.toml import Finite, Name, Strict, describe, read_toml

Value = bool | int | float | str


def _single(given: Any) -> Any:
    if isinstance(given, str | Number | np.generic):
        return given
    raise InputError("expected a single value: a number, text, true or false")


def _values(given: Any) -> Any:
    is_list = isinstance(given, Iterable) and not isinstance(given, str | Mapping)
    if is_list and all(isinstance(item, str | Number | np.generic) for item in given):
        return given
    raise InputError("expected a list of values")


_Single = Annotated[Value, BeforeValidator(_single)]
_Values = Annotated[list[Value], BeforeValidator(_values), Field(min_length=1)]


class Range(Strict):
    """Bounds of a sampled parameter."""

    low: Finite | str
    """Lower end, a number or text with a unit."""
    high: Finite | str
    """Upper end, a number or text with a unit."""
    log: StrictBool = False
    """Draw uniformly in the logarithm."""


class Sample(Strict):
    """Points drawn from ranges."""

    method: Literal["latin-hypercube", "sobol", "saltelli"]
    """`latin-hypercube`, `sobol` (Sobol's scrambled sequence, SciPy), or `saltelli`: `n` base
    points, each with its crossings, n (d + 2) points of d parameters in all, which tell
    sensitivities of first and total order (SALib).
    """
    n: Annotated[int, Field(strict=True, ge=1, le=10**7)]
    """Points; with `saltelli` a power of two."""
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    """Of the draw."""
    ranges: Annotated[dict[str, Range], Field(min_length=1)]
    """Bounds by dotted name of the parameter."""


class Study(Strict):
    """A study, as its TOML file says it.

    ``grid``, ``zip`` and ``sample`` together make the product of their dimensions.

    In Python scene, system, radar, parts and fidelities may be objects as well as names, as fields
    and as values of ``scene``, ``system``, ``radar``, ``system.SECTION.part``, ``fidelity.preset``;
    a metric may be a function of an `Outcome`, and so may values of ``processing.method`` and
    ``processing.detection`` be functions, as `hardware.reconstruct` and `hardware.Processing` take
    them. ``objects`` holds them by the names they get.

    >>> from twin.system import load_system
    >>> fast = load_system("workable").with_({"optics.f_number": 0.8})
    >>> def brightest(outcome):
    ...     "Electrons of the brightest cell."
    ...     return outcome.capture.scene_e.max()
    >>> study = Study(name="lens", metrics=[brightest], grid={"system": ["workable", fast]})
    >>> study.n_points, study.point(1)
    (2, {'system': 'workable (changed)'})

    Raises InputError for what can't be.
    """

    name: Name
    """Of the study and its folder under `runs`. Default: the file's."""
    model: Literal["rendered", "closed-form"] = "rendered"
    """`rendered`: each point through the whole chain; `closed-form`: from formulas, a million
    points in a second.
    """
    scene: str = "yard"
    """Name, file or folder of the scene."""
    system: str = "workable"
    """Name or file of the optical system."""
    radar: str = "hybrid-79"
    """Name or file of the radar, for metrics of the radar."""
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    """Of noise and of light paths."""
    metrics: Annotated[tuple[str, ...], Field(min_length=1)]
    """What is measured of each point, by name; or a function of one's own, `file.py:function`."""
    front: tuple[str, str] | None = None
    """Two of the metrics, by whose trade designs are chosen: points that cannot be on their Pareto
    front are computed to a coarse tolerance alone."""
    set: dict[str, _Single] = {}
    """Parameters, by dotted name, that differ from scene and system in every point."""
    grid: dict[str, _Values] = {}
    """Parameters of which every combination of the values is a point."""
    zip: list[dict[str, _Values]] = []
    """Tables of parameters that change together."""
    sample: Sample | None = None
    """Points drawn from ranges."""
    folder: Path = Path()
    """Folder to which names of files in the study are relative; a file's own, never in the file."""
    objects: Annotated[dict[str, Any], Field(exclude=True, repr=False)] = {}
    """In Python: objects by the names that they get."""
    _file: str = PrivateAttr("")

    if not TYPE_CHECKING:

        def __init__(self, **fields: Any) -> None:
            try:
                super().__init__(**fields)
            except ValidationError as error:
                raise InputError(describe(error, Study, fields)) from error

    @model_validator(mode="before")
    @classmethod
    def _names_its_objects(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "objects" in data:
            return data
        return named(data)

    @model_validator(mode="after")
    def _is_consistent(self) -> "Study":
        seen: dict[str, str] = {}  # as each is said
        groups: list[Mapping[str, Any]] = [self.set, self.grid, *self.zip]
        if self.sample:
            groups.append(self.sample.ranges)
        for names in groups:
            for name in names:
                if other := seen.get(full_name(name)):
                    too = "" if other == name else f", as {other} too"
                    raise InputError(f"{name}: is given twice{too}")
                seen[full_name(name)] = name
        for index, together in enumerate(self.zip):
            lengths = {name: len(values) for name, values in together.items()}
            if len(set(lengths.values())) != 1:
                raise InputError(f"zip.{index}: lists of different lengths: {lengths}")
        check_metrics(self.metrics, self.model)
        check_front(self.front, self.metrics)
        for name, value in self.set.items():
            check_value(name, value)
        _ = self.axes
        check_effects(self.model, self.parameters, self.metrics)
        check_accuracy(self.parameters)
        if self.model == "rendered":
            check_methods(self.values_of("processing.method"))
        return self

    def with_set(self, values: dict[str, Value]) -> "Study":
        """The same with other parameters that differ from scene and system in every point. Raises
        InputError as a study does.
        """
        said = {name: getattr(self, name) for name in type(self).model_fields}
        changed = type(self)(**{**said, "set": values})
        changed._file = self._file
        return changed

    @property
    def label(self) -> str:
        """How messages name it: its file, or without one its name."""
        return self._file or self.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """Every parameter that is set or varied."""
        sampled = self.sample.ranges if self.sample else ()
        return tuple(n for names in (self.set, self.grid, *self.zip, sampled) for n in names)

    def values_of(self, parameter: str) -> list[Value]:
        """Values that a parameter is given somewhere, one by one; none of what is drawn."""
        found: list[Value] = [self.set[parameter]] if parameter in self.set else []
        for together in (self.grid, *self.zip):
            found += together.get(parameter, [])
        return found

    @cached_property
    def axes(self) -> tuple["Axis", ...]:
        """Dimensions of the study; those that need a new render vary slowest."""
        axes = [Axis(n, {n: _grid_column(n, v)}) for n, v in self.grid.items()]
        axes += [
            Axis(f"zip_{i}", {n: _column(n, v) for n, v in together.items()})
            for i, together in enumerate(self.zip)
        ]
        if self.sample:
            axes.append(Axis("sample", _drawn(self.sample)))
        return tuple(sorted(axes, key=lambda axis: not axis.is_optical))

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return tuple(len(axis) for axis in self.axes)

    @property
    def n_points(self) -> int:
        """Points in all."""
        return math.prod(self.shape)

    @property
    def n_sharing(self) -> int:
        """Points, one after another, that differ at most in what a new render is not needed for;
        1 where what moves within a frame is followed, so that each has light of its own.
        """
        motion = "fidelity.motion_tolerance"
        if motion in self.parameters and self.values_of(motion) != [NONE]:
            return 1
        return math.prod(len(axis) for axis in self.axes if not axis.is_optical)

    def point(self, index: int) -> dict[str, Value]:
        """What is set in a point, by parameter."""
        values = {name: check_value(name, value) for name, value in self.set.items()}
        for axis, place in zip(self.axes, np.unravel_index(index, self.shape), strict=True):
            values |= {name: column[place].item() for name, column in axis.columns.items()}
        return values

    def same_render(self, index: int) -> NDArray[np.intp]:
        """Points, in their order, that differ from a point at most in what a new render is not
        needed for.
        """
        if not self.shape:
            return np.zeros(1, np.intp)
        places = np.unravel_index(index, self.shape)
        each = [a.same_render(int(p)) for a, p in zip(self.axes, places, strict=True)]
        return np.ravel_multi_index(np.ix_(*each), self.shape).ravel()

    @cached_property
    def digest(self) -> str:
        """Of all that the study says."""
        return sha256(self.model_dump_json(exclude={"folder"}).encode()).hexdigest()

    def columns(self, start: int, stop: int) -> dict[str, NDArray[Any]]:
        """What is set in a run of points, by parameter: arrays."""
        n = stop - start
        found: dict[str, NDArray[Any]] = {
            name: np.full(n, check_value(name, value)) for name, value in self.set.items()
        }
        places = np.unravel_index(np.arange(start, stop), self.shape) if self.shape else ()
        for axis, place in zip(self.axes, places, strict=True):
            found |= {name: column[place] for name, column in axis.columns.items()}
        return found


class Axis:
    """A dimension: one or more parameters that change together."""

    def __init__(self, name: str, columns: dict[str, NDArray[Any]]) -> None:
        self.name = name
        self.columns = columns

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    @property
    def is_optical(self) -> bool:
        """Whether a step along it may need another render."""
        return any(is_optical(name) for name in self.columns)

    def same_render(self, place: int) -> NDArray[np.intp]:
        """Places where all that may need another render is as in this one."""
        optical = [column for name, column in self.columns.items() if is_optical(name)]
        same = [column == column[place] for column in optical]
        return np.flatnonzero(np.all([np.ones(len(self), bool), *same], axis=0))


def load_study(path: str | Path) -> Study:
    """A study from its TOML file.

    Raises InputError naming the file, the parameter, the value, and what was expected.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"study: {str(path)!r} is no file")
    content = read_toml(path)
    content.setdefault("name", path.stem)
    for field in ("folder", "objects"):
        if field in content:
            raise InputError(f"{path}: {field}: is no field of a study")
    try:
        study = Study.model_validate({**content, "folder": path.resolve().parent})
        study._file = str(path)
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error, Study, content)}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if study.model == "rendered":
        methods, detections = (study.values_of(f"processing.{k}") for k in ("method", "detection"))
        try:
            check_functions(methods, detections, study.folder)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    return study


def _column(name: str, values: list[Value]) -> NDArray[Any]:
    """Values of one parameter, all of a kind."""
    checked = [check_value(name, value) for value in values]
    kinds = sorted({_kind(value) for value in checked})
    if len(kinds) > 1:
        raise InputError(f"{name}: holds {' and '.join(kinds)}, expected values of one kind")
    return np.array(checked)


def _kind(value: Value) -> str:
    if isinstance(value, str):
        return "text"
    return "true or false" if isinstance(value, bool) else "numbers"


def _grid_column(name: str, values: list[Value]) -> NDArray[Any]:
    column = _column(name, values)
    if len(set(column.tolist())) != len(column):
        raise InputError(f"{name}: a value stands twice")
    return column


def _crossed(n: int, d: int, seed: int) -> NDArray[np.float64]:
    """Base points and their crossings (n (d + 2), d): A, A with each column of B, B (Saltelli et
    al., Comput. Phys. Commun. 181, 2010).
    """
    from SALib.sample import sobol

    if n & (n - 1):
        raise InputError(f"sample.n: {n}: expected a power of two with saltelli")
    problem = {"num_vars": d, "names": list(range(d)), "bounds": [[0.0, 1.0]] * d}
    return np.asarray(sobol.sample(problem, n, calc_second_order=False, seed=seed))


def _drawn(sample: Sample) -> dict[str, NDArray[Any]]:
    from scipy.stats import qmc

    d = len(sample.ranges)
    if sample.method == "sobol":
        # Balance holds for powers of two; any number of its first points is a sequence still.
        power = max(0, math.ceil(math.log2(sample.n)))
        unit = qmc.Sobol(d, rng=np.random.default_rng(sample.seed)).random_base2(power)[: sample.n]
    elif sample.method == "saltelli":
        unit = _crossed(sample.n, d, sample.seed)
    else:
        unit = qmc.LatinHypercube(d, rng=np.random.default_rng(sample.seed)).random(sample.n)
    columns = {}
    for share, (name, bounds) in zip(unit.T, sample.ranges.items(), strict=True):
        low, high = (check_value(name, v) for v in (bounds.low, bounds.high))
        if not (isinstance(low, float | int) and isinstance(high, float | int) and low < high):
            raise InputError(f"sample.ranges.{name}: expected numbers, low below high")
        if bounds.log:
            if low <= 0:
                raise InputError(f"sample.ranges.{name}.low: {low}: expected above 0 with log")
            columns[name] = low * (high / low) ** share
        else:
            columns[name] = low + (high - low) * share
    return columns
