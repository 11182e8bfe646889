"""Records that a command takes, from a log or from a sensor, and what it tells of a damaged log."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from hardware.commands.output import Output
from hardware.errors import InputError

if TYPE_CHECKING:
    import threading

    from hardware.calibration import Calibration
    from hardware.drivers import SpiSettings
    from hardware.drivers.radio import Schedule
    from hardware.recording import Received
    from hardware.recording.ending import Ending
    from hardware.records import RadarFrontEnd

#: Exit status of a command that succeeded on the intact part of a damaged log.
DATA_LOST = 1
#: Exit status of a command that a signal ended before what was asked for had come.
STOPPED_EARLY = 1
Settings = Annotated[
    Path | None, typer.Option("--settings", help="TOML file: patterns and times of a camera.")
]
RadarSetup = Annotated[
    Path | None, typer.Option("--radar-setup", help="JSON file: schedule and front end of a radio.")
]


def records_of(
    source: str,
    settings: Path | None,
    radar_setup: Path | None = None,
    over: "threading.Event | None" = None,
    ending: "Ending | None" = None,
) -> "Iterator[Received]":
    """Records of a log, or of a sensor by its URL, until ``over`` is set; how a log ends is put
    into ``ending``.
    """
    from hardware.recording import read_records
    from hardware.sources import open_source

    if is_log(source):
        return read_records(source, ending)
    camera, radio = settings_of(settings), setup_of(radar_setup)
    return open_source(source, camera, radio, over=over, ending=ending)


def is_log(source: str) -> bool:
    """Whether a source is a log, not the URL of a sensor."""
    return ":" not in source and source.endswith(".mcap")


def log_of(source: str) -> str:
    """Path of a log that is read or, by its URL, replayed."""
    return source.removeprefix("replay:").partition("?")[0]


def settings_of(path: Path | None) -> "SpiSettings | None":
    """Settings of a camera. Raises InputError."""
    from hardware.drivers.settings import read_settings

    return read_settings(path) if path else None


def setup_of(path: Path | None) -> "tuple[Schedule, RadarFrontEnd] | None":
    """Schedule and front end of a radio. Raises InputError."""
    from hardware.drivers.radio.setup import read_setup

    return read_setup(path) if path else None


def calibration_of(say: Output, path: Path, max_age_days: float) -> "Calibration":
    """A calibration from its file; what was wrong with it is told again. Raises InputError."""
    from hardware.calibration import read_calibration

    calibration = read_calibration(path, max_age_s=86400 * max_age_days)
    for warning in calibration.warnings:
        say.warn(f"{path}: calibration: {warning}")
    return calibration


def flag_counts(flags: object) -> dict[str, int]:
    """Number of exposures or slots with each flag that any has."""
    import numpy as np

    from hardware.records import Flag

    counts = {str(f.name).lower(): int(np.count_nonzero(np.bitwise_and(flags, f))) for f in Flag}  # type: ignore[call-overload]
    return {name: n for name, n in counts.items() if n}


@contextmanager
def naming(source: str | Path, ending: "Ending | None" = None) -> Iterator[None]:
    """Name a file or log in an InputError that does not, with what is wrong with the log."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{source}: "):
            raise
        fault = fault_in_brackets(ending) if ending else ""
        raise InputError(f"{source}: {error}{fault}") from error


def fault_in_brackets(ending: "Ending") -> str:
    """Why a log may hold less than is asked for; empty where it is whole."""
    return f" ({ending.fault})" if ending.fault else ""


def warn_of_damage(say: Output, endings: "Mapping[str | Path, Ending]") -> None:
    """Warn of incomplete logs; where data are lost, exit with `DATA_LOST`."""
    for path, ending in endings.items():
        if ending.fault:
            say.warn(f"{path}: {ending.advice(path)}")
    if any(ending.lost for ending in endings.values()):
        raise typer.Exit(DATA_LOST)


def end_early(say: Output, reached: str) -> NoReturn:
    """Warn that a signal ended the command before its limit; exit with `STOPPED_EARLY`."""
    say.warn(f"stopped by a signal after {reached}")
    raise typer.Exit(STOPPED_EARLY)
