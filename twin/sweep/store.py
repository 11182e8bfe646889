"""Results on disk: finished points survive a kill at any moment, and the sweep resumes after them.

While a sweep runs, ``points/COLUMN.npy`` (metrics and their errors) hold one number per point and
``journal.jsonl`` one line per finished run of points, appended after its numbers are written; and,
before points are computed anew, to a finer tolerance or since their numbers are damaged, a line
that says which; and one that says for which scores light was chosen.
Finished, ``results.zarr`` is the labelled dataset. ``study.json`` says what the points are of: the
study, versions of the libraries, digests of all inputs. All have checksums, see
`twin.sweep.checksums`; what is damaged is computed again when the sweep resumes.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from hardware.files import place_beside, read_json
from hardware.formatting import setting_text
from twin.digest import versions
from twin.fidelity import PRESETS, Fidelity, Tolerance
from twin.fidelity.knobs import NONE
from twin.files import InputError, new_folder
from twin.sweep.accuracy import accuracy_of, other_accuracy
from twin.sweep.accuracy_names import KNOB, PRESET, TOLERANCE
from twin.sweep.checksums import (
    DamagedError,
    is_sealed,
    sealed,
    sums_file,
    unsealed,
    write_sums,
)
from twin.sweep.dataset import Label, Progress, column, dataset, gain
from twin.sweep.evaluate import Chunk
from twin.sweep.inputs import Inputs
from twin.sweep.names import MODEL_ERRORS, columns_of
from twin.sweep.points import PointNumbers, reserve
from twin.sweep.refinement import coarse_study, largest_errors, may_be_on_front
from twin.sweep.study import Study
from twin.toml import describe

if TYPE_CHECKING:
    import xarray

Points = NDArray[np.intp]

_TEXT_LENGTH = 300
#: Of two studies, that are told.
_MOST_DIFFERENCES = 4
_UNSET = "(not set)"
#: Keys of the journal's lines, one set for each kind of line.
_TOLD = {"renders", "errors", "warnings", "void"}
_ENTRIES = ({"scores"}, {"refine"}, {"again"}, {"refined", *_TOLD}, {"start", "stop", *_TOLD})


class Store:
    """A sweep's folder that exists; see `create_or_resume`."""

    def __init__(self, out: Path) -> None:
        self.out, plan = out, read_plan(out)
        self._needs_seal = is_sealed(plan)
        self.study = _study_of(out, plan)
        self.chunk: int = plan["chunk"]
        self._plan = plan
        # A sweep begun before metrics had errors goes on without.
        columns = plan.get("columns", self.study.metrics)
        self._points = PointNumbers(
            out / "points", columns, self.study.n_points, has_checksums=self._needs_seal
        )
        self.done: set[int] = set()
        self._to_refine: set[int] = set()
        self.progress = Progress()
        self._read_journal()

    def _read_journal(self) -> None:
        path = self.out / "journal.jsonl"
        if not path.is_file():
            return
        # A line cut off by a kill, or damaged: its points are computed again.
        for line in path.read_text(errors="replace").splitlines():
            with suppress(ValueError):
                entry = json.loads(line)
                if isinstance(entry, dict) and any(keys <= entry.keys() for keys in _ENTRIES):
                    self._note(unsealed(entry, needs_seal=self._needs_seal))

    def damaged(self) -> set[int]:
        """All points of runs that are done in which numbers are not those that were written.

        Those that a kill left half written are not done yet, or not as finely as asked.
        """
        differ = self._points.differ()
        differ[list(self._to_refine - self.progress.refined)] = False
        return {point for run in self._runs_done() if differ[run].any() for point in run.tolist()}

    def _runs_done(self) -> Iterator[Points]:
        n = self.study.n_points
        return (np.arange(start, min(start + self.chunk, n)) for start in self.done)

    def compute_again(self, points: set[int]) -> None:
        """Have `damaged` points be done no more, which is written down before they are computed."""
        self._append({"again": sorted(points)})

    def _note(self, entry: dict[str, Any]) -> None:
        if "scores" in entry:
            self.progress.scores = entry["scores"]
            return
        if "refine" in entry:
            self._to_refine |= set(entry["refine"])
            return
        if "again" in entry:
            points = set(entry["again"])
            self.progress.forget(points)
            self.progress.refined -= points
            self.progress.points_done -= len(points)
            self.done -= points
            return
        if "refined" in entry:
            self.progress.forget(entry["refined"])
            self.progress.refined |= set(entry["refined"])
        elif entry["start"] in self.done:
            return
        else:
            self.done.add(entry["start"])
            self.progress.points_done += entry["stop"] - entry["start"]
            # Where the line of an earlier pass over them was lost.
            self.progress.refined -= set(range(entry["start"], entry["stop"]))
        self.progress.renders += entry["renders"]
        self.progress.errors |= {int(index): text for index, text in entry["errors"].items()}
        for kind, found in entry["warnings"].items():
            self.progress.warned.setdefault(kind, []).extend(found["points"])
            self.progress.words.setdefault(kind, found["first"])
        for side, void in entry["void"].items():
            self.progress.void.setdefault(side, []).extend(void)

    def chosen_for(self, scores: str) -> None:
        """Note for which scores light was chosen; empty for none."""
        if scores != self.progress.scores:
            self._append({"scores": scores})

    def todo(self) -> Iterator[Points]:
        """Runs of points that are not done."""
        for start in range(0, self.study.n_points, self.chunk):
            if start not in self.done:
                yield np.arange(start, min(start + self.chunk, self.study.n_points))

    def to_refine(self) -> Iterator[Points]:
        """Runs of points that are to be computed anew, as finely as asked, and are not yet.

        Which they are is decided when all points before are done, and written down before the first
        of them is computed, so it does not depend on when a sweep was interrupted.
        """
        if coarse_study(self.study) is None or any(True for _ in self.todo()):
            return
        left = self._to_refine - self.progress.refined
        if not left and (left := self._may_be_on_front()):
            self._append({"refine": sorted(left)})
        ordered = np.array(sorted(left), np.intp)
        for start in range(0, len(ordered), self.chunk):
            yield ordered[start : start + self.chunk]

    def _may_be_on_front(self) -> set[int]:
        """Points at coarse accuracy that may be on the study's front."""
        assert self.study.front is not None
        data, names = self.dataset(), self.study.front
        gains = np.stack([gain(data[name]).to_numpy().ravel() for name in names])
        errors = np.stack(
            [
                # All points draw the same noise.
                largest_errors(
                    *(data[f"{name}.{kind}"].to_numpy().ravel() for kind in MODEL_ERRORS)
                )
                for name in names
            ]
        )
        # Not of a void record: it means nothing that another point is worse than such a one.
        sound = np.stack([np.isfinite(column(data, name).to_numpy().ravel()) for name in names])
        found = np.flatnonzero(may_be_on_front(gains, errors, np.logical_and(*sound)))
        return set(found.tolist()) - self.progress.refined

    def add(self, chunk: Chunk, *, refined: bool = False) -> None:
        """Keep a run's results: numbers first, then the line that says they are there.

        ``refined``: computed anew. Raises InputError when the disk is full; everything so far stays
        readable.
        """
        self._points.write(chunk.points, chunk.values)
        points: list[int] = chunk.points.tolist()
        which = {"refined": points} if refined else {"start": points[0], "stop": points[-1] + 1}
        entry = {
            **which,
            "renders": chunk.renders,
            "errors": {str(k): v[:_TEXT_LENGTH] for k, v in chunk.errors.items()},
            "warnings": {
                kind: {"points": list(said), "first": next(iter(said.values()))[:_TEXT_LENGTH]}
                for kind, said in chunk.warnings.items()
            },
            "void": chunk.void,
        }
        self._append(entry)

    def _append(self, entry: dict[str, Any]) -> None:
        try:
            with (self.out / "journal.jsonl").open("a") as journal:
                # After a kill the last line may lack its end.
                lead = "\n" if journal.tell() and not self._ends_well() else ""
                journal.write(lead + json.dumps(sealed(entry)) + "\n")
        except OSError as error:
            raise self._full(error) from error
        self._note(entry)

    def _full(self, error: OSError) -> InputError:
        return InputError(f"{self.out}: {error.strerror or error}; what is done stays")

    def _ends_well(self) -> bool:
        with (self.out / "journal.jsonl").open("rb") as journal:
            journal.seek(-1, os.SEEK_END)
            return journal.read(1) == b"\n"

    def finish(self) -> None:
        """Write the dataset, whole or not at all."""
        final = self.out / "results.zarr"
        with place_beside(final) as partial:
            try:
                self.dataset().to_zarr(partial, mode="w", zarr_format=2, consolidated=False)
            except OSError as error:
                raise self._full(error) from error
            # Without its checksums a dataset is not read: what the journal holds is.
            sums_file(final).unlink(missing_ok=True)
            shutil.rmtree(final, ignore_errors=True)
            os.replace(partial, final)
            try:
                write_sums(final)
            except OSError as error:
                raise self._full(error) from error

    def dataset(self) -> "xarray.Dataset":
        """Everything so far, labelled; points not done and points that failed are NaN.

        Numbers that are there already, and what is to be said of them not yet, are of points that
        are not done.
        """
        not_done = np.ones(self.study.n_points, np.bool_)
        for run in self._runs_done():
            not_done[run] = False
        not_done |= self._points.differ()
        numbers = {
            name: np.where(not_done, np.nan, array) for name, array in self._points.arrays.items()
        }
        attributes = {
            name: json.dumps(self._plan[name]) for name in ("study", "versions", "inputs")
        }
        return dataset(self.study, numbers, self._plan["labels"], self.progress, attributes)


