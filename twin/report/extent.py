"""The part of a range-Doppler map in which something is."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.evaluation import RadarEvaluation

Array = NDArray[np.float64]

_BEYOND = 1.33  # times the farthest target or echo, and the fastest one
_LEAST_CELLS = 12  # of rate to each side of 0


def shown_ranges(evaluation: RadarEvaluation) -> slice:
    """From 0 to a third beyond the farthest target or echo."""
    propagation = evaluation.capture.propagation
    far = [t.wrapped_range_m for t in evaluation.capture.truth]
    far += [p.range_m for p in propagation.paths]
    if propagation.echoes.delay_s.size:
        far.append(float(propagation.echoes.delay_s.max()) * C_M_PER_S / 2)
    top = _BEYOND * max(far, default=evaluation.image.range_m[-1])
    return slice(0, max(8, int(np.searchsorted(evaluation.image.range_m, top))))


def top_range_m(evaluation: RadarEvaluation) -> float:
    """Somewhat beyond the farthest target and detection, within what `shown_ranges` holds."""
    far = [t.wrapped_range_m for t in evaluation.capture.truth]
    far += [d.range_m for d in evaluation.detections if np.isfinite(d.range_m)]
    last = float(evaluation.image.range_m[shown_ranges(evaluation)][-1])
    return min(last, 1.15 * max(far)) if far else last


def shown_rates(evaluation: RadarEvaluation) -> tuple[float, float]:
    """To a third beyond the fastest target and detection, to both sides of 0 alike (m/s)."""
    rates = [t.range_rate_m_per_s for t in evaluation.capture.truth]
    rates += [d.range_rate_m_per_s for d in evaluation.detections]
    moved = np.abs(np.nan_to_num(folded(evaluation, rates)))
    cell = evaluation.waveform.velocity_cell_m_per_s
    most = float(np.abs(evaluation.image.range_rate_m_per_s).max(initial=cell))
    fastest = min(most, max(_LEAST_CELLS * cell, _BEYOND * float(moved.max(initial=0.0))))
    return -fastest, fastest


def folded(evaluation: RadarEvaluation, rates_m_per_s: Sequence[float]) -> Array:
    """Range rates as shown on the map, within what is unambiguous; 0 where not measured."""
    fastest = evaluation.waveform.max_velocity_m_per_s
    return np.asarray((np.nan_to_num(rates_m_per_s) + fastest) % (2 * fastest) - fastest)


def mover_row(evaluation: RadarEvaluation) -> int:
    """Row of the strongest moving detection, else of the strongest cell."""
    cell = evaluation.waveform.velocity_cell_m_per_s
    movers = [d for d in evaluation.detections if abs(d.range_rate_m_per_s) > cell]
    if movers:
        return int(np.argmin(np.abs(evaluation.image.range_m - movers[0].range_m)))
    return int(np.argmax(evaluation.image.power_w.max(axis=1)))
