"""Numbers of the radar report: waveform, link budget, detections beside the truth."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import constants

from hardware.formatting import number, quantity_text, si
from hardware.radar import Detection
from twin.accuracy import Interval
from twin.radar.detection_count import window_loss
from twin.radar.evaluation import RadarEvaluation
from twin.radar.intervals import body_level
from twin.radar.micro_doppler import WINDOWS
from twin.radar.propagation.facets.convergence import percent, stated

_CFAR = {"ca": "cell-averaging", "go": "greatest-of", "os": "ordered-statistic"}


def radar_summary(evaluation: RadarEvaluation) -> dict[str, Any]:
    """Tables for the page, ready to print."""
    return {
        "name": evaluation.radar.name,
        "description": evaluation.radar.description,
        "waveform": _waveform(evaluation),
        "window_cell": si(WINDOWS * evaluation.waveform.velocity_cell_m_per_s, "m/s"),
        "interval": si(evaluation.radar.burst_s, "s"),
        "budget": [(n, f"{_told(v)} {unit}") for n, v, unit in budget_figures(evaluation)],
        "targets": _targets(evaluation),
        "headlines": str(evaluation).splitlines(),
        "missed": [f"{t.name}: {evaluation.expectation(t)}" for t in evaluation.missed],
        "further": _further(evaluation),
        "others": _others(evaluation),
        "roles": [
            (a.name, str(a.role), number(a.over_fresnel_zone))
            for a in evaluation.capture.propagation.roles
        ],
        "bodies": [
            (
                body.name,
                body_level(body).text("dB"),
                stated(body) + ("" if body.is_bounded else ", what fixed knobs leave out aside"),
                f"{percent(body.tolerance)} %" + ("" if body.is_within_tolerance else ", exceeded"),
            )
            for body in evaluation.capture.propagation.bodies
        ],
        "assumptions": evaluation.capture.assumptions,
        "window": evaluation.how.window,
        "false_alarm": number(evaluation.how.cfar.false_alarm),
        "detection": evaluation.frame.detection,
        "cfar": _CFAR[evaluation.how.cfar.method],
        "picture": _picture(evaluation),
        "n_paths": len(evaluation.capture.propagation.names),
    }


def _waveform(evaluation: RadarEvaluation) -> list[tuple[str, str]]:
    wave, seen = evaluation.radar.ofdm, evaluation.waveform
    return [
        (
            "band",
            f"{wave.carrier_hz / 1e9:g} GHz, {si(wave.bandwidth_hz, 'Hz')} in "
            f"{wave.n_subcarriers} subcarriers of {si(wave.subcarrier_spacing_hz, 'Hz')}",
        ),
        *_parts(evaluation),
        ("range", f"cell {si(seen.range_cell_m, 'm')}, unambiguous to {si(wave.max_range_m, 'm')}"),
        (
            "interval",
            f"{wave.n_slots} slots of {si(wave.slot_period_s, 's')}, "
            f"{wave.repeats} repeats averaged in each",
        ),
        (
            "range rate",
            f"cell {si(seen.velocity_cell_m_per_s, 'm/s')}, "
            f"unambiguous to ± {si(seen.max_velocity_m_per_s, 'm/s')}",
        ),
    ]


def _parts(evaluation: RadarEvaluation) -> list[tuple[str, str]]:
    """Bursts, carrier steps and antennas where there are several."""
    record, radar = evaluation.capture.record, evaluation.radar
    n_bursts, n_steps, _, n_receivers = record.iq.shape[:4]
    n_transmitters = len(record.front_end.transmitters_m)
    rows = []
    if n_bursts > 1:
        length = float(np.linalg.norm(record.pose[-1].position_m - record.pose[0].position_m))
        rows.append(("bursts", f"{n_bursts} along {si(length, 'm')}; map: the first"))
    if n_steps > 1:
        last = record.carriers_hz[-1] / 1e9
        rows.append(("carrier steps", f"{n_steps}, to {last:g} GHz in {si(radar.burst_s, 's')}"))
    if n_transmitters * n_receivers > 1:
        rows.append(
            ("transmitters x receivers", f"{n_transmitters} x {n_receivers}, transmitting by turns")
        )
    return rows


def _picture(evaluation: RadarEvaluation) -> list[dict[str, str]]:
    """Targets in the image of a track."""
    if evaluation.picture is None:
        return []
    return [
        {
            "name": seen.name,
            "place": f"{seen.down_range_m:.3f} m ahead, {seen.cross_range_m:+.3f} m to the left",
            "off": si(seen.off_m, "m"),
            "rcs": f"{number(seen.rcs_m2)} m²",
            "declared": f"{number(seen.declared_rcs_m2)} m²",
        }
        for seen in evaluation.picture.seen
    ]


def budget_figures(evaluation: RadarEvaluation) -> list[tuple[str, Interval, str]]:
    """Name, value and unit of every line of the link budget, for 10 m^2 at 150 m or as far as the
    radar is unambiguous.
    """
    radar = evaluation.radar
    wave, end = evaluation.waveform, radar.front_end
    far = min(150.0, wave.max_range_m)
    received = radar.received_power_w(far, 10.0)
    noise = constants.k * 290.0 * wave.bandwidth_hz
    cells = wave.n_subcarriers * wave.n_slots
    predicted = radar.sample_noise_w / cells * window_loss(evaluation)
    known = [
        ("transmit power", _db(end.transmit_power_w.value * 1e3), "dBm"),
        ("antenna gain, each way", radar.antenna.ahead_dbi, "dBi"),
        ("losses", end.losses_db.value, "dB"),
        (f"received from 10 m² at {far:.0f} m", _db(received * 1e3), "dBm"),
        ("thermal noise in the band, k T0 B", _db(noise * 1e3), "dBm"),
        ("noise figure", end.noise_figure_db.value, "dB"),
        ("averaging of repeats", _db(wave.repeats), "dB"),
        ("processing gain N M", _db(cells), "dB"),
        ("SNR after processing, rectangular window", _db(radar.image_snr(received)), "dB"),
        ("noise per cell, predicted", _db(predicted * 1e3), "dBm"),
    ]
    found = ("noise per cell, found", noise_found_dbm(evaluation), "dBm")
    return [*((name, Interval(value), unit) for name, value, unit in known), found]


def noise_found_dbm(evaluation: RadarEvaluation) -> Interval:
    """Mean noise of a cell, as the vehicle finds it on the map."""
    level_w, error_w = evaluation.image.noise_w, evaluation.image.noise_error_w
    noise_db = 10 / np.log(10) * error_w / level_w if level_w > 0 else 0.0
    return Interval(_db(level_w * 1e3), noise=float(noise_db))


def _targets(evaluation: RadarEvaluation) -> list[dict[str, str]]:
    triples = zip(evaluation.detections, evaluation.intervals, evaluation.matches, strict=True)
    by_target = {target.name: (found, model) for found, model, target in triples if target}
    rows = []
    for target in evaluation.capture.truth:
        detection, model = by_target.get(target.name, (None, None))
        rows.append(
            {
                "name": target.name,
                "rcs": f"{number(target.rcs_m2)} m²",
                "range": si(target.range_m, "m", 5),
                "rate": quantity_text(target.range_rate_m_per_s, "m/s", 4),
                "power": f"{_db(target.received_w * 1e3):.1f} dBm",
                "found_range": _off(model.range_m, target.wrapped_range_m, "m")
                if model
                else "not detected",
                "found_rate": _off(model.range_rate_m_per_s, target.range_rate_m_per_s, "m/s")
                if model
                else "",
                "found_power": _off(model.level_dbm, _db(target.received_w * 1e3), "dB")
                if model
                else "",
                "snr": f"{detection.snr_db:.1f} dB" if detection else "",
            }
        )
    return rows


def _off(measured: Interval, true: float, unit: str) -> str:
    """What was measured less the truth, with its interval."""
    off = measured.value - true
    return "not measured" if np.isnan(off) else replace(measured, value=off).text(unit, sign=True)


def _further(evaluation: RadarEvaluation) -> list[str]:
    """Echoes of other parts of the targets' objects."""
    return [
        f"{part.name}: {_place(detection)}"
        for detection, part in zip(evaluation.detections, evaluation.further, strict=True)
        if part
    ]


def _others(evaluation: RadarEvaluation) -> list[str]:
    """Detections within no target's extent."""
    return [
        _place(detection)
        for detection, target, part in zip(
            evaluation.detections, evaluation.matches, evaluation.further, strict=True
        )
        if target is None and part is None
    ]


def _place(detection: Detection) -> str:
    """Range, range rate and SNR of a detection, as far as measured."""
    parts = [
        "" if np.isnan(detection.range_m) else f"{detection.range_m:.3f} m",
        ""
        if np.isnan(detection.range_rate_m_per_s)
        else f"{detection.range_rate_m_per_s:+.3f} m/s",
        f"{detection.snr_db:.1f} dB",
    ]
    return ", ".join(part for part in parts if part)


def _db(ratio: float) -> float:
    return float(10 * np.log10(ratio)) if ratio > 0 else -np.inf


def _told(figure: Interval) -> str:
    return str(figure) if figure.half_width else number(figure.value, 4)
