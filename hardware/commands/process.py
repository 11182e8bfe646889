"""The command ``ugv process``: images and detections of the records of a log or a sensor."""

import itertools
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.processing import with_processing
from hardware.commands.quantities import quantity_of
from hardware.commands.radar import MaxAge
from hardware.commands.records import (
    RadarSetup,
    Settings,
    calibration_of,
    end_early,
    fault_in_brackets,
    is_log,
    log_of,
    naming,
    records_of,
    warn_of_damage,
)
from hardware.errors import InputError, check_positive

if TYPE_CHECKING:
    from hardware.calibration import CameraCalibration, RadarCalibration
    from hardware.motion_of_tracks import MotionOfTracks
    from hardware.processing import RecordSummary
    from hardware.radar.settings import Processing
    from hardware.reconstruction.motion import Motion, Search
    from hardware.recording import Received

_CalibrationFiles = Annotated[
    list[Path], typer.Option("--calibration", help="From `ugv calibrate`; one a sensor.")
]


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command()(with_output(with_processing(process), "ugv process"))


def process(
    say: Output,
    source: Annotated[str, typer.Argument(help="A log, or the URL of a sensor.")],
    *,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="New log; default SOURCE-processed.mcap, beside a log."),
    ] = None,
    method: Annotated[str, typer.Option(help="See `ugv methods`; or file.py:function.")] = "lmmse",
    settings: Settings = None,
    radar_setup: RadarSetup = None,
    calibration: _CalibrationFiles = [],  # noqa: B006 (typer copies it)
    max_age: MaxAge = 30.0,
    distance: Annotated[
        float | None,
        typer.Option(
            help="Of the surfaces whose reflectance a camera's calibration tells, m, one for all "
            "cells; default: its target's. One at d is told (distance / d)^2 of its reflectance.",
            parser=quantity_of("m"),
        ),
    ] = None,
    records: Annotated[int, typer.Option(min=0, help="So many records; 0: no limit.")] = 0,
    how: "Processing",
    tracks: Annotated[bool, typer.Option(help="Follow detections from burst to burst.")] = False,
    image_every: Annotated[
        int,
        typer.Option(
            min=0, help="An image after so many patterns, from a sliding window; 0: a set."
        ),
    ] = 0,
    motion: Annotated[
        str | None,
        typer.Option(
            help="How images move within a set: as of `ugv reconstruct`, or `radar`: by the rig's "
            "poses and the radar's tracks."
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="TOML file for --motion radar where the log does not tell: NAME = [x, y, z, qw, "
            "qx, qy, qz] of each sensor, [field_deg] NAME = [down, along] of the camera."
        ),
    ] = None,
) -> None:
    """Process records to images and detections; those of a radar as with `ugv detect`."""
    from hardware.interruption import asked_to_end
    from hardware.processing import process as process_record
    from hardware.reconstruction import method_of
    from hardware.recording import Log
    from hardware.recording.ending import Ending
    from hardware.sliding_images import SlidingImages
    from hardware.tracks import RadarTracks

    if image_every and method != "lmmse":
        raise InputError(
            f"--method: {method}: images between whole sets are linear estimates, expected no "
            "--method beside --image-every"
        )
    image_motion = _image_motion(source, motion, rig, image_every)
    camera, radar = _calibrations(say, calibration, max_age)
    if distance is not None:
        if not camera:
            raise InputError("--distance: is for a camera's --calibration")
        check_positive("--distance", distance)
    write_results = partial(
        process_record,
        how=how,
        method=method_of(method),
        camera=camera,
        radar=radar,
        tracks=RadarTracks() if tracks or motion == "radar" else None,
        sliding=SlidingImages(image_every, image_motion) if image_every else None,  # type: ignore[arg-type]
        motion=image_motion,
        distance_m=distance,
    )
    target, ending = out or _beside(source), Ending()
    if target.exists():
        raise InputError(f"{target}: exists: expected a new log: name another by -o, or delete it")
    # From a log, chunks are cut by their size alone: the same log gives the same bytes.
    flush_s = math.inf if is_log(source) else 0.5
    with asked_to_end() as over, Log(target, flush_s=flush_s) as log:
        incoming = records_of(source, settings, radar_setup, over, ending)
        processed = _Processed(say)
        for received in itertools.islice(incoming, records or None):
            if over.is_set():
                break
            with naming(source):
                processed.add(received, partial(write_results, received, log))
        if over.is_set():
            say.line("stopped")
        if not processed.n:
            whole = "whole " if processed.n_failed else ""
            raise InputError(f"{source}: no {whole}record in it{fault_in_brackets(ending)}")
    say.add(source=source, records=processed.n, results=processed.results)
    say.written(target)
    warn_of_damage(say, {log_of(source): ending})
    if over.is_set() and processed.n + processed.n_failed < records:
        end_early(say, f"{processed.n + processed.n_failed} of {records} records")


