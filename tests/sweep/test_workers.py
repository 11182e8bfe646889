"""Processes that compute a sweep's points."""

import subprocess
import sys

#: An end that closes nothing, as of a kill, with what a cluster holds meanwhile.
ENDED_EARLY = """
import multiprocessing, os
from twin.sweep.workers import _local

if __name__ == "__main__":
    with _local(1):
        held = multiprocessing.get_context("spawn").Lock()
        os._exit(130)
"""


def test_an_early_end_leaves_no_words_of_pythons_own(tmp_path) -> None:
    """Python's tracker had told of semaphores that it then removed, with a path of its source."""
    script = tmp_path / "ended.py"
    script.write_text(ENDED_EARLY)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "")
