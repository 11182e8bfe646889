"""A point of a sweep as files of one's own: its system and radar, and the command that runs it."""

import json
import os
import shlex
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hardware.files import whole_file
from hardware.formatting import setting_text
from twin.files import InputError
from twin.radar.device.design import load_radar
from twin.sweep.dataset import COARSE, column, gain, half_width
from twin.sweep.inputs import beside, digest_now
from twin.sweep.names import needs_radar
from twin.sweep.parameters import full_name
from twin.sweep.plan import stored_inputs, stored_study
from twin.sweep.setup import Values, groups_of
from twin.sweep.study import Study, Value
from twin.system import load_system
from twin.toml import names_file, placed

if TYPE_CHECKING:
    import xarray

#: Options of `twin run` that say what a parameter of a study says.
_OPTIONS = {
    "seed": "--seed",
    "processing.method": "--method",
    "processing.detection": "--detection",
    "fidelity.preset": "--fidelity",
    "fidelity.tolerance": "--tolerance",
}
_LOADERS: dict[str, Callable[[Path], object]] = {"system": load_system, "radar": load_radar}
_KINDS = tuple(_LOADERS)


@dataclass(frozen=True)
class Best:
    """The point of most (or, of what is better so, least) of a metric, and how many others are
    within what the model may be off by; where that is not known of all points, how many are equal.
    """

    point: int
    n_as_good: int
    errors_known: bool

    def __str__(self) -> str:
        """The point, and how many others are as good."""
        if not self.errors_known:
            equal = f", {self.n_as_good} more exactly equal" if self.n_as_good else ""
            return f"point {self.point}; the model's errors are not known{equal}"
        near = f"; {self.n_as_good} more within the model's errors" if self.n_as_good else ""
        return f"point {self.point}{near}"


@dataclass(frozen=True)
class Chosen:
    """Files of a point, by path, the ``kinds`` of design they hold, the command that runs them, and
    what neither says.
    """

    files: Mapping[Path, str]
    kinds: tuple[str, ...]
    command: str
    left_out: tuple[str, ...]


def best_point(data: "xarray.Dataset", metric: str, *, void: bool = False) -> Best:
    """The best by a metric of a sweep's dataset; ``void``: points of void records count too.

    Raises InputError for a metric that was not measured, or of which there is no number.
    """
    values = column(data, metric, void=void)
    gains = gain(values).to_numpy().ravel()
    known = np.isfinite(gains)
    if not known.any():
        raise InputError(f"metric: {metric!r}: no point has a number of it that is not void")
    widths = half_width(data, metric, of_model=True)
    errors = np.zeros(len(gains)) if widths is None else widths.to_numpy().ravel()
    errors_known = not np.isnan(errors[known]).any()
    if not errors_known:  # as of a metric of one's own that gives a number alone
        errors = np.zeros(len(gains))
    point = int(np.nanargmax(np.where(known, gains, np.nan)))
    as_good = known & (gains + errors >= gains[point] - errors[point])
    return Best(point, int(as_good.sum()) - 1, errors_known)


def check_point(data: "xarray.Dataset", point: int) -> None:
    """Raise InputError for a point that a sweep has not, or that failed."""
    errors = data["error"].to_numpy().ravel()
    if not 0 <= point < len(errors):
        raise InputError(f"point = {point}: expected 0 to {len(errors) - 1}")
    if errors[point]:
        raise InputError(f"point = {point}: failed: {errors[point]}")


def is_coarse(data: "xarray.Dataset", point: int) -> bool:
    """Whether a point was computed to a coarse tolerance alone."""
    return COARSE in data and bool(data[COARSE].to_numpy().ravel()[point])


def chosen(sweep: Path, point: int, path: Path) -> Chosen:
    """A point of a sweep's folder as files: its system at ``path``, and beside it, where the study
    varies the radar, ``NAME-radar.toml``. Each builds on what the study builds on.

    Raises InputError where neither differs from what the study builds on, and where that is not
    what it was.
    """
    study = stored_study(sweep)
    values = study.point(point)
    groups = groups_of(values)
    places = {"system": path, "radar": path.with_name(f"{path.stem}-radar{path.suffix}")}
    said = f"{sweep.name}, point {point}"
    files = {
        kind: _file(study, kind, groups[kind], places[kind], said)
        for kind in _KINDS
        if kind in groups
    }
    others = {name: value for name, value in values.items() if not _is_in(name, files)}
    if not files:
        told = ", ".join(f"{name} = {setting_text(name, v)}" for name, v in others.items())
        raise InputError(f"point {point}: differs in neither system nor radar: {told or 'in none'}")
    _check_bases(sweep, study, values)
    command, left_out = _command(study, others, {kind: places[kind] for kind in files})
    texts = {places[kind]: text for kind, text in files.items()}
    return Chosen(texts, tuple(files), command, left_out)


