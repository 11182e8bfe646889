"""What the vehicle makes of a radar record, beside what is really there."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hardware.described import Described
from hardware.formatting import counted
from hardware.radar import Detection, OfdmWaveform, RangeDopplerMap
from hardware.radar.output import cell
from hardware.radar.process import Frame, process
from hardware.radar.settings import Processing
from hardware.radar.windows import normalised_window
from hardware.records import RadarRecord
from twin.radar.acquisition import RadarCapture
from twin.radar.device.design import RadarDesign
from twin.radar.intervals import DetectionIntervals, detection_intervals
from twin.radar.micro_doppler import MicroDoppler, micro_doppler
from twin.radar.picture import TrackPicture, track_picture
from twin.radar.propagation.facets.convergence import beyond_tolerance, worst_by_body
from twin.radar.propagation.result import Path as RadioPath
from twin.radar.truth import TrueTarget
from twin.scene import Scene

_CELLS = 2.0  # by which a detection may lie beside a target, in range and rate


@dataclass(frozen=True, eq=False, repr=False)
class RadarEvaluation(Described):
    """One radar's capture, what the vehicle makes of its first burst, which true target each
    detection is (or None), what a track sees over all bursts, and what turns or swings.

    Printed, it says what was achieved.
    """

    radar: RadarDesign
    capture: RadarCapture
    frame: Frame
    matches: tuple[TrueTarget | None, ...]
    how: Processing
    picture: TrackPicture | None
    micro_doppler: tuple[MicroDoppler, ...] = ()

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

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the capture, and of what the vehicle's processing says of the first burst."""
        return tuple(dict.fromkeys([*map(str, self.capture.warnings), *self.frame.warnings]))

    @cached_property
    def intervals(self) -> tuple[DetectionIntervals, ...]:
        """Of each detection, what the model may be off by, and its noise."""
        sent_w = self.radar.front_end.transmit_power_w.value
        return detection_intervals(
            self.detections, self.capture, self.image, self.waveform, self.how.window, sent_w
        )

    @property
    def further(self) -> tuple[TrueTarget | None, ...]:
        """Of each detection that is no target by itself, the target whose object it is part of."""
        return further_echoes(self.detections, self.matches, self.capture.truth, self.waveform)

    @property
    def missed(self) -> tuple[TrueTarget, ...]:
        """True targets without a detection."""
        names = {match.name for match in self.matches if match}
        return tuple(target for target in self.capture.truth if target.name not in names)

    @property
    def beyond_tolerance(self) -> str:
        """Which bodies' echoes are stated to more than was asked, at the burst where their errors
        are largest; empty if none is.
        """
        bodies = (body for burst in self.capture.bursts for body in burst.bodies)
        return beyond_tolerance(worst_by_body(bodies))

    def expectation(self, target: TrueTarget) -> str:
        """What was to be expected of a target, in words."""
        if not target.visible:
            return "no direct echo"
        if not self.image.noise_w:
            return "the map is empty"
        return f"{self.expected_snr_db(target):.1f} dB over the map's noise expected"

    def expected_snr_db(self, target: TrueTarget) -> float:
        """Of a target's peak over the map's noise, by the radar equation; infinite where the map
        has none, as of a converter whose step is above all that comes.
        """
        heard_w = target.received_w * _kept(target, self.radar.ofdm, self.how.window)
        noise_w = self.image.noise_w
        return float(10 * np.log10(max(heard_w, 1e-300) / noise_w)) if noise_w else float("inf")

    def __str__(self) -> str:
        """What was achieved, a line each: over a track, on the map, and what is missing."""
        name, truth = self.radar.name, self.capture.truth
        lines = [f"{name}: {self.picture}"] if self.picture else []
        lines.append(f"{name}: {self.headline}")
        if self.missed:
            text = ", ".join(f"{t.name} ({self.expectation(t)})" for t in self.missed)
            where = " on the map" if self.picture else ""
            lines.append(f"{name}: missed{where}: {text}")
        lines = lines if truth else lines[-1:]
        if self.beyond_tolerance:
            lines.append(f"{name}: echoes {self.beyond_tolerance}")
        return "\n".join(lines)

    @property
    def tally(self) -> str:
        """How many targets are detected; the number of detections where the scene names none."""
        n = len(self.capture.truth)
        if not n:
            return counted(len(self.detections), "detection")
        return f"{n - len(self.missed)} of {counted(n, 'target')} detected"

    @property
    def headline(self) -> str:
        """How many targets the map of the first burst shows."""
        hit = len(self.capture.truth) - len(self.missed)
        parts = sum(target is not None for target in self.further)
        found = counted(len(self.detections), "detection")
        text = f"{hit} of {counted(len(self.capture.truth), 'target')} among {found}"
        if not self.capture.truth:
            text = f"{found}; the scene names no targets"
        if parts:
            text += f", {parts} of them further echoes of the same objects"
        return f"map of the first burst: {text}" if self.picture else text


