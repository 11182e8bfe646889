"""Charts of the page as data: what its script draws, pans and zooms.

A chart has an image (levels of 8 bits with their axes), layers of marks and lines, and its axes'
names; the script of ``charts.js`` draws them in the colours of the page's scheme.
"""

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Chart = dict[str, Any]

_DIGITS = 6
#: Colours of levels, from least to greatest, each as red, green and blue of 8 bits: 17 of the map
#: `cividis` (Nunez et al., PLOS ONE 2018, doi 10.1371/journal.pone.0199239), as Matplotlib has it.
HEAT = (
    (0, 34, 77),
    (0, 45, 105),
    (26, 56, 111),
    (49, 67, 108),
    (67, 78, 107),
    (82, 89, 108),
    (97, 100, 111),
    (110, 112, 115),
    (124, 123, 120),
    (139, 135, 120),
    (155, 147, 118),
    (171, 160, 114),
    (187, 173, 108),
    (204, 187, 99),
    (222, 201, 87),
    (239, 216, 70),
    (253, 231, 55),
)


def axis(name: str, low: float, high: float) -> dict[str, Any]:
    """An axis and the span of it that is shown at first."""
    return {"name": name, "low": _plain(low), "high": _plain(high)}


def raster(
    levels: Array,
    x: tuple[float, float],
    y: tuple[float, float],
    low: float,
    high: float,
    unit: str,
    *,
    colours: str = "heat",
    name: str = "",
) -> dict[str, Any]:
    """An image (rows, columns), row 0 at ``y[0]``, column 0 at ``x[0]``, both at the outer borders.

    Levels from ``low`` to ``high`` become 1 to 255; NaN becomes 0, which is not drawn.
    """
    span = high - low if high > low else 1.0
    scaled = np.clip((levels - low) / span, 0, 1)
    bytes_ = np.where(np.isnan(scaled), 0, 1 + np.round(254 * np.nan_to_num(scaled)))
    return {
        "rows": levels.shape[0],
        "columns": levels.shape[1],
        "data": base64.b64encode(bytes_.astype(np.uint8).tobytes()).decode(),
        "x": [_plain(v) for v in x],
        "y": [_plain(v) for v in y],
        "low": _plain(low),
        "high": _plain(high),
        "unit": unit,
        "colours": colours,
        "name": name,
    }


def layer(
    name: str,
    x: Any,
    y: Any,
    *,
    mark: str = "line",
    colour: str = "blue",
    labels: Sequence[str] = (),
    texts: Sequence[str] = (),
    levels: Any = (),
    errors: tuple[Any, Any] | None = None,
    dashed: bool = False,
    off: bool = False,
) -> dict[str, Any]:
    """Marks or lines of one kind, a line of the legend.

    ``mark``: line (NaN parts it), area, ring, plus, cross, dot or diamond. ``labels`` stand beside
    the marks where there is room, ``texts`` are shown under the pointer; ``levels`` from 0 to 1 set
    colours of their own. ``errors``: half-widths along x and y. ``off``: hidden at first.
    """
    return {
        "name": name,
        "x": numbers(x),
        "y": numbers(y),
        "mark": mark,
        "colour": colour,
        "labels": list(labels),
        "texts": list(texts),
        "levels": numbers(levels),
        "errors": [numbers(e) for e in errors] if errors else None,
        "dashed": dashed,
        "off": off,
    }


def numbers(values: Any) -> list[float | None]:
    """Rounded to a few digits, None for NaN."""
    return [_plain(value) for value in np.asarray(values, dtype=np.float64).ravel()]


def _plain(value: float) -> float | None:
    value = float(value)
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
