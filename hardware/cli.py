"""The command ``ugv``: what the vehicle does with its records. Errors are one line, exit code 2."""

import os
import sys

import typer

from hardware.commands import images, log, radar
from hardware.commands.output import CLOSED_PIPE, reader_left, version_option
from hardware.errors import HardwareError
from hardware.files import one_line, said

app = typer.Typer(
    name="ugv",
    help="Records from sensors, images and detections from records.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for room in (images, radar, log):
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
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
        sys.stdout.flush()
    except HardwareError as error:
        message = str(error)
    except SystemExit as error:  # commands return; a user's own code, and completion, do not
        if "_UGV_COMPLETE" in os.environ:
            raise
        if reader_left(error):
            sys.exit(CLOSED_PIPE)
        message = f"code of one's own called sys.exit({error})"
    except OSError as error:
        if reader_left(error):
            sys.exit(CLOSED_PIPE)
        message = said(error)
    except MemoryError as error:
        message = f"out of memory ({error})" if str(error) else "out of memory"
    except Exception as error:
        if not hasattr(error, "format_message"):  # how usage errors are told from faults
            raise
        message = error.format_message()
    except KeyboardInterrupt:
        print("ugv: interrupted", file=sys.stderr)
        sys.exit(130)
    else:
        sys.exit(code)
    print(f"ugv: error: {one_line(message)}", file=sys.stderr)
    sys.exit(2)
