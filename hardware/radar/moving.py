"""Echoes of a channel from which all static echoes are subtracted, measured beside these.

The mean over slots that is subtracted holds a part of each moving echo too. Without it an echo's
peak is elsewhere, by half a cell of rate and more with few slots, and at rate 0 a part of it is
left. So each echo is fitted together with what is static, of any range profile, and its errors are
those of that fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.fitted_targets import fitted_echo
from hardware.radar.joint_fit import JointModel
from hardware.radar.measurement import EchoMeasurement, cells_apart, without_duplicates
from hardware.radar.refinement import Blocks, blocks_about
from hardware.radar.superresolution import steps_of
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_STATIC = 0.5  # cells of rate up to which an echo is no moving one
_NEAR, _MOST_NEAR = 8.0, 4  # cells of range, and number, of other echoes that are fitted with one
_TRIED = np.linspace(-1.0, 1.0, 17)  # cells of rate from the peak, from which the fit begins


def moving_echoes(
    echoes: Sequence[EchoMeasurement], channel: Complex, waveform: OfdmWaveform, noise_w: float
) -> list[EchoMeasurement]:
    """Echoes, strongest first, of a channel without its mean over slots, measured anew, without
    those that are static. ``noise_w``: of a cell without a window.
    """
    moving = [echo for echo in echoes if not _is_at_rest(echo, waveform)]
    near = cells_apart(echoes, moving, waveform)[..., 0].min(axis=1, initial=np.inf)
    # With none beside it at its range an echo at rest is what several moving ones make together.
    moving += [echo for echo, away in zip(echoes, near, strict=True) if away > _NEAR]
    places = np.array([(echo.delay_s, echo.delay_rate) for echo in moving]).reshape(-1, 2)
    about = blocks_about(channel, waveform, "boxcar", places[:, 0], places[:, 1])
    measured = [
        _fitted(echo, blocks, [other for other in moving if other is not echo], waveform, noise_w)
        for echo, blocks in zip(moving, about, strict=True)
    ]
    measured = [echo for echo in measured if not _is_at_rest(echo, waveform)]
    return without_duplicates(measured, waveform, folded=False)


def _is_at_rest(echo: EchoMeasurement, waveform: OfdmWaveform) -> bool:
    """Whether an echo shows at rest, or at a rate that folds to there."""
    cells = echo.delay_rate / waveform.delay_rate_cell
    return bool(abs(cells - waveform.n_slots * np.rint(cells / waveform.n_slots)) < _STATIC)


def _fitted(
    echo: EchoMeasurement,
    blocks: Blocks,
    others: Sequence[EchoMeasurement],
    waveform: OfdmWaveform,
    noise_w: float,
) -> EchoMeasurement:
    """An echo fitted beside what is static and the nearest of others."""
    middle = np.array([blocks.delay_s, blocks.delay_rate])
    steps = steps_of(others, middle, blocks.grid.cell)
    near = np.abs(steps[:, 0]) <= _NEAR
    nearest = steps[near][np.argsort(np.abs(steps[near]).max(axis=1))[:_MOST_NEAR]]
    model = JointModel(blocks, nearest, noise_w, beside_static=True)
    fits = [model.fit(np.array([[0.0, cells]])) for cells in _TRIED]
    fit = model.refined(min(fits, key=lambda one: one.misfit).places)
    found = fitted_echo(model, fit, 0, waveform, noise_w)
    moved = found.delay_rate - echo.delay_rate
    alternatives = tuple(rate + moved for rate in echo.delay_rate_alternatives)
    return replace(found, delay_rate_alternatives=alternatives)
