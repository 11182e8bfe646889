"""The commands ``ugv calibrate camera`` and ``radar``, against a target at a known distance."""

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.quantities import quantity_of
from hardware.commands.records import (
    RadarSetup,
    Settings,
    is_log,
    log_of,
    naming,
    records_of,
    warn_of_damage,
)
from hardware.errors import InputError
from hardware.formatting import with_error

if TYPE_CHECKING:
    from hardware.radar.process import Frame
    from hardware.recording import Received
    from hardware.records import RadarRecord

_Record = TypeVar("_Record")


def register(app: typer.Typer) -> None:
    """Add the commands to an application."""
    calibrate = typer.Typer(help="Calibrate against a reference target at a known distance.")
    for name, command in (("camera", calibrate_camera), ("radar", calibrate_radar)):
        calibrate.command(name)(with_output(command, f"ugv calibrate {name}"))
    app.add_typer(calibrate, name="calibrate")


def calibrate_camera(
    say: Output,
    dark: Annotated[str, typer.Argument(help="Log or URL: the lens covered.")],
    flat: Annotated[str, typer.Argument(help="Log or URL: the target fills the view.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration to write (HDF5).")],
    distance: Annotated[float, typer.Option(help="Of the target, m.", parser=quantity_of("m"))],
    reflectance: Annotated[
        float, typer.Option(help="Of the target, Lambertian.", parser=quantity_of(None))
    ] = 1.0,
    settings: Settings = None,
) -> None:
    """Dark and flat of a camera."""
    from hardware.calibration import CalibrationTarget, CameraCalibration, write_calibration
    from hardware.records import SpiRecord

    _check_positive(distance=distance, reflectance=reflectance)
    target = CalibrationTarget(distance, reflectance)
    pair = [_first(records_of(source, settings), source, SpiRecord) for source in (dark, flat)]
    result = CameraCalibration.of(pair[0], pair[1], target, (dark, flat))
    for warning in result.warnings:
        say.warn(warning)
    write_calibration(result, out)
    say.written(out)


def calibrate_radar(
    say: Output,
    source: Annotated[str, typer.Argument(help="Log or URL: the target in view.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Calibration to write (HDF5).")],
    distance: Annotated[float, typer.Option(help="Of the target, m.", parser=quantity_of("m"))],
    cross_section: Annotated[
        float, typer.Option(help="Of the target, m^2.", parser=quantity_of("m^2"))
    ],
    radar_setup: RadarSetup = None,
) -> None:
    """Range offset and two-way gain of a radar, from all bursts of a log or the first record of a
    sensor.
    """
    from hardware.calibration import CalibrationTarget, RadarCalibration, write_calibration
    from hardware.recording.ending import Ending

    _check_positive(distance=distance, cross_section=cross_section)
    target = CalibrationTarget(distance, cross_section)
    ending = Ending()
    incoming = records_of(source, None, radar_setup, ending=ending)
    bursts = _bursts(say, source, incoming, None if is_log(source) else 1)
    with naming(source, ending):
        result = RadarCalibration.of(bursts, target)
    for warning in result.warnings:
        say.warn(f"{source}: {warning}")
    write_calibration(result, out)
    offset = with_error(result.range_offset_m, result.range_offset_error_m, "m")
    gain = with_error(result.two_way_gain_db, result.two_way_gain_error_db, "dB")
    more_db = result.two_way_gain_db - 2 * result.antenna_gain_dbi + result.losses_db
    than = f", {abs(more_db):.2f} dB {'less' if more_db < 0 else 'more'} than the record declares"
    say.verdict(
        f"range offset {offset}; two-way gain {gain}{than if math.isfinite(more_db) else ''}"
    )
    say.add(
        range_offset_m=result.range_offset_m,
        range_offset_error_m=result.range_offset_error_m,
        two_way_gain_db=result.two_way_gain_db,
        two_way_gain_error_db=result.two_way_gain_error_db,
    )
    say.written(out)
    warn_of_damage(say, {log_of(source): ending})


def _bursts(
    say: Output, source: str, incoming: "Iterator[Received]", records: int | None
) -> "Iterator[tuple[int, RadarRecord, Frame]]":
    """Number of its record, record and what it shows of the bursts of so many radar records, of
    all: None.
    """
    from hardware.radar.integrity import UnusableBurstError
    from hardware.radar.process import frames
    from hardware.records import RadarRecord

    found = (
        (each.number, each.record) for each in incoming if isinstance(each.record, RadarRecord)
    )
    for count, (of_log, record) in enumerate(itertools.islice(found, records), 1):
        number = of_log or count
        try:
            for frame in frames(record):
                yield number, record, frame
        except UnusableBurstError as error:
            say.warn(f"{source}: record {number}: left out: {error}")


def _check_positive(**options: float) -> None:
    """Raise InputError naming the first option that is not above 0."""
    for name, value in options.items():
        if not value > 0:
            raise InputError(f"--{name.replace('_', '-')}: {value:g}, expected a number above 0")


def _first(incoming: "Iterator[Received]", source: str, kind: type[_Record]) -> _Record:
    for received in incoming:
        if isinstance(received.record, kind):
            return received.record
    raise InputError(f"{source}: no {kind.__name__} in it")