def evaluate_radar(
    radar: RadarDesign,
    capture: RadarCapture,
    how: Processing | None = None,
    *,
    scene: Scene | None = None,
) -> RadarEvaluation:
    """Process a record as the vehicle does, and match detections with the truth.

    Carrier steps without leakage cannot be joined: then the first one stands for all. ``scene``, as
    it is at the first burst, is what the picture of a track and micro-Doppler are compared with;
    without it there is none of either.
    """
    how, record = how or Processing(), joinable(capture.record)
    frame = process(record, 0, how)
    return RadarEvaluation(
        radar=radar,
        capture=capture,
        frame=frame,
        matches=match_detections(frame.detections, capture.truth, frame.waveform),
        how=how,
        picture=track_picture(scene, radar, record) if scene else None,
        micro_doppler=micro_doppler(scene, radar, record, capture.truth) if scene else (),
    )


def joinable(record: RadarRecord) -> RadarRecord:
    """The record; of one whose carrier steps nothing joins, the first step alone."""
    if len(record.carriers_hz) == 1 or np.isfinite(record.front_end.leakage_delay_s):
        return record
    first = {name: getattr(record, name)[:, :1] for name in ("iq", "device_time_ns", "flags")}
    return replace(record, carriers_hz=record.carriers_hz[:1], **first)


def match_detections(
    detections: Sequence[Detection], truth: tuple[TrueTarget, ...], waveform: OfdmWaveform
) -> tuple[TrueTarget | None, ...]:
    """Which true target each detection is; each target goes to one detection.

    The nearest target within two cells in range and rate of its declared place, strongest detection
    first; of the rates that it has within the interval any counts. A target without one, such as a
    ball of which the centre is declared, goes to the strongest detection within two cells of its
    object's extent in range and rate. Of an ambiguous rate any alternative counts.
    """
    free = list(truth)
    matches: list[TrueTarget | None] = []
    for detection in detections:
        best, nearest = None, _CELLS
        for target in free:
            off_range = abs(detection.range_m - target.wrapped_range_m) / waveform.range_cell_m
            rates = np.array(
                [detection.range_rate_m_per_s, *detection.range_rate_alternatives_m_per_s]
            )
            off_rates = np.abs(rates - target.range_rate_m_per_s) - target.rate_change_m_per_s
            off_rate = max(float(off_rates.min()), 0.0)
            # What is not measured, NaN, tells nothing against a target.
            off = float(np.nanmax([off_range, off_rate / waveform.velocity_cell_m_per_s, 0.0]))
            if off <= nearest:
                best, nearest = target, off
        if best is not None:
            free.remove(best)
        matches.append(best)
    for target in free:
        for i, detection in enumerate(detections):
            if matches[i] is None and _within(detection, target, waveform):
                matches[i] = target
                break
    return tuple(matches)


