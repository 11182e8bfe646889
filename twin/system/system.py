"""One complete optical system: its sections, and what must fit between them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from hardware.formatting import number
from hardware.patterns import Patterns, PatternSet, RasterScan
from twin.files import InputError, catalog_folder
from twin.system.acquisition import Acquisition, TimeOfFlight
from twin.system.curves import check_curves
from twin.system.detector import Photodetector, Readout
from twin.system.emitter import Emitter
from twin.system.environment import Sky, Weather
from twin.system.optics import Filter, Optics
from twin.system.own_patterns import read_own_patterns
from twin.system.part import PARTS, SECTIONS, Part, load_part
from twin.toml import Entry, bundled, load_entry


class System(Entry):
    """One complete optical system.

    >>> system = load_system("workable")
    >>> fast = system.with_({"optics.f_number": 0.8, "detector.part": "fga015"})
    >>> fast.optics.f_number.value, fast.name
    (0.8, 'workable (changed)')
    """

    with_parts: ClassVar[tuple[str, ...]] = SECTIONS

    emitter: Emitter
    """The pattern projector."""
    filter: Filter
    """The band-pass filter."""
    optics: Optics
    """The lens before the detector."""
    detector: Photodetector
    """The photodiode or sensor."""
    readout: Readout
    """The amplifier and the converter."""
    acquisition: Acquisition
    """Which patterns are shown, and for how long."""
    sky: Sky | None = None
    """The sun the system is meant for. Default: the scene's."""
    time_of_flight: TimeOfFlight | None = None
    """Distance from the time that light takes. Default: an image without distances."""
    weather: Weather | None = None
    """The air. Default: nothing absorbs or scatters."""

    @model_validator(mode="after")
    def _patterns_exist(self) -> "System":
        try:
            _ = self.patterns
        except (InputError, FileNotFoundError) as error:
            if self.acquisition.patterns is not None:
                raise InputError(f"acquisition.patterns: {error}") from None
            field, rest = str(error).split(":", 1)
            places = {"count": "n_patterns", "order": "order", "mode": "mode"}
            place = f"acquisition.{places[field]}" if field in places else f"emitter.{field}"
            raise InputError(f"{place}:{rest}") from None
        return self

    @model_validator(mode="after")
    def _physics_allows_it(self) -> "System":
        acquisition = self.acquisition
        self.detector.check_quantum_limit(
            self.detector.responsivity_a_per_w.value, self.emitter.peak_wavelength_m.value
        )
        rate, period = self.detector.line_rate_hz, acquisition.pattern_period_s.value
        if rate is not None and rate.value * period < 1 - 1e-9:
            raise InputError(
                f"acquisition.pattern_period_s = {period:g}: detector.line_rate_hz allows "
                f"{rate.value:g} readouts per second, one in {1 / rate.value:.3g} s"
            )
        exposure_s = acquisition.integration_time_s.value
        tof = self.time_of_flight
        if tof is not None and tof.pulse_rate_hz and tof.pulse_rate_hz.value * exposure_s < 1:
            raise InputError(
                f"time_of_flight.pulse_rate_hz = {tof.pulse_rate_hz.value:g}: less than one pulse "
                f"in acquisition.integration_time_s = {exposure_s:g}"
            )
        if tof is not None and tof.modulation_hz is not None:
            slowest = min(tof.modulation_hz.value)
            if slowest * exposure_s < 1:
                raise InputError(
                    f"time_of_flight.modulation_hz = {slowest:g}: less than one period in "
                    f"acquisition.integration_time_s = {exposure_s:g}"
                )
        return self

    def with_(self, changes: Mapping[str, Any]) -> Self:
        """See `twin.toml.Entry.with_`; files of curves are read too."""
        changed = super().with_(changes)
        check_curves(changed.emitter, changed.filter, changed.detector)
        return changed

    def _section_of(self, section: str, part: str | Path | Part) -> Any:
        found = getattr(load_part(part), section, None)
        if found is None:
            name = part.name if isinstance(part, Part) else part
            raise InputError(f"{section}.part = {str(name)!r}: this part has no {section}")
        return found

    @property
    def patterns(self) -> Patterns:
        """The pattern set that is shown."""
        if self.acquisition.patterns is not None:
            return read_own_patterns(
                self.acquisition.patterns.value,
                count=self.acquisition.n_patterns.value,
                shape=(self.emitter.rows.value, self.emitter.columns.value),
                mode=self.acquisition.mode.value,
            )
        if self.is_raster:
            return RasterScan(
                self.emitter.rows.value, self.emitter.columns.value, self.acquisition.mode.value
            )
        if self.acquisition.order.value == "custom":
            raise InputError(
                "order: 'custom' needs the rows that are shown, for which a system has no field: "
                "expected another order, or a file of masks in acquisition.patterns"
            )
        return PatternSet(
            rows=self.emitter.rows.value,
            columns=self.emitter.columns.value,
            count=self.acquisition.n_patterns.value,
            order=self.acquisition.order.value,  # type: ignore[arg-type]
            mode=self.acquisition.mode.value,
        )

    @property
    def sampling_note(self) -> str | None:
        """What is left out where fewer patterns are shown than there are cells: of the user's own
        choice, or since another grid kept its base's number of patterns.
        """
        shown, n_cells = self.patterns.count, self.patterns.n_cells
        if shown >= n_cells:
            return None
        share = _SHARES.get(shown / n_cells, f"{number(100 * shown / n_cells, 2)} %")
        return (
            f"acquisition.n_patterns = {shown}: samples {share} of the {n_cells} patterns of "
            f"{self.patterns.columns} x {self.patterns.rows} cells"
        )

    @property
    def is_raster(self) -> bool:
        """Whether one cell is lit after another."""
        own = self.acquisition.patterns is not None
        return self.acquisition.order.value == "raster" and not own

    @model_validator(mode="after")
    def _scan_is_whole(self) -> "System":
        acquisition, optics = self.acquisition, self.optics
        if not self.is_raster:
            if optics.is_scanned:
                raise InputError("optics.field_stop: scanned belongs to acquisition.order raster")
            return self
        n_cells = self.patterns.n_cells
        if acquisition.n_patterns.value != n_cells:
            raise InputError(
                f"acquisition.n_patterns = {acquisition.n_patterns.value}: a raster scan lights "
                f"every cell, expected {n_cells}"
            )
        if not self.emitter.has_lens or self.n_detectors > 1:
            raise InputError(
                "acquisition.order: raster needs emitter.projection lens and one pixel"
            )
        tof = self.time_of_flight
        gates = len(tof.gate_delays_s.value) if tof and tof.gate_delays_s else 0
        if acquisition.mode.value == "plain" and gates < 4 and not (tof and tof.modulation_hz):
            raise InputError(
                "acquisition.mode: a plain raster scan needs at least 4 gates (time_of_flight), of "
                "which those without an echo tell the background; else differential"
            )
        if optics.is_scanned and self.weather:
            raise InputError(
                "weather: the light that air scatters into a field that follows the lit cell is "
                "not modelled: expected none, or optics.field_stop matched"
            )
        side = optics.receiver_cells.value if optics.receiver_cells else 1
        if side > min(self.emitter.rows.value, self.emitter.columns.value):
            raise InputError(f"optics.receiver_cells = {side}: more than the field has")
        return self

    @model_validator(mode="after")
    def _lens_has_an_image(self) -> "System":
        focus = self.optics.focus_m
        if focus is not None and focus.value <= self.focal_length_m:
            raise InputError(
                f"optics.focus_m = {focus.value:g}: expected more than the focal length of the "
                f"lens, {self.focal_length_m:.3g} m"
            )
        return self

    @model_validator(mode="after")
    def _line_sensor_fits(self) -> "System":
        if self.detector.pixels is None or self.detector.pixels.value == 1:
            columns = self.acquisition.columns
            if columns is not None and columns.value > 1:
                raise InputError(
                    f"acquisition.columns = {columns.value}: belongs to a line sensor "
                    "(detector.pixels), expected 1 or none"
                )
            return self
        if self.detector.pixels.value % self.n_detectors:
            raise InputError(
                f"acquisition.columns: {self.n_detectors} does not divide "
                f"detector.pixels, {self.detector.pixels.value}"
            )
        if self.emitter.columns.value != 1 or self.optics.field_stop.value != "matched":
            raise InputError(
                "a line sensor takes its columns itself: emitter.columns must be 1 (it is "
                f"{self.emitter.columns.value}) and optics.field_stop matched"
            )
        if not self.emitter.has_lens or self.time_of_flight:
            raise InputError(
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
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the virtual image, detectors side by side."""
        return self.emitter.rows.value, self.emitter.columns.value * self.n_detectors

    @property
    def focal_length_m(self) -> float:
        """Of the lens that spreads the detector, a line sensor's whole, over the field."""
        tangent = math.tan(math.radians(self.optics.field_of_view_deg.value) / 2)
        field_area = (4 if self.has_square_field else math.pi) * tangent**2 * self.receiver_share
        pixels = self.detector.pixels.value if self.detector.pixels else 1
        return math.sqrt(self.detector.area_m2 * pixels / field_area)

    @property
    def receiver_share(self) -> float:
        """Share of the field that the detector sees at one time: 1, or some cells of a scan."""
        if not self.optics.is_scanned:
            return 1.0
        side = self.optics.receiver_cells.value if self.optics.receiver_cells else 1
        return side**2 / (self.emitter.rows.value * self.emitter.columns.value)

    @property
    def has_square_field(self) -> bool:
        """Whether what the detector sees is a square, not a disc."""
        return self.optics.field_stop.value != "detector" or self.detector.shape.value == "square"

    @property
    def pixels_per_detector(self) -> int:
        """Pixels whose charge is added to one number."""
        return (self.detector.pixels.value if self.detector.pixels else 1) // self.n_detectors

    @property
    def frame_time_s(self) -> float:
        """Time to show all patterns once."""
        turns = self.patterns.n_exposures if self.gates_at_once else self.n_exposures
        return turns * self.acquisition.pattern_period_s.value

    @property
    def gates_at_once(self) -> bool:
        """Whether all gates of a pattern are taken in the same exposure."""
        return self.time_of_flight is not None and self.time_of_flight.at_once

    @property
    def mean_power_w(self) -> float:
        """Mean power that the emitter sends out during a frame, W: in the solid angle of its field,
        of which patterns send the lit cells' share.
        """
        half = math.radians(self.emitter.field_of_view_deg.value) / 2
        field_sr = 4 * math.asin(math.sin(half) ** 2)
        peak_w = self.emitter.radiant_intensity_w_per_sr.value * field_sr
        pulsed = self.time_of_flight.emitter_share if self.time_of_flight else 1.0
        lit = self.patterns.signal(np.ones(self.patterns.n_cells)).mean() / self.patterns.n_cells
        return float(peak_w * pulsed * lit)

    @property
    def n_exposures(self) -> int:
        """Exposures of one frame: every pattern with every shutter."""
        shutters = self.time_of_flight.n_shutters if self.time_of_flight else 1
        return self.patterns.n_exposures * shutters


_SHARES = {0.5: "half", 0.25: "a quarter", 0.125: "an eighth"}


def load_system(name: "str | Path | System") -> System:
    """A bundled system by name, or a user's own TOML file; a system is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected; files of curves
    that it names are read too.
    """
    system = load_entry(System, name, "system", catalog_folder() / "systems", PARTS)
    check_curves(system.emitter, system.filter, system.detector)
    return system


def system_names() -> list[str]:
    """Names of the bundled systems."""
    return bundled(catalog_folder() / "systems")
