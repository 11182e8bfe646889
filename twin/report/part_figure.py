"""The spectral curve of a catalogue part: line, passband, responsivity, or sun."""

import numpy as np
from matplotlib.figure import Figure

from twin.files import InputError
from twin.optics.spectra import emitter_line, filter_shape
from twin.report.style import BLUE, ORANGE, new_figure
from twin.scene.clear_sky import clear_sun
from twin.system import Part
from twin.system.curves import read_responsivity


def plot_part(part: Part) -> Figure:
    """Curve over wavelength, with its shift with angle where that is known.

    Raises InputError for a part without a spectrum.
    """
    figure = new_figure((5.6, 3.2))
    axis = figure.subplots()
    if part.emitter:
        axis.plot(*emitter_line(part.emitter), color=BLUE)
        axis.set_ylabel("line, relative")
    elif part.filter:
        center, width = part.filter.center_wavelength_m.value, part.filter.width_m.value
        nm = np.linspace(center - 2 * width, center + 1.5 * width, 2001) * 1e9
        for angle, color in ((0.0, BLUE), (10.0, ORANGE)):
            shape = part.filter.transmission.value * filter_shape(part.filter, nm, angle)
            axis.plot(nm, shape, color=color, label=f"{angle:g} deg")
        axis.legend(frameon=False)
        axis.set_ylabel("transmission")
    elif part.detector:
        axis.plot(*read_responsivity(part.detector), color=BLUE)
        axis.set_ylabel("responsivity (A/W)")
    elif part.sky and part.sky.sun_elevation_deg:
        axis.plot(*clear_sun(part.sky.sun_elevation_deg.value), color=BLUE, lw=0.7)
        axis.set_ylabel("irradiance (W/m^2/nm)")
    else:
        raise InputError(f"part {part.name}: a {part.kind} of this kind has no spectral curve")
    axis.set_xlabel("wavelength (nm)")
    axis.set_title(part.description)
    return figure
