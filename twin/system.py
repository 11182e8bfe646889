"""The system under study, as data: emitter, filter, optics, detector, readout, acquisition, sky.

A system is a TOML file. Every value is a table ``{ value = ..., source = "..." }`` or
``{ value = ..., assumed = "..." }``; a bare number counts as assumed. ``base = "paper"`` takes
everything that the file leaves out from another system.
"""

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from hardware.patterns import Mode, Order, PatternSet
from twin.files import catalog_folder
from twin.toml import (
    Count,
    Entry,
    Fraction,
    NonNegative,
    Positive,
    Sourced,
    Strict,
    bundled,
    load_entry,
)

FieldAngle = Annotated[Positive, Field(lt=170)]
GridSize = Annotated[int, Field(strict=True, ge=1, le=1024)]
Duration = Annotated[Positive, Field(le=1e3)]


#: Range of the solar spectrum's table (ASTM G-173).
SUN_BAND_M = (280e-9, 4000e-9)


class Emitter(Strict):
    """Pattern projector: equal cells in a square field, lit or dark.

    With all cells lit it has ``radiant_intensity_w_per_sr`` in every direction of the field; a
    single lit cell has that same radiant intensity inside its own solid angle.
    """

    rows: Sourced[GridSize]
    columns: Sourced[GridSize]
    field_of_view_deg: Sourced[FieldAngle]
    radiant_intensity_w_per_sr: Sourced[NonNegative]
    peak_wavelength_m: Sourced[Positive]
    line_fwhm_m: Sourced[Positive]


class Filter(Strict):
    """Band-pass filter, flat inside its width."""

    center_wavelength_m: Sourced[Positive]
    width_m: Sourced[Positive]
    transmission: Sourced[Fraction]

    @model_validator(mode="after")
    def _in_the_table(self) -> "Filter":
        center, half = self.center_wavelength_m.value, self.width_m.value / 2
        if not SUN_BAND_M[0] <= center - half <= center + half <= SUN_BAND_M[1]:
            raise ValueError(
                f"band {center - half:g} to {center + half:g} m is outside the solar spectrum, "
                f"{SUN_BAND_M[0]:g} to {SUN_BAND_M[1]:g} m"
            )
        return self


class Optics(Strict):
    """Lens before the detector.

    ``field_stop``: ``matched``, the detector's area is spread over a square field;
    ``detector``, the detector's own outline behind the lens is what is seen.
    """

    f_number: Sourced[Positive]
    transmission: Sourced[Fraction]
    field_of_view_deg: Sourced[FieldAngle]
    field_stop: Sourced[Literal["matched", "detector"]]


class Detector(Strict):
    """Photodiode; ``width_m`` is the side of a square or the diameter of a disc."""

    shape: Sourced[Literal["disc", "square"]]
    width_m: Sourced[Positive]
    responsivity_a_per_w: Sourced[Positive]
    dark_current_a: Sourced[NonNegative]

    @property
    def area_m2(self) -> float:
        """Photosensitive area."""
        square = self.width_m.value**2
        return square * math.pi / 4 if self.shape.value == "disc" else square


class Readout(Strict):
    """Transimpedance amplifier that averages over the integration time, then the ADC."""

    transimpedance_ohm: Sourced[Positive]
    temperature_k: Sourced[NonNegative]
    read_noise_e: Sourced[NonNegative]
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=31)]]
    adc_full_scale_v: Sourced[Positive]
    adc_offset_v: Sourced[NonNegative]


class Acquisition(Strict):
    """Which patterns are shown, and for how long."""

    integration_time_s: Sourced[Duration]
    pattern_period_s: Sourced[Duration]
    n_patterns: Sourced[Count]
    order: Sourced[Order]
    mode: Sourced[Mode]

    @model_validator(mode="after")
    def _fits(self) -> "Acquisition":
        if self.integration_time_s.value > self.pattern_period_s.value:
            raise ValueError("integration_time_s is longer than pattern_period_s")
        return self


class Sky(Strict):
    """The sun a system is meant for; takes precedence over the scene's."""

    illuminance_lx: Sourced[NonNegative]


class System(Entry):
    """One complete optical system."""

    emitter: Emitter
    filter: Filter
    optics: Optics
    detector: Detector
    readout: Readout
    acquisition: Acquisition
    sky: Sky | None = None

    @model_validator(mode="after")
    def _patterns_exist(self) -> "System":
        try:
            _ = self.patterns
        except ValueError as error:
            field, rest = str(error).split(":", 1)
            place = "acquisition.n_patterns" if field == "count" else f"emitter.{field}"
            raise ValueError(f"{place}:{rest}") from None
        return self

    @property
    def patterns(self) -> PatternSet:
        """The pattern set that is shown."""
        return PatternSet(
            rows=self.emitter.rows.value,
            columns=self.emitter.columns.value,
            count=self.acquisition.n_patterns.value,
            order=self.acquisition.order.value,
            mode=self.acquisition.mode.value,
        )

    @property
    def frame_time_s(self) -> float:
        """Time to show all patterns once."""
        return self.patterns.n_exposures * self.acquisition.pattern_period_s.value


def load_system(name: "str | Path | System") -> System:
    """A bundled system by name, or a user's own TOML file; a system is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(System, name, "system", catalog_folder() / "systems")


def system_names() -> list[str]:
    """Names of the bundled systems."""
    return bundled(catalog_folder() / "systems")
