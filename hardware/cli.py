"""The command ``ugv``: what the vehicle does with its records. Errors are one line, exit code 2."""

import sys

import typer

from hardware.commands import images, log, radar
from hardware.errors import HardwareError
from hardware.files import one_line, said

app = typer.Typer(
    name="ugv",
    help="Records from sensors, images and detections from records.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for room in (images, radar, log):
    room.register(app)


@app.callback()
def _ugv() -> None:
    """Records from sensors, images and detections from records."""


def main() -> None:
    """Entry point: run a command, turn expected errors into one line and exit code 2."""
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except HardwareError as error:
        message = str(error)
    except SystemExit as error:  # commands return; only a user's own code ends the program
        message = f"code of one's own called sys.exit({error})"
    except OSError as error:
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
