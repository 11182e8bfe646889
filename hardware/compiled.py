"""Optional acceleration by numba: looked for at the first call, never needed.

A kernel is a plain Python function over NumPy arrays that numba can compile. Beside each stands a
NumPy path with equal results, taken where numba is not installed or ``UGV_NUMBA=0`` is set.
Compiled code is kept on disk, so only the first run on a machine pays for the compilation.
"""

import importlib.util
import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any


@lru_cache(maxsize=1)
def available() -> bool:
    """Whether numba is installed and not switched off by ``UGV_NUMBA=0``."""
    return os.environ.get("UGV_NUMBA", "1") != "0" and bool(importlib.util.find_spec("numba"))


@lru_cache(maxsize=32)
def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function with numba; importing numba takes half a second, once.

    Sums may be reordered to use vector instructions (not across NaN or infinity), which changes
    their last bits.
    """
    import numba

    return numba.njit(function, cache=True, fastmath={"reassoc", "contract"})
