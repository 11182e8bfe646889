"""BLAS with one thread, where matrices are small."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within it, or the function that it decorates, BLAS has one thread, unless
    ``OPENBLAS_NUM_THREADS`` says otherwise.

    Threads that wait for each other's part of a small product keep their cores busy: on a machine
    with other work a burst of 4096 x 256 took six times the processor time and seven times as long,
    least squares of 512 patterns of one's own with 32 x 32 cells eleven and eight times.
    """
    if os.environ.get("OPENBLAS_NUM_THREADS"):
        yield
        return
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        yield
