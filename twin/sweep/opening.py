"""A sweep's results as a dataset, read from its folder: the whole, or what there is so far."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from twin.files import InputError
from twin.sweep.checksums import DamagedWarning, is_sealed, sums_file
from twin.sweep.plan import read_plan
from twin.sweep.results import open_results
from twin.sweep.store import Store

if TYPE_CHECKING:
    import xarray


def open_sweep(out: str | Path) -> "xarray.Dataset":
    """A sweep's dataset: finished, or what there is of it so far. Nothing is written.

    Warns (`DamagedWarning`) of what is damaged or missing of the folder where the rest can be read,
    and of a folder of an older version, without checksums. Raises InputError for a folder without a
    sweep, and where numbers are damaged.
    """
    out = Path(out)
    results = out / "results.zarr"
    if results.is_dir():
        if sums_file(results).is_file():
            return open_results(results)
        if not ((out / "study.json").is_file() and is_sealed(read_plan(out))):
            data = open_results(results, of_older_version=True)
            text = f"{results}: without checksums, as of an older version: damage to it is not told"
            warnings.warn(text, DamagedWarning, stacklevel=2)
            return data
    store = Store(out, writable=False)
    for fault in store.faults:
        warnings.warn(fault, DamagedWarning, stacklevel=2)
    if damaged := store.damaged():
        raise InputError(f"{store.told(damaged)}; `twin sweep` again computes them anew")
    return store.dataset()
