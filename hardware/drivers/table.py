"""The pattern table as bytes, the same on both sides of the line."""

import numpy as np

from hardware.errors import InputError
from hardware.patterns import Mode, OwnPatterns, Patterns

_BLOCK = 1024


def table_bytes(patterns: Patterns) -> bytes:
    """One bit per cell, 1 lit, in the order of the exposures; each pattern begins a new byte.

    The first cell is the highest bit of the first byte; unused bits are 0. Raises InputError for
    patterns with grey levels, which no device of this protocol shows.
    """
    if isinstance(patterns, OwnPatterns):
        patterns.check_binary("a camera takes one bit per cell")
    blocks = range(0, patterns.n_exposures, _BLOCK)
    return b"".join(_packed(patterns, slice(at, at + _BLOCK)) for at in blocks)


def _packed(patterns: Patterns, exposures: slice) -> bytes:
    masks = patterns.masks(exposures)
    return np.packbits(masks.reshape(len(masks), -1), axis=1).tobytes()


def patterns_in(table: bytes, rows: int, columns: int, mode: Mode) -> OwnPatterns:
    """Patterns of a table that holds those of a user's own. Raises InputError where its exposures
    are not what the mode says: each pattern before its complement, both references first.
    """
    packed = np.frombuffer(table, np.uint8).reshape(-1, -(-rows * columns // 8))
    shown = OwnPatterns.unpacked(packed, rows, columns, "plain").levels
    if mode == "differential":
        shown = shown[0::2]
    elif mode == "reference":
        shown = shown[2:]
    patterns = OwnPatterns(shown, mode)
    if table_bytes(patterns) != table:
        raise InputError(f"patterns: the table is not one of mode {mode!r}")
    return patterns
