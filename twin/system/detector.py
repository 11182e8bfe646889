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

    ``width_m`` is the diameter of a disc or the side of a square; a rectangle has ``height_m`` too.
    ``line_rate_hz``: readouts per second at most. ``responsivity_csv``: a vendor's curve,
    wavelength and A/W, in place of one number.

    An avalanche photodiode multiplies by ``gain``, and adds the noise of doing so: by the
    ``excess_noise_factor`` at that gain, or by the ``ionisation_ratio`` k of its two carriers, of
    which F = k M + (1 - k) (2 - 1 / M) (McIntyre, IEEE Trans. Electron Devices 13, 1966, p. 164).
    Responsivity and dark current are then those at the terminals, gain included; all of the dark
    current is taken to be multiplied.

    ``function``: a user's own detector with its readout, a class or function that makes a
    `twin.Detector` of the `System`: ``file.py:name``, the name of an entry point of the group
    ``twin.detector``, or in Python itself. Shape and width are still those of the area; what it
    makes of responsivity and dark current is its own.
    """

    alternatives: ClassVar = (("excess_noise_factor",), ("ionisation_ratio",))
    limits: ClassVar = {
        "width_m": (1e-12, 1e3),
        "height_m": (1e-12, 1e3),
        "dark_current_a": (0, 1e3),
    }

    shape: Sourced[Literal["disc", "square", "rectangle"]]
    width_m: Sourced[Positive]
    height_m: Sourced[Positive] | None = None
    pixels: Sourced[Count] | None = None
    responsivity_a_per_w: Sourced[Positive]
    responsivity_csv: Sourced[str] | None = None
    dark_current_a: Sourced[NonNegative]
    gain: Sourced[Annotated[Finite, Field(ge=1, le=1e8)]] | None = None
    excess_noise_factor: Sourced[Annotated[Finite, Field(ge=1, le=1e8)]] | None = None
    ionisation_ratio: Sourced[Annotated[NonNegative, Field(le=1)]] | None = None
    line_rate_hz: Sourced[Positive] | None = None
    function: Sourced[OwnCode] | None = None

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
    """Amplifier and ADC.

    A transimpedance amplifier (``transimpedance_ohm``) averages the current over the integration
    time; a capacitive one (``feedback_capacitance_f``, CTIA) collects the charge, up to
    ``full_well_e``, and has its reset noise in ``read_noise_e``. Below ``flicker_corner_hz`` the
    amplifier's noise density grows as 1/f. ``bandwidth_hz``: of the amplifier's one pole, which
    carries a share of each exposure into the next; default: wide enough to settle.
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
    feedback_capacitance_f: Sourced[Positive] | None = None
    full_well_e: Sourced[Positive] | None = None
    temperature_k: Sourced[NonNegative]
    read_noise_e: Sourced[NonNegative]
    flicker_corner_hz: Sourced[NonNegative] | None = None
    bandwidth_hz: Sourced[Positive] | None = None
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=31)]]
    adc_full_scale_v: Sourced[Positive]
    adc_offset_v: Sourced[NonNegative]

    @model_validator(mode="after")
    def _is_one_amplifier(self) -> "Readout":
        if (self.transimpedance_ohm is None) == (self.feedback_capacitance_f is None):
            raise InputError("needs either transimpedance_ohm or feedback_capacitance_f")
        return self

    @model_validator(mode="after")
    def _offset_is_in_range(self) -> "Readout":
        if self.adc_offset_v.value >= self.adc_full_scale_v.value:
            raise InputError(
                f"adc_offset_v = {self.adc_offset_v.value:g} leaves nothing of adc_full_scale_v, "
                f"{self.adc_full_scale_v.value:g}"
            )
        return self
