"""What the vehicle makes of a radar record, beside what is really there."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hardware.radar import Detection, OfdmWaveform, RangeDopplerMap
from hardware.radar.pictures import cell
from hardware.radar.process import Frame, Processing, process
from hardware.records import RadarRecord
from twin.radar.acquisition import RadarCapture
from twin.radar.device.design import RadarDesign
from twin.radar.picture import TrackPicture, track_picture
from twin.radar.propagation.paths import Path as RadioPath
from twin.radar.truth import TrueTarget
from twin.scene import Scene


@dataclass(frozen=True, eq=False)
class RadarEvaluation:
    """One radar's capture, what the vehicle makes of its first burst, which true target each
    detection is (or None), and what a track sees over all bursts.
    """

    radar: RadarDesign
    capture: RadarCapture
    frame: Frame
    matches: tuple[TrueTarget | None, ...]
    how: Processing
    picture: TrackPicture | None

    @property
    def waveform(self) -> OfdmWaveform:
        """What the map is made of: all carrier steps together, one transmitter's slots."""
        return self.frame.waveform

    @property
    def image(self) -> RangeDopplerMap:
        """The map of the first burst."""
        return self.frame.image

    @property
    def detections(self) -> tuple[Detection, ...]:
        """Of the first burst, strongest first."""
        return self.frame.detections


def evaluate_radar(
    radar: RadarDesign,
    capture: RadarCapture,
    how: Processing | None = None,
    *,
    scene: Scene | None = None,
) -> RadarEvaluation:
    """Process a record as the vehicle does, and match detections with the truth.

    Carrier steps without leakage cannot be joined: then the first one stands for all. ``scene``, as
    it is at the first burst, is what the picture of a track is compared with; without it there is
    none.
    """
    how, record = how or Processing(), _joinable(capture.record)
    frame = process(record, 0, how)
    return RadarEvaluation(
        radar=radar,
        capture=capture,
        frame=frame,
        matches=match_detections(frame.detections, capture.truth, frame.waveform),
        how=how,
        picture=track_picture(scene, radar, record) if scene else None,
    )


def _joinable(record: RadarRecord) -> RadarRecord:
    """The record; of one whose carrier steps nothing joins, the first step alone."""
    if len(record.carriers_hz) == 1 or np.isfinite(record.leakage_delay_s):
        return record
    first = {name: getattr(record, name)[:, :1] for name in ("iq", "device_time_ns", "flags")}
    return replace(record, carriers_hz=record.carriers_hz[:1], **first)


def match_detections(
    detections: Sequence[Detection], truth: tuple[TrueTarget, ...], waveform: OfdmWaveform
) -> tuple[TrueTarget | None, ...]:
    """Nearest true target within two cells in range and rate; each target goes to one detection.

    Of an ambiguous rate any alternative counts.
    """
    free = list(truth)
    matches: list[TrueTarget | None] = []
    for found in detections:
        best, nearest = None, 2.0
        for target in free:
            off_range = abs(found.range_m - target.wrapped_range_m) / waveform.range_cell_m
            rates = np.array([found.range_rate_m_per_s, *found.range_rate_alternatives_m_per_s])
            off_rate = float(np.abs(rates - target.range_rate_m_per_s).min())
            off = max(off_range, off_rate / waveform.velocity_cell_m_per_s)
            if off <= nearest:
                best, nearest = target, off
        if best is not None:
            free.remove(best)
        matches.append(best)
    return tuple(matches)


def write_detections(evaluation: RadarEvaluation, path: Path) -> None:
    """``detections.csv``: one row per detection, strongest first, with the target it is; empty is
    what array or antenna do not tell.
    """
    rows = (
        {
            **{name: cell(value) for name, value in asdict(found).items()},
            "target": target.name if target else "",
        }
        for found, target in zip(evaluation.detections, evaluation.matches, strict=True)
    )
    _write(path, [*(f.name for f in fields(Detection)), "target"], rows)


def write_truth_table(truth: Sequence[TrueTarget], path: Path) -> None:
    """``truth.csv``: one row per true target."""
    names = [f.name for f in fields(TrueTarget) if f.name != "wrapped_range_m"]
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
