"""How an image moves: where the light that a cell shows at a time stood at the reference time.

Places are (row, column) in cells, cell centres at whole numbers, (0, 0) the first cell; times are
seconds after the reference time, the frame's middle unless told otherwise. Down and to the right
are positive.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError

Array = NDArray[np.float64]


class Motion(ABC):
    """A warp of the image over time."""

    @abstractmethod
    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """Where what ``places`` (n, 2) show at a time stood at time 0, ``(n, 2)``, in cells.

        ``shape`` is the image's, rows and columns. Raises InputError where it does not fit.
        """

    def brightness(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """Light that ``places`` (n, 2) show at a time over that of their sources at time 0,
        ``(n,)``: 1, unless a motion knows better.
        """
        return np.ones(len(places))

    @property
    def parts(self) -> "tuple[Motion, ...]":
        """What moves without jumps from place to place: all of it, or each layer."""
        return (self,)


class Translation(Motion):
    """All of the image moves alike: its patterns stay products of a row's and a column's part."""

    @abstractmethod
    def displacement(self, time_s: Array) -> Array:
        """Of the image since time 0, cells down and to the right, ``(n, 2)`` at times ``(n,)``."""

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`."""
        return np.asarray(places - self.displacement(np.array([time_s])))


@dataclass(frozen=True)
class Shift(Translation):
    """Constant velocity of the whole image.

    Parameters
    ----------
    down_cells_per_s, right_cells_per_s
        Of the image's content; a rig that turns to the left moves it to the right.
    down_cells_per_s2, right_cells_per_s2
        Acceleration.

    >>> Shift(0.0, 10.0).displacement(np.array([0.5]))
    array([[0., 5.]])
    """

    down_cells_per_s: float
    right_cells_per_s: float
    down_cells_per_s2: float = 0.0
    right_cells_per_s2: float = 0.0

    def __post_init__(self) -> None:
        for name in vars(self):
            value = getattr(self, name)
            if np.ndim(value):
                raise InputError(f"motion: {name}: shape {np.shape(value)}, expected a number")
            _check(f"motion: {name}", value)

    def displacement(self, time_s: Array) -> Array:
        """See `Translation.displacement`."""
        velocity = np.array([self.down_cells_per_s, self.right_cells_per_s])
        acceleration = np.array([self.down_cells_per_s2, self.right_cells_per_s2])
        t = np.asarray(time_s)[:, None]
        return np.asarray(velocity * t + acceleration * t**2 / 2)


@dataclass(frozen=True, eq=False)
class ShiftTrack(Translation):
    """Displacements of the whole image at some times, a cubic spline between them.

    Parameters
    ----------
    time_s : (n,)
        After the reference time, ascending; the frame must lie within them.
    cells : (n, 2)
        Displacement down and to the right.
    """

    time_s: Array
    cells: Array

    def __post_init__(self) -> None:
        t, d = np.asarray(self.time_s, np.float64), np.asarray(self.cells, np.float64)
        if t.ndim != 1 or len(t) < 2 or d.shape != (len(t), 2):
            raise InputError(
                f"motion: times {t.shape}, cells {d.shape}, expected (n,) and (n, 2), n at least 2"
            )
        _check("motion: time_s", t)
        _check("motion: cells", d)
        if (np.diff(t) <= 0).any():
            raise InputError("motion: time_s: do not ascend")

    def displacement(self, time_s: Array) -> Array:
        """See `Translation.displacement`. Raises InputError outside the times given."""
        from scipy.interpolate import CubicSpline  # takes 0.1 s to import

        t = np.asarray(self.time_s, np.float64)
        wanted = np.asarray(time_s)
        slack = 1e-9 * (t[-1] - t[0])
        if wanted.size and (wanted.min() < t[0] - slack or wanted.max() > t[-1] + slack):
            raise InputError(
                f"motion: time_s: {t[0]:g} to {t[-1]:g} s, but exposures are from "
                f"{wanted.min():g} to {wanted.max():g} s"
            )
        return np.asarray(CubicSpline(t, np.asarray(self.cells, np.float64))(wanted))


