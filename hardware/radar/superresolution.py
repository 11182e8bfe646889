"""Targets closer than a cell or two, resolved by Newtonized orthogonal matching pursuit.

The strongest target is searched, all targets are fitted together by least squares (delays, rates
and amplitudes), their sum is subtracted, and the residual is searched again until it is noise
(Mamandipoor, Ramasamy and Madhow, IEEE Trans. Signal Process. 64, 2016, doi
10.1109/TSP.2016.2580523). No window is used: it would cost resolution, and the fit has no side
lobes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.demodulation import Complex
from hardware.radar.measurement import EchoMeasurement, echo_measurement
from hardware.radar.refinement import Blocks, blocks_about, unit_echoes
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_CLOSEST = 0.3  # cells
_BESIDE, _MOST_BESIDE = 8.0, 4  # cells, and number, of other echoes that are fitted with an echo


def resolve(
    channel: Complex,
    waveform: OfdmWaveform,
    echo: EchoMeasurement,
    noise_w: float,
    *,
    false_alarm: float = 1e-6,
    reach: float = 3.0,
    at_most: int = 4,
    others: Sequence[EchoMeasurement] = (),
) -> list[EchoMeasurement]:
    """Split an echo into those of the targets that it consists of, nearest first.

    Parameters
    ----------
    channel, waveform
        As for `detect`.
    echo
        What is to be split.
    noise_w
        Mean noise power of a cell without a window.
    false_alarm
        Probability of a false target per cell searched.
    reach
        Cells searched to each side in delay, and a third of it in rate.
    at_most
        Largest number of targets.
    others
        Echoes elsewhere, whose side lobes are fitted as well; of the nearest ones also the places,
        which were measured in the side lobes of this echo.

    Two targets closer than 0.3 cells are never resolved: such a pair would fit the error of the
    model, which is 60 dB and more below a target because of single precision and the blocks.
    """
    place = np.array([echo.delay_s]), np.array([echo.delay_rate])
    (blocks,) = blocks_about(channel, waveform, "boxcar", *place)
    reached = reach, max(reach / 3, 1.0)
    beside, fixed = _nearest(_steps_of(others, blocks))
    known = unit_echoes(blocks, fixed)
    every = np.concatenate([unit_echoes(blocks, beside), known])
    rest = blocks.sums - _fit_amplitudes(every, blocks.sums)[1]
    steps = np.zeros((0, 2))
    amplitudes = np.zeros((0, len(blocks.sums)), dtype=np.complex128)
    while len(steps) < at_most:
        power, step = _strongest(rest, blocks, reached)
        if power * len(rest) <= noise_w * _threshold(false_alarm, len(rest)):
            break
        fitted = _least_squares_fit(np.vstack([steps, step, beside]), blocks, known)
        candidate = fitted[: len(steps) + 1]
        if (
            _closest(np.vstack([fitted, fixed])) < _CLOSEST
            or np.abs(candidate[:, 0]).max() > reach + 1
        ):
            break
        steps, beside = candidate, fitted[len(candidate) :]
        every, explained = _fit_amplitudes(
            np.concatenate([unit_echoes(blocks, fitted), known]), blocks.sums
        )
        amplitudes, rest = every[: len(steps)], blocks.sums - explained
    noise = ChannelNoise.white(len(blocks.sums), noise_w)
    parts = [
        echo_measurement(blocks, step, amplitude, waveform, noise_w, "boxcar", noise)
        for step, amplitude in zip(steps, amplitudes, strict=True)
    ]
    return sorted(parts, key=lambda part: part.delay_s)


def _threshold(false_alarm: float, n_channels: int) -> float:
    """Level that a peak of noise near a cell exceeds with this probability: sum over channels, over
    the mean of one.

    Between cells noise peaks higher than on them: along each axis sqrt(pi x / 3) times as often
    (Rice's rate of crossings of a level x by band-limited noise).
    """
    from scipy.special import gammainccinv

    return float(gammainccinv(n_channels, false_alarm / (np.pi / 3 * -np.log(false_alarm))))


def _strongest(
    rest: NDArray[np.complex128], blocks: Blocks, reach: tuple[float, float]
) -> tuple[float, Array]:
    """Mean power over channels, and cells (2,), of the highest point of a grid of eighths."""
    axes = [np.linspace(-r, r, int(16 * r) + 1) for r in reach]
    across = np.exp(1j * np.outer(axes[0], blocks.grid.by_delay))
    along = np.exp(1j * np.outer(blocks.grid.by_rate, axes[1]))
    power = np.mean(np.abs(across @ rest @ along) ** 2, axis=0)
    row, column = np.unravel_index(np.argmax(power), power.shape)
    return float(power[row, column]), np.array([axes[0][row], axes[1][column]])


def _steps_of(others: Sequence[EchoMeasurement], blocks: Blocks) -> Array:
    """Cells (n, 2) from the middle of blocks to other echoes."""
    delay = np.array([echo.delay_s for echo in others])
    rate = np.array([echo.delay_rate for echo in others])
    off = np.stack([delay - blocks.delay_s, rate - blocks.delay_rate], axis=-1)
    return np.nan_to_num(off / blocks.grid.cell)  # NaN is not measured


def _nearest(steps: Array) -> tuple[Array, Array]:
    """Of echoes at steps (n, 2) those that are fitted with their places, and the others."""
    away = np.abs(steps).max(axis=1)
    order = np.argsort(away, kind="stable")
    count = min(int(np.count_nonzero(away <= _BESIDE)), _MOST_BESIDE)
    return steps[order[:count]], steps[order[count:]]


def _closest(steps: Array) -> float:
    """Least distance of two, in cells along the axis on which they are farther apart."""
    apart = np.abs(steps[:, None] - steps).max(axis=-1)
    return float(apart[np.triu_indices(len(steps), 1)].min(initial=np.inf))


def _fit_amplitudes(
    atoms: NDArray[np.complex128], sums: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Least squares: amplitudes (n_targets, n_channels), and their sum (n_channels, n_f, n_t)."""
    flat = atoms.reshape(len(atoms), sums[0].size).T
    amplitudes = np.linalg.lstsq(flat, sums.reshape(len(sums), -1).T, rcond=None)[0]
    return np.asarray(amplitudes), np.asarray((flat @ amplitudes).T).reshape(sums.shape)


def _least_squares_fit(start: Array, blocks: Blocks, known: NDArray[np.complex128]) -> Array:
    """Cells (n_targets, 2) of all targets together by least squares, amplitudes projected out."""
    from scipy.optimize import least_squares

    scale = np.linalg.norm(blocks.sums) or 1.0

    def misfit(flat: Array) -> Array:
        atoms = np.concatenate([unit_echoes(blocks, flat.reshape(-1, 2)), known])
        rest = (blocks.sums - _fit_amplitudes(atoms, blocks.sums)[1]).ravel() / scale
        return np.concatenate([rest.real, rest.imag])

    return np.asarray(least_squares(misfit, start.ravel(), xtol=1e-6).x).reshape(-1, 2)
