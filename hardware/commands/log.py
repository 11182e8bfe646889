"""Commands of ``ugv`` on logs, from `capture` to `calibrate`."""

import itertools
import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.quantities import quantity_of
from hardware.commands.radar import (
    CfarMethod,
    ClutterShape,
    DetectionOption,
    FalseAlarm,
    MovingOnly,
    Resolve,
    Window,
    processing,
)
from hardware.errors import InputError
from hardware.formatting import si

if TYPE_CHECKING:
    import threading

    from hardware.calibration import Calibration
    from hardware.drivers import SpiSettings
    from hardware.drivers.radio import Schedule
    from hardware.motion_of_tracks import MotionOfTracks
    from hardware.reconstruction.motion import Motion
    from hardware.recording import Received
    from hardware.recording.reading import Ending
    from hardware.records import RadarFrontEnd

_Kind = TypeVar("_Kind")
#: Exit status of a command that succeeded on the intact part of a damaged log.
_DATA_LOST = 1
_Settings = Annotated[
    Path | None, typer.Option("--settings", help="TOML file: patterns and times of a camera.")
]
_RadarSetup = Annotated[
    Path | None, typer.Option("--radar-setup", help="JSON file: schedule and front end of a radio.")
]
_Calibrations = Annotated[
    list[Path], typer.Option("--calibration", help="From `ugv calibrate`; one a sensor.")
]
_MaxAge = Annotated[
    float,
    typer.Option(help="Days after which a calibration is refused.", parser=quantity_of("d")),
]


def register(app: typer.Typer) -> None:
    """Add the commands to an application."""
    for command in (capture, process, replay, info, recover, export):
        app.command()(with_output(command, f"ugv {command.__name__}"))
    calibrate = typer.Typer(help="Calibrate against a reference target at a known distance.")
    calibrate.command("camera")(with_output(calibrate_camera, "ugv calibrate camera"))
    calibrate.command("radar")(with_output(calibrate_radar, "ugv calibrate radar"))
    app.add_typer(calibrate, name="calibrate")


def capture(
    say: Output,
    urls: Annotated[
        list[str],
        typer.Argument(
            help="/dev/ttyACM0, socket:// or zmq://HOST:PORT, uhd:ARGS, replay:FILE, or "
            "twin:SCENE?system=NAME&radar=NAME&seed=N&pace=fast (NAME: also a file, or none) "
            "where the simulator is installed."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="New log (MCAP).")],
    settings: _Settings = None,
    radar_setup: _RadarSetup = None,
    rig: Annotated[
        Path | None, typer.Option(help="TOML file: NAME = [x, y, z, qw, qx, qy, qz] of a sensor.")
    ] = None,
    duration: Annotated[
        float, typer.Option(help="Seconds; default: until Ctrl-C.", parser=quantity_of("s"))
    ] = math.inf,
    records: Annotated[int, typer.Option(min=0, help="So many records; 0: no limit.")] = 0,
) -> None:
    """Record the data of sensors. Exit status 1: everything received was recorded, but a log among
    the sources is damaged.
    """
    from hardware.capture import capture as run
    from hardware.files import read_toml
    from hardware.interruption import asked_to_end
    from hardware.recording import Log
    from hardware.recording.reading import Ending

    loaded, setup = _settings(settings), _setup(radar_setup)
    extrinsics = read_toml(rig) if rig else {}
    extrinsics.pop("field_deg", None)  # of cameras, for `ugv process --motion radar`
    n, missed, begun = Counter[str](), Counter[str](), time.monotonic()
    endings: dict[str, Ending] = {}
    limits: dict[str, Any] = {"duration_s": duration, "records": records, "endings": endings}
    with asked_to_end() as over, Log(out, extrinsics=extrinsics) as log:
        incoming = run(urls, log, loaded, setup, over=over, **limits)
        try:
            for received in incoming:
                n[received.topic] += 1
                missed[received.topic] += _nothing_heard(received)
                say.step(f"{received.topic}: record {n[received.topic]}")
        finally:
            if over.is_set():
                say.line("stopped")
            took_s = time.monotonic() - begun
            say.verdict(f"{out}: {n.total()} records in {took_s:.1f} s")
            say.add(log=out, records=dict(n), seconds=took_s, stopped=over.is_set())
        if not n:
            raise InputError(f"{', '.join(urls)}: no record came")
    for topic in n:
        if missed[topic] == n[topic]:
            raise InputError(
                f"{out}: {topic}: every slot of its {n[topic]} records is overrun, nothing was "
                "heard: the bursts reach the radio after their time. Give the setup more time "
                "(schedule: step_period_s, lead_s), or serve a virtual radio with --pace fast"
            )
    _tell(say, {url.removeprefix("replay:").partition("?")[0]: end for url, end in endings.items()})