def _beside(source: str) -> Path:
    """Where results go: beside a log, or of a sensor into the working directory."""
    if is_log(source):
        return Path(source).with_name(f"{Path(source).stem}-processed.mcap")
    name = Path(source.rpartition("/")[2].rpartition(":")[2]).stem
    return Path(f"{name or 'records'}-processed.mcap")


@dataclass
class _Processed:
    """Numbers of the records processed and failed, and the ``results`` for the document."""

    say: Output
    n: int = 0
    n_failed: int = 0
    results: list[dict[str, str | int]] = field(default_factory=list)
    _start_ns: int | None = None
    _of_topic: Counter[str] = field(default_factory=Counter)

    def add(self, received: "Received", write_results: "Callable[[], RecordSummary]") -> None:
        """Process a record and print what came of it, with its number among those of its topic.

        Raises InputError where it is whole.
        """
        from hardware.radar.integrity import UnusableBurstError

        say, topic = self.say, received.topic
        self._of_topic[topic] += 1
        number = received.number or self._of_topic[topic]
        name = f"{topic}, record {number}"
        try:
            summary = write_results()
        except InputError as error:
            if not (isinstance(error, UnusableBurstError) or received.record.flags.any()):
                raise InputError(f"{name}: {error}") from error
            # Too little of this record arrived; the next one may be whole.
            self.n_failed += 1
            say.warn(f"{name}: not processed: {error}")
            return
        self.n += 1
        say.step(f"processed {name}")
        for warning in summary.warnings:
            say.warn(f"{name}: {warning}")
        if self._start_ns is None:
            self._start_ns = received.host_ns
        after_s = (received.host_ns - self._start_ns) / 1e9
        for line in summary.lines:
            say.verdict(f"{name}, {after_s:.3f} s: {line}")
        if say.json:
            self.results += [
                {"topic": topic, "record": number, "result": line} for line in summary.lines
            ]


def _calibrations(
    say: Output, paths: list[Path], max_age_days: float
) -> "tuple[CameraCalibration | None, RadarCalibration | None]":
    """The first of each kind. Raises InputError for one that is too old."""
    from hardware.calibration import CameraCalibration, RadarCalibration

    loaded = [calibration_of(say, path, max_age_days) for path in paths]
    cameras = (each for each in loaded if isinstance(each, CameraCalibration))
    radars = (each for each in loaded if isinstance(each, RadarCalibration))
    return next(cameras, None), next(radars, None)


def _image_motion(
    source: str, motion: str | None, rig: Path | None, image_every: int
) -> "Motion | Search | MotionOfTracks | None":
    """What images are compensated for. Raises InputError where options contradict each other."""
    from hardware.commands.motions import motion_of
    from hardware.reconstruction.motion import Layers, ShiftTrack

    if rig and motion != "radar":
        raise InputError("--rig: is for --motion radar")
    if motion is None:
        return None
    if image_every and motion == "radar":
        raise InputError("--motion: radar: needs whole sets, expected no --image-every")
    given = _motion_of_tracks(source, rig) if motion == "radar" else motion_of(motion)
    if image_every and isinstance(given, Layers | ShiftTrack):
        raise InputError(
            f"--motion: {motion}: its time 0 is the middle of a whole set, expected no "
            "--image-every, or a motion that is the same at all times"
        )
    return given


def _motion_of_tracks(source: str, rig: Path | None) -> "MotionOfTracks":
    """For ``--motion radar``. Raises InputError for a log without records of both sensors, and
    where it is unknown how these are mounted.
    """
    from hardware.motion_of_tracks import MotionOfTracks
    from hardware.recording.ending import Ending
    from hardware.recording.mounting import RADAR, SPI, Mounting, logged_mounting, read_mounting

    given, logged = read_mounting(rig) if rig else Mounting(), Mounting()
    path, ending = log_of(source), Ending()
    if path.endswith(".mcap"):
        logged = logged_mounting(path, ending)
        for kind in (SPI, RADAR):
            if kind not in logged.records.values():
                name = kind.rpartition("/")[2]
                raise InputError(
                    f"{path}: --motion radar: no {name} in it{fault_in_brackets(ending)}, expected "
                    "both sensors"
                )
    mounting = Mounting(
        {**logged.poses, **given.poses},
        {**logged.fields_rad, **given.fields_rad},
        logged.records,
    )
    mounting.check()
    return MotionOfTracks(mounting)
