"""The system under study, as data: emitter, filter, optics, detector, readout, acquisition, sky,
weather.

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

#: Float32 directions have steps of 3e-6 deg: below, a cell's edges are lost in them.
FieldAngle = Annotated[Positive, Field(ge=2e-3, lt=170)]
GridSize = Annotated[int, Field(strict=True, ge=1, le=1024)]
#: The record's clock counts ns.
Duration = Annotated[Positive, Field(ge=1e-9, le=1e3)]
#: Above the atmosphere the sun gives some 1.3e5 lx.
Illuminance = Annotated[NonNegative, Field(le=1e7)]
#: Bare elements are all told apart by a matrix of cells x cells.
_MOST_BARE = 4096


#: Range of the solar spectrum's table (ASTM G-173).
SUN_BAND_M = (280e-9, 4000e-9)


class Emitter(Strict):
    """Pattern projector: equal cells in a square field, lit or dark.

    With all cells lit it has ``radiant_intensity_w_per_sr`` on its axis and, without
    ``viewing_angle_deg``, in every direction of the field; a single lit cell has that same radiant
    intensity inside its own solid angle.

    viewing_angle_deg
        Full angle at which a lobe cos^m has fallen to one half; default: a flat field.
    projection
        ``lens`` images each cell into the field; ``none``: bare LEDs at ``pitch_m``, each with its
        lobe over the whole field and its share of the radiant intensity.
    blur_rms_deg
        Standard deviation of the projection's Gaussian blur.
    fill_factor
        Share of a cell that is lit, a square in its middle, which holds all of the cell's light.
    contrast_ratio
        Lit over dark; default: dark cells emit nothing.
    intensity_spread, intensity_seed
        Relative standard deviation of unequal cells, and the draw that makes them.
    intensity_noise
        Relative fluctuation of the whole emitter from exposure to exposure, rms.
    switching_time_s
        10 to 90 % of a cell switched on or off, exponential.
    kind, source_diameter_m
        For eye safety alone: which standard holds, and the diameter of the apparent source; without
        it a source too small to be resolved is taken, the worst case.
    """

    rows: Sourced[GridSize]
    columns: Sourced[GridSize]
    field_of_view_deg: Sourced[FieldAngle]
    radiant_intensity_w_per_sr: Sourced[Annotated[NonNegative, Field(le=1e9)]]
    peak_wavelength_m: Sourced[Positive]
    line_fwhm_m: Sourced[Positive]
    spectrum_csv: Sourced[str] | None = None
    viewing_angle_deg: Sourced[FieldAngle] | None = None
    projection: Sourced[Literal["lens", "none"]] | None = None
    pitch_m: Sourced[Positive] | None = None
    blur_rms_deg: Sourced[Annotated[NonNegative, Field(lt=45)]] | None = None
    fill_factor: Sourced[Fraction] | None = None
    contrast_ratio: Sourced[Annotated[Finite, Field(gt=1)]] | None = None
    intensity_spread: Sourced[Annotated[NonNegative, Field(lt=1)]] | None = None
    intensity_seed: Sourced[Annotated[int, Field(strict=True, ge=0)]] | None = None
    intensity_noise: Sourced[Annotated[NonNegative, Field(lt=1)]] | None = None
    switching_time_s: Sourced[NonNegative] | None = None
    kind: Sourced[Literal["led", "laser"]] | None = None
    source_diameter_m: Sourced[Positive] | None = None

    @model_validator(mode="after")
    def _bare_leds_are_described(self) -> "Emitter":
        if self.has_lens:
            return self
        if self.rows.value * self.columns.value > _MOST_BARE:
            raise ValueError(f"rows x columns: at most {_MOST_BARE} elements without a lens")
        if self.pitch_m is None or self.viewing_angle_deg is None:
            raise ValueError("projection none needs pitch_m and viewing_angle_deg")
        if self.blur_rms_deg is not None or self.fill_factor is not None:
            raise ValueError("projection none: without a lens there is no blur and no fill factor")
        return self

    @property
    def has_lens(self) -> bool:
        """Whether cells are imaged into the field."""
        return self.projection is None or self.projection.value == "lens"


class Filter(Strict):
    """Band-pass filter, flat inside its width.

    ``transmission_csv``: a vendor's curve, wavelength and transmission, in place of the flat top;
    ``transmission`` is then a factor beside it. ``effective_index``: of the interference stack,
    which moves the band to shorter wavelengths with angle. ``place``: ``before lens`` (default),
    light meets it at the angle of the field; ``behind lens``, in the cone of the f-number.
    """

    center_wavelength_m: Sourced[Positive]
    width_m: Sourced[Positive]
    transmission: Sourced[Fraction]
    transmission_csv: Sourced[str] | None = None
    effective_index: Sourced[Annotated[Positive, Field(gt=1)]] | None = None
    place: Sourced[Literal["before lens", "behind lens"]] | None = None

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
    ``edge_illumination``: vignetting beyond cos^4, what is left at the middle of the field's edge.
    ``blur_rms_deg``: standard deviation of the lens's Gaussian blur, some 0.1 deg for a Fresnel
    lens. ``focus_m``: the pupil has its true size and is focused there; default: a pinhole in
    position, in focus everywhere.
    """

    f_number: Sourced[Positive]
    transmission: Sourced[Fraction]
    field_of_view_deg: Sourced[FieldAngle]
    field_stop: Sourced[Literal["matched", "detector"]]
    edge_illumination: Sourced[Fraction] | None = None
    blur_rms_deg: Sourced[Annotated[NonNegative, Field(lt=45)]] | None = None
    focus_m: Sourced[Positive] | None = None


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


