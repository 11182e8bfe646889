"""Photodiode or sensor, amplifier and converter."""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy import constants

from twin.errors import InputError
from twin.own_parts import OwnCode
from twin.toml import Count, Finite, NonNegative, Positive, Sourced, Strict


class Photodetector(Strict):
    """Photodiode, or one of the equal pixels of a sensor.

    An avalanche photodiode multiplies by ``gain``, and adds the noise of doing so: by the
    ``excess_noise_factor`` at that gain, or by the ``ionisation_ratio`` of its two carriers.
    """

    alternatives: ClassVar = (("excess_noise_factor",), ("ionisation_ratio",))
    limits: ClassVar = {
        "width_m": (1e-12, 1e3),
        "height_m": (1e-12, 1e3),
        "dark_current_a": (0, 1e3),
    }

    shape: Sourced[Literal["disc", "square", "rectangle"]]
    """Outline of the photosensitive area of one pixel."""
    width_m: Sourced[Positive]
    """Diameter of a disc, or side of a square or rectangle."""
    height_m: Sourced[Positive] | None = None
    """Other side of a rectangle; with that shape alone."""
    pixels: Sourced[Count] | None = None
    """Pixels of a line sensor. Default: a single detector."""
    responsivity_a_per_w: Sourced[Positive]
    """Photocurrent per light power at the emitter's wavelength; with `gain`, at the terminals."""
    responsivity_csv: Sourced[str] | None = None
    """File of the vendor's curve, wavelength and A/W, in place of the one number."""
    dark_current_a: Sourced[NonNegative]
    """Current without light at the terminals, of one pixel; with `gain` all of it is taken to be
    multiplied.
    """
    gain: Sourced[Annotated[Finite, Field(ge=1, le=1e8)]] | None = None
    """Electrons at the terminals for each one that a photon frees, of an avalanche photodiode.
    Default: 1.
    """
    excess_noise_factor: Sourced[Annotated[Finite, Field(ge=1, le=1e8)]] | None = None
    """Mean square over squared mean of the avalanche's multiplication at that gain."""
    ionisation_ratio: Sourced[Annotated[NonNegative, Field(le=1)]] | None = None
    """Ratio k of the ionisation of both carriers, from which the excess noise F = k M + (1 - k) (2
    - 1 / M) follows (McIntyre, IEEE Trans. Electron Devices 13, 1966, p. 164).
    """
    line_rate_hz: Sourced[Positive] | None = None
    """Readouts per second at most. Default: as many as there are patterns."""
    function: Sourced[OwnCode] | None = None
    """A user's own detector with its readout: a class or function that makes a `twin.Detector` of
    the `System`, as `file.py:name`, the name of an entry point of the group `twin.detector`, or in
    Python itself. Shape and width are still those of the area.
    """

    @model_validator(mode="after")
    def _has_its_sides(self) -> "Photodetector":
        if (self.shape.value == "rectangle") == (self.height_m is None):
            raise InputError("a rectangle has width_m and height_m, a disc or square width_m alone")
        return self

    @model_validator(mode="after")
    def _says_what_gain_costs(self) -> "Photodetector":
        stated = [self.excess_noise_factor, self.ionisation_ratio]
        if self.gain is None and any(stated):
            raise InputError("excess_noise_factor and ionisation_ratio belong to a gain")
        if self.gain is not None and (stated[0] is None) == (stated[1] is None):
            raise InputError("gain needs either excess_noise_factor or ionisation_ratio")
        if self.multiplication == 1 and self.excess_noise > 1:
            raise InputError(
                f"excess_noise_factor = {self.excess_noise:g}: a gain of 1 multiplies nothing and "
                "adds no noise, expected 1"
            )
        return self

    @property
    def multiplication(self) -> float:
        """Electrons at the terminals for each one that a photon frees: 1 without an avalanche."""
        return self.gain.value if self.gain else 1.0

    @property
    def excess_noise(self) -> float:
        """Mean square over squared mean of the multiplication, 1 for a constant one."""
        if self.excess_noise_factor is not None:
            return self.excess_noise_factor.value
        if self.ionisation_ratio is None:
            return 1.0
        k, m = self.ionisation_ratio.value, self.multiplication
        return k * m + (1 - k) * (2 - 1 / m)

    def check_quantum_limit(self, responsivity_a_per_w: float, wavelength_m: float) -> None:
        """Raise InputError for more than one electron a photon before multiplication, anywhere in
        arrays of designs.
        """
        limit = quantum_limit_a_per_w(wavelength_m)
        designs = np.broadcast_arrays(
            responsivity_a_per_w, wavelength_m, limit, self.multiplication
        )
        worst = np.argmax(designs[0] / (designs[2] * designs[3]))
        found, at_m, electron, gain = (float(column.flat[worst]) for column in designs)
        if found > gain * electron * (1 + 1e-6):
            raise InputError(
                f"detector.responsivity_a_per_w = {found:g}: at {at_m * 1e9:g} nm one electron a "
                f"photon is {electron:.4g} A/W"
                + (f", {gain * electron:.4g} A/W with a gain of {gain:g}" if self.gain else "")
                + "; more needs detector.gain and its excess_noise_factor or ionisation_ratio"
            )

    @property
    def area_m2(self) -> float:
        """Photosensitive area of one pixel."""
        height = self.height_m.value if self.height_m else self.width_m.value
        area = self.width_m.value * height
        return area * math.pi / 4 if self.shape.value == "disc" else area


