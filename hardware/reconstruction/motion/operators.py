"""The linear map from a moving image to its measurements, without a matrix of it.

Light is constant in each unknown of the grid, and a cell gathers what lies within it at its time:
for shifts that is exact. A Hadamard pattern is the outer product of two Walsh functions, and so is
a shifted one: measurement k is u_k^T X v_k. Other warps are sparse matrices at some instants, with
images between them interpolated in time, and the fast transform behind them.
"""

from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import fwht_in_place, hadamard_rows
from hardware.reconstruction.motion.grid import Grid
from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.layers import Layers, Seen
from hardware.reconstruction.motion.model import Motion, Translation
from hardware.reconstruction.motion.timing import TimedRows

Array = NDArray[np.float64]

#: Values that the matrices of one operator may hold: 512 MiB.
MOST_VALUES = 2**26


class MovingPatterns(Protocol):
    """Measurements of the unknowns of a grid, and the transpose."""

    grid: Grid

    def image(self, unknowns: Array) -> Array:
        """Cells (rows, columns) of the image at the reference time."""

    def forward(self, unknowns: Array) -> Array:
        """Measurements ``(count,)`` of unknowns ``grid.shape``."""

    def adjoint(self, values: Array) -> Array:
        """Transpose of `forward`."""

    def rows(self, some: NDArray[np.intp]) -> Array:
        """Some rows of the matrix, ``(len(some), *grid.shape)``."""


def moving_patterns(
    timed: TimedRows, motion: Motion, shape: tuple[int, int], knobs: Compensation
) -> MovingPatterns:
    """The operator of a motion. Raises InputError where it leads too far beyond the image."""
    if isinstance(motion, Translation):
        return ShiftedPatterns(timed, motion, shape, knobs)
    return WarpedPatterns(timed, motion, shape, knobs)


class ShiftedPatterns:
    """All of the image moves alike; each measurement at its own time."""

    def __init__(
        self, timed: TimedRows, motion: Translation, shape: tuple[int, int], knobs: Compensation
    ) -> None:
        moved = motion.displacement(timed.time_s.ravel())
        far = np.array(shape) - 1.0
        low = np.minimum(-moved.max(axis=0), 0.0)
        high = np.maximum(far - moved.min(axis=0), far)
        size = timed.rows.size * knobs.oversampling * float(np.sum(high - low + 2))
        check_size(size, float(np.abs(moved).max()))
        self.grid = Grid.around(shape, low - 0.5, high + 0.5, knobs.oversampling)
        down, along = divmod(timed.rows.ravel(), shape[1])
        g, n = self.grid, knobs.oversampling
        u = shifted_rows(down, moved[:, 0], shape[0], -g.above, g.shape[0], n)
        self._u = u * timed.weight.reshape(-1, 1)
        self._v = shifted_rows(along, moved[:, 1], shape[1], -g.left, g.shape[1], n)
        self._terms, self._centred = timed.rows.shape, timed.centred

    def image(self, unknowns: Array) -> Array:
        """See `MovingPatterns`."""
        return self.grid.image(unknowns)

    def forward(self, unknowns: Array) -> Array:
        """See `MovingPatterns`."""
        found = np.einsum("kj,kj->k", self._u @ unknowns, self._v)
        found = found.reshape(self._terms).sum(axis=0)
        return np.asarray(found - found.mean() if self._centred else found)

    def adjoint(self, values: Array) -> Array:
        """See `MovingPatterns`."""
        y = values - values.mean() if self._centred else values
        each = np.broadcast_to(y, self._terms).reshape(-1, 1)
        return np.asarray(self._u.T @ (each * self._v))

    def rows(self, some: NDArray[np.intp]) -> Array:
        """See `MovingPatterns`."""
        found = np.zeros((len(some), *self.grid.shape))
        for term in range(self._terms[0]):
            k = term * self._terms[1] + some
            found += self._u[k][:, :, None] * self._v[k][:, None, :]
        return found - self._mean if self._centred else found

    @cached_property
    def _mean(self) -> Array:
        """Of all rows."""
        return np.asarray(self._u.T @ self._v / self._terms[1])


