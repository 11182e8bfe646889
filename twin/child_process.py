"""Processes started by this one: they end with it, and leave Ctrl-C to it."""

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from twin.errors import EngineError, InputError

SPAWN = multiprocessing.get_context("spawn")


def start_process(target: Callable[..., None], *args: Any) -> SpawnProcess:
    """Run ``target(*args)`` in a new process.

    Ctrl-C goes to all processes of a terminal: it is left to this one. The new process ends at once
    when this one has ended, however it ends. Raises what pickling the arguments raises, OSError.
    """
    resource_tracker.ensure_running()  # first, since it lifts what is blocked
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process = SPAWN.Process(target=_until_parent_ends, args=(target, args), daemon=True)
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return process


def attempt(call: Callable[..., Any], *args: Any) -> tuple[Any, Exception | None]:
    """What a call gives, or the error to raise in the parent process: InputError, EngineError and
    MemoryError as they are, an EngineError in place of all others, not all of which can be pickled.
    """
    try:
        return call(*args), None
    except (InputError, EngineError, MemoryError) as error:
        return None, error
    except SystemExit as error:
        return None, EngineError(f"code of one's own called sys.exit({error})")
    except Exception as error:
        return None, EngineError(f"{type(error).__name__}: {error}")


class Helper:
    """A process that makes one call while this one does something else.

    As all processes of `multiprocessing` it loads the script that starts it: there it is started
    under ``if __name__ == "__main__":``, and not from a script on standard input.

    Parameters
    ----------
    module
        Imported there at once, while nothing is asked yet.
    """

    def __init__(self, module: str) -> None:
        self._line, theirs = SPAWN.Pipe()
        self._process = start_process(_help, theirs, module)
        self._free = True
        theirs.close()

    def ask(self, call: Callable[..., Any], *args: Any) -> bool:
        """Have ``call(*args)`` made; False, and nothing is done, where it can't be pickled,
        or after another call or `close`.
        """
        if not self._free:
            return False
        try:
            asked = pickle.dumps((call, args), protocol=pickle.HIGHEST_PROTOCOL)
        except Exception:  # whatever a user's own part raises
            return False
        self._free = False
        try:
            self._line.send_bytes(asked)
        except OSError:
            raise self._died() from None
        return True

    def answer(self) -> Any:
        """What the call gives. Raises what the call raises, see `attempt`; EngineError where the
        process has died.
        """
        try:
            found, error = self._line.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if error:
            raise error
        return found

    def close(self) -> None:
        """End the process; any number of times."""
        self._free = False
        self._line.close()

    def _died(self) -> EngineError:
        self._process.join(1.0)
        code = self._process.exitcode
        if code is not None and code < 0:
            how = f": ended by {signal.Signals(-code).name}"
            how += ", for want of memory maybe" * (code == -signal.SIGKILL)
        else:
            how = "" if code is None else f": exit status {code}"
        return EngineError(f"a process started by this one has died{how}")


def _help(line: Connection, module: str) -> None:
    import_module(module)
    try:
        call, args = pickle.loads(line.recv_bytes())
        line.send(attempt(call, *args))
    except (EOFError, OSError):
        pass


def _until_parent_ends(target: Callable[..., None], args: tuple[Any, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    target(*args)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(0)
