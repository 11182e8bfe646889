"""Several echoes fitted together: delays, rates and amplitudes by least squares.

The amplitudes are projected out (variable projection, Golub and Pereyra, Inverse Problems 19, 2003,
doi 10.1088/0266-5611/19/2/201); the places follow by the method of Levenberg and Marquardt. The
normal matrix at the solution is the Fisher information of the places.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hardware.radar.refinement import Blocks, unit_echoes

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_STEPS = 30  # at most
_STILL = 1e-2  # of the noise of a cell: what the last step is to gain at least
_MOST_NOISE = 10.0  # of an amplitude beside the others, over that of an echo alone, in power
_FARTHEST = 0.5  # cells: the largest step


@dataclass(frozen=True, eq=False)
class JointModel:
    """Block sums, and echoes at fixed places ``fixed`` (n, 2) that are fitted in amplitude alone.

    Blocks are weighted to equal noise, ``noise_w`` of a cell. Places are cells from the middle of
    the blocks. ``beside_static``: the channel is one without its mean over slots, and so are the
    echoes that are fitted.
    """

    blocks: Blocks
    fixed: Array
    noise_w: float
    beside_static: bool = False

    @cached_property
    def weights(self) -> Array:
        """Root of each block's share of all samples (n_f, n_t)."""
        grid = self.blocks.grid
        counts = np.outer(grid.count_f, grid.count_t)
        return np.asarray(np.sqrt(counts / counts.sum()))

    @property
    def at_rest(self) -> float:
        """Cells of rate from the middle of the blocks to what does not move."""
        return float(-self.blocks.delay_rate / self.blocks.grid.cell[1])

    @cached_property
    def sums(self) -> Complex:
        """Weighted sums (n_channels, n_blocks) without the fixed echoes."""
        flat = (self.blocks.sums / self.weights).reshape(len(self.blocks.sums), -1)
        return self._beside_known(flat)

    def echoes(self, places: Array) -> tuple[Complex, Complex]:
        """Weighted sums (n, n_blocks) of echoes of unit amplitude, without the fixed echoes; and
        their changes (2 n, n_blocks) by cell of delay and of rate.
        """
        unit = self._unit(places)
        changes = (self._turns * unit[:, None]).reshape(-1, self.weights.size)
        return self._beside_known(unit), self._beside_known(changes)

    def fit(self, places: Array) -> "JointFit":
        """The echoes at these places (n, 2), amplitudes fitted."""
        echoes, changes = self.echoes(places)
        basis, triangle = np.linalg.qr(echoes.T)
        inverse = np.linalg.pinv(triangle)
        along = self.sums @ basis.conj()
        return JointFit(
            places=places,
            amplitudes=inverse @ along.T,
            residual=self.sums - along @ basis.T,
            changes=changes - (changes @ basis.conj()) @ basis.T,
            along=inverse @ (basis.conj().T @ changes.T),
            gram=inverse @ inverse.conj().T,
        )

    def refined(self, places: Array) -> "JointFit":
        """The echoes at the places of least squares that are reached from these."""
        best, damping = self.fit(places), 1e-3
        for _ in range(_STEPS if len(places) else 0):
            step, gain_w = best.step(damping)
            if gain_w < _STILL * self.noise_w:
                break
            moved = self.fit(best.places + np.clip(step, -_FARTHEST, _FARTHEST))
            if moved.misfit < best.misfit:
                best, damping = moved, damping / 10
            else:
                damping *= 10
        return best

    def residual_sums(self, fit: "JointFit") -> Complex:
        """What a fit leaves of the block sums (n_channels, n_f, n_t)."""
        return np.asarray(fit.residual.reshape(self.blocks.sums.shape) * self.weights)

    def alone(self, fit: "JointFit", i: int) -> Blocks:
        """One echo of a fit, with what the fit leaves, in blocks about its place."""
        place = fit.places[i]
        unit, _ = self.echoes(place[None])
        echo = (fit.amplitudes[i][:, None] * unit).reshape(self.blocks.sums.shape) * self.weights
        grid, (delay_s, delay_rate) = self.blocks.grid, place * self.blocks.grid.cell
        return replace(
            self.blocks,
            sums=(self.residual_sums(fit) + echo) * grid.phasor(place),
            delay_s=self.blocks.delay_s + delay_s,
            delay_rate=self.blocks.delay_rate + delay_rate,
        )

    @cached_property
    def _turns(self) -> Complex:
        """Change of each block over itself (2, n_blocks), by cell of delay and of rate: of its
        phase. What it loses changes some 1e-4 times as much.
        """
        grid = self.blocks.grid
        by_delay = np.broadcast_to(grid.by_delay[:, None], self.weights.shape)
        by_rate = 2 * np.pi * grid.cell[1] * np.outer(grid.carrier_hz + grid.f_hz, grid.t_s)
        return np.asarray(-1j * np.stack([by_delay.ravel(), by_rate.ravel()]))

    def _beside_known(self, rows: Complex) -> Complex:
        """Rows (n, n_blocks) without what is static and the fixed echoes."""
        return _without(self._moving(rows), self._known)

    @cached_property
    def _known(self) -> Complex:
        return np.asarray(np.linalg.qr(self._moving(self._unit(self.fixed)).T)[0])

    def _moving(self, rows: Complex) -> Complex:
        """Rows (n, n_blocks) without what is static, of any range profile, if that is asked for."""
        if not self.beside_static:
            return rows
        by_f = rows.reshape(len(rows), *self.weights.shape)
        along = np.einsum("nft,ft->nf", by_f, self._static.conj())
        return np.asarray((by_f - along[..., None] * self._static).reshape(rows.shape))

    @cached_property
    def _static(self) -> Complex:
        """What does not move, over the slots, of norm 1 for each block of subcarriers."""
        still = self._unit(np.array([[0.0, self.at_rest]])).reshape(self.weights.shape)
        return np.asarray(still / np.linalg.norm(still, axis=1, keepdims=True))

    def _unit(self, places: Array) -> Complex:
        return (unit_echoes(self.blocks, places) / self.weights).reshape(
            len(places), self.weights.size
        )


