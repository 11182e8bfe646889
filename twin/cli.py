"""The command ``twin``. Errors are one line and exit code 2; nothing half-written stays behind."""

import faulthandler
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import CodeType, FrameType

import typer

from hardware.commands.entry import leave, outcome
from hardware.commands.output import version_option, with_output
from twin import __version__
from twin.commands import catalogue, driving, figures, scenes, serving, studies, with_stages
from twin.progress import continued, interrupts

_TELL = sys.unraisablehook
_DELAY_S = 0.1
_MOST_DELAYS = 100

app = typer.Typer(
    name="twin",
    help="Digital twin of a vehicle's single-pixel camera and radar.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for command in (
    scenes.run,
    scenes.check,
    studies.trade,
    studies.sweep,
    studies.show,
    driving.drive,
    figures.budget,
    figures.safety,
    figures.rcs,
    catalogue.systems,
    catalogue.parts,
):
    app.command()(with_output(command, f"twin {command.__name__}", during=with_stages))
app.command("import")(with_output(scenes.import_, "twin import"))
app.command()(with_output(serving.serve, "twin serve", has_json=False, during=with_stages))
app.command()(catalogue.schema)


@app.callback()
def _twin(version: version_option("twin", lambda: __version__) = False) -> None:  # type: ignore[valid-type]
    """Digital twin of a vehicle's single-pixel camera and radar."""


def main() -> None:
    """Entry point: run a command, turn expected errors into one line and exit code 2."""
    from twin.errors import TwinError

    if sys.__stderr__ and not faulthandler.is_enabled():
        faulthandler.enable(sys.__stderr__)  # says where in the twin a library crashed
    sys.unraisablehook = _again_if_lost
    ended: int | str | None = None
    try:
        signal.signal(signal.SIGINT, _interrupt)
        signal.signal(signal.SIGTERM, _interrupt)
        ended = outcome(app, "twin", TwinError)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("twin", "hardware"):
            raise
        ended = f"{error}; the simulator's libraries: pip install 'ugv-twin[twin]'"
    except KeyboardInterrupt:
        pass
    except Exception:
        if not interrupts:
            raise
    if interrupts:
        there = [f"the same command continues {path}" for path in continued if path.exists()]
        print("twin: interrupted,", *there or ["nothing half-written is left"], file=sys.stderr)
        sys.stderr.flush()
        os._exit(130)  # threads of a library that was still loading would abort an orderly exit
    leave("twin", ended)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Remember the signal: libraries in between may turn the exception into another one.

    While a module is being loaded the signal is sent again a little later, for some ten seconds at
    most: an exception that passes through a compiled library's registration aborts the process.
    One that comes when the command has already ended for an earlier one changes nothing.
    """
    interrupts.append(number)
    if len(interrupts) > 1 and not _runs_the_command(frame):
        return
    if len(interrupts) > _MOST_DELAYS or not _loads_a_module(frame):
        raise KeyboardInterrupt
    _send_again(number)


def _loads_a_module(frame: FrameType | None) -> bool:
    loader = "<frozen importlib._bootstrap>"
    return any(code.co_filename == loader for code in _codes(frame))


def _runs_the_command(frame: FrameType | None) -> bool:
    return outcome.__code__ in _codes(frame)


def _codes(frame: FrameType | None) -> Iterator[CodeType]:
    while frame is not None:
        yield frame.f_code
        frame = frame.f_back


def _again_if_lost(lost: "sys.UnraisableHookArgs") -> None:
    """An exception that compiled code could not pass on: an interrupt is sent again."""
    if isinstance(lost.exc_value, KeyboardInterrupt):
        _send_again(signal.SIGINT)
    else:
        _TELL(lost)


def _send_again(number: int) -> None:
    again = threading.Timer(_DELAY_S, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()
