"""Targets closer than a cell or two, told apart by orthogonal matching pursuit off the grid.

The strongest target is found, all are fitted together by least squares (delays, rates and
amplitudes), their sum is taken away, and the rest is searched again, until it holds nothing above
noise (Mamandipoor, Ramasamy and Madhow, IEEE Trans. Signal Process. 64, 2016, doi
10.1109/TSP.2016.2580523). Without a window: it would cost resolution and nothing here has side
lobes.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.detection import Detection, measurement
from hardware.radar.refinement import Blocks, blocks_about
from hardware.radar.waveform import OfdmWaveform

Array = NDArray[np.float64]


def resolve(
    channel: Complex,
    waveform: OfdmWaveform,
    found: Detection,
    noise_w: float,
    *,
    false_alarm: float = 1e-6,
    reach: float = 3.0,
    at_most: int = 4,
) -> list[tuple[Detection, NDArray[np.complex128]]]:
    """Split a detection into the targets that it consists of, nearest first.

    Parameters
    ----------
    channel, waveform
        As for `detect`.
    found
        What is looked at closely.
    noise_w
        Mean noise power of a cell without a window.
    false_alarm
        Probability per cell searched that noise is taken for one more target.
    reach
        Cells to each side in range that are searched, and in rate a third of it.
    at_most
        Targets looked for.

    Each comes with its amplitude on every channel.
    """
    blocks = blocks_about(
        channel,
        waveform,
        "boxcar",
        np.array([found.range_m]),
        np.array([found.range_rate_m_per_s]),
    )[0]
    reached = reach, max(reach / 3, 1.0)
    steps = np.zeros((0, 2))
    amplitudes = np.zeros((0, len(blocks.sums)), dtype=np.complex128)
    rest = blocks.sums
    while len(steps) < at_most:
        power, step = _strongest(rest, blocks, reached)
        if power * len(rest) <= noise_w * _threshold(false_alarm, len(rest)):
            break
        steps = _fitted(np.vstack([steps, step]), blocks)
        atoms = _atoms(blocks, steps)
        amplitudes = _amplitudes(atoms, blocks.sums)
        rest = blocks.sums - np.einsum("kc,kft->cft", amplitudes, atoms)
    results = [
        measurement(blocks, step, amplitude, waveform, noise_w, "boxcar")
        for step, amplitude in zip(steps, amplitudes, strict=True)
    ]
    return sorted(results, key=lambda pair: pair[0].range_m)


def _threshold(false_alarm: float, n_channels: int) -> float:
    """Sum over channels of noise over its mean that a peak near a cell exceeds by chance.

    Between cells noise peaks higher than on them: along each axis sqrt(pi x / 3) as often (Rice's
    rate of crossings of a level x by band-limited noise).
    """
    from scipy.special import gammainccinv

    return float(gammainccinv(n_channels, false_alarm / (np.pi / 3 * -np.log(false_alarm))))


def _strongest(
    rest: NDArray[np.complex128], blocks: Blocks, reach: tuple[float, float]
) -> tuple[float, Array]:
    """Mean power over channels, and cells (2,), of the highest point of a grid of eighths."""
    by_delay, by_rate = blocks.turns
    axes = [np.linspace(-r, r, int(16 * r) + 1) for r in reach]
    across = np.exp(1j * np.outer(axes[0], by_delay))
    along = np.exp(1j * np.outer(by_rate[len(by_rate) // 2], axes[1]))
    power = np.mean(np.abs(across @ rest @ along) ** 2, axis=0)
    row, column = np.unravel_index(np.argmax(power), power.shape)
    return float(power[row, column]), np.array([axes[0][row], axes[1][column]])


def _atoms(blocks: Blocks, steps: Array) -> NDArray[np.complex128]:
    """Block sums (n_targets, n_f, n_t) of targets of unit amplitude."""
    a, b = blocks.turns
    turn = a * steps[:, 0, None, None] + b * steps[:, 1, None, None]
    # What turning within a block leaves of its sum.
    along_f = blocks.share_f * np.sinc(steps[:, :1] * blocks.share_f)
    along_t = blocks.share_t * np.sinc(steps[:, 1:] * blocks.share_t)
    return np.asarray(np.exp(-1j * turn) * along_f[:, :, None] * along_t[:, None])


def _amplitudes(
    atoms: NDArray[np.complex128], sums: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Least squares, (n_targets, n_channels)."""
    flat = atoms.reshape(len(atoms), -1).T
    return np.asarray(np.linalg.lstsq(flat, sums.reshape(len(sums), -1).T, rcond=None)[0])


def _fitted(start: Array, blocks: Blocks) -> Array:
    """Cells (n_targets, 2) of all targets together by least squares, amplitudes projected out."""
    from scipy.optimize import least_squares

    measured = blocks.sums.reshape(len(blocks.sums), -1).T
    scale = np.linalg.norm(measured) or 1.0

    def misfit(flat: Array) -> Array:
        atoms = _atoms(blocks, flat.reshape(-1, 2))
        rest = measured - atoms.reshape(len(atoms), -1).T @ _amplitudes(atoms, blocks.sums)
        return np.concatenate([rest.real.ravel(), rest.imag.ravel()]) / scale

    return np.asarray(least_squares(misfit, start.ravel(), xtol=1e-6).x).reshape(-1, 2)
