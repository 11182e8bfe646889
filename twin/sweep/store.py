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
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hardware.files import place_beside, whole_file
from hardware.formatting import counted
from twin.digest import versions
from twin.files import InputError, new_folder
from twin.sweep.checksums import (
    DamagedError,
    DamagedWarning,
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
from twin.sweep.plan import check_same, read_plan, study_of
from twin.sweep.points import PointNumbers, reserve
from twin.sweep.refinement import coarse_study, largest_errors, may_be_on_front
from twin.sweep.results import open_results
from twin.sweep.study import Study

if TYPE_CHECKING:
    import xarray

Points = NDArray[np.intp]

_TEXT_LENGTH = 300
#: Numbers of lines of the journal that are told.
_MOST_LINES = 4
_UNSEEN = "damage to it is not told"
_UNCHECKED = "numbers that results.zarr does not hold stand as they are, unchecked"
_NOT_DONE = "points that no line tells of show no numbers, and `twin sweep` computes them again"
#: Keys of the journal's lines, one set for each kind of line.
_TOLD = {"renders", "errors", "warnings", "void"}
_ENTRIES = ({"scores"}, {"refine"}, {"again"}, {"refined", *_TOLD}, {"start", "stop", *_TOLD})


class Store:
    """A sweep's folder that exists; see `create_or_resume`.

    ``writable``: points are to be computed; else no file is written to. ``faults``: what is damaged
    or missing, with its file, where the rest can be gone on with.
    """

    def __init__(self, out: Path, *, writable: bool) -> None:
        self.out, plan = out, read_plan(out)
        self._needs_seal = is_sealed(plan)
        self.study = study_of(out, plan)
        self.chunk: int = plan["chunk"]
        self._plan = plan
        # A sweep begun before metrics had errors goes on without.
        columns = plan.get("columns", self.study.metrics)
        self._points = PointNumbers(
            out / "points",
            columns,
            self.study.n_points,
            has_checksums=self._needs_seal,
            writable=writable,
        )
        self.done: set[int] = set()
        self._to_refine: set[int] = set()
        self._again: set[int] = set()
        self._first_warned: dict[str, int] = {}
        self.progress = Progress()
        self.faults: list[str] = []
        if not self._needs_seal:
            self.faults.append(f"{out}: without checksums, as of an older version: {_UNSEEN}")
        if self._points.lost_checksums:
            self.faults.append(f"{self._points.lost_checksums}: {_UNCHECKED}")
        self._read_journal(writable=writable)

    @property
    def _journal(self) -> Path:
        return self.out / "journal.jsonl"

    def _read_journal(self, *, writable: bool) -> None:
        path, written = self._journal, self._points.written()  # first: a sweep may go on meanwhile
        text = path.read_text(errors="replace") if path.is_file() else ""
        intact, damaged = [], []
        *lines, end = text.split("\n")
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
                if not (isinstance(entry, dict) and any(k <= entry.keys() for k in _ENTRIES)):
                    raise DamagedError("of another kind")
                self._note(unsealed(entry, needs_seal=self._needs_seal))
                intact.append(line)
            except ValueError:
                damaged.append(str(number))
        if not path.is_file():
            self.faults.append(f"{path}: is missing: {_NOT_DONE}")
        elif damaged:
            more = ", ..." if damaged[_MOST_LINES:] else ""
            which = ", ".join(damaged[:_MOST_LINES]) + more
            self.faults.append(f"{path}: is damaged in line {which}: {_NOT_DONE}")
        elif self._n_untold(written) > self.chunk:  # a kill leaves one run without its line
            which = "lacks lines of points whose numbers are there"
            self.faults.append(f"{path}: {which}: {_NOT_DONE}")
        if writable and (damaged or end):  # a line that a kill cut off has no end
            with whole_file(path) as partial:
                partial.write_text("".join(f"{line}\n" for line in intact))

    def _n_untold(self, written: NDArray[np.bool_]) -> int:
        """How many points that are ``written`` no line of the journal tells of."""
        written[list(self._again)] = False
        for run in self._runs_done():
            written[run] = False
        return int(written.sum())

    def damaged(self) -> set[int]:
        """All points of runs that are done in which numbers are not those that were written.

        Those that a kill left half written are not done yet, or not as finely as asked.
        """
        differ = self._points.differ()
        if self._points.lost_checksums:
            differ |= self._unlike_results()
        differ[list(self._to_refine - self.progress.refined)] = False
        return {point for run in self._runs_done() if differ[run].any() for point in run.tolist()}

    def _unlike_results(self) -> NDArray[np.bool_]:
        """Of each point, whether its numbers are others than in ``results.zarr``, where that is
        there and whole.
        """
        unlike = np.zeros(self.study.n_points, np.bool_)
        results = self.out / "results.zarr"
        with suppress(InputError, OSError):
            whole = open_results(results)
            for name, numbers in self._points.arrays.items():
                held = whole[name].to_numpy().ravel()
                unlike |= (numbers != held) & ~(np.isnan(numbers) & np.isnan(held))
        return unlike

    def told(self, damaged: set[int]) -> str:
        """What is `damaged`, in words that begin with its file."""
        which = f"{counted(len(damaged), 'point')} from {min(damaged)} on"
        if lost := self._points.lost:
            more = f", and {counted(len(lost) - 1, 'other file')} like it" if lost[1:] else ""
            return f"{lost[0]}{more}: numbers of {which} are gone"
        where = self.out / "points"
        return f"{where}: is damaged: numbers of some of {which} are not those that were written"

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
            self._again |= points
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
            first = found["points"][0]
            if first <= self._first_warned.get(kind, first):  # lines may come in any order
                self.progress.words[kind] = found["first"]
                self._first_warned[kind] = first
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
            with self._journal.open("a") as journal:
                journal.write(json.dumps(sealed(entry)) + "\n")
        except OSError as error:
            raise self._full(error) from error
        self._note(entry)

    def _full(self, error: OSError) -> InputError:
        return InputError(f"{self.out}: {error.strerror or error}; what is done stays")

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
        check_same(out, read_plan(out), plan)
    elif (out / "points").is_dir():
        read_plan(out)  # raises what is to be said of a sweep without one
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is not empty and holds no sweep; expected a new folder")
    else:
        with new_folder(out) as folder:
            reserve(folder / "points", plan["columns"], study.n_points)
            (folder / "journal.jsonl").touch()
            (folder / "study.json").write_text(json.dumps(sealed(plan), indent=1))
    store = Store(out, writable=True)
    if damaged := store.damaged():
        store.faults.append(f"{store.told(damaged)}; they are computed again")
        store.compute_again(damaged)
    for fault in store.faults:
        warnings.warn(fault, DamagedWarning, stacklevel=3)
    return store
