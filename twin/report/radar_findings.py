"""The verdict on a radar in words, from its map, the radar equation and its noise."""

from dataclasses import replace

import numpy as np

from hardware.formatting import counted, number, si
from twin.accuracy import Figure, Interval
from twin.radar.detection_count import threshold_db
from twin.radar.evaluation import RadarEvaluation
from twin.radar.truth import TrueTarget
from twin.report.findings import Finding, State
from twin.report.levers import Lever
from twin.report.radar_summary import budget_figures

#: Excess of the map's noise over the thermal one from which other causes limit the radar.
_EXCESS_DB = 3.0
_CELLS = 2.0  # within which two targets are one peak


def radar_finding(evaluation: RadarEvaluation) -> Finding:
    """Of a radar: its targets, its reach by the radar equation, and what keeps it from more."""
    capture, radar = evaluation.capture, evaluation.radar
    if capture.void:
        return _void(evaluation)
    truth, missed = capture.truth, evaluation.missed
    reach_m, excess = reach_of(evaluation, 1.0), noise_excess_db(evaluation)
    excess_db, nepers = excess.value, excess.noise * np.log(10) / 10
    state, beyond = _state(evaluation), bool(evaluation.beyond_tolerance)
    result = (
        f"{len(truth) - len(missed)} of {len(truth)} targets"
        if truth
        else f"{len(evaluation.detections)} detections"
    )
    of = (radar.name,)
    return Finding(
        radar.name,
        radar.description,
        state,
        f"{result}; echoes less exact than asked" if beyond else result,
        (
            ("What is seen", _seen(evaluation)),
            ("To what distance", _how_far(evaluation, reach_m)),
            ("What limits it", _limit(evaluation, excess_db)),
            ("What would help most", _help(evaluation, excess_db)),
        ),
        _levers(),
        (
            # Of the fourth root of the noise; where that does not limit it, too wide.
            Figure(
                of,
                "range of 1 m² by the radar equation",
                "m",
                Interval(reach_m, noise=reach_m * nepers / 4),
            ),
            Figure(of, "threshold over the map's noise", "dB", Interval(threshold_db(evaluation))),
            Figure(of, "map's noise over the thermal one", "dB", excess),
        ),
    )


def _state(evaluation: RadarEvaluation) -> State:
    """By what is missed, and by the errors that bodies' echoes are stated to."""
    if evaluation.missed or not evaluation.detections:
        return "limited"
    return "usable" if evaluation.beyond_tolerance else "good"


def reach_of(evaluation: RadarEvaluation, rcs_m2: float) -> float:
    """Range (m) at which an echo equals the threshold by the radar equation in free space, at most
    the unambiguous one.
    """
    radar, far = evaluation.radar, evaluation.waveform.max_range_m
    needed_w = evaluation.image.noise_w * 10 ** (threshold_db(evaluation) / 10)
    if not needed_w > 0:
        return far
    return float(min(far, (radar.received_power_w(1.0, rcs_m2) / needed_w) ** 0.25))


def noise_excess_db(evaluation: RadarEvaluation) -> Interval:
    """Noise found on the map over the thermal one that the link budget predicts."""
    known = {name: figure for name, figure, _ in budget_figures(evaluation)}
    found = known["noise per cell, found"]
    return replace(found, value=found.value - known["noise per cell, predicted"].value)


def _seen(evaluation: RadarEvaluation) -> str:
    others = sum(
        match is None and part is None
        for match, part in zip(evaluation.matches, evaluation.further, strict=True)
    )
    told = [evaluation.headline]
    if evaluation.capture.truth:
        told.append(f"{counted(others, 'detection')} of other surfaces")
    if evaluation.picture:
        told.insert(0, str(evaluation.picture))
    if beyond := evaluation.beyond_tolerance:
        told.append(f"echoes {beyond}")
    return (
        "; ".join(told) if evaluation.detections else f"no detection at all; {evaluation.headline}"
    )


def _how_far(evaluation: RadarEvaluation, reach_m: float) -> str:
    wave = evaluation.waveform
    ranges = [d.range_m for d in evaluation.detections if np.isfinite(d.range_m)]
    told = [f"the farthest detection is at {si(max(ranges), 'm')}"] if ranges else []
    if reach_m >= wave.max_range_m:
        told.append(f"1 m² stands above the threshold to the unambiguous {si(reach_m, 'm')}")
    else:
        told.append(
            f"1 m² stands above the threshold to {si(reach_m, 'm')} (unambiguous to "
            f"{si(wave.max_range_m, 'm')})"
        )
    cell = f"a range cell is {si(wave.range_cell_m, 'm')}"
    return "; ".join([*told, f"{cell}, a rate cell {si(wave.velocity_cell_m_per_s, 'm/s')}"])


