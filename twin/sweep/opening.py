"""A sweep's results as a dataset, read from its folder: the whole, or what there is so far."""

from pathlib import Path
from typing import TYPE_CHECKING

from hardware.formatting import counted
from twin.files import InputError
from twin.sweep.checksums import fault_in, is_sealed, sums_file
from twin.sweep.store import Store, read_plan

if TYPE_CHECKING:
    import xarray


def open_sweep(out: str | Path) -> "xarray.Dataset":
    """A sweep's dataset: finished, or what there is of it so far.

    Raises InputError for a folder without one.
    """
    out = Path(out)
    results = out / "results.zarr"
    if results.is_dir():
        if sums_file(results).is_file():
            return _open_results(results)
        if not ((out / "study.json").is_file() and is_sealed(read_plan(out))):
            return _open_results(results, of_older_version=True)
    if not (out / "study.json").is_file():
        raise InputError(f"{out}: holds no sweep")
    store = Store(out)
    if damaged := store.damaged():
        n, first = counted(len(damaged), "point"), min(damaged)
        raise InputError(
            f"{out / 'points'}: is damaged: numbers of some of {n} from {first} on are not "
            "those of their checksums; `twin sweep` again computes them anew"
        )
    return store.dataset()


def _open_results(results: Path, *, of_older_version: bool = False) -> "xarray.Dataset":
    """A finished dataset; InputError where it is damaged, which one without checksums is only known
    to be where it can't be read.
    """
    import xarray

    fault = "" if of_older_version else fault_in(results)
    if not fault:
        try:
            data = xarray.open_zarr(results, consolidated=False)
            return data.load() if of_older_version else data
        except Exception as error:  # of whichever library meets it
            fault = f"{results.name}: can't be read: {type(error).__name__}: {error}"
    raise InputError(
        f"{results.parent}: {fault}; `twin sweep` again writes it from the points that are done, "
        f"and without {results.name} they are read themselves"
    )