def create_or_resume(
    study: Study, out: Path, chunk: int, inputs: Inputs, labels: dict[str, Label]
) -> Store:
    """A sweep's folder: what is there of the same study and the same inputs, or a new one.

    ``labels``: of each metric. Raises InputError where the folder holds another
    study's results, those of other inputs, or something else, or where there is no room for them.
    """
    plan: dict[str, Any] = {
        "study": study.model_dump(mode="json", exclude={"folder"}),
        "folder": str(study.folder),
        "versions": versions(),
        "inputs": dict(inputs.digests),
        "labels": labels,
        "chunk": chunk,
        "columns": columns_of(study.metrics, study.model),
    }
    if (out / "study.json").is_file():
        _check(out, read_plan(out), plan)
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is not empty and holds no sweep; expected a new folder")
    else:
        with new_folder(out) as folder:
            reserve(folder / "points", plan["columns"], study.n_points)
            (folder / "study.json").write_text(json.dumps(sealed(plan), indent=1))
    store = Store(out)
    if damaged := store.damaged():
        store.compute_again(damaged)
    return store


def _check(out: Path, old: dict[str, Any], new: dict[str, Any]) -> None:
    """Raise InputError where a folder's points are of something else."""
    if differs := other_accuracy(old["study"], new["study"]):
        raise InputError(
            f"{out}: holds results of {differs}; expected the same, or another folder (--out)"
        )
    if different := _differences("", old["study"], new["study"]):
        shown = "; ".join(different[:_MOST_DIFFERENCES])
        if len(different) > _MOST_DIFFERENCES:
            shown += f" and {len(different) - _MOST_DIFFERENCES} more"
        raise InputError(
            f"{out}: holds results of another study: {shown}; "
            "expected the same, or another folder (--out)"
        )
    for kind, what in (("versions", "other versions of"), ("inputs", "other content of")):
        names = old[kind].keys() | new[kind].keys()
        if other := sorted(n for n in names if old[kind].get(n) != new[kind].get(n)):
            raise InputError(
                f"{out}: holds results of {what} {', '.join(other)}; expected the same, or "
                "another folder (--out)"
            )


