"""The command ``twin``: interrupted while it is still being loaded, it ends in one line as well."""

import os
import signal
from types import FrameType


def main() -> None:
    """Load the command line and run it."""
    signal.signal(signal.SIGINT, _end_at_once)
    from twin.cli import main as command

    command()


def _end_at_once(number: int, frame: FrameType | None) -> None:
    os.write(2, b"twin: interrupted, nothing half-written is left\n")
    os._exit(130)


if __name__ == "__main__":
    main()
