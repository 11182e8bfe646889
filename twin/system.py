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
    Finite,
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
    radiant_intensity_w_per_sr: Sourced[Annotated[NonNegative, Field(le=1e9)]]
    peak_wavelength_m: Sourced[Positive]
    line_fwhm_m: Sourced[Positive]
    spectrum_csv: Sourced[str] | None = None


class Filter(Strict):
    """Band-pass filter, flat inside its width.

    ``transmission_csv``: a vendor's curve, wavelength and transmission, in place of the flat top;
    ``transmission`` is then a factor beside it. ``effective_index``: of the interference stack,
    which moves the band to shorter wavelengths with angle.
    """

    center_wavelength_m: Sourced[Positive]
    width_m: Sourced[Positive]
    transmission: Sourced[Fraction]
    transmission_csv: Sourced[str] | None = None
    effective_index: Sourced[Annotated[Positive, Field(gt=1)]] | None = None

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
    ``full_well_e``, and has its reset noise in ``read_noise_e``.
    """

    transimpedance_ohm: Sourced[Positive] | None = None
    feedback_capacitance_f: Sourced[Positive] | None = None
    full_well_e: Sourced[Positive] | None = None
    temperature_k: Sourced[NonNegative]
    read_noise_e: Sourced[NonNegative]
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=31)]]
    adc_full_scale_v: Sourced[Positive]
    adc_offset_v: Sourced[NonNegative]

    @model_validator(mode="after")
    def _is_one_amplifier(self) -> "Readout":
        if (self.transimpedance_ohm is None) == (self.feedback_capacitance_f is None):
            raise ValueError("needs either transimpedance_ohm or feedback_capacitance_f")
        return self


class Acquisition(Strict):
    """Which patterns are shown, and for how long.

    ``columns``: of a line sensor, whose pixels are binned to them; default one per pixel.
    """

    integration_time_s: Sourced[Duration]
    pattern_period_s: Sourced[Duration]
    n_patterns: Sourced[Count]
    order: Sourced[Order]
    mode: Sourced[Mode]
    columns: Sourced[Count] | None = None

    @model_validator(mode="after")
    def _fits(self) -> "Acquisition":
        if self.integration_time_s.value > self.pattern_period_s.value:
            raise ValueError("integration_time_s is longer than pattern_period_s")
        return self


class Sky(Strict):
    """The sun a system is meant for; takes precedence over the scene's.

    Either ``illuminance_lx`` on the plane normal to the sun, with the spectrum of ASTM G-173, or
    ``sun_elevation_deg`` in a clear sky, which gives both illuminance and spectrum.
    """

    illuminance_lx: Sourced[NonNegative] | None = None
    sun_elevation_deg: Sourced[Annotated[Finite, Field(ge=-90, le=90)]] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> "Sky":
        if (self.illuminance_lx is None) == (self.sun_elevation_deg is None):
            raise ValueError("needs either illuminance_lx or sun_elevation_deg")
        return self


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

    @model_validator(mode="after")
    def _line_sensor_fits(self) -> "System":
        if self.detector.pixels is None or self.detector.pixels.value == 1:
            return self
        if self.detector.pixels.value % self.n_detectors:
            raise ValueError(
                f"acquisition.columns: {self.n_detectors} does not divide "
                f"detector.pixels, {self.detector.pixels.value}"
            )
        if self.emitter.columns.value != 1 or self.optics.field_stop.value != "matched":
            raise ValueError(
                "a line sensor takes its columns itself: emitter.columns must be 1 (it is "
                f"{self.emitter.columns.value}) and optics.field_stop matched"
            )
        return self

    @property
    def n_detectors(self) -> int:
        """Numbers per exposure: 1, or the columns of a line sensor."""
        if self.detector.pixels is None or self.detector.pixels.value == 1:
            return 1
        columns = self.acquisition.columns
        return columns.value if columns else self.detector.pixels.value

    @property
    def pixels_per_detector(self) -> int:
        """Pixels whose charge is added to one number."""
        return (self.detector.pixels.value if self.detector.pixels else 1) // self.n_detectors

    @property
    def frame_time_s(self) -> float:
        """Time to show all patterns once."""
        return self.patterns.n_exposures * self.acquisition.pattern_period_s.value


class Part(Entry):
    """A part one can buy, or one the paper describes: one section of a system."""

    emitter: Emitter | None = None
    filter: Filter | None = None
    optics: Optics | None = None
    detector: Detector | None = None
    readout: Readout | None = None
    sky: Sky | None = None

    @model_validator(mode="after")
    def _is_one_thing(self) -> "Part":
        if len(self._sections()) != 1:
            raise ValueError(f"needs exactly one section of {', '.join(_PART_SECTIONS)}")
        return self

    @property
    def kind(self) -> str:
        """Name of its section."""
        return self._sections()[0]

    def _sections(self) -> list[str]:
        return [name for name in _PART_SECTIONS if getattr(self, name) is not None]


_PARTS = catalog_folder() / "parts"
_PART_SECTIONS = ("emitter", "filter", "optics", "detector", "readout", "sky")


def load_system(name: "str | Path | System") -> System:
    """A bundled system by name, or a user's own TOML file; a system is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(System, name, "system", catalog_folder() / "systems", _PARTS)


def system_names() -> list[str]:
    """Names of the bundled systems."""
    return bundled(catalog_folder() / "systems")


def load_part(name: "str | Path | Part") -> Part:
    """A bundled part by name, or a user's own TOML file.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(Part, name, "part", _PARTS)


def part_names() -> list[str]:
    """Names of the bundled parts."""
    return bundled(_PARTS)
