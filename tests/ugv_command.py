"""The command ``ugv``, as a user runs it."""

import subprocess
import sys
from typing import Any

#: A camera's settings: 8 x 8 cells in 13 ms.
SETTINGS = """
integration_time_s = 1e-5
pattern_period_s = 1e-4
[patterns]
rows = 8
columns = 8
count = 64
"""


def started(*arguments: object, **options: Any) -> "subprocess.Popen[str]":
    """At its work; what it says can be read."""
    command = [sys.executable, "-m", "hardware", *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **pipes, **options)


def ugv(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Its exit status and what it said."""
    process = started(*arguments)
    try:
        said = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    return subprocess.CompletedProcess(process.args, process.returncode, *said)