def write_chosen(found: Chosen) -> None:
    """Write the files, each whole or not at all, after they were read as any command reads them.
    Raises InputError where there is one already that says something else, and for what no command
    takes; nothing is written then.
    """
    for path, text in found.files.items():
        if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
            raise InputError(f"{path}: exists already, expected a new file")
    with ExitStack() as written:
        for kind, (path, text) in zip(found.kinds, found.files.items(), strict=True):
            partial = written.enter_context(whole_file(path))
            partial.write_text(text, encoding="utf-8")
            if partial != path:  # no pipe
                _check_design(kind, partial, path)


def _check_design(kind: str, partial: Path, path: Path) -> None:
    """Raise InputError, which names the file as it is to be, for what is no system or radar."""
    try:
        _LOADERS[kind](partial)
    except InputError as error:
        said = str(error).replace(str(partial), str(path))
        raise InputError(f"{said}; nothing was written") from error


def _is_in(name: str, files: Mapping[str, str]) -> bool:
    return full_name(name).partition(".")[0] in files


def _file(study: Study, kind: str, values: Values, path: Path, said: str) -> str:
    """A system or radar in TOML: what it builds on, and the point's values over it."""
    base = str(values.get("", getattr(study, kind)))
    sections: dict[str, list[str]] = {}
    for name, value in values.items():
        section, _, field = name.partition(".")
        if not field:
            continue
        lines = sections.setdefault(section, [])
        if field == "part":
            lines.insert(0, f"part = {_text(_from(path, str(value), study.folder))}")
            continue
        if names_file(field) and isinstance(value, str):
            value = placed(field, value, study.folder)
        lines.append(f"{field} = {{ value = {_text(value)}, assumed = {_text(said)} }}")
    tables = [f"\n[{section}]\n" + "\n".join(lines) + "\n" for section, lines in sections.items()]
    return f"base = {_text(_from(path, base, study.folder))}\n" + "".join(tables)


def _from(path: Path, name: str, folder: Path) -> str:
    """How a file names what a study names: a bundled entry by name, a file by where it is from
    there.
    """
    found = Path(beside(name, folder))
    if not found.is_file():
        return name
    return Path(os.path.relpath(found.resolve(), path.resolve().parent)).as_posix()


def _text(value: Value) -> str:
    """A value in TOML, a number to its last bit."""
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def _check_bases(sweep: Path, study: Study, values: Values) -> None:
    """Raise InputError where what a file builds on is not what the sweep was of."""
    stored = stored_inputs(sweep)
    for kind in _KINDS:
        name = str(values.get(kind, getattr(study, kind)))
        known = stored.get(f"{kind} {name}")
        if known is not None and known != digest_now(kind, name, study.folder):
            raise InputError(f"{kind} {name}: is not, or no longer, a file as {sweep} was made of")


def _command(
    study: Study, others: Values, places: Mapping[str, Path]
) -> tuple[str, tuple[str, ...]]:
    """The command that runs the files, and what of the point it cannot say."""
    if study.model == "closed-form":
        words = ["twin", "budget", "--system", str(places.get("system", study.system))]
        left_out = others
    else:
        scene = beside(str(others.pop("scene", study.scene)), study.folder)
        words = ["twin", "run", os.path.relpath(scene) if isinstance(scene, Path) else scene]
        for kind in _KINDS:
            base = beside(str(others.pop(kind, getattr(study, kind))), study.folder)
            if kind == "system" or kind in places or needs_radar(study.metrics):
                words += [f"--{kind}", str(places.get(kind, base))]
        options = {name: value for name, value in others.items() if name in _OPTIONS and value}
        words += [word for name, v in options.items() for word in (_OPTIONS[name], str(v))]
        left_out = {name: value for name, value in others.items() if name not in _OPTIONS}
    told = tuple(f"{name} = {setting_text(name, value)}" for name, value in left_out.items())
    return shlex.join(words), told
