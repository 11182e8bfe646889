"""Cross-section over azimuth: as a polar and as a Cartesian plot."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from twin.radar.cross_section import Sweep
from twin.report.style import BLUE, new_figure

_DEPTH_DB = 60.0  # below the largest value, what is drawn


def plot_rcs(sweep: Sweep, title: str) -> Figure:
    """Both plots in one figure, in dBsm, cut off 60 dB below the largest value."""
    values = sweep.cross_section_dbsm
    top = float(np.max(values)) if np.isfinite(values).any() else 0.0
    drawn = np.maximum(values, top - _DEPTH_DB)
    figure = new_figure((9.0, 4.0))
    polar = figure.add_subplot(1, 2, 1, projection="polar")
    assert isinstance(polar, PolarAxes)
    polar.plot(np.radians(sweep.azimuth_deg), drawn, color=BLUE, lw=0.9)
    polar.set_rlim(top - _DEPTH_DB, 5 * np.ceil(top / 5))
    polar.set_title("RCS (dBsm), radar at azimuth")
    flat = figure.add_subplot(1, 2, 2)
    flat.plot(sweep.azimuth_deg, drawn, color=BLUE, lw=0.9)
    flat.set_xlabel("azimuth (deg)")
    flat.set_ylabel("RCS (dBsm)")
    flat.set_ylim(top - _DEPTH_DB, top + 3)
    flat.set_title(f"at most {top:.1f} dBsm, at {sweep.azimuth_deg[np.argmax(values)]:g} deg")
    figure.suptitle(title)
    return figure
