"""Any reconstruction method by what a user gives: a bundled name, a function, a file's function."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.own_functions import OwnFunction, OwnFunctionError, is_file_function, own_function
from hardware.reconstruction.registry import (
    METHODS,
    Array,
    Method,
    Solve,
    load_plugins,
    normal_errors,
)
from hardware.reconstruction.sensing import Sensing

_ARGUMENTS = ("values", "noise_variance", "sensing")


def method_of(given: str | Method | Solve, *, folder: Path | None = None) -> Method:
    """A reconstruction method.

    Parameters
    ----------
    given
        A name in `METHODS`; a `Method`; a function of (values, noise_variance, sensing), or where
        such a function is, ``file.py:function``. It takes measurements (count,) in electrons, the
        noise variance of one, and the `Sensing`, and returns cells (n_cells,) in electrons, alone
        or with their standard errors (n_cells,). It is called once for each detector.
    folder
        What a relative path starts from; default the working directory.

    The result's name is the function's with a digest of its source.

    Raises InputError for an unknown name; OwnFunctionError, an InputError, for a function that is
    not there or takes other arguments. When called, the method raises OwnFunctionError for a
    result of another shape, or with NaN or infinity in cells that the patterns measure.

    >>> from hardware import PatternSet
    >>> def plain_inverse(values, noise_variance, sensing):
    ...     "Inverse of a full set."
    ...     return sensing.adjoint(values) / sensing.n_cells
    >>> own = method_of(plain_inverse)
    >>> own.name[:14], own.summary
    ('plain_inverse-', 'Inverse of a full set.')
    >>> cells, standard_error = own(np.ones(64), 1.0, PatternSet(8, 8, 64))
    """
    if isinstance(given, Method):
        return given
    if isinstance(given, str) and not is_file_function(given):
        if given not in METHODS:
            load_plugins()
        if given not in METHODS:
            raise InputError(
                f"method: {given!r} is none of {', '.join(METHODS)}, and no file.py:function"
            )
        return METHODS[given]
    if not isinstance(given, str) and not callable(given):
        raise InputError(f"method: {given!r:.60}: expected a name, file.py:function or a callable")
    own = own_function(given, _ARGUMENTS, folder=folder)
    summary = (getattr(own.function, "__doc__", None) or "").strip().split("\n")[0]
    return Method(own.label, summary, _checked(own), False, False, False, normal_errors)


def _checked(own: OwnFunction) -> Solve:
    def solve(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, Array | None]:
        given = own(values.copy(), noise_variance, sensing)
        cells, error = given if isinstance(given, tuple) and len(given) == 2 else (given, None)
        checked = _array(own.name, "cells", cells, sensing)
        if error is None:
            return checked, None
        errors = _array(own.name, "standard errors", error, sensing)
        if (errors[sensing.measured] < 0).any():
            raise OwnFunctionError(f"{own.name}: returned negative standard errors")
        return checked, errors

    return solve


def _array(name: str, what: str, given: object, sensing: Sensing) -> NDArray[np.float64]:
    """Real numbers (n_cells,), finite where the patterns measure."""
    array = np.asarray(given)
    if array.dtype.kind not in "fiub":
        raise OwnFunctionError(
            f"{name}: returned {what} of type {type(given).__name__} ({array.dtype}), expected "
            "real numbers"
        )
    if array.shape != (sensing.n_cells,):
        raise OwnFunctionError(
            f"{name}: returned {what} of shape {array.shape}, expected ({sensing.n_cells},)"
        )
    if bad := int(np.count_nonzero(~np.isfinite(array[sensing.measured]))):
        raise OwnFunctionError(f"{name}: returned NaN or infinity in {bad} measured {what}")
    return array.astype(np.float64)