def shifted_rows(
    rows: NDArray[np.intp], moved: Array, n: int, first: int, count: int, oversampling: int
) -> Array:
    """Walsh functions ``rows`` (k,) of n cells, each moved back by ``moved`` (k,) cells, on
    ``count`` unknowns from the edge of cell ``first`` on, ``(k, count)``.

    An unknown that is ``w`` cells wide has the integral of the function over it.
    """
    walsh = hadamard_rows(rows, n).astype(np.float64)
    integral = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(walsh, axis=1)], axis=1)
    edges = first + np.arange(count + 1) / oversampling
    at = np.clip(edges + moved[:, None], 0.0, n)
    cell = np.minimum(at.astype(np.intp), n - 1)
    k = np.arange(len(rows))[:, None]
    return np.diff(integral[k, cell] + (at - cell) * walsh[k, cell], axis=1)


class WarpedPatterns:
    """Any warp: sparse matrices at instants, images between them interpolated in time."""

    def __init__(
        self, timed: TimedRows, motion: Motion, shape: tuple[int, int], knobs: Compensation
    ) -> None:
        from scipy import sparse  # takes 0.1 s to import

        n, n_cells = knobs.oversampling, shape[0] * shape[1]
        places = subcell_places(shape, n)
        instants = _instants(timed.time_s, motion, places, shape, knobs.step_cells)
        if layered := isinstance(motion, Layers):
            seen = motion.on_grid(instants, places, 1 / n, shape)
        else:
            seen = [Seen.all_of(motion, float(t), places, shape) for t in instants]
        low = np.min([np.zeros(2), *(one.sources.min(axis=0) for one in seen)], axis=0)
        high = np.max([np.array(shape) - 1.0, *(one.sources.max(axis=0) for one in seen)], axis=0)
        far = max(float(np.abs(one.sources - places[one.part]).max()) for one in seen)
        check_size(8.0 * n * n * n_cells * len(instants), far)
        check_size(n * n * float(np.prod(high - low + 2)), far)
        self.grid = Grid.around(shape, low - 0.5, high + 0.5, n)
        parts = [_gathering(one, n_cells, self.grid) for one in seen]
        self._reference: Any = parts.pop() if layered else None
        self._warp: Any = sparse.vstack(parts, format="csr")
        self._back: Any = self._warp.T.tocsr()
        self._shape = (len(instants), n_cells)
        at = np.interp(timed.time_s, instants, np.arange(len(instants), dtype=np.float64))
        self._before = np.minimum(at.astype(np.intp), max(len(instants) - 2, 0))
        self._after = np.minimum(self._before + 1, len(instants) - 1)
        late = at - self._before
        self._weights = timed.weight * (1 - late), timed.weight * late
        self._timed = timed

    def image(self, unknowns: Array) -> Array:
        """See `MovingPatterns`."""
        if self._reference is None:
            return self.grid.image(unknowns)
        cells = self._reference @ unknowns.ravel()
        return np.asarray(cells.reshape(self.grid.rows, self.grid.columns))

    def forward(self, unknowns: Array) -> Array:
        """See `MovingPatterns`."""
        fields = np.ascontiguousarray((self._warp @ unknowns.ravel()).reshape(self._shape).T)
        spectra, rows = fwht_in_place(fields), self._timed.rows
        found = self._weights[0] * spectra[rows, self._before]
        found = (found + self._weights[1] * spectra[rows, self._after]).sum(axis=0)
        return np.asarray(found - found.mean() if self._timed.centred else found)

    def adjoint(self, values: Array) -> Array:
        """See `MovingPatterns`."""
        y = values - values.mean() if self._timed.centred else values
        spectra, rows = np.zeros(self._shape[::-1]), self._timed.rows
        np.add.at(spectra, (rows, self._before), self._weights[0] * y)
        np.add.at(spectra, (rows, self._after), self._weights[1] * y)
        fields = fwht_in_place(spectra)
        return np.asarray((self._back @ fields.T.ravel()).reshape(self.grid.shape))

    def rows(self, some: NDArray[np.intp]) -> Array:
        """See `MovingPatterns`."""
        n_cells = self._shape[1]
        found = np.zeros((len(some), self.grid.shape[0] * self.grid.shape[1]))
        for at, weight in zip((self._before, self._after), self._weights, strict=True):
            for instant in np.unique(at[:, some]):
                part = self._back[:, instant * n_cells : (instant + 1) * n_cells]
                for term, now in enumerate(at[:, some] == instant):
                    row = np.flatnonzero(now)  # each once, as `numpy.add.at` would be slow
                    walsh = hadamard_rows(self._timed.rows[term, some[row]], n_cells)
                    weighted = weight[term, some[row], None] * walsh
                    found[row] += (part @ weighted.T).T
        if self._timed.centred:
            found -= self._mean
        return found.reshape(-1, *self.grid.shape)

    @cached_property
    def _mean(self) -> Array:
        """Of all rows, ``(n_unknowns,)``."""
        spectra, rows = np.zeros(self._shape[::-1]), self._timed.rows
        np.add.at(spectra, (rows, self._before), self._weights[0] / self._timed.count)
        np.add.at(spectra, (rows, self._after), self._weights[1] / self._timed.count)
        return np.asarray(self._back @ fwht_in_place(spectra).T.ravel())