@dataclass(frozen=True, eq=False)
class JointFit:
    """Echoes at ``places`` (n, 2) with their ``amplitudes`` (n, n_channels), and the weighted
    ``residual`` (n_channels, n_blocks).

    ``changes`` (2 n, n_blocks): of the echoes by cell of delay and of rate, what amplitudes do not
    follow; ``along`` (n, 2 n): what they do. ``gram`` (n, n): variance and covariance of the
    amplitudes at known places, over that of one echo alone.
    """

    places: Array
    amplitudes: Complex
    residual: Complex
    changes: Complex
    along: Complex
    gram: Complex

    @cached_property
    def misfit(self) -> float:
        """Energy of the residual."""
        return float(np.vdot(self.residual, self.residual).real)

    def tells_apart(self, n_echoes: int, as_well_as: "JointFit | None" = None) -> bool:
        """Whether the amplitudes of its first echoes can be told from those of all others; or
        almost as well as in another fit.
        """
        noise, others = (
            float(np.diag(fit.gram).real[:n_echoes].max(initial=0.0))
            for fit in (self, as_well_as or self)
        )
        return noise <= (max(_MOST_NOISE, 2 * others) if as_well_as else _MOST_NOISE)

    @cached_property
    def information(self) -> Array:
        """Fisher information of the places (2 n, 2 n), times half the noise of a cell."""
        return np.asarray(((self._by_axis.conj() @ self._by_axis.T) * self._products.T).real)

    def step(self, damping: float) -> tuple[Array, float]:
        """Step of the places (n, 2) towards the least misfit, and by how much that falls to first
        order.
        """
        slope = np.sum(self._by_axis.conj() * (self.changes.conj() @ self.residual.T), axis=1).real
        diagonal = np.diag(self.information)
        floor = 1e-12 * diagonal.max(initial=0.0) or 1.0  # an axis of one sample tells nothing
        system = self.information + np.diag(damping * diagonal + floor)
        step = np.linalg.solve(system, slope)
        return step.reshape(-1, 2), float(step @ slope)

    @cached_property
    def covariance(self) -> Array:
        """Of the places (2 n, 2 n), in cells, for noise of 1 in a cell."""
        return np.asarray(0.5 * np.linalg.pinv(self.information, rcond=1e-12, hermitian=True))

    def power_variance(self, echo: int) -> float:
        """Of the mean power of an echo over channels by errors of the places, for noise of 1."""
        slope = -2 * np.mean(
            (self.amplitudes[echo].conj() * self.along[echo][:, None] * self._by_axis).real, axis=1
        )
        return float(slope @ self.covariance @ slope)

    @property
    def _by_axis(self) -> Complex:
        """Amplitudes (2 n, n_channels) of the echo that moves along each axis."""
        return np.repeat(self.amplitudes, 2, axis=0)

    @cached_property
    def _products(self) -> Complex:
        return np.asarray(self.changes @ self.changes.conj().T)


def _without(rows: Complex, basis: Complex) -> Complex:
    """Rows (n, n_blocks) projected out of an orthonormal basis (n_blocks, n_basis)."""
    return np.asarray(rows - (rows @ basis.conj()) @ basis.T)
