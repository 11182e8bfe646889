"""Style of figures and numbers; colour-blind safe colours (Okabe and Ito)."""

import textwrap

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


def wrapped(title: str, width: int = 40) -> str:
    """A title in lines that stay within a panel about 3 inches wide."""
    return "\n".join(textwrap.wrap(title, width))