@dataclass(frozen=True, eq=False)
class Homography(Motion):
    """A plane seen by a moving camera; affine and rigid warps with it.

    Parameters
    ----------
    rate : (3, 3)
        Generator G: what stands at (row, column, 1) at time 0 stands at expm(G t) (row, column, 1)
        at t, divided by its last number; cells and seconds, the first cell's centre at (0, 0).

    A turn of w rad/s about the place (r, c), from down towards right, is [[0, -w, w c],
    [w, 0, -w r], [0, 0, 0]].
    """

    rate: Array

    def __post_init__(self) -> None:
        rate = np.asarray(self.rate, np.float64)
        if rate.shape != (3, 3):
            raise InputError(f"motion: rate: shape {rate.shape}, expected (3, 3)")
        _check("motion: rate", rate)

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`."""
        from scipy.linalg import expm  # takes 0.1 s to import

        with np.errstate(all="ignore"):  # overflow is told below
            back = expm(-time_s * np.asarray(self.rate, np.float64))
            found = np.column_stack([places, np.ones(len(places))]) @ back.T
        if not (np.isfinite(found).all() and (found[:, 2] > 0).all()):
            raise InputError(
                f"motion: rate: at {time_s:g} s a cell shows what is infinitely far, or behind"
            )
        return np.asarray(found[:, :2] / found[:, 2:])


@dataclass(frozen=True, eq=False)
class CellMotion(Motion):
    """A constant velocity of each cell of the image as it is at time 0.

    Parameters
    ----------
    cells_per_s : (rows, columns, 2)
        Down and to the right. It is taken linear between cells and constant beyond the border.
        What is covered and uncovered at edges of objects is not told apart.
    """

    cells_per_s: Array

    def __post_init__(self) -> None:
        _check("motion: cells_per_s", self.cells_per_s)
        field = np.asarray(self.cells_per_s, np.float64)
        if field.ndim != 3 or field.shape[2] != 2:
            raise InputError(
                f"motion: cells_per_s: shape {field.shape}, expected (rows, columns, 2)"
            )

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`."""
        field = np.asarray(self.cells_per_s, np.float64)
        if field.shape[:2] != shape:
            raise InputError(
                f"motion: cells_per_s: of {field.shape[0]} x {field.shape[1]} cells, the image has "
                f"{shape[0]} x {shape[1]}"
            )
        return fixed_point(places, lambda s: time_s * sampled(field, s))


def fixed_point(places: Array, displacement: Callable[[Array], Array]) -> Array:
    """Sources s with s + displacement(s) = places, by damped fixed-point steps.

    It converges where displacements of neighbours differ by less than their distance; elsewhere,
    at edges of objects, it ends at one of the sources or between them.
    """
    found = places.copy()
    for step in range(_FIXED_POINT_STEPS):
        wanted = places - displacement(found)
        change = np.abs(wanted - found).max(initial=0.0)
        found = wanted if step < _FIXED_POINT_STEPS // 2 else (found + wanted) / 2
        if change < _FIXED_POINT_CELLS:
            break
    return found


def sampled(field: Array, places: Array) -> Array:
    """Values (n, k) of a field (rows, columns, k) at places (n, 2): linear, constant beyond."""
    from scipy.ndimage import map_coordinates  # takes 0.1 s to import

    at = places.T
    parts = [
        map_coordinates(part, at, order=1, mode="nearest") for part in np.moveaxis(field, 2, 0)
    ]
    return np.stack(parts, axis=1)


def all_finite(value: ArrayLike) -> bool:
    """Whether a value holds finite real numbers only."""
    try:
        kind = np.asarray(value).dtype.kind
    except ValueError:  # lists of unequal lengths
        return False
    return kind in "fiu" and bool(np.isfinite(np.asarray(value, np.float64)).all())


def _check(name: str, value: ArrayLike) -> None:
    if not all_finite(value):
        given = " ".join(repr(value).split())  # of an array in one line
        raise InputError(f"{name}: {given:.60}, expected finite numbers")


#: Steps, and where they end.
_FIXED_POINT_STEPS, _FIXED_POINT_CELLS = 40, 1e-6