def process(
    say: Output,
    source: Annotated[str, typer.Argument(help="A log, or the URL of a sensor.")],
    *,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="New log; default SOURCE-processed.mcap.")
    ] = None,
    method: Annotated[str, typer.Option(help="See `ugv methods`; or file.py:function.")] = "lmmse",
    settings: _Settings = None,
    radar_setup: _RadarSetup = None,
    calibration: _Calibrations = [],  # noqa: B006 (typer copies it)
    max_age: _MaxAge = 30.0,
    records: Annotated[int, typer.Option(min=0, help="So many records; 0: no limit.")] = 0,
    false_alarm: FalseAlarm = None,
    cfar: CfarMethod = None,
    clutter_shape: ClutterShape = None,
    window: Window = None,
    resolve: Resolve = False,
    moving_only: MovingOnly = False,
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
    detection: DetectionOption = None,
) -> None:
    """Process records to images and detections; those of a radar as with `ugv detect`."""
    from hardware.calibration import CameraCalibration, RadarCalibration
    from hardware.commands.motions import motion_of
    from hardware.interruption import asked_to_end
    from hardware.motion_of_tracks import MotionOfTracks
    from hardware.processing import process as run
    from hardware.reconstruction import method_of
    from hardware.reconstruction.motion import Search
    from hardware.recording import Log
    from hardware.recording.reading import Ending
    from hardware.sliding_images import SlidingImages
    from hardware.tracks import RadarTracks

    by_radar = motion == "radar"
    radar_tracks = RadarTracks() if tracks or by_radar else None
    if rig and not by_radar:
        raise InputError("--rig: is for --motion radar")
    moved: Motion | Search | MotionOfTracks | None = None
    if by_radar:
        moved = _motion_of_tracks(source, rig)
    elif motion is not None:
        moved = motion_of(motion)
    if image_every and isinstance(moved, Search | MotionOfTracks):
        raise InputError(f"--motion: {motion}: needs whole sets, expected no --image-every")
    sliding = SlidingImages(image_every, moved) if image_every else None  # type: ignore[arg-type]
    calibrations = [_calibration(path, max_age) for path in calibration]
    camera = next((one for one in calibrations if isinstance(one, CameraCalibration)), None)
    radar = next((one for one in calibrations if isinstance(one, RadarCalibration)), None)
    how = processing(false_alarm, cfar, clutter_shape, window, resolve, moving_only, detection)
    solve = method_of(method)
    stem = Path(source.rpartition("/")[2].rpartition(":")[2]).stem or "records"
    target = out or Path(f"{stem}-processed.mcap")
    n, failed, ending = 0, False, Ending()
    start_ns: int | None = None
    results: list[dict[str, str]] = []
    # From a log, chunks are cut by their size alone: the same log gives the same bytes.
    flush_s = math.inf if _is_log(source) else 0.5
    with asked_to_end() as over, Log(target, flush_s=flush_s) as log:
        incoming = _records(source, settings, radar_setup, over, ending)
        for received in itertools.islice(incoming, records or None):
            if over.is_set():
                break
            try:
                outcome = run(
                    received,
                    log,
                    method=solve,
                    how=how,
                    camera=camera,
                    radar=radar,
                    tracks=radar_tracks,
                    sliding=sliding,
                    motion=moved,
                )
            except InputError as error:
                if not received.record.flags.any():
                    raise
                # Too little of this record arrived; the next one may be whole.
                failed = True
                say.warn(f"{received.topic}: not processed: {error}")
                continue
            n += 1
            say.step(f"processed record {n}, of {received.topic}")
            for warning in outcome.warnings:
                say.warn(f"{received.topic}: {warning}")
            start_ns = received.host_ns if start_ns is None else start_ns
            after_s = (received.host_ns - start_ns) / 1e9
            for line in outcome.lines:
                say.verdict(f"{received.topic}, {after_s:.3f} s: {line}")
            if say.json:
                results += [{"topic": received.topic, "result": line} for line in outcome.lines]
        if over.is_set():
            say.line("stopped")
        if not n:
            whole = "whole " if failed else ""
            raise InputError(f"{source}: no {whole}record in it{_because(ending)}")
    say.add(source=source, records=n, results=results)
    say.written(target)
    _tell(say, {source.removeprefix("replay:").partition("?")[0]: ending})


def replay(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log.")],
    speed: Annotated[float, typer.Option(help="Times the recorded pace.")] = 1.0,
) -> None:
    """Replay a log at its recorded pace, with one line for each record."""
    from hardware.recording.reading import Ending
    from hardware.sources import replay as play

    first_ns, ending = None, Ending()
    records: list[dict[str, Any]] = []
    for received in play(path, speed=speed, ending=ending):
        first_ns = received.host_ns if first_ns is None else first_ns
        since_s = (received.host_ns - first_ns) * 1e-9
        flags = _flag_counts(received.record.flags)
        told = ", ".join(f"{n} {name}" for name, n in flags.items())
        say.verdict(f"{since_s:10.3f} s  {received.topic}  {told}".rstrip())
        if say.json:
            records.append({"topic": received.topic, "time_s": since_s, "flags": flags})
    if first_ns is None:
        raise InputError(f"{path}: no record in it{_because(ending)}")
    say.add(log=path, records=records)
    _tell(say, {path: ending})


