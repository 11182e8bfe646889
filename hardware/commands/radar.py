"""The commands ``ugv detect``, ``image`` and ``spectrogram``: what a radar's record shows."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output, result_file, with_output
from hardware.commands.processing import MovingOnly, with_processing
from hardware.commands.quantities import quantity_of
from hardware.commands.records import calibration_of, naming, warn_of_damage
from hardware.errors import InputError
from hardware.formatting import counted, si

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from hardware.radar.burst import DemodulatedBurst
    from hardware.radar.settings import Processing
    from hardware.recording.ending import Ending
    from hardware.records import RadarRecord
    from hardware.waveform import OfdmWaveform

Record = Annotated[Path, typer.Argument(help="Record of a radar (HDF5).")]
MaxAge = Annotated[
    float,
    typer.Option(help="Age at which a calibration is refused, days.", parser=quantity_of("d")),
]


def register(app: typer.Typer) -> None:
    """Add the radar's commands."""
    for command in (with_processing(detect), image, spectrogram):
        app.command()(with_output(command, f"ugv {command.__name__}"))


def detect(
    say: Output,
    record: Record,
    *,
    how: "Processing",
    calibration: Annotated[
        Path | None, typer.Option(help="File that `ugv calibrate radar` wrote.")
    ] = None,
    max_age: MaxAge = 30.0,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write; default RECORD-detections.csv.")
    ] = None,
    png: Annotated[
        Path | None, typer.Option(help="PNG of the first range-Doppler map to write.")
    ] = None,
) -> None:
    """Detect targets: range, rate, angle, cross-section, each with its standard error. The
    cross-section is that of a target on the boresight: off it the antenna's gain makes it too low.
    """
    from hardware.calibration import RadarCalibration
    from hardware.processing import calibrated
    from hardware.radar.output import table_rows, write_detections, write_png
    from hardware.radar.process import frames
    from hardware.records import read_radar_record

    reference = calibration_of(say, calibration, max_age) if calibration else None
    if not (reference is None or isinstance(reference, RadarCalibration)):
        raise InputError(f"{calibration}: the calibration of a camera, expected a radar's")
    loaded, table = read_radar_record(record), []
    target = result_file(record, "-detections.csv", out, png)
    say.step(f"read {record}")
    shown = png
    with naming(record):
        for frame in frames(loaded, how):
            say.step(f"processed burst {frame.burst}")
            _warn(say, record, frame.warnings)
            detections = calibrated(frame, loaded, reference)
            say.verdict(f"{record}: burst {frame.burst}: {len(detections)} detections{frame.by}")
            for line in table_rows(detections) if detections else ():
                say.line(line)
            if shown:
                write_png(shown, frame.image.power_w)
                say.written(shown, " (range downwards, rate to the right)")
                shown = None
            table += [(frame.burst, detection) for detection in detections]
    say.add(
        record=record,
        detections=[{"burst": burst, **vars(detection)} for burst, detection in table],
    )
    write_detections(target, table)
    say.written(target)


