"""Whole commands, as a user waits for them."""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.timing import Figure, timed_command


def figures() -> Iterator[Figure]:
    """Start-up, and the main job with everything warm."""
    python = sys.executable
    yield "import hardware", timed_command([python, "-c", "import hardware"]), ""
    yield "twin --help", timed_command([python, "-m", "twin", "--help"]), ""
    with tempfile.TemporaryDirectory() as folder:
        command = [python, "-m", "twin", "run", "yard", "--out", str(Path(folder) / "out")]
        yield (
            "twin run scenes/yard, optics (two systems) and radar, warm",
            timed_command(command, runs=3),
            "",
        )
