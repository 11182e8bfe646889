"""What the model of light may be off by in the electrons and in the noise of a capture.

Statistical errors are those of light's finitely many paths, systematic ones bounds of what is left
out. Neither is the sensor's own noise.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain, Powers
from twin.detector.noise import settled_share
from twin.system import System

Array = NDArray[np.float64]

#: Relative step for the slope of the noise over its causes.
_STEP = 1e-3
#: Relative error of the noise by uneven rounding from which on images differ with it.
_UNEVEN = 0.01


@dataclass(frozen=True, eq=False)
class ModelError:
    """Errors of a capture, beside those of its cells.

    ``noise``, ``noise_systematic`` (rows, columns): of the noise of each cell, relative; the same
    for all cells of a detector, since it is that of all light together. ``signal`` and
    ``signal_systematic``: of the mean signal, relative. ``background_w`` and
    ``background_systematic_w``: of the sun's light on a detector, W, of which one gives
    ``electrons_per_watt`` in an exposure. ``scatter``: root mean square of what light is off by
    from exposure to exposure, over their noise; of motion that is taken as still a bound, where it
    is above 1. ``of_exposures``: of cells in the exposures, electrons, (rows, columns), where their
    light is of other paths than the truth; None where it is the same. ``uneven_step_w``: of the
    sun's light on a detector, W, that is a step of the converter, where other noise is so little
    that what rounding does depends on where light lies between two steps; else 0.
    """

    noise: Array
    noise_systematic: Array
    signal: float
    signal_systematic: float
    background_w: float
    background_systematic_w: float
    electrons_per_watt: float
    scatter: float = 0.0
    of_exposures: Array | None = None
    uneven_step_w: float = 0.0


#: Of a capture that is told nothing else.
NO_ERROR = ModelError(np.zeros((1, 1)), np.zeros((1, 1)), 0.0, 0.0, 0.0, 0.0, 0.0)


def model_error(chain: Chain, power: Powers, signal_w: Array) -> ModelError:
    """`ModelError` of a capture."""
    system, cells_w = chain.system, power.cells_w.sum(axis=0)
    total_w = cells_w.sum(axis=1)
    signal = _ratio(np.sqrt(np.sum(power.error_w**2, axis=1)), total_w)
    signal_systematic = _ratio(power.left_out_w.sum(axis=1), total_w)
    background = _ratio(power.sun_error_w, power.sun_w)
    background_systematic = _ratio(power.sun_left_out_w, power.sun_w)
    by_signal, by_background = _noise_slopes(chain, signal_w, power.sun_w)
    noise = np.hypot(by_signal * signal, by_background * background)
    noise_systematic = by_signal * signal_systematic + by_background * background_systematic
    uneven, step_e = _uneven_rounding(chain, signal_w, power.sun_w)
    noise_systematic += uneven
    noise_systematic += _unseen_sun(chain, signal_w, power)
    ones, n_detectors = np.ones_like(cells_w), len(power.sun_w)
    weight, open_share = _ratio(total_w, total_w.sum()), float(chain.open_share.mean())
    per_watt = _electrons_per_watt(chain, signal_w, power)
    return ModelError(
        noise=side_by_side(noise[:, None] * ones, system),
        noise_systematic=side_by_side(noise_systematic[:, None] * ones, system),
        signal=float(np.linalg.norm(weight * signal)),
        signal_systematic=float(weight @ signal_systematic),
        background_w=open_share * float(np.linalg.norm(power.sun_error_w)) / n_detectors,
        background_systematic_w=open_share * float(power.sun_left_out_w.mean()),
        electrons_per_watt=per_watt,
        uneven_step_w=step_e / per_watt if per_watt and uneven.max() > _UNEVEN else 0.0,
    )


def side_by_side(by_detector: Array, system: System) -> Array:
    """Cells of all detectors (n_detectors, n_cells) as one image, detectors side by side."""
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    return np.hstack(list(by_detector.reshape(-1, *shape)))


def _noise_slopes(chain: Chain, signal_w: Array, sun_w: Array) -> tuple[Array, Array]:
    """Relative change of each detector's noise over that of signal and of background."""

    def log_noise(signal: float, background: float) -> Array:
        budgets = chain.noise_by_detector(signal * signal_w, background * sun_w)
        total = np.array([budget.total_noise_e for budget in budgets])
        return np.log(total, out=np.zeros_like(total), where=total > 0)

    here, step = log_noise(1.0, 1.0), np.log1p(_STEP)
    by_signal, by_background = log_noise(1 + _STEP, 1.0), log_noise(1.0, 1 + _STEP)
    return (by_signal - here) / step, (by_background - here) / step


def _electrons_per_watt(chain: Chain, signal_w: Array, power: Powers) -> float:
    """Of the sun's light, as much of it as there is, or may be."""
    for sun_w in (power.sun_w, power.sun_left_out_w):
        if (mean_w := float(sun_w.mean())) > 0 and math.isfinite(mean_w):
            return chain.noise(signal_w, sun_w).background_e / mean_w
    return 0.0


def _unseen_sun(chain: Chain, signal_w: Array, power: Powers) -> Array:
    """Relative change of each detector's noise by sun that no path met."""
    without, beside = (
        np.array([budget.total_noise_e for budget in chain.noise_by_detector(signal_w, sun_w)])
        for sun_w in (np.zeros_like(power.sun_w), power.sun_left_out_w)
    )
    return np.where(power.sun_w > 0, 0.0, _ratio(beside - without, without))


def _uneven_rounding(chain: Chain, signal_w: Array, sun_w: Array) -> tuple[Array, float]:
    """Relative error of each detector's noise where other noise is less than the converter's step:
    the part of rounding's error that follows from where light lies between two steps may be nothing
    or twice its mean for light a little other. And the largest step, electrons.
    """
    found, step_e = [], 0.0
    for budget in chain.noise_by_detector(signal_w, sun_w):
        total, rounding = budget.total_noise_e, budget.noise_e.get("quantisation", 0.0)
        other = math.sqrt(max(total**2 - rounding**2, 0.0))
        share = settled_share(other / rounding) if rounding else 0.0
        found.append(share * (rounding / total) ** 2 / 2 if total else 0.0)
        step_e = max(step_e, math.sqrt(12) * rounding)
    return np.array(found), step_e


def _ratio(part: Array, whole: Array | float) -> Array:
    return np.divide(part, whole, out=np.zeros_like(part), where=np.asarray(whole) > 0)