class TimeOfFlight(Strict):
    """Distance from the time that light takes; every pattern is shown once for each shutter.

    Indirect: power modulated at each of ``modulation_hz``, the detector sensitive half of the time,
    in step, at ``phase_steps`` phases; ``contrast`` of the modulation and the detector together.
    Gated: pulses of ``pulse_width_s``, ``pulse_rate_hz`` of them a second, the detector open for
    ``gate_width_s`` after each of ``gate_delays_s``; radiant intensity is that of the pulse.
    """

    modulation_hz: Sourced[Annotated[tuple[Positive, ...], Field(min_length=1)]] | None = None
    phase_steps: Sourced[Annotated[int, Field(strict=True, ge=3, le=16)]] | None = None
    contrast: Sourced[Fraction] | None = None
    pulse_width_s: Sourced[Positive] | None = None
    pulse_rate_hz: Sourced[Positive] | None = None
    gate_width_s: Sourced[Positive] | None = None
    gate_delays_s: Sourced[Annotated[tuple[NonNegative, ...], Field(min_length=1)]] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "TimeOfFlight":
        gated = [self.pulse_width_s, self.pulse_rate_hz, self.gate_width_s, self.gate_delays_s]
        indirect = [self.modulation_hz, self.contrast]
        if not (
            (None not in gated and not any(indirect)) or (None not in indirect and not any(gated))
        ):
            raise ValueError(
                "needs either modulation_hz and contrast, or pulse_width_s, pulse_rate_hz, "
                "gate_width_s and gate_delays_s"
            )
        for name in ("pulse_width_s", "gate_width_s"):
            width = getattr(self, name)
            if width and self.pulse_rate_hz and width.value * self.pulse_rate_hz.value > 1:
                raise ValueError(f"{name} is longer than the time between pulses")
        return self

    @property
    def n_phases(self) -> int:
        """Taps per modulation frequency."""
        return self.phase_steps.value if self.phase_steps else 4

    @property
    def n_shutters(self) -> int:
        """Exposures of each pattern."""
        if self.modulation_hz is not None:
            return len(self.modulation_hz.value) * self.n_phases
        return len(self.gate_delays_s.value) if self.gate_delays_s else 1


class Sky(Strict):
    """The sun a system is meant for; takes precedence over the scene's.

    Either ``illuminance_lx`` on the plane normal to the sun, with the spectrum of ASTM G-173, or
    ``sun_elevation_deg`` in a clear sky, which gives both illuminance and spectrum.
    """

    illuminance_lx: Sourced[Illuminance] | None = None
    sun_elevation_deg: Sourced[Annotated[Finite, Field(ge=-90, le=90)]] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> "Sky":
        if (self.illuminance_lx is None) == (self.sun_elevation_deg is None):
            raise ValueError("needs either illuminance_lx or sun_elevation_deg")
        return self


