"""Patterns from the fields of a record: Hadamard rows by their order, a user's own from arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import OwnPatterns, PatternSet, RasterScan


def patterns_from_record(
    *,
    order: str,
    digest: str = "",
    packed: NDArray[np.integer] | None = None,
    grey_levels: NDArray[np.integer] | None = None,
    **fields: Any,
) -> PatternSet | OwnPatterns | RasterScan:
    """Patterns of the fields of a record. Raises InputError for what does not fit together, and
    for a user's own patterns whose digest is not that of their content.
    """
    if order == "raster":
        count = fields.pop("count")
        scan = RasterScan(**fields)
        if scan.count != count:
            raise InputError(f"patterns: a scan of {scan.count} cells, expected {count}")
        return scan
    if order != "own":
        return PatternSet(order=order, **fields)  # type: ignore[arg-type]
    rows, columns, count, mode = (fields[n] for n in ("rows", "columns", "count", "mode"))
    if packed is not None:
        own = OwnPatterns.unpacked(packed, rows, columns, mode)
    elif grey_levels is not None and grey_levels.size == count * rows * columns:
        own = OwnPatterns(grey_levels.astype(np.uint16).reshape(count, rows, columns), mode)
    else:
        raise InputError(f"patterns: neither bits nor levels of {count} own patterns")
    if own.count != count:
        raise InputError(f"patterns: {own.count}, expected {count}")
    if own.digest != digest:
        raise InputError(f"patterns: their SHA-256 is {own.digest}, the record says {digest!r:.70}")
    return own
