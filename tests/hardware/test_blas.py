"""BLAS with one thread where matrices are small."""

import os

import numpy as np
import pytest
from spi_records import record_of, scene
from threadpoolctl import threadpool_info, threadpool_limits

from hardware import reconstruct
from hardware.blas import one_blas_thread
from hardware.patterns import PatternSet


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


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="of one core BLAS has one thread anyway")
def test_reconstruction_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of bundled methods and of a user's own."""
    seen = []

    def own(values, noise_variance, sensing):
        seen.append(threads())
        return sensing.adjoint(values)

    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "")
    patterns = PatternSet(8, 8, 64)
    record = record_of(patterns.masks().reshape(-1, 64) @ scene(8, 8).ravel(), patterns)
    with threadpool_limits(2, user_api="blas"):
        reconstruct(record, own)
        assert threads() == {2}
    assert seen
    assert all(each == {1} for each in seen)