class Weather(Strict):
    """The air between the devices and what they look at, the same everywhere.

    Extinction comes from what is named: fog, haze and clear air by ``visibility_m`` (2 % contrast
    at 550 nm) and ``visibility_model``; rain and snow by their rates (melted, for snow); smoke by
    its mass per volume. They add up.

    ``single_scattering_albedo``, ``asymmetry`` (mean cosine) and ``lidar_ratio_sr`` (extinction
    over backscatter) belong to the particles together; without a lidar ratio the phase function
    is that of Henyey and Greenstein. Temperature, pressure and water vapour are the radar's.
    """

    visibility_m: Sourced[Annotated[Positive, Field(ge=1)]] | None = None
    visibility_model: Sourced[Literal["kim", "kruse"]] | None = None
    rain_mm_per_h: Sourced[Annotated[NonNegative, Field(le=1000)]] | None = None
    snow_mm_per_h: Sourced[Annotated[NonNegative, Field(le=1000)]] | None = None
    snow_kind: Sourced[Literal["dry", "wet"]] | None = None
    smoke_kg_per_m3: Sourced[Annotated[NonNegative, Field(le=1)]] | None = None
    single_scattering_albedo: Sourced[Annotated[NonNegative, Field(le=1)]]
    asymmetry: Sourced[Annotated[Finite, Field(gt=-1, lt=1)]]
    lidar_ratio_sr: Sourced[Positive] | None = None
    temperature_k: Sourced[Annotated[Positive, Field(ge=150, le=350)]] | None = None
    pressure_pa: Sourced[Annotated[Positive, Field(ge=1e3, le=2e5)]] | None = None
    water_vapour_kg_per_m3: Sourced[Annotated[NonNegative, Field(le=0.1)]] | None = None

    @model_validator(mode="after")
    def _says_what_is_needed(self) -> "Weather":
        if (self.snow_mm_per_h is None) != (self.snow_kind is None):
            raise ValueError("snow needs both snow_mm_per_h and snow_kind")
        if self.visibility_model is not None and self.visibility_m is None:
            raise ValueError("visibility_model needs visibility_m")
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
    time_of_flight: TimeOfFlight | None = None
    weather: Weather | None = None

    @model_validator(mode="after")
    def _patterns_exist(self) -> "System":
        try:
            _ = self.patterns
        except ValueError as error:
            field, rest = str(error).split(":", 1)
            places = {"count": "n_patterns", "subset": "order", "mode": "mode"}
            place = f"acquisition.{places[field]}" if field in places else f"emitter.{field}"
            raise ValueError(f"{place}:{rest}") from None
        if self.patterns.n_arms > 1:
            raise ValueError("acquisition.mode: 'complementary' needs two detectors, has one")
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
        if not self.emitter.has_lens or self.time_of_flight:
            raise ValueError(
                "a line sensor needs emitter.projection lens, and no time_of_flight section"
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
    def picture_shape(self) -> tuple[int, int]:
        """Rows and columns of the virtual image, detectors side by side."""
        return self.emitter.rows.value, self.emitter.columns.value * self.n_detectors

    @property
    def pixels_per_detector(self) -> int:
        """Pixels whose charge is added to one number."""
        return (self.detector.pixels.value if self.detector.pixels else 1) // self.n_detectors

    @property
    def frame_time_s(self) -> float:
        """Time to show all patterns once."""
        return self.n_exposures * self.acquisition.pattern_period_s.value

    @property
    def n_exposures(self) -> int:
        """Exposures of one frame: every pattern with every shutter."""
        shutters = self.time_of_flight.n_shutters if self.time_of_flight else 1
        return self.patterns.n_exposures * shutters


class Part(Entry):
    """A part one can buy, or one the paper describes: one section of a system."""

    emitter: Emitter | None = None
    filter: Filter | None = None
    optics: Optics | None = None
    detector: Detector | None = None
    readout: Readout | None = None
    sky: Sky | None = None
    weather: Weather | None = None

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
_PART_SECTIONS = ("emitter", "filter", "optics", "detector", "readout", "sky", "weather")


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
