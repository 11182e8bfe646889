"""What a command line ends with: expected errors are one line and exit code 2."""

import os
import sys
from typing import Any, NoReturn

from hardware.commands.output import CLOSED_PIPE, reader_left
from hardware.files import one_line, said


def outcome(app: Any, program: str, expected: type[Exception]) -> int | str | None:
    """Run the command of ``sys.argv``: its exit code, or what an expected error says.

    NumPy is not yet loaded, and BLAS gets one thread unless the user says otherwise: matrices are
    small, and threads that wait for each other took four times the CPU time on a busy machine.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        code: int | None = app(sys.argv[1:] or ["--help"], standalone_mode=False)
        sys.stdout.flush()
        return code
    except expected as error:
        return str(error)
    except SystemExit as error:  # commands return; a user's own code, and completion, do not
        if f"_{program.upper()}_COMPLETE" in os.environ:
            raise
        return CLOSED_PIPE if reader_left(error) else f"code of one's own called sys.exit({error})"
    except OSError as error:
        return CLOSED_PIPE if reader_left(error) else said(error)
    except MemoryError as error:
        return f"out of memory ({error})" if str(error) else "out of memory"
    except Exception as error:
        if not hasattr(error, "format_message"):  # how usage errors are told from faults
            raise
        return str(error.format_message())


def leave(program: str, ended: int | str | None) -> NoReturn:
    """Exit as `outcome` says."""
    if isinstance(ended, str):
        print(f"{program}: error: {one_line(ended)}", file=sys.stderr)
        sys.exit(2)
    sys.exit(ended)
