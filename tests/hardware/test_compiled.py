"""Kernels that numba compiles."""

import numpy as np
import pytest

from hardware.compiled import kernel


@pytest.mark.library("numba")
def test_kernels_run_where_no_folder_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container that runs with another user's files and without a home."""
    from numba.core.caching import CacheImpl

    def _twice(x: np.ndarray) -> np.ndarray:
        return 2 * x

    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    np.testing.assert_array_equal(kernel(_twice)(np.ones(3)), 2 * np.ones(3))
