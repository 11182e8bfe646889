"""The command ``ugv``: what the vehicle does with its records. Errors are one line, exit code 2."""

import sys

import typer

from hardware.commands import calibrate, capture, images, log, process, radar
from hardware.commands.entry import leave, outcome
from hardware.commands.output import version_option
from hardware.errors import HardwareError

app = typer.Typer(
    name="ugv",
    help="Records from sensors, images and detections from records.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for room in (images, radar, capture, process, log, calibrate):
    room.register(app)


def _version() -> str:
    from importlib.metadata import version

    return version("ugv-twin")


@app.callback()
def _ugv(version: version_option("ugv", _version) = False) -> None:  # type: ignore[valid-type]
    """Records from sensors, images and detections from records."""


def main() -> None:
    """Entry point: run a command, turn expected errors into one line and exit code 2."""
    try:
        ended = outcome(app, "ugv", HardwareError)
    except KeyboardInterrupt:
        print("ugv: interrupted", file=sys.stderr)
        sys.exit(130)
    leave("ugv", ended)
