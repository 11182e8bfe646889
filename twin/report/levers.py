"""How much a design's SNR grows with one of its settings, in closed form from its noise budget.

Every noise of the budget scales with a setting by a known power; their squares add. A setting's
factor on the SNR is that of the signal over that of the sum.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hardware.patterns import PatternSet
from twin.camera.evaluation import Evaluation
from twin.detector import NoiseBudget
from twin.errors import InputError
from twin.optics.spectra import in_band_fraction
from twin.system import System

_ROOT = math.sqrt(2.0)
_SIGNAL, _SUN = "shot noise of the signal", "shot noise of the sun"
_DARK, _JOHNSON = "shot noise of the dark current", "Johnson noise of the amplifier"
_READ, _FLICKER = "read noise", "1/f noise of the amplifier"
_EMITTER, _STEP = "fluctuation of the emitter", "quantisation"


@dataclass(frozen=True)
class Lever:
    """One change of a setting, and the factor on the SNR per pixel that it brings."""

    change: str
    field: str
    snr_factor: float


def camera_levers(evaluation: Evaluation) -> tuple[Lever, ...]:
    """Changes of a camera's settings by a factor of two, the most effective first.

    Noises of a user's own detector that have other names than the bundled one's stay as they are.
    """
    budget, system = evaluation.capture.noise, evaluation.system
    found = [
        Lever(change, field, _gain(budget, signal, noises))
        for change, field, signal, noises in _changes(system, budget)
    ]
    patterns = system.patterns
    if isinstance(patterns, PatternSet) and patterns.count == patterns.n_cells:
        # A cell of four times the area has four times the light; the inverse transform of a quarter
        # of the values adds up half of their noise less.
        change = "cells twice as wide and high, a quarter of the patterns"
        found.append(Lever(change, "emitter.rows, emitter.columns", 2.0))
    found.append(Lever("two frames averaged", "acquisition", _ROOT))
    return tuple(sorted(found, key=lambda lever: -lever.snr_factor))


def _changes(
    system: System, budget: NoiseBudget
) -> Iterator[tuple[str, str, float, Mapping[str, float]]]:
    """Change, field, and what it multiplies: the signal, and noises by name."""
    capacitive = system.readout.feedback_capacitance_f is not None
    lit = {_SIGNAL: _ROOT, _EMITTER: 2.0}
    yield "twice the emitter's power", "emitter.radiant_intensity_w_per_sr", 2.0, lit
    yield "twice the lens's area", "optics.f_number", 2.0, {**lit, _SUN: _ROOT}
    longer = {**lit, _SUN: _ROOT, _DARK: _ROOT, _FLICKER: _ROOT}
    if not capacitive:  # charge noise of a resistor, and the converter's step in electrons
        white = _amplifier(budget, _ROOT)
        longer |= {_JOHNSON: _ROOT, _STEP: 2.0, _FLICKER: _ROOT * white}
    exposure = "acquisition.integration_time_s, pattern_period_s"
    yield "twice the exposure", exposure, 2.0, longer
    if capacitive:
        yield "half the capacitance", "readout.feedback_capacitance_f", 1.0, {_STEP: 0.5}
    else:
        gain = {_JOHNSON: 1 / _ROOT, _FLICKER: _amplifier(budget, 1 / _ROOT), _STEP: 0.5}
        yield "twice the transimpedance", "readout.transimpedance_ohm", 1.0, gain
    for words, factor in (("half", 0.5), ("twice", 2.0)):
        share = _line_share(system, factor)
        noises = {_SUN: math.sqrt(factor), _SIGNAL: math.sqrt(share), _EMITTER: share}
        yield f"a filter {words} as wide", "filter.width_m", share, noises
    yield "half the dark current", "detector.dark_current_a", 1.0, {_DARK: 1 / _ROOT}
    yield "half the read noise", "readout.read_noise_e", 1.0, {_READ: 0.5}
    yield "one bit more", "readout.adc_bits", 1.0, {_STEP: 0.5}


def _amplifier(budget: NoiseBudget, johnson: float) -> float:
    """Factor on the amplifier's white noise, in proportion to which its 1/f noise is."""
    before = budget.noise_e.get(_JOHNSON, 0.0), budget.noise_e.get(_READ, 0.0)
    white = math.hypot(*before)
    return math.hypot(johnson * before[0], before[1]) / white if white else 1.0


def _gain(budget: NoiseBudget, signal: float, noises: Mapping[str, float]) -> float:
    """Factor on the SNR; 1 without any noise."""
    changed = math.hypot(*(noises.get(n, 1.0) * value for n, value in budget.noise_e.items()))
    return signal * budget.total_noise_e / changed if changed else 1.0


def _line_share(system: System, factor: float) -> float:
    """Share of the emitter's line in a filter wider by a factor, over that of the filter."""
    width = system.filter.width_m.value
    try:
        wider = system.with_({"filter.width_m": width * factor})
    except InputError:  # a filter's curve has no width to change
        return 1.0
    now = in_band_fraction(system.emitter, system.filter)
    return float(in_band_fraction(wider.emitter, wider.filter) / now) if now else 1.0