def info(say: Output, path: Annotated[Path, typer.Argument(help="A log.")]) -> None:
    """Print the contents of a log."""
    from hardware.recording.reading import Ending, read_messages, unpack_record
    from hardware.records import SpiRecord
    from hardware.records.spi import exposures_between

    ending, counts, types = Ending(), Counter[str](), dict[str, str]()
    flags, devices, times = Counter[str](), set[str](), [math.inf, -math.inf]
    missing, last = Counter[str](), dict[str, SpiRecord]()
    for logged in read_messages(path, ending):
        counts[logged.topic] += 1
        types[logged.topic] = logged.schema.name
        times = [min(times[0], logged.message.log_time), max(times[1], logged.message.log_time)]
        if received := unpack_record(path, logged):
            record = received.record
            flags.update(_flag_counts(record.flags))
            devices.add(record.device)
            if isinstance(record, SpiRecord):
                missing[logged.topic] += exposures_between(last.get(logged.topic), record)
                last[logged.topic] = record
    if ending.fault and not counts:
        raise InputError(f"{path}: no whole message in it: {ending.fault}")
    length_s = max(times[1] - times[0], 0) * 1e-9 if counts else 0.0
    say.verdict(f"{path}: {sum(counts.values())} messages over {length_s:.3f} s")
    for topic, n in sorted(counts.items()):
        say.line(f"  {topic}: {n} x {types[topic]}")
    for device in sorted(devices):
        say.line(f"  device: {device}")
    say.line("  flags: " + (", ".join(f"{n} {name}" for name, n in flags.items()) or "none"))
    for topic, n in sorted(missing.items()):
        if n:
            say.line(f"  missing: {n} exposures of {topic}, between its records")
    if ending.fault:
        say.verdict(f"  {ending.advice(path)}")
    say.add(
        log=path,
        duration_s=length_s,
        topics=[
            {"topic": topic, "messages": n, "type": types[topic], "missing": missing[topic]}
            for topic, n in sorted(counts.items())
        ],
        devices=sorted(devices),
        flags=flags,
        fault=ending.fault,
    )
    if ending.lost:
        raise typer.Exit(_DATA_LOST)


def recover(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log that was cut short.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Instead of in its own place.")
    ] = None,
) -> None:
    """Recover a log whose writer was killed, or that is damaged. Exit status 1: data were lost; the
    original file is then kept beside it.
    """
    from hardware.recording import recover as run

    result = run(path, out)
    fault = result.ending.fault
    say.verdict(f"{out or path}: {result.kept} messages; {fault or 'nothing was wrong'}")
    say.add(log=out or path, messages=result.kept, fault=fault, original=result.original)
    if result.original:
        say.line(f"as it was: {result.original}")
    if result.ending.lost:
        say.warn(f"{path}: {result.ending.lost}")
        raise typer.Exit(_DATA_LOST)


def export(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the SigMF recordings.")],
) -> None:
    """Write the radar records of a log as SigMF."""
    from hardware.recording import read_records
    from hardware.recording.reading import Ending
    from hardware.records import RadarRecord
    from hardware.records.sigmf import export_sigmf

    n, ending = 0, Ending()
    for received in read_records(path, ending):
        if isinstance(received.record, RadarRecord):
            out.mkdir(parents=True, exist_ok=True)
            export_sigmf(received.record, out / f"radar-{n:06d}")
            n += 1
    if not n:
        raise InputError(f"{path}: no radar record in it{_because(ending)}")
    say.verdict(f"{out}: {n} recordings")
    say.add(recordings=n, folder=out)
    _tell(say, {path: ending})


def calibrate_camera(
    say: Output,
    dark: Annotated[str, typer.Argument(help="Log or URL: the lens covered.")],
    flat: Annotated[str, typer.Argument(help="Log or URL: the target fills the view.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration to write (HDF5).")],
    distance: Annotated[float, typer.Option(help="Of the target, m.", parser=quantity_of("m"))],
    reflectance: Annotated[
        float, typer.Option(help="Of the target, Lambertian.", parser=quantity_of(None))
    ] = 1.0,
    settings: _Settings = None,
) -> None:
    """Dark and flat of a camera."""
    from hardware.calibration import CalibrationTarget, CameraCalibration, write_calibration
    from hardware.records import SpiRecord

    target = CalibrationTarget(distance, reflectance)
    pair = [_first(_records(source, settings), source, SpiRecord) for source in (dark, flat)]
    write_calibration(CameraCalibration.of(pair[0], pair[1], target), out)
    say.written(out)


