"""Processes that compute a sweep's points."""

import signal
import subprocess
import sys

from twin.workers import dask

#: An end that closes nothing, as of a kill, with what a cluster holds meanwhile.
ENDED_EARLY = """
import multiprocessing, os
from twin.workers import _local, _loop

if __name__ == "__main__":
    with _loop() as loop, _local(1, loop):
        held = multiprocessing.get_context("spawn").Lock()
        os._exit(130)
"""


def test_an_early_end_leaves_no_words_of_pythons_own(tmp_path) -> None:
    """Python's tracker had told of semaphores that it then removed, with a path of its source."""
    script = tmp_path / "ended.py"
    script.write_text(ENDED_EARLY)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "")


def test_ctrl_c_in_a_terminal_reaches_the_main_process_alone() -> None:
    """It goes to all processes of the terminal; workers that still imported printed a trace."""
    with dask(None, 2) as submit:
        masks = [submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()) for _ in range(8)]
        assert all(signal.SIGINT in submit.result(mask) for mask in masks)
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
