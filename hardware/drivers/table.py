"""The pattern table as bytes, the same on both sides of the line."""

import numpy as np

from hardware.patterns import PatternSet

_BLOCK = 1024


def table_bytes(patterns: PatternSet) -> bytes:
    """One bit per cell, 1 lit, in the order of the exposures; each pattern begins a new byte.

    The first cell is the highest bit of the first byte; unused bits are 0.
    """
    blocks = range(0, patterns.n_exposures, _BLOCK)
    return b"".join(_packed(patterns, slice(at, at + _BLOCK)) for at in blocks)


def _packed(patterns: PatternSet, exposures: slice) -> bytes:
    masks = patterns.masks(exposures)
    return np.packbits(masks.reshape(len(masks), -1), axis=1).tobytes()
