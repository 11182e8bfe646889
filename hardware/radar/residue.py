"""What is left around an echo after its subtraction: noise and other echoes."""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.refinement import APART, BlockGrid, Blocks, unit_echoes

Array = NDArray[np.float64]

#: Cells to each side of an echo in which its noise is measured.
AROUND = 3
_ALIKE = 1e-9  # of the power of what is subtracted, below which it is rounding error
_LEAST_LEFT = 0.05  # of noise, from which its power can be told


def residual_cells(
    blocks: Blocks,
    step: Array,
    reach: int = AROUND,
    *,
    follow: bool = True,
    leakage: NDArray[np.complex128] | None = None,
    beside: Array | None = None,
) -> NDArray[np.complex128]:
    """Amplitudes (n_channels, n_cells) of the cells around a target after its subtraction: noise
    and other echoes, up to ``reach`` cells to each side.

    ``follow``: every channel has a delay and a rate of its own, as where antennas are a part of a
    range cell apart. ``leakage`` (n_subcarriers,): what subcarriers hold of the target beside its
    echo, over the echo. ``beside`` (n, 2): others that are subtracted as well. What the subtraction
    takes from white noise is given back in the mean.
    """
    moves = np.array([[0.0, 0.0], [APART, 0.0], [0.0, APART]])[: 3 if follow else 1]
    subtracted = step[None] if beside is None else np.vstack([step, beside])
    places = (subtracted[:, None] + moves).reshape(-1, 2)
    atoms = unit_echoes(blocks, places).reshape(len(places), -1)
    if leakage is not None:
        starts = np.cumsum(blocks.grid.count_f) - blocks.grid.count_f
        by_block = np.add.reduceat(leakage, starts) / blocks.grid.count_f
        leaked = atoms[0].reshape(len(by_block), -1) * by_block[:, None]
        atoms = np.vstack([atoms, leaked.reshape(1, -1)])
    values, vectors = np.linalg.eigh(atoms.conj() @ atoms.T)
    some = values > _ALIKE * values[-1]  # along an axis of one sample all places are the same
    basis = (atoms.T @ vectors[:, some] / np.sqrt(values[some])).T
    flat = blocks.sums.reshape(len(blocks.sums), -1)
    cells = _cells_around(flat - (flat @ basis.conj().T) @ basis, blocks.grid, step, reach)
    left = _share_left(basis, blocks.grid, step, reach)
    return cells / np.sqrt(left) if left > _LEAST_LEFT else np.zeros_like(cells)


def residual_power(cells: NDArray[np.complex128]) -> float:
    """Mean power of `residual_cells` over cells and channels."""
    return float(np.mean(np.abs(cells) ** 2))


def _cells_around(
    flat: NDArray[np.complex128], grid: BlockGrid, step: Array, reach: int
) -> NDArray[np.complex128]:
    """Cells and those halfway between (n, n_cells), around a place of block sums (n, n_blocks): on
    whole cells from a place the side lobes of an echo as far from it are not seen.
    """
    shape = len(grid.f_hz), len(grid.t_s)
    most = [min(reach, (n - 1) // 2) for n in shape]
    cells = [np.arange(-2 * cells, 2 * cells + 1) / 2 for cells in most]
    across = np.exp(1j * np.outer(step[0] + cells[0], grid.by_delay))
    along = np.exp(1j * np.outer(grid.by_rate, step[1] + cells[1]))
    return np.asarray((across @ flat.reshape(-1, *shape) @ along).reshape(len(flat), -1))


def _share_left(basis: NDArray[np.complex128], grid: BlockGrid, step: Array, reach: int) -> float:
    """Mean power of white noise in the cells around a place after projection out of an orthonormal
    basis (n, n_blocks), over that before.
    """
    power = np.outer(grid.count_f * grid.taper_f**2, grid.count_t * grid.taper_t**2).ravel()
    taken, with_noise = (_cells_around(part, grid, step, reach) for part in (basis, basis * power))
    among = (basis * power) @ basis.conj().T
    lost = 2 * np.vdot(taken, with_noise).real - np.vdot(taken, among.T @ taken).real
    return float(1 - lost / (power.sum() * taken.shape[1]))
