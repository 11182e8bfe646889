"""What other processes make in tests; they import this module alone."""

import os
import signal
import time

from twin.files import InputError


def reciprocal(number: int) -> float:
    """1 / (3 - number), where 2 is a fault of the user and 3 one of the engine."""
    if number == 2:
        raise InputError("scene.toml: wrong")
    return 1 / (3 - number)


def with_process(number: int, word: str) -> tuple[int, str, int]:
    """What it is made of, and by which process; some take a moment."""
    if word == "slow":
        time.sleep(0.3)
    return number, word, os.getpid()


def dies(number: int) -> None:
    os._exit(1)


def leaves_ctrl_c(number: int) -> bool:
    """Whether this process leaves Ctrl-C to its parent."""
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
