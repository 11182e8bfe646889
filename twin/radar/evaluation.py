"""What the vehicle makes of a radar record, beside what is really there."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from hardware.radar import Detection, OfdmWaveform, RangeDopplerMap, channel, detect, range_doppler
from twin.radar.acquisition import RadarCapture
from twin.radar.design import RadarDesign
from twin.radar.propagation import Path as RadioPath
from twin.radar.truth import TrueTarget


@dataclass(frozen=True, eq=False)
class RadarEvaluation:
    """One radar's capture, a map, its detections, and which true target each one is.

    Map and detections are those of the first burst, carrier step, transmitter and receiver, whose
    waveform is ``waveform``. ``matches`` has a true target or None for every detection.
    """

    radar: RadarDesign
    capture: RadarCapture
    waveform: OfdmWaveform
    image: RangeDopplerMap
    detections: tuple[Detection, ...]
    matches: tuple[TrueTarget | None, ...]
    window: str
    false_alarm: float


def evaluate_radar(
    radar: RadarDesign,
    capture: RadarCapture,
    *,
    window: str = "blackmanharris",
    false_alarm: float = 1e-8,
) -> RadarEvaluation:
    """Process one channel of a record as the vehicle does, and match detections with the truth."""
    waveform = radar.channel_waveform
    received = channel(capture.record)[:, capture.record.transmitter == 0]
    image = range_doppler(received, waveform, window)
    found = detect(received, waveform, image, window=window, false_alarm=false_alarm)
    return RadarEvaluation(
        radar=radar,
        capture=capture,
        waveform=waveform,
        image=image,
        detections=tuple(found),
        matches=match_detections(found, capture.truth, radar),
        window=window,
        false_alarm=false_alarm,
    )


def match_detections(
    detections: Sequence[Detection], truth: tuple[TrueTarget, ...], radar: RadarDesign
) -> tuple[TrueTarget | None, ...]:
    """Nearest true target within two cells in range and rate; each target goes to one detection."""
    wave, free = radar.channel_waveform, list(truth)
    matches: list[TrueTarget | None] = []
    for found in detections:
        best, nearest = None, 2.0
        for target in free:
            off_range = abs(found.range_m - target.seen_at[0]) / wave.range_cell_m
            off_rate = abs(found.range_rate_m_per_s - target.seen_at[1])
            off = max(off_range, off_rate / wave.velocity_cell_m_per_s)
            if off <= nearest:
                best, nearest = target, off
        if best is not None:
            free.remove(best)
        matches.append(best)
    return tuple(matches)


def write_detections(evaluation: RadarEvaluation, path: Path) -> None:
    """``detections.csv``: one row per detection, strongest first, with the target it is."""
    rows = (
        {**asdict(found), "target": target.name if target else ""}
        for found, target in zip(evaluation.detections, evaluation.matches, strict=True)
    )
    _write(path, [*(f.name for f in fields(Detection)), "target"], rows)


def write_truth_table(truth: Sequence[TrueTarget], path: Path) -> None:
    """``truth.csv``: one row per true target."""
    names = [f.name for f in fields(TrueTarget) if f.name != "seen_at"]
    _write(path, names, ({name: getattr(t, name) for name in names} for t in truth))


def write_paths(paths: Sequence[RadioPath], path: Path) -> None:
    """``paths.csv``: every path with its objects, range, rate and power over the sent one."""
    rows = (
        {
            "via": " > ".join(p.via),
            "range_m": p.range_m,
            "delay_s": p.delay_s,
            "delay_rate": p.delay_rate,
            "gain_db": 20 * np.log10(abs(p.amplitude)),
            "phase_rad": float(np.angle(p.amplitude)),
        }
        for p in paths
    )
    _write(path, ["via", "range_m", "delay_s", "delay_rate", "gain_db", "phase_rad"], rows)


def _write(path: Path, names: list[str], rows: Iterable[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