def _limit(evaluation: RadarEvaluation, excess_db: float) -> str:
    told = []
    for target in evaluation.missed:
        told.append(f"{target.name} is missed: {_why(target, evaluation)}")
    if excess_db > _EXCESS_DB:
        told.append(
            f"the map's noise is {excess_db:.1f} dB over the thermal one: phase noise, clutter or "
            "side lobes, not the receiver"
        )
    else:
        told.append(f"thermal noise ({excess_db:+.1f} dB beside the budget's)")
    clutter = evaluation.frame.clutter
    if not clutter.is_noise:
        told.append(f"clutter: {number(clutter.exceedance, 2)} times the strong cells of noise")
    if evaluation.detections and all(np.isnan(d.azimuth_rad) for d in evaluation.detections):
        told.append("no direction: the array tells range and rate alone")
    kinds = ("saturated", "ambiguous", "no-echo", "lost", "overrun")
    told += [str(w) for w in evaluation.capture.warnings if w.kind in kinds]
    return "; ".join(told)


def _why(target: TrueTarget, evaluation: RadarEvaluation) -> str:
    """What keeps a target from being detected."""
    wave = evaluation.waveform
    if not target.visible:
        return "hidden, no direct echo"
    lacking = threshold_db(evaluation) - _snr_db(target, evaluation)
    if lacking > 0:
        return f"noise, {lacking:.1f} dB below the threshold"
    for other in evaluation.capture.truth:
        ranges = abs(other.wrapped_range_m - target.wrapped_range_m) / wave.range_cell_m
        rates = abs(other.range_rate_m_per_s - target.range_rate_m_per_s)
        same_rate = rates / wave.velocity_cell_m_per_s < _CELLS
        if other is not target and ranges < _CELLS and same_rate:
            return f"resolution, within two cells of {other.name}"
    return f"clutter or side lobes, though {-lacking:.1f} dB above the threshold of noise"


def _snr_db(target: TrueTarget, evaluation: RadarEvaluation) -> float:
    noise_w = evaluation.image.noise_w
    return float(10 * np.log10(max(target.received_w, 1e-300) / noise_w)) if noise_w else np.inf


def _levers() -> tuple[Lever, ...]:
    """By the radar equation: factors on the SNR of a lone target."""
    return (
        Lever("twice the antenna's gain, both ways", "antenna.gain_dbi", 4.0),
        Lever("twice the transmitted power", "front_end.transmit_power_w", 2.0),
        Lever("twice the slots, in twice the time", "waveform.n_slots", 2.0),
        Lever("3 dB less noise figure", "front_end.noise_figure_db", 10**0.3),
    )


def _help(evaluation: RadarEvaluation, excess_db: float) -> str:
    """What lifts the weakest target that is missed for noise, or else what adds reach."""
    told = []
    lacking = [
        threshold_db(evaluation) - _snr_db(target, evaluation)
        for target in evaluation.missed
        if target.visible
    ]
    if excess_db > _EXCESS_DB:
        told.append("a cleaner oscillator or a window of lower side lobes; more power lifts both")
    elif short := [db for db in lacking if db > 0]:
        worst = max(short)
        told.append(
            f"{worst:.1f} dB: {number(10 ** (worst / 10), 2)} times the power or slots, or "
            f"{worst / 2:.1f} dBi more antenna gain"
        )
    elif any(db <= 0 for db in lacking):
        told.append("a wider band or a longer interval, which part echoes from their neighbours")
    if reach_of(evaluation, 1.0) >= evaluation.waveform.max_range_m:
        told.append(
            "for more range half of waveform.subcarrier_spacing_hz, which doubles the unambiguous "
            "one: noise allows it"
        )
    else:
        told.append(
            "twice the antenna's gain takes the same target "
            f"{number(4**0.25)} times as far, twice the power or the slots {number(2**0.25)} times"
        )
    if any(not target.visible for target in evaluation.missed):
        told.append("another pose of the rig for what is hidden")
    if evaluation.detections and all(np.isnan(d.azimuth_rad) for d in evaluation.detections):
        told.append("for directions several elements.receivers_m, or a track")
    return "; ".join(told)


def _void(evaluation: RadarEvaluation) -> Finding:
    reasons = "; ".join(str(w) for w in evaluation.capture.warnings if w.void)
    radar = evaluation.radar
    counts = number(radar.front_end.noise_counts.value)
    clips = any(w.void and w.kind == "saturated" for w in evaluation.capture.warnings)
    gain = ("below", "a lower gain, until no slot clips") if clips else ("above", "a higher gain")
    return Finding(
        radar.name,
        radar.description,
        "void",
        "void",
        (
            ("What is seen", f"nothing that counts: {reasons}"),
            ("To what distance", "none"),
            ("What limits it", reasons),
            (
                "What would help most",
                f"a front_end.noise_counts {gain[0]} {counts}, {gain[1]}",
            ),
        ),
    )