def _differences(name: str, old: Any, new: Any) -> list[str]:
    """What differs between two studies as they are stored, by dotted name: the old, the new."""
    if old == new:
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            text
            for key in dict.fromkeys((*old, *new))
            for text in _differences(f"{name}.{key}".lstrip("."), old.get(key), new.get(key))
        ]
    was, now = (_UNSET if value is None else setting_text("", value) for value in (old, new))
    return [f"{name} = {was}, not {now}" if was != now else f"{name}: other values"]


def read_plan(out: Path) -> dict[str, Any]:
    """What a folder's ``study.json`` says. Raises InputError."""
    path = out / "study.json"
    try:
        plan: dict[str, Any] = read_json(path)
        unsealed(plan, needs_seal=False)
        missing = {"study", "folder", "versions", "inputs", "labels", "chunk"} - plan.keys()
    except DamagedError as error:
        raise InputError(
            f"{path}: is damaged ({error}); begin the sweep anew in another folder (--out)"
        ) from error
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: can't be read as a sweep's ({error})") from error
    if missing:
        raise InputError(f"{path}: lacks {', '.join(sorted(missing))}: of an older version")
    return plan


def stored_study(out: Path) -> Study:
    """The study that a folder's sweep is of. Raises InputError for a folder without one."""
    return _study_of(out, read_plan(out))


def stored_inputs(out: Path) -> dict[str, str]:
    """Digests of the inputs of a folder's sweep, by kind and name."""
    found: dict[str, str] = read_plan(out)["inputs"]
    return found


def _study_of(out: Path, plan: dict[str, Any]) -> Study:
    try:
        return Study.model_validate({**plan["study"], "folder": plan["folder"]})
    except ValidationError as error:
        told = describe(error, Study, plan["study"])
        raise InputError(f"{out / 'study.json'}: study: {told}") from error


def stored_accuracy(out: Path) -> Fidelity | None:
    """Knobs that a folder's sweep sets, by a tolerance or a preset and by themselves; None where
    there is no such sweep.
    """
    said = accuracy_of(read_plan(out)["study"]) if (out / "study.json").is_file() else {}
    if TOLERANCE in said:
        knobs = Tolerance.of(str(said[TOLERANCE])).knobs()
    elif said.get(PRESET) in PRESETS:
        knobs = PRESETS[said[PRESET]]
    else:
        return None
    own = said.keys() - {TOLERANCE, PRESET}
    named = {name.removeprefix(KNOB): said[name] for name in own}
    if named.get("motion_tolerance") == NONE:
        named["motion_tolerance"] = None
    return knobs.with_(named)
