"""Echoes of a channel from which all static echoes are subtracted, measured beside these.

The mean over slots that is subtracted holds a part of each moving echo too. Without it an echo's
peak is elsewhere, by half a cell of rate and more with few slots, and at rate 0 a part of it is
left. So each echo is fitted together with what is static, of any range profile, and its errors are
those of that fit.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hardware.radar.ambiguity import possible_rates
from hardware.radar.demodulation import Complex
from hardware.radar.fitted_targets import FittedTargets, fitted_echo
from hardware.radar.joint_fit import JointFit, JointModel
from hardware.radar.measurement import EchoMeasurement, cells_apart, without_duplicates
from hardware.radar.refinement import Blocks, blocks_about
from hardware.radar.superresolution import REACH, peak_of_noise, steps_of
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_STATIC = 0.5  # cells of rate up to which an echo is no moving one
_SLOW = (-0.3, 0.3)  # cells of rate from which a slow target beside an echo is looked for
_NEAR, _MOST_NEAR = 8.0, 4  # cells of range, and number, of other echoes that are fitted with one
_AROUND = np.linspace(-1.0, 1.0, 33)  # cells from an echo at which what is left is looked for
_TRIED = np.linspace(-1.0, 1.0, 17)  # cells of rate from the peak, from which the fit begins
_MOST_PAIRS = 6  # of those of `_PAIRS` from which the fit of two echoes goes on
_PAIRS = [
    np.array([[0.0, first], [0.0, second]])
    for first, second in combinations(np.linspace(-3.0, 3.0, 13), 2)
]


def moving_echoes(
    echoes: Sequence[EchoMeasurement],
    channel: Complex,
    waveform: OfdmWaveform,
    noise_w: float,
    false_alarm: float,
    *,
    fastest: float,
) -> tuple[list[EchoMeasurement], int]:
    """Echoes, strongest first, of a channel without its mean over slots, measured anew, with slow
    ones that others are not measured without; and the number of those that are lost although more
    than one moves there.

    ``noise_w``: of a cell without a window; ``false_alarm``: probability that noise alone is taken
    for a second echo; ``fastest``: largest delay rate, in s/s, of which ``echoes`` hold all rates
    up to half a cell more.
    """
    moving = without_static_echoes(echoes, waveform)
    near = cells_apart(echoes, moving, waveform)[..., 0].min(axis=1, initial=np.inf)
    # With none beside it at its range an echo at rest is what several moving ones make together.
    moving += [echo for echo, away in zip(echoes, near, strict=True) if away > _NEAR]
    places = np.array([(echo.delay_s, echo.delay_rate) for echo in moving]).reshape(-1, 2)
    about = blocks_about(channel, waveform, "boxcar", places[:, 0], places[:, 1])
    least_w = noise_w * peak_of_noise(false_alarm, channel.shape[0]) / channel.shape[0]
    measured, n_lost = list[EchoMeasurement](), 0
    for echo, blocks in zip(moving, about, strict=True):
        model = _model(blocks, [other for other in moving if other is not echo], noise_w)
        fit = _likeliest(model, [np.array([[0.0, cells]]) for cells in _TRIED], 1)
        parts = [_moved(echo, fitted_echo(model, fit, 0, waveform, noise_w), waveform, fastest)]
        several = _highest_left_w(model, fit) > least_w
        if several and _is_at_rest(parts[0], waveform):
            fit = _likeliest(model, _PAIRS, _MOST_PAIRS)
            pair = FittedTargets(model, 2, channel, waveform, noise_w, fastest)
            parts = pair.at_likeliest_rates(fit)
            n_lost += not without_static_echoes(parts, waveform)
        elif several and (with_slow := _beside_slow(model, fit, least_w)):
            both = [fitted_echo(model, with_slow, i, waveform, noise_w) for i in range(2)]
            parts = [_moved(echo, both[0], waveform, fastest), both[1]]
        if without_static_echoes(parts, waveform):
            measured += parts
    return without_duplicates(measured, waveform, folded=False), n_lost


def without_static_echoes(
    echoes: Sequence[EchoMeasurement], waveform: OfdmWaveform
) -> list[EchoMeasurement]:
    """Echoes without those at rest, or at a rate that folds to there."""
    return [echo for echo in echoes if not _is_at_rest(echo, waveform)]


def _is_at_rest(echo: EchoMeasurement, waveform: OfdmWaveform) -> bool:
    """Whether an echo shows at rest, or at a rate that folds to there."""
    cells = echo.delay_rate / waveform.delay_rate_cell
    return bool(abs(cells - waveform.n_slots * np.rint(cells / waveform.n_slots)) < _STATIC)


def _model(blocks: Blocks, others: Sequence[EchoMeasurement], noise_w: float) -> JointModel:
    """What is static and the nearest of others, beside which an echo is fitted."""
    middle = np.array([blocks.delay_s, blocks.delay_rate])
    steps = steps_of(others, middle, blocks.grid.cell)
    near = np.abs(steps[:, 0]) <= _NEAR
    nearest = steps[near][np.argsort(np.abs(steps[near]).max(axis=1))[:_MOST_NEAR]]
    return JointModel(blocks, nearest, noise_w, beside_static=True)


def _likeliest(model: JointModel, beginnings: Sequence[Array], at_most: int) -> JointFit:
    """The best fit that is reached from the ``at_most`` best of some places (n, 2)."""
    fits = sorted((model.fit(places) for places in beginnings), key=lambda one: one.misfit)
    reached = [model.refined(one.places) for one in fits[:at_most]]
    return min(reached, key=lambda one: one.misfit)


def _beside_slow(model: JointModel, fit: JointFit, least_w: float) -> JointFit | None:
    """An echo fitted with a slow target at its range, where that leaves noise alone."""
    slow = [np.array([fit.places[0, 0], model.at_rest + cells]) for cells in _SLOW]
    both = _likeliest(model, [np.vstack([fit.places, one]) for one in slow], len(slow))
    is_slow = abs(both.places[1, 1] - model.at_rest) < _STATIC
    return both if is_slow and _highest_left_w(model, both) <= least_w else None


def _moved(
    echo: EchoMeasurement, fitted: EchoMeasurement, waveform: OfdmWaveform, fastest: float
) -> EchoMeasurement:
    """An echo as it is fitted, at the likeliest of its rates that is none too fast, and with what
    others it may have.
    """
    moved = fitted.delay_rate - echo.delay_rate
    rates = np.array([echo.delay_rate, *echo.delay_rate_alternatives]) + moved
    possible = possible_rates(fitted, waveform, fastest)
    off = np.abs(rates[:, None] - possible).min(axis=1)
    likeliest, *others = rates[off < waveform.delay_rate_cell / 2].tolist() or [fitted.delay_rate]
    return replace(fitted, delay_rate=likeliest, delay_rate_alternatives=tuple(others))


def _highest_left_w(model: JointModel, fit: JointFit) -> float:
    """Highest mean power over channels that a fit leaves near its first echo: within a cell of
    range and the reach of rates.
    """
    grid, at = model.blocks.grid, fit.places[0]
    across = np.exp(1j * np.outer(at[0] + _AROUND, grid.by_delay))
    along = np.exp(1j * np.outer(grid.by_rate, at[1] + REACH * _AROUND))
    left = across @ model.residual_sums(fit) @ along
    return float(np.mean(np.abs(left) ** 2, axis=0).max())
