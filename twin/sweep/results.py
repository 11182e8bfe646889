"""The finished dataset of a sweep's folder, ``results.zarr``, read as its checksums say it is."""

from pathlib import Path
from typing import TYPE_CHECKING

from twin.files import InputError
from twin.sweep.checksums import fault_in

if TYPE_CHECKING:
    import xarray


def open_results(results: Path, *, of_older_version: bool = False) -> "xarray.Dataset":
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
