"""Where reconstruction methods are found: one file, one decorator.

    from hardware.reconstruction.registry import Array, Sensing, method

    @method("mine")
    def mine(values, noise_variance, sensing):
        \"\"\"One line that says what it does.\"\"\"
        return cells, standard_error  # or None where the method gives no error

A file in `hardware.reconstruction.methods`, or a module named by an installed package under the
entry-point group ``ugv.reconstruction``, is found by itself.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import Patterns
from hardware.reconstruction.sensing import Sensing

Array = NDArray[np.float64]
Solve = Callable[[Array, float, Sensing], tuple[Array, Array | None]]
SolveJointly = Callable[[Array, Array, Sensing], tuple[Array, Array | None]]


@dataclass(frozen=True)
class Method:
    """A reconstruction method.

    ``solve`` takes measurements (count,), the noise variance of one and the `Sensing`, and gives
    cells (n_cells,) with their standard error (n_cells,) or None, in electrons. A ``joint`` method
    takes all detectors at once: (count, n_detectors), (n_detectors,); gives (n_cells,
    n_detectors). A method that needs Hadamard rows on a clean grid of cells says ``grid_only``; one
    that takes longer than a frame, ``slow``. ``errors_in_95`` is how many of its standard errors
    hold 95 % of all cells: 1.96 of normal errors. A ``linear`` method states errors and takes sums
    of measurements as any: images of shutters are made of such
    (`hardware.reconstruction.shutter_images`).
    """

    name: str
    summary: str
    solve: Solve | SolveJointly
    joint: bool
    grid_only: bool
    slow: bool
    errors_in_95: Callable[[Sensing], float]
    linear: bool = False

    def __call__(
        self,
        values: Array,
        noise_variance: float | Array,
        sensing: Sensing | Patterns,
    ) -> tuple[Array, Array | None]:
        """Solve. Raises InputError for values that do not fit, or are not numbers."""
        problem = Sensing(sensing) if isinstance(sensing, Patterns) else sensing
        if len(values) != problem.count:
            raise InputError(f"values: {len(values)}, the pattern set has {problem.count}")
        if not (np.isfinite(values).all() and np.isfinite(noise_variance).all()):
            raise InputError("values: hold what is not a number")
        if self.grid_only and problem.mixing:
            raise InputError(f"method: {self.name!r} needs a clean grid of cells, without mixing")
        if self.grid_only and problem.is_dense:
            raise InputError(
                f"method: {self.name!r} needs rows of the Hadamard matrix, these patterns are a "
                "user's own; 'least-squares' inverts any"
            )
        if not (self.joint and values.ndim == 1):
            return self.solve(values, noise_variance, problem)  # type: ignore[arg-type]
        cells, error = self.solve(values[:, None], np.atleast_1d(noise_variance), problem)  # type: ignore[arg-type]
        return cells[:, 0], None if error is None else error[:, 0]


METHODS: dict[str, Method] = {}


def normal_errors(_: Sensing) -> float:
    """Standard errors that hold 95 % of normal errors."""
    return 1.96


def method(
    name: str,
    *,
    joint: bool = False,
    grid_only: bool = False,
    slow: bool = False,
    errors_in_95: Callable[[Sensing], float] = normal_errors,
    linear: bool = False,
) -> Callable[
    [Callable[..., tuple[Array, Array | None]]], Callable[..., tuple[Array, Array | None]]
]:
    """Register a function as a reconstruction method. Raises InputError for a name in use."""

    def register(
        solve: Callable[..., tuple[Array, Array | None]],
    ) -> Callable[..., tuple[Array, Array | None]]:
        if name in METHODS:
            raise InputError(f"method: {name!r} is registered twice")
        summary = (solve.__doc__ or "").strip().split("\n")[0]
        METHODS[name] = Method(name, summary, solve, joint, grid_only, slow, errors_in_95, linear)
        return solve

    return register


def discover() -> None:
    """Import every module of this package that registers methods."""
    from hardware.reconstruction import methods

    for module in sorted(pkgutil.iter_modules(methods.__path__), key=lambda m: m.name):
        importlib.import_module(f"{methods.__name__}.{module.name}")


@lru_cache(maxsize=1)
def load_plugins() -> None:
    """Import what installed packages offer; looking for it takes tens of milliseconds."""
    from importlib.metadata import entry_points

    for point in entry_points(group="ugv.reconstruction"):
        point.load()