def image(
    say: Output,
    record: Record,
    *,
    near: Annotated[
        float, typer.Option(help="Nearest down-range, m.", parser=quantity_of("m"))
    ] = 0.5,
    far: Annotated[
        float, typer.Option(help="Farthest down-range, m.", parser=quantity_of("m"))
    ] = 2.5,
    width: Annotated[
        float, typer.Option(help="Cross-range from edge to edge, m.", parser=quantity_of("m"))
    ] = 2.0,
    cells: Annotated[int, typer.Option(help="Cells along each side.")] = 200,
    wall: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Focus through a wall: distance, thickness (m), permittivity."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write; default RECORD-image.csv.")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="PNG to write.")] = None,
) -> None:
    """Image a scene from bursts along a track, by back-projection."""
    import numpy as np

    from hardware.radar.imaging import Wall
    from hardware.radar.imaging import image as focus
    from hardware.radar.output import write_image, write_png
    from hardware.records import read_radar_record

    if cells < 1 or not 0 <= near < far or not width > 0:
        raise InputError(
            f"image: {cells} cells from {near:g} to {far:g} m, {width:g} m wide: expected at least "
            "one cell, 0 m <= near < far, and a width above 0 m"
        )
    loaded = read_radar_record(record)
    target = result_file(record, "-image.csv", out, png)
    say.step(f"read {record}")
    with naming(record):
        focused = focus(
            loaded,
            np.linspace(near, far, cells),
            np.linspace(-width / 2, width / 2, cells),
            wall=Wall(*wall) if wall else None,
        )
    say.step("focused")
    _warn(say, record, focused.warnings)
    power = np.abs(focused.value) ** 2
    if not power.any():
        raise InputError(f"{record}: the image is all zero: expected bursts with signals")
    down, cross = np.unravel_index(np.argmax(power), power.shape)
    across_m = focused.cross_resolution_m
    across = f"{si(across_m, 'm')} cross-range (Eq. 6)" if np.isfinite(across_m) else "none across"
    say.line(
        f"{record}: {counted(focused.n_bursts, 'burst')}; resolution "
        f"{si(focused.down_resolution_m, 'm')} down-range (Eq. 7), {across}"
    )
    peak_dbm = 10 * np.log10(1e3 * power.max())
    down_m, cross_m = focused.down_range_m[down], focused.cross_range_m[cross]
    place = f"at {down_m:.3f} m, {cross_m:+.3f} m to the left"
    if not focused.shows_directions:
        place = f"at a range of {np.hypot(down_m, cross_m):.3f} m, in an unknown direction"
        down_m = cross_m = np.nan
    say.verdict(f"peak {peak_dbm:.1f} dBm {place}")
    say.add(
        record=record,
        bursts=focused.n_bursts,
        figures=[
            {"name": "resolution, down-range", "unit": "m", "value": focused.down_resolution_m},
            {"name": "resolution, cross-range", "unit": "m", "value": across_m},
            {"name": "peak", "unit": "dBm", "value": peak_dbm},
            {"name": "down-range of the peak", "unit": "m", "value": down_m},
            {"name": "cross-range of the peak", "unit": "m", "value": cross_m},
        ],
    )
    write_image(target, focused)
    say.written(target)
    if png:
        # As seen from above: far on top, left on the left.
        write_png(png, power[::-1, ::-1], span_db=25.0)
        say.written(png)


def spectrogram(
    say: Output,
    record: Annotated[Path, typer.Argument(help="Record of a radar (HDF5), or a log (MCAP).")],
    *,
    at: Annotated[
        float, typer.Option("--at", help="Range of the spectrogram, m.", parser=quantity_of("m"))
    ],
    span: Annotated[
        float,
        typer.Option(
            help="Width of the ranges around it, of which the strongest is used, m.",
            parser=quantity_of("m"),
        ),
    ] = 0.0,
    receding: Annotated[
        float,
        typer.Option(
            help="Rate at which that range grows from burst to burst.", parser=quantity_of("m/s")
        ),
    ] = 0.0,
    burst: Annotated[
        int | None,
        typer.Option(min=0, help="Show one burst; default: the first of a record, all of a log."),
    ] = None,
    window_slots: Annotated[
        int | None,
        typer.Option(help="Slots in a window within a burst; default: an eighth of it."),
    ] = None,
    moving_only: MovingOnly = False,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write; default RECORD-spectrogram.csv.")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="PNG to write.")] = None,
) -> None:
    """Micro-Doppler at one range: how range rates change within a burst, or over the bursts of a
    log, by the first antenna.
    """
    import numpy as np

    from hardware.radar import spectrogram as spectrogram_of
    from hardware.radar import spectrogram_of_intervals
    from hardware.radar.output import write_png, write_spectrogram
    from hardware.radar.spectrogram import FALSE_ALARM
    from hardware.recording.ending import Ending

    over_all = record.suffix == ".mcap" and burst is None
    if over_all and window_slots is not None:
        raise InputError("--window-slots: of a log each burst is one window: expected a --burst")
    if receding and not over_all:
        raise InputError("--receding: within one burst the range stays: expected a log, no --burst")
    wanted = None if over_all else burst or 0
    target = result_file(record, "-spectrogram.csv", out, png)
    ending = Ending()
    intervals = _intervals(say, record, wanted, moving_only, ending)
    with naming(record, ending):
        if over_all:
            seen = spectrogram_of_intervals(intervals, at, range_rate_m_per_s=receding, span_m=span)
            which = f"{len(seen.time_s)} bursts in {si(float(seen.time_s[-1]), 's')}"
        else:
            _, channel, waveform = next(intervals)
            seen = spectrogram_of(channel, waveform, at, window_slots, span_m=span)
            which = f"burst {wanted}"
    ridge = seen.ridge_m_per_s
    peak_dbm = 10 * np.log10(1e3 * seen.power_w.max()) if seen.power_w.any() else -np.inf
    heard = ridge[np.isfinite(ridge)]
    least, most = (heard.min(), heard.max()) if len(heard) else (np.nan, np.nan)
    shown = f"the strongest range rate goes from {least:+.3f} to {most:+.3f} m/s"
    if len(heard) < len(ridge):
        shown += f" in {len(heard)} of {len(ridge)} windows, the others show no echo"
    if not len(heard):
        chance = f"in {100 * FALSE_ALARM:g} % of spectrograms at most noise alone is stronger"
        shown = f"no echo is above the noise ({chance})"
    say.verdict(f"{record}: {which}: at {si(at, 'm')} {shown}; peak {peak_dbm:.1f} dBm")
    say.add(
        record=record,
        burst=wanted,
        figures=[
            {"name": "range", "unit": "m", "value": at},
            {"name": "strongest range rate, least", "unit": "m/s", "value": least},
            {"name": "strongest range rate, most", "unit": "m/s", "value": most},
            {"name": "peak", "unit": "dBm", "value": peak_dbm},
        ],
    )
    write_spectrogram(target, seen)
    say.written(target)
    if png:
        write_png(png, seen.power_w[::-1])
        say.written(png, " (time to the right, receding on top)")
    warn_of_damage(say, {record: ending})


