"""Means over the detector's field: light of a wall, and what the filter passes of it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.budget.link import Number, OpticalLink
from twin.budget.table1 import detector_of, link_of
from twin.errors import InputError
from twin.optics.passband import mean_over_field
from twin.optics.radiometry import (
    field_angles,
    field_stop,
    lit_tan,
    mean_cos_power,
    wall_share,
)
from twin.optics.solar_irradiance import sun_in_band
from twin.optics.spectra import in_band_fraction
from twin.system import Part, System

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FieldMeans:
    """What a wall's light is over the field.

    ``in_band``: share of the emitter's line behind the filter, mean over the light of a wall;
    ``sun_w_per_m2``: irradiance of the sun behind the filter on the wall, that counts on the axis
    as the whole field does: with cos^4 of the lens.
    """

    in_band: Number
    sun_w_per_m2: Number


def field_means(system: System) -> FieldMeans:
    """Means of a system, whose fields may hold arrays that broadcast, except its angles.

    Raises InputError for a raster.
    """
    if system.is_raster:
        raise InputError(
            "acquisition.order: closed formulas know pattern sets, expected none of raster"
        )
    seen, sky = field_stop(system), system.sky
    lit_deg, emitted = field_angles(min(seen[0], lit_tan(system)), 7, seen)
    degrees, sent = field_angles(seen[0], 4, seen)

    def line_at(angle_deg: Number) -> Number:
        return in_band_fraction(system.emitter, system.filter, angle_deg)

    def sun_at(angle_deg: Number) -> Number:
        return sun_in_band(sky, system.filter, angle_deg).irradiance_w_per_m2 if sky else 0.0

    return FieldMeans(
        in_band=mean_over_field(system, line_at, lit_deg, emitted),
        sun_w_per_m2=mean_over_field(system, sun_at, degrees, sent) * mean_cos_power(4, *seen),
    )


def field_link(system: System, part: Part) -> OpticalLink:
    """Link of one pixel of a sensor, in place of the system's detector, as the mean over its field:
    `link_of` with the cosines of the field, and with the shift of the filter with the angle.
    """
    system = system.unchecked_copy({"detector": detector_of(part)})
    means = field_means(system)
    return replace(
        link_of(system, part),
        in_band=means.in_band,
        sun_w_per_m2=means.sun_w_per_m2,
        lit_share=wall_share(system),
    )