def check_has_closed_form(detector: Photodetector) -> None:
    """Raise InputError for a user's own detector, of which closed formulas know nothing."""
    if detector.function is not None:
        raise InputError(
            "detector.function: closed formulas know the bundled photodiode, expected none"
        )


def quantum_limit_a_per_w(wavelength_m: float) -> float:
    """Responsivity of one electron a photon, q lambda / (h c): 1.250 A/W at 1550 nm."""
    return constants.e * wavelength_m / (constants.h * constants.c)


class Readout(Strict):
    """Amplifier and ADC. The amplifier is a transimpedance one, or a capacitive one that collects
    the charge.
    """

    alternatives: ClassVar = (("transimpedance_ohm",), ("feedback_capacitance_f", "full_well_e"))
    limits: ClassVar = {
        "transimpedance_ohm": (1e-9, 1e18),
        "feedback_capacitance_f": (1e-24, 1e3),
        "read_noise_e": (0, 1e18),
        "bandwidth_hz": (1e-9, 1e15),
        "adc_full_scale_v": (1e-15, 1e9),
    }

    transimpedance_ohm: Sourced[Positive] | None = None
    """Of a transimpedance amplifier, which averages the current over the integration time."""
    feedback_capacitance_f: Sourced[Positive] | None = None
    """Of a capacitive amplifier (CTIA), which collects the charge."""
    full_well_e: Sourced[Positive] | None = None
    """Charge up to which a capacitive amplifier collects. Default: up to the converter's rail."""
    temperature_k: Sourced[NonNegative]
    """Of the amplifier's resistor, for its Johnson noise."""
    read_noise_e: Sourced[NonNegative]
    """Noise of one readout, rms, the reset noise of a capacitive amplifier included."""
    flicker_corner_hz: Sourced[NonNegative] | None = None
    """Frequency fc below which the amplifier's noise density, S0 (1 + fc / f), grows as 1/f; S0
    over the integration time is its Johnson and read noise. Default: nowhere.
    """
    bandwidth_hz: Sourced[Positive] | None = None
    """Of the amplifier's one pole, which carries a share of each exposure into the next. Default:
    wide enough to settle.
    """
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=31)]]
    """Bits of the converter."""
    adc_full_scale_v: Sourced[Positive]
    """Range of the converter from code 0 on: 2^adc_bits steps of adc_full_scale_v / 2^adc_bits. The
    highest code, 2^adc_bits - 1, is one step below it.
    """
    adc_offset_v: Sourced[NonNegative]
    """Voltage at the converter without any light, so that noise is not cut off at zero."""

    @model_validator(mode="after")
    def _is_one_amplifier(self) -> "Readout":
        if (self.transimpedance_ohm is None) == (self.feedback_capacitance_f is None):
            raise InputError("needs either transimpedance_ohm or feedback_capacitance_f")
        return self

    @model_validator(mode="after")
    def _only_a_capacitance_has_a_well(self) -> "Readout":
        if self.full_well_e is not None and self.feedback_capacitance_f is None:
            raise InputError(
                f"full_well_e = {self.full_well_e.value:g}: a transimpedance amplifier has no "
                "well, expected feedback_capacitance_f beside it, or no full_well_e"
            )
        return self

    @model_validator(mode="after")
    def _offset_is_in_range(self) -> "Readout":
        if self.adc_offset_v.value >= self.adc_full_scale_v.value:
            raise InputError(
                f"adc_offset_v = {self.adc_offset_v.value:g} leaves nothing of adc_full_scale_v, "
                f"{self.adc_full_scale_v.value:g}"
            )
        return self