def _intervals(
    say: Output, path: Path, burst: int | None, moving_only: bool, ending: "Ending"
) -> "Iterator[tuple[float, NDArray[np.complexfloating], OfdmWaveform]]":
    """Time of its middle, channel of the first antenna and waveform of a burst, or of all (None):
    then the waveform is that of a whole burst, of which a channel may hold fewer slots. How a log
    ends is put into ``ending``. Bursts are numbered through all records, in warnings too.
    """
    from dataclasses import replace

    import numpy as np

    from hardware.radar.clutter import without_static
    from hardware.radar.detection_warnings import ranges_of_a_spectrogram
    from hardware.radar.integrity import unusable_bursts

    n_bursts, is_first = 0, True
    for record in _radar_records(path, ending):
        unusable = unusable_bursts(record, moving_only=moving_only)
        for own in range(len(record.iq)):
            number, n_bursts = n_bursts, n_bursts + 1
            if burst not in (None, number):
                continue
            interval, why = _interval(record, own, unusable, over_all=burst is None)
            if interval is None and burst is not None:
                raise InputError(_renumbered(why, own, number))
            if interval is None:
                say.warn(f"{path}: left out: {_renumbered(why, own, number)}")
                continue
            _warn(say, path, [_renumbered(told, own, number) for told in interval.warnings])
            if is_first:
                _warn(say, path, ranges_of_a_spectrogram(interval))
                is_first = False
            channel = without_static(interval.channel) if moving_only else interval.channel
            waveform = interval.waveform
            if burst is None:
                n_transmitters = len(np.unique(record.transmitter))
                waveform = replace(waveform, n_slots=record.waveform.n_slots // n_transmitters)
            yield 1e-9 * interval.middle_ns, channel[0], waveform
            say.step(f"read burst {number} of {path}")
    if not n_bursts:
        raise InputError("no record of a radar in it")
    if burst is None and is_first:
        raise InputError("no burst of a radar in it that can be used")
    if burst is not None and burst >= n_bursts:
        raise InputError(f"--burst {burst}: it holds {n_bursts}, the first is 0")


def _interval(
    record: "RadarRecord", burst: int, unusable: dict[int, str], *, over_all: bool
) -> "tuple[DemodulatedBurst | None, str]":
    """A burst, or why there is none; ``over_all``: none that holds a part of the band alone."""
    from hardware.radar.burst import demodulate

    if burst in unusable:
        return None, unusable[burst]
    interval = demodulate(record, burst)
    n_subcarriers = len(record.carriers_hz) * record.waveform.n_subcarriers
    if over_all and interval.waveform.n_subcarriers < n_subcarriers:
        return None, f"{interval.warnings[0]}, less than the band of others"
    return interval, ""


def _renumbered(text: str, own: int, number: int) -> str:
    """What is told of a burst by its number within its record, by its number in a log."""
    return text.replace(f"burst {own}", f"burst {number}", 1)


def _radar_records(path: Path, ending: "Ending") -> "Iterator[RadarRecord]":
    """Of a file, or of all of a log, whose fault is put into ``ending``."""
    from hardware.recording import read_records
    from hardware.records import RadarRecord, read_radar_record

    if path.suffix != ".mcap":
        yield read_radar_record(path)
        return
    for received in read_records(path, ending):
        if isinstance(received.record, RadarRecord):
            yield received.record


def _warn(say: Output, record: Path, warnings: "Iterable[str]") -> None:
    for warning in warnings:
        say.warn(f"{record}: {warning}")