def further_echoes(
    detections: Sequence[Detection],
    matches: Sequence[TrueTarget | None],
    truth: Sequence[TrueTarget],
    waveform: OfdmWaveform,
) -> tuple[TrueTarget | None, ...]:
    """Of each detection that is no target by itself, the target within two cells of whose extent in
    range and rate it lies, the nearest of several.
    """
    parts: list[TrueTarget | None] = []
    for detection, match in zip(detections, matches, strict=True):
        near = [t for t in truth if match is None and _within(detection, t, waveform)]
        parts.append(
            min(near, key=lambda t: abs(detection.range_m - t.wrapped_range_m), default=None)
        )
    return tuple(parts)


def _kept(target: TrueTarget, waveform: OfdmWaveform, window: str) -> float:
    """Share of a target's power that is left at its peak over Doppler, where its changing rate
    spreads it.
    """
    t = waveform.slot_times_s
    latest = waveform.n_slots * waveform.slot_period_s / 2
    turn = 2 * np.pi / waveform.wavelength_m * target.rate_change_m_per_s / latest * t**2
    spectrum = np.fft.fft(normalised_window(window, len(t)) * np.exp(-1j * turn), 8 * len(t)) / len(
        t
    )
    return float(np.max(np.abs(spectrum) ** 2))


def _within(detection: Detection, target: TrueTarget, waveform: OfdmWaveform) -> bool:
    """Whether a detection lies within two cells of a target's object."""
    rates = np.array([detection.range_rate_m_per_s, *detection.range_rate_alternatives_m_per_s])
    off_range, off_rate = target.beside(detection.range_m, rates)
    return (
        off_range <= _CELLS * waveform.range_cell_m
        and off_rate <= _CELLS * waveform.velocity_cell_m_per_s
    )


def write_detections(evaluation: RadarEvaluation, path: Path) -> None:
    """``detections.csv``: one row per detection, strongest first, with the target it is; empty is
    what array or antenna do not tell. Columns ``model_QUANTITY_standard_error`` and
    ``model_QUANTITY_systematic``: what the model may be off by; a level whose systematic error is
    infinite may still be bounded upward, by ``model_level_dbm_systematic_above``.
    """
    rows = (
        {
            **{name: cell(value) for name, value in asdict(detection).items()},
            **{name: cell(value) for name, value in _model_errors(intervals).items()},
            "target": target.name if target else "",
            "further_echo_of": part.name if part else "",
        }
        for detection, intervals, target, part in zip(
            evaluation.detections,
            evaluation.intervals,
            evaluation.matches,
            evaluation.further,
            strict=True,
        )
    )
    errors = [
        f"model_{f.name}_{kind}"
        for f in fields(DetectionIntervals)
        for kind in ("standard_error", "systematic")
    ] + ["model_level_dbm_systematic_above"]
    names = [*(f.name for f in fields(Detection)), *errors, "target", "further_echo_of"]
    _write(path, names, rows)


def _model_errors(intervals: DetectionIntervals) -> dict[str, float]:
    """Columns of a detection; NaN, which is left empty, of what is not measured."""
    found = {}
    for name, interval in vars(intervals).items():
        is_known = not np.isnan(interval.value)
        found[f"model_{name}_standard_error"] = interval.standard_error if is_known else np.nan
        found[f"model_{name}_systematic"] = interval.systematic if is_known else np.nan
    above = intervals.level_dbm.systematic_above
    found["model_level_dbm_systematic_above"] = np.nan if above is None else above
    return found


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
            "delay_acceleration_per_s": p.delay_acceleration_per_s,
            "gain_db": 20 * np.log10(abs(p.amplitude)),
            "phase_rad": float(np.angle(p.amplitude)),
        }
        for p in paths
    )
    names = ["via", "range_m", "delay_s", "delay_rate", "delay_acceleration_per_s"]
    _write(path, [*names, "gain_db", "phase_rad"], rows)


def _write(path: Path, names: list[str], rows: Iterable[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
