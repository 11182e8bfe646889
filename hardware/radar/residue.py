"""What is left around an echo after its subtraction: noise and other echoes."""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.refinement import APART, BlockGrid, Blocks, unit_echoes

Array = NDArray[np.float64]

#: Cells to each side of an echo in which its noise is measured.
AROUND = 3
#: The same along one axis alone: of 13 cells the mean scatters by 0.3 on one channel, and a main
#: lobe of a window leaves some.
_ALONG = 6
#: Times the median of those cells, above which a cell counts as this much: another strong echo is
#: no clutter everywhere. Of noise it takes 6 %.
_ANOTHER_ECHO = 4.0
#: Chance that white noise along one axis counts for that of the block: stated errors are 2 % wider
#: in the mean. Clutter of half the noise, which one channel seldom tells, leaves them 6 % narrow.
_BY_CHANCE = 0.03
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
    and other echoes, up to ``reach`` cells to each side, or along one axis.

    Clutter at rest lies in the cells of one rate, what a body's parts scatter in those of one
    range: the mean of a block dilutes them. Those of the target's own rate or range are taken where
    they hold more than noise like that of the block would by chance.

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
    rest, grid = flat - (flat @ basis.conj().T) @ basis, blocks.grid
    block, _ = _cells_around(rest, basis, grid, step, (reach, reach))
    most, most_w = block, residual_power(block)
    n_channels = _independent_channels(block)
    for along in ((_ALONG, 0), (0, _ALONG)):
        cells, n_cells = _cells_around(rest, basis, grid, step, along)
        cells = _without_strong(cells)
        by_chance = _by_chance(n_channels * n_cells)
        if residual_power(cells) > max(most_w, by_chance * residual_power(block)):
            most, most_w = cells, residual_power(cells)
    return most


def residual_power(cells: NDArray[np.complex128]) -> float:
    """Mean power of `residual_cells` over cells and channels."""
    return float(np.mean(np.abs(cells) ** 2))


def _without_strong(cells: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Cells (n_channels, n_cells), of which none is farther above their median than counts."""
    power = np.mean(np.abs(cells) ** 2, axis=0)
    most = _ANOTHER_ECHO * np.median(power)
    return cells * np.sqrt(most / np.maximum(power, max(most, np.finfo(float).tiny)))


def _by_chance(n_free: float) -> float:
    """Mean power of so many independent cells, over that expected, which noise seldom exceeds."""
    from scipy.special import gammainccinv

    return float(gammainccinv(n_free, _BY_CHANCE)) / n_free if n_free else np.inf


def _independent_channels(cells: NDArray[np.complex128]) -> float:
    """As many independent channels have means of power that scatter as those of cells
    (n_channels, n_cells) do.
    """
    covariance = cells @ cells.conj().T
    square = float(np.vdot(covariance, covariance).real)
    return float(np.trace(covariance).real) ** 2 / square if square else 0.0


def _cells_around(
    rest: NDArray[np.complex128],
    basis: NDArray[np.complex128],
    grid: BlockGrid,
    step: Array,
    reach: tuple[int, int],
) -> tuple[NDArray[np.complex128], float]:
    """Cells of what is left of block sums (n_channels, n_blocks) after projection out of an
    orthonormal basis, with the mean power that white noise had before, and the number of them that
    are independent along their longer axis; zeros where nothing is left of noise.
    """
    cells = _cells_of(rest, grid, step, reach)
    left = _share_left(basis, grid, step, reach)
    if left <= _LEAST_LEFT:
        return np.zeros_like(cells), 0.0
    axis = int(reach[1] > reach[0])
    count, taper = ((grid.count_f, grid.taper_f), (grid.count_t, grid.taper_t))[axis]
    square = float(count @ taper**2) ** 2 / float(count.sum() * (count @ taper**4))  # of a window
    whole = 1 + 2 * min(reach[axis], (len(count) - 1) // 2)
    return cells / np.sqrt(left), left * whole * square


def _cells_of(
    flat: NDArray[np.complex128], grid: BlockGrid, step: Array, reach: tuple[int, int]
) -> NDArray[np.complex128]:
    """Cells and those halfway between (n, n_cells), around a place of block sums (n, n_blocks): on
    whole cells from a place the side lobes of an echo as far from it are not seen.
    """
    shape = len(grid.f_hz), len(grid.t_s)
    most = [min(cells, (n - 1) // 2) for cells, n in zip(reach, shape, strict=True)]
    cells = [np.arange(-2 * cells, 2 * cells + 1) / 2 for cells in most]
    across = np.exp(1j * np.outer(step[0] + cells[0], grid.by_delay))
    along = np.exp(1j * np.outer(grid.by_rate, step[1] + cells[1]))
    return np.asarray((across @ flat.reshape(-1, *shape) @ along).reshape(len(flat), -1))


def _share_left(
    basis: NDArray[np.complex128], grid: BlockGrid, step: Array, reach: tuple[int, int]
) -> float:
    """Mean power of white noise in the cells around a place after projection out of an orthonormal
    basis (n, n_blocks), over that before.
    """
    power = np.outer(grid.count_f * grid.taper_f**2, grid.count_t * grid.taper_t**2).ravel()
    taken, with_noise = (_cells_of(part, grid, step, reach) for part in (basis, basis * power))
    among = (basis * power) @ basis.conj().T
    lost = 2 * np.vdot(taken, with_noise).real - np.vdot(taken, among.T @ taken).real
    return float(1 - lost / (power.sum() * taken.shape[1]))