def subcell_places(shape: tuple[int, int], n: int) -> Array:
    """Middles of the n x n parts of each cell, cell by cell, ``(n_cells * n * n, 2)``."""
    parts = (np.arange(n) + 0.5) / n - 0.5
    row, column, down, along = np.meshgrid(
        np.arange(shape[0]), np.arange(shape[1]), parts, parts, indexing="ij"
    )
    return np.column_stack([(row + down).ravel(), (column + along).ravel()])


def farthest_cells(motion: Motion, time_s: Array, shape: tuple[int, int]) -> float:
    """The most that any place of the image moves from its place at time 0, at the times given."""
    return max(_farthest(one, time_s, shape) for one in motion.parts)


def _farthest(motion: Motion, time_s: Array, shape: tuple[int, int]) -> float:
    if isinstance(motion, Translation):
        return float(np.abs(motion.displacement(time_s.ravel())).max(initial=0.0))
    places = subcell_places(shape, 1)
    ends = (float(time_s.min()), float(time_s.max()))
    return max(float(np.abs(motion.sources(t, places, shape) - places).max()) for t in ends)


def _instants(
    time_s: Array, motion: Motion, places: Array, shape: tuple[int, int], step_cells: float
) -> Array:
    """Times between which no place moves by more than a step, ascending, the ends among them."""
    first, last = float(time_s.min()), float(time_s.max())
    if last <= first:
        return np.array([first])
    found = [first]

    def at(time_s: float) -> Array:
        return np.concatenate([one.sources(time_s, places, shape) for one in motion.parts])

    here = at(first)
    whole = float(np.abs(at(last) - here).max())
    share = 1.0
    while found[-1] < last:
        ahead = min(found[-1] + share * (last - first), last)
        there = at(ahead)
        moved = float(np.abs(there - here).max())
        if not np.isfinite(moved):
            raise InputError("motion: leads to what is not a number")
        if moved > step_cells and share > 1e-6:
            share *= max(0.8 * step_cells / moved, 0.01)
            continue
        found.append(ahead)
        check_size(8.0 * len(found) * len(places), max(whole, moved * len(found)))
        here, share = there, share * 1.1
    return np.array(found)


def _gathering(seen: Seen, n_cells: int, grid: Grid) -> Any:
    """Sparse matrix (n_cells, unknowns): the mean of each cell's parts, linear between unknowns."""
    from scipy import sparse

    n = grid.oversampling
    at = (seen.sources + [grid.above + 0.5, grid.left + 0.5]) * n - 0.5
    corner = np.floor(at).astype(np.intp)
    late = at - corner
    cell = seen.part // (n * n)
    rows, columns, weights = [], [], []
    for down in (0, 1):
        for along in (0, 1):
            weight = np.abs(1 - down - late[:, 0]) * np.abs(1 - along - late[:, 1])
            r = np.clip(corner[:, 0] + down, 0, grid.shape[0] - 1)
            c = np.clip(corner[:, 1] + along, 0, grid.shape[1] - 1)
            rows.append(cell)
            columns.append(r * grid.shape[1] + c)
            weights.append(weight * seen.light / (n * n))
    size = (n_cells, grid.shape[0] * grid.shape[1])
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    return sparse.coo_array(entries, shape=size).tocsr()


def check_size(values: float, moved: float) -> None:
    """Raise InputError for an operator that is larger than `MOST_VALUES`."""
    if not values <= MOST_VALUES:
        raise InputError(
            f"motion: moves the image by {moved:.3g} cells within the frame; "
            f"{np.ceil(values / 2**17):.6g} MiB are needed to follow it, at most "
            f"{MOST_VALUES / 2**17:g} MiB are granted: take fewer patterns, or a shorter frame"
        )
