"""BLAS with one thread where matrices are small."""

import os

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from hardware.blas import one_blas_thread


def threads() -> set[int]:
    np.ones((2, 2)) @ np.ones((2, 2))
    return {
        library["num_threads"] for library in threadpool_info() if "blas" in library["user_api"]
    }


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="of one core BLAS has one thread anyway")
@pytest.mark.parametrize("said", [None, "2"])
def test_blas_has_one_thread_unless_the_user_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, said: str | None
) -> None:
    """And as many as before afterwards, after an error too."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", said or "")
    with threadpool_limits(2, user_api="blas"):
        with one_blas_thread():
            assert threads() == ({2} if said else {1})
        assert threads() == {2}
        with pytest.raises(ZeroDivisionError):
            one_blas_thread()(lambda: 1 / 0)()
        assert threads() == {2}
