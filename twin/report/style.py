"""Style of figures and numbers; colour-blind safe colours (Okabe and Ito)."""

import math

from matplotlib.figure import Figure

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#8a8f98"
_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "white",
}


def new_figure(size: tuple[float, float]) -> Figure:
    """An empty figure, size in inches."""
    import matplotlib as mpl

    mpl.rcParams.update(_STYLE)
    return Figure(figsize=size, dpi=120)


def si(value: float, unit: str) -> str:
    """Number with an SI prefix, three significant digits."""
    from matplotlib.ticker import EngFormatter

    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))) % 3)
    return str(EngFormatter(unit=unit, places=digits)(value))
