"""Results on disk: what is done survives a kill at any moment, and is resumed.

While a sweep runs, ``points/METRIC.npy`` hold one number per point and ``journal.jsonl`` one line
per finished run of points, appended after its numbers are written. Finished, ``results.zarr`` is
the labelled dataset.
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.format import open_memmap

from twin.files import InputError
from twin.sweep.evaluate import Chunk
from twin.sweep.metrics import described
from twin.sweep.parameters import unit_of
from twin.sweep.study import Study

if TYPE_CHECKING:
    import xarray

_LIBRARIES = ("ugv-twin", "numpy", "scipy", "mitsuba", "drjit", "sionna-rt")
_ERROR_LENGTH = 300


class Store:
    """A sweep's folder. Opens what is there, or begins anew.

    Raises InputError where the folder holds another study's results, or something else, or there
    is no room for the results.
    """

    def __init__(self, study: Study, out: Path, chunk: int) -> None:
        self.study, self.out, self.chunk = study, out, chunk
        plan = self._plan()
        known = out / "study.json"
        if known.is_file():
            self._check(json.loads(known.read_text()), plan)
            self.chunk = chunk = json.loads(known.read_text())["chunk"]
        elif out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out}: is not empty and holds no sweep; expected a new folder")
        self._begin(known, {**plan, "chunk": chunk})
        self.done, self.errors, self.renders = self._read_journal()

    def _plan(self) -> dict[str, Any]:
        return {
            "study": self.study.model_dump(mode="json", exclude={"folder"}),
            "folder": str(self.study.folder),
            "versions": {name: _version(name) for name in _LIBRARIES},
        }

    def _check(self, old: dict[str, Any], new: dict[str, Any]) -> None:
        for name in ("study", "versions"):
            if old.get(name) != new[name]:
                what = "another study" if name == "study" else "other versions of the libraries"
                raise InputError(
                    f"{self.out}: holds results of {what}; expected the same, or a new folder"
                )

    def _begin(self, known: Path, plan: dict[str, Any]) -> None:
        points = self.out / "points"
        try:
            points.mkdir(parents=True, exist_ok=True)
            self.arrays = {name: self._array(points, name) for name in self.study.metrics}
            if not known.is_file():
                partial = known.with_suffix(".partial")
                partial.write_text(json.dumps(plan, indent=1))
                os.replace(partial, known)
        except OSError as error:
            raise InputError(f"{self.out}: {error.strerror or error}") from error

    def _array(self, folder: Path, name: str) -> Any:
        """One number per point, room for all of them taken at once: a full disk is found now."""
        path, shape = folder / f"{name.replace(':', '.')}.npy", (self.study.n_points,)
        if not path.is_file():
            partial = path.with_suffix(".partial")
            array = open_memmap(partial, mode="w+", dtype=np.float64, shape=shape)
            with partial.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, partial.stat().st_size)
            for start in range(0, len(array), 2**20):
                array[start : start + 2**20] = np.nan
            array.flush()
            os.replace(partial, path)
        return open_memmap(path, mode="r+")

    def _read_journal(self) -> tuple[set[int], dict[int, str], int]:
        done: set[int] = set()
        errors: dict[int, str] = {}
        renders = 0
        path = self.out / "journal.jsonl"
        if path.is_file():
            for line in path.read_text().splitlines():
                with suppress(ValueError):  # a line cut off by a kill
                    entry = json.loads(line)
                    done.add(entry["start"])
                    errors |= {int(k): v for k, v in entry["errors"].items()}
                    renders += entry["renders"]
        return done, errors, renders

    def todo(self) -> Iterator[tuple[int, int]]:
        """Runs of points that are not done."""
        for start in range(0, self.study.n_points, self.chunk):
            if start not in self.done:
                yield start, min(start + self.chunk, self.study.n_points)

    def add(self, chunk: Chunk) -> None:
        """Keep a run's results: numbers first, then the line that says they are there.

        Raises InputError when the disk is full; everything so far stays readable.
        """
        for name, values in chunk.values.items():
            self.arrays[name][chunk.start : chunk.stop] = values
        entry = {
            "start": chunk.start,
            "stop": chunk.stop,
            "renders": chunk.renders,
            "errors": {str(k): v[:_ERROR_LENGTH] for k, v in chunk.errors.items()},
        }
        try:
            with (self.out / "journal.jsonl").open("a") as journal:
                # After a kill the last line may lack its end.
                lead = "\n" if journal.tell() and not self._ends_well() else ""
                journal.write(lead + json.dumps(entry) + "\n")
        except OSError as error:
            raise self._full(error) from error
        self.done.add(chunk.start)
        self.errors |= chunk.errors
        self.renders += chunk.renders

    def _full(self, error: OSError) -> InputError:
        return InputError(f"{self.out}: {error.strerror or error}; what is done stays")

    def _ends_well(self) -> bool:
        with (self.out / "journal.jsonl").open("rb") as journal:
            journal.seek(-1, os.SEEK_END)
            return journal.read(1) == b"\n"

    def finish(self) -> None:
        """Write the dataset, whole or not at all."""
        partial, final = self.out / "results.partial", self.out / "results.zarr"
        shutil.rmtree(partial, ignore_errors=True)
        try:
            self.dataset().to_zarr(partial, mode="w", zarr_format=2, consolidated=False)
        except OSError as error:
            raise self._full(error) from error
        shutil.rmtree(final, ignore_errors=True)
        os.replace(partial, final)

    def dataset(self) -> "xarray.Dataset":
        """Everything so far, labelled; points not done and points that failed are NaN."""
        import xarray

        study = self.study
        names = [axis.name for axis in study.axes] or ["point"]
        shape = study.shape or (1,)
        closed = study.model == "closed-form"
        data = {}
        for name, array in self.arrays.items():
            unit, meaning = described(name, study.folder, closed_form=closed)
            data[name] = (names, array.reshape(shape), {"units": unit, "long_name": meaning})
        error = np.full(study.n_points, "", dtype=f"<U{_ERROR_LENGTH}" if self.errors else "<U1")
        for index, text in self.errors.items():
            error[index] = text
        data["error"] = (names, error.reshape(shape), {"long_name": "why a point failed"})
        coords = {}
        for axis in study.axes:
            for name, column in axis.columns.items():
                known = unit_of(name)
                values = column.astype(str) if column.dtype.kind in "USO" else column
                coords[name] = (axis.name, values, {"units": known} if known else {})
        plan = self._plan()
        return xarray.Dataset(
            data,
            coords,
            attrs={
                "study": json.dumps(plan["study"]),
                "versions": json.dumps(plan["versions"]),
                "seed": study.seed,
                "points": study.n_points,
                "points_done": sum(min(self.chunk, study.n_points - s) for s in self.done),
                "points_failed": len(self.errors),
                "renders": self.renders,
            },
        )


def open_sweep(out: str | Path) -> "xarray.Dataset":
    """A sweep's dataset: finished, or what there is of it so far.

    Raises InputError for a folder without one.
    """
    import xarray

    out = Path(out)
    if (out / "results.zarr").is_dir():
        return xarray.open_zarr(out / "results.zarr", consolidated=False)
    plan = out / "study.json"
    if not plan.is_file():
        raise InputError(f"{out}: holds no sweep")
    content = json.loads(plan.read_text())
    study = Study.model_validate({**content["study"], "folder": content["folder"]})
    return Store(study, out, content["chunk"]).dataset()


def _version(name: str) -> str:
    return version(name)
