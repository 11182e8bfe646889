"""A verdict in words of each sensor: what it sees, how far, what limits it, what would help."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hardware.formatting import number, quantity_text, si
from twin.accuracy import Figure, Interval
from twin.camera.evaluation import Evaluation
from twin.detector import FrontEnd
from twin.report.levers import Lever, camera_levers
from twin.system import System

#: Bands of depth in which the SNR is looked at, and the least number of cells in one.
_BANDS, _LEAST_CELLS = 16, 4
#: Factor on the SNR from which a change is worth a word.
_HELPS = 1.05

#: ``usable``: all targets are seen, but echoes are stated to more than the error asked for.
State = Literal["good", "usable", "limited", "void"]


@dataclass(frozen=True)
class Finding:
    """Verdict on one sensor.

    ``answers``: pairs of a question and its answer, in the order in which they are read.
    ``levers``: settings with their factor on the SNR. ``figures``: numbers that only it shows.
    """

    sensor: str
    description: str
    state: State
    result: str
    answers: tuple[tuple[str, str], ...]
    levers: tuple[Lever, ...] = ()
    figures: tuple[Figure, ...] = ()


def camera_finding(evaluation: Evaluation) -> Finding:
    """Of a camera, from its verdict, noise budget and truth."""
    verdict = evaluation.verdict
    if verdict.void or not verdict.lit_share:
        return _void(evaluation)
    levers = camera_levers(evaluation)
    seen_m, reach_m, far_m = _distances(evaluation)
    figures = [
        Figure((evaluation.system.name,), name, "m", Interval(value, systematic=np.inf))
        for name, value in (
            ("distance to which half of the lit cells are above their noise", seen_m),
            ("distance at which a cell such as the median one has an SNR of 1", reach_m),
            ("farthest lit surface", far_m),
        )
        if np.isfinite(value)
    ]
    figures += [
        Figure((evaluation.system.name, lever.change), "factor on the SNR", "", Interval(factor))
        for lever in levers
        if (factor := lever.snr_factor)
    ]
    return Finding(
        evaluation.system.name,
        evaluation.system.description,
        "good" if verdict.snr_median >= 1 and not verdict.not_within else "limited",
        verdict.short,
        (
            ("What is seen", f"{verdict}; {evaluation.images}"),
            ("To what distance", _how_far(evaluation, seen_m, reach_m, far_m)),
            ("What limits it", _camera_limit(evaluation)),
            ("What would help most", _help(levers)),
        ),
        levers,
        tuple(figures),
    )


def _distances(evaluation: Evaluation) -> tuple[float, float, float]:
    """Farthest band of depth with a median SNR of 1; reach of a median cell; farthest depth."""
    capture = evaluation.capture
    depth_m, snr = capture.truth.depth_m, capture.snr
    if depth_m.shape != snr.shape:  # several detectors side by side
        return np.nan, np.nan, np.nan
    lit = capture.lit & np.isfinite(depth_m)
    if not lit.any():
        return np.nan, np.nan, np.nan
    order = np.argsort(depth_m[lit], kind="stable")
    depth_m, snr = depth_m[lit][order], snr[lit][order]
    bands = np.array_split(np.arange(len(snr)), max(1, min(_BANDS, len(snr) // _LEAST_CELLS)))
    good = [band for band in bands if np.median(snr[band]) >= 1]
    seen_m = float(depth_m[good[-1][-1]]) if good else np.nan
    # The light that a lit cell's surface returns falls with the square of the distance.
    reach_m = float(np.median(depth_m * np.sqrt(np.maximum(snr, 0.0))))
    return seen_m, reach_m, float(depth_m[-1])


def _how_far(evaluation: Evaluation, seen_m: float, reach_m: float, far_m: float) -> str:
    if not np.isfinite(far_m):
        return "not told: no lit cell has one depth"
    if not np.isfinite(seen_m):
        found = f"at no depth are half of the lit cells above their noise, to {si(far_m, 'm')}"
    elif seen_m >= far_m:
        found = f"to the farthest lit surface, {si(far_m, 'm')}, half of the cells and more"
    else:
        found = f"half of the cells and more to {si(seen_m, 'm')}, of {si(far_m, 'm')} lit"
    half = np.radians(evaluation.system.emitter.field_of_view_deg.value / 2)
    cells = max(evaluation.system.emitter.rows.value, evaluation.system.emitter.columns.value)
    cell = si(2 * float(np.tan(half)) / cells * far_m, "m", 2)
    ranges = f"; distances: {evaluation.ranges}" if evaluation.ranges else ""
    return (
        f"{found}. A surface such as the median one falls to an SNR of 1 at {si(reach_m, 'm', 2)} "
        f"(signal with the inverse square, noise as it is); a cell is {cell} wide at the farthest"
        f"{ranges}"
    )


def _camera_limit(evaluation: Evaluation) -> str:
    """The largest noises with their share of the variance, and what warnings say besides."""
    budget, verdict = evaluation.capture.noise, evaluation.verdict
    total = budget.total_noise_e
    if not total:
        return "no noise at all: the resolution alone"
    ordered = sorted(budget.noise_e.items(), key=lambda item: -item[1])
    shares = [f"{name}, {(value / total) ** 2:.0%}" for name, value in ordered if value][:2]
    parts = [f"noise: of its variance {' and '.join(shares)}"]
    if verdict.snr_median >= 10:
        image = evaluation.reconstructions[0].picture
        grid = f"{image.shape[1]} x {image.shape[0]} cells"
        parts.insert(0, f"resolution before noise: {grid}, each with a median SNR above 10")
    kinds = ("saturated", "lag", "quantisation", "lost", "overrun", "reset")
    parts += [str(w) for w in evaluation.capture.warnings if w.kind in kinds]
    share = evaluation.capture.in_band_fraction
    if share < 0.5:
        parts.append(f"the filter passes {share:.0%} of the emitter's line")
    return "; ".join(parts)


def _help(levers: tuple[Lever, ...]) -> str:
    """The most effective changes, each alone, and those that bring nothing."""
    best = [lever for lever in levers if lever.snr_factor >= _HELPS][:3]
    none = [lever.change for lever in levers if abs(lever.snr_factor - 1) < 0.01][:3]
    told = ", ".join(f"{lever.change} (SNR × {number(lever.snr_factor)})" for lever in best)
    return told + (f". Nothing would come of {' or '.join(none)}" if none else "")


def _void(evaluation: Evaluation) -> Finding:
    """Of a record without an image: why, by how much, and what to set."""
    verdict, system = evaluation.verdict, evaluation.system
    reasons = "; ".join(verdict.void_because) or "no cell of the field sends light back"
    kinds: set[str] = {warning.kind for warning in verdict.void_because}
    if system.detector.function is not None:
        limit, advice = reasons, "settings of the own detector, of which no closed form is known"
    else:
        limit, advice = _remedy(evaluation, kinds, reasons)
    return Finding(
        system.name,
        system.description,
        "void",
        verdict.short if verdict.void else "void (no light)",
        (
            ("What is seen", f"nothing. {verdict}" if verdict.void else f"nothing: {reasons}"),
            ("To what distance", "none"),
            ("What limits it", limit),
            ("What would help most", advice),
        ),
    )


def _remedy(evaluation: Evaluation, kinds: set[str], reasons: str) -> tuple[str, str]:
    """By how much the converter misses the light, and the setting that removes it."""
    system, capture = evaluation.system, evaluation.capture
    end = FrontEnd.of(system)
    brightest_e = (
        float(capture.signal_w.max(initial=0.0) + capture.background_w) * end.electrons_per_watt
        + end.dark_e
    )
    rail_e = (2**end.adc_bits - 1 - end.offset_counts) * end.electrons_per_count
    top_e = min(rail_e, end.full_well_e)
    light = f"the brightest exposure has {number(brightest_e)} e-"
    if "saturated" in kinds and top_e > 0:
        over = brightest_e / top_e
        limit = f"overexposed: {light}, {number(over)} times the {number(top_e)} e- that fit"
        if end.full_well_e <= rail_e:
            return limit, _shorter(system, over, "the full well")
        return limit, _less_gain(system, over)
    if "black" in kinds:
        step_v = system.readout.adc_full_scale_v.value / 2**end.adc_bits
        at_least = quantity_text(4 * step_v, "V")
        return f"black: {reasons}", f"a readout.adc_offset_v of {at_least} (four steps) or more"
    if "underexposed" in kinds:
        swing_e = float(np.ptp(capture.signal_w)) * end.electrons_per_watt
        step_e = end.electrons_per_count
        if not swing_e:
            return f"underexposed: {reasons}", "light: the patterns' signal does not move at all"
        limit = (
            f"underexposed: the patterns move {number(swing_e)} e-, the converter's step is "
            f"{number(step_e)} e-"
        )
        return limit, f"a gain, or light, {number(4 * step_e / swing_e)} times as high (four steps)"
    if "lag" in kinds:
        return f"lag: {reasons}", "a longer acquisition.pattern_period_s, or a faster amplifier"
    if not capture.lit.any():
        return (
            f"no light comes back: {light}, all of it sun and dark current",
            "another pose of the rig, or a surface in the emitter's field",
        )
    return reasons, "the settings that the warning names"


def _less_gain(system: System, over: float) -> str:
    """The largest gain with which the brightest exposure fits."""
    resistance = system.readout.transimpedance_ohm
    if resistance is not None:
        most = quantity_text(resistance.value / over, "ohm")
        return f"a readout.transimpedance_ohm of at most {most}, {number(over)} times less"
    capacitance = system.readout.feedback_capacitance_f
    if capacitance is None:
        return f"{number(over)} times less gain"
    least = quantity_text(capacitance.value * over, "F")
    return f"a readout.feedback_capacitance_f of at least {least}, {number(over)} times more"


def _shorter(system: System, over: float, because: str) -> str:
    most = quantity_text(system.acquisition.integration_time_s.value / over, "s")
    return f"an acquisition.integration_time_s of at most {most}: {because} allows no more light"
