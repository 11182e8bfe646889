"""Compiled kernels: plain Python functions over NumPy arrays that numba compiles at the first call.

On the vehicle they are optional: beside each stands a NumPy path with equal results, taken where
numba is not installed or ``UGV_NUMBA=0`` is set. Compiled code is kept on disk, so only the first
run on a machine pays for the compilation.
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
def kernel(function: Callable[..., Any], *parts: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function, and ``parts``, the functions that it calls, with numba; importing numba
    takes half a second, once.

    Sums may be reordered to use vector instructions (not across NaN or infinity), which changes
    their last bits; division by zero is infinite, as in NumPy. Where no folder can be written, code
    is not kept.
    """
    import numba

    for part in parts:
        _callable(part)
    options = {"fastmath": {"reassoc", "contract"}, "error_model": "numpy"}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # numba: no locator available
        return numba.njit(function, **options)


@lru_cache(maxsize=32)
def _callable(function: Callable[..., Any]) -> None:
    """Let kernels call a function."""
    from numba.extending import register_jitable

    register_jitable(function)