def calibrate_radar(
    say: Output,
    source: Annotated[str, typer.Argument(help="Log or URL: the target in view.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration to write (HDF5).")],
    distance: Annotated[float, typer.Option(help="Of the target, m.", parser=quantity_of("m"))],
    cross_section: Annotated[
        float, typer.Option(help="Of the target, m^2.", parser=quantity_of("m^2"))
    ],
    radar_setup: _RadarSetup = None,
) -> None:
    """Range offset and power of a radar."""
    from hardware.calibration import CalibrationTarget, RadarCalibration, write_calibration
    from hardware.radar.process import process as processed
    from hardware.records import RadarRecord

    target = CalibrationTarget(distance, cross_section)
    record = _first(_records(source, None, radar_setup), source, RadarRecord)
    frame = processed(record)
    for warning in frame.warnings:
        say.warn(f"{source}: {warning}")
    result = RadarCalibration.of(record.device, frame.detections, target)
    write_calibration(result, out)
    say.verdict(f"range offset {si(result.range_offset_m, 'm')}")
    say.add(range_offset_m=result.range_offset_m)
    say.written(out)


def _records(
    source: str,
    settings: Path | None,
    radar_setup: Path | None = None,
    over: "threading.Event | None" = None,
    ending: "Ending | None" = None,
) -> "Iterator[Received]":
    from hardware.recording import read_records
    from hardware.sources import open_source

    if _is_log(source):
        return read_records(source, ending)
    return open_source(source, _settings(settings), _setup(radar_setup), over=over, ending=ending)


def _is_log(source: str) -> bool:
    return ":" not in source and source.endswith(".mcap")


def _motion_of_tracks(source: str, rig: Path | None) -> "MotionOfTracks":
    """For ``--motion radar``. Raises InputError for a log without records of both sensors, and
    where it is unknown how these are mounted.
    """
    from hardware.motion_of_tracks import MotionOfTracks
    from hardware.recording.mounting import (
        RADAR,
        SPI,
        Mounting,
        logged_mounting,
        read_mounting,
    )
    from hardware.recording.reading import Ending

    logged, path = Mounting(), source.removeprefix("replay:").partition("?")[0]
    given, ending = read_mounting(rig) if rig else Mounting(), Ending()
    if path.endswith(".mcap"):
        logged = logged_mounting(path, ending)
        for kind in (SPI, RADAR):
            if kind not in logged.records.values():
                name = kind.rpartition("/")[2]
                raise InputError(
                    f"{path}: --motion radar: no {name} in it{_because(ending)}, expected both "
                    "sensors"
                )
    mounting = Mounting(
        {**logged.poses, **given.poses},
        {**logged.fields_rad, **given.fields_rad},
        logged.records,
    )
    mounting.check()
    return MotionOfTracks(mounting)


def _because(ending: "Ending") -> str:
    return f" ({ending.fault})" if ending.fault else ""


def _tell(say: Output, endings: Mapping[str | Path, "Ending"]) -> None:
    """Warn of incomplete logs; where data are lost, exit with status 1."""
    for path, ending in endings.items():
        if ending.fault:
            say.warn(f"{path}: {ending.advice(path)}")
    if any(ending.lost for ending in endings.values()):
        raise typer.Exit(_DATA_LOST)


def _first(incoming: "Iterator[Received]", source: str, kind: type[_Kind]) -> _Kind:
    for received in incoming:
        if isinstance(received.record, kind):
            return received.record
    raise InputError(f"{source}: no {kind.__name__} in it")


def _settings(path: Path | None) -> "SpiSettings | None":
    from hardware.drivers.settings import read_settings

    return read_settings(path) if path else None


def _setup(path: Path | None) -> "tuple[Schedule, RadarFrontEnd] | None":
    from hardware.drivers.radio.setup import read_setup

    return read_setup(path) if path else None


def _calibration(path: Path, max_age_days: float) -> "Calibration":
    from hardware.calibration import read_calibration

    return read_calibration(path, max_age_s=86400 * max_age_days)


def _nothing_heard(received: "Received") -> bool:
    """Whether all slots of a radar's record are lost."""
    from hardware.records import Flag, RadarRecord

    record = received.record
    return isinstance(record, RadarRecord) and bool((record.flags & Flag.OVERRUN).all())


def _flag_counts(flags: object) -> dict[str, int]:
    import numpy as np

    from hardware.records import Flag

    counts = {str(f.name).lower(): int(np.count_nonzero(np.bitwise_and(flags, f))) for f in Flag}  # type: ignore[call-overload]
    return {name: n for name, n in counts.items() if n}
