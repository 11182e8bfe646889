"""Photodiode or sensor, amplifier and converter."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.toml import Count, NonNegative, Positive, Sourced, Strict


class Detector(Strict):
    """Photodiode, or one of the equal pixels of a sensor.

    ``width_m`` is the diameter of a disc or the side of a square; a rectangle has ``height_m`` too.
    ``line_rate_hz``: readouts per second at most. ``responsivity_csv``: a vendor's curve,
    wavelength and A/W, in place of one number.
    """

    shape: Sourced[Literal["disc", "square", "rectangle"]]
    width_m: Sourced[Positive]
    height_m: Sourced[Positive] | None = None
    pixels: Sourced[Count] | None = None
    responsivity_a_per_w: Sourced[Positive]
    responsivity_csv: Sourced[str] | None = None
    dark_current_a: Sourced[NonNegative]
    line_rate_hz: Sourced[Positive] | None = None

    @model_validator(mode="after")
    def _has_its_sides(self) -> "Detector":
        if (self.shape.value == "rectangle") == (self.height_m is None):
            raise ValueError("a rectangle has width_m and height_m, a disc or square width_m alone")
        return self

    @property
    def area_m2(self) -> float:
        """Photosensitive area of one pixel."""
        height = self.height_m.value if self.height_m else self.width_m.value
        area = self.width_m.value * height
        return area * math.pi / 4 if self.shape.value == "disc" else area


class Readout(Strict):
    """Amplifier and ADC.

    A transimpedance amplifier (``transimpedance_ohm``) averages the current over the integration
    time; a capacitive one (``feedback_capacitance_f``, CTIA) collects the charge, up to
    ``full_well_e``, and has its reset noise in ``read_noise_e``. Below ``flicker_corner_hz`` the
    amplifier's noise density grows as 1/f.
    """

    transimpedance_ohm: Sourced[Positive] | None = None
    feedback_capacitance_f: Sourced[Positive] | None = None
    full_well_e: Sourced[Positive] | None = None
    temperature_k: Sourced[NonNegative]
    read_noise_e: Sourced[NonNegative]
    flicker_corner_hz: Sourced[NonNegative] | None = None
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=31)]]
    adc_full_scale_v: Sourced[Positive]
    adc_offset_v: Sourced[NonNegative]

    @model_validator(mode="after")
    def _is_one_amplifier(self) -> "Readout":
        if (self.transimpedance_ohm is None) == (self.feedback_capacitance_f is None):
            raise ValueError("needs either transimpedance_ohm or feedback_capacitance_f")
        return self
