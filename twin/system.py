"""The system under study, as data: emitter, filter, optics, detector, readout, acquisition, sky.

A system is a TOML file. Every value is a table ``{ value = ..., source = "..." }`` or
``{ value = ..., assumed = "..." }``; a bare number counts as assumed. ``base = "paper"`` takes
everything that the file leaves out from another system.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from hardware.patterns import Mode, Order, PatternSet
from twin.files import InputError, catalog_folder
from twin.toml import Fraction, NonNegative, Positive, Sourced, Strict, describe, read_toml

FieldAngle = Annotated[float, Field(gt=0, lt=170)]
GridSize = Annotated[int, Field(ge=1, le=1024)]


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
    adc_bits: Sourced[Annotated[int, Field(ge=1, le=31)]]
    adc_full_scale_v: Sourced[Positive]
    adc_offset_v: Sourced[NonNegative]


class Acquisition(Strict):
    """Which patterns are shown, and for how long."""

    integration_time_s: Sourced[Positive]
    pattern_period_s: Sourced[Positive]
    n_patterns: Sourced[Annotated[int, Field(ge=1)]]
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


class System(Strict):
    """One complete optical system."""

    name: str
    description: str = ""
    emitter: Emitter
    filter: Filter
    optics: Optics
    detector: Detector
    readout: Readout
    acquisition: Acquisition
    sky: Sky | None = None

    @model_validator(mode="after")
    def _patterns_exist(self) -> "System":
        _ = self.patterns
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

    def values(self) -> list[tuple[str, Sourced[Any]]]:
        """Every value with its dotted name, in the file's order."""
        return [
            (f"{section}.{name}", getattr(part, name))
            for section in type(self).model_fields
            if isinstance(part := getattr(self, section), Strict)
            for name in type(part).model_fields
        ]


def load_system(name: str | Path) -> System:
    """A bundled system by name, or a user's own TOML file.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    path = _find(name)
    try:
        return System.model_validate(_with_base(path))
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error)}") from error


def system_names() -> list[str]:
    """Names of the bundled systems."""
    return sorted(path.stem for path in (catalog_folder() / "systems").glob("*.toml"))


def _find(name: str | Path) -> Path:
    bundled = catalog_folder() / "systems" / f"{name}.toml"
    path = Path(name)
    if bundled.is_file() and path.suffix != ".toml":
        return bundled
    if path.is_file():
        return path
    raise InputError(
        f"system: {str(name)!r} is neither a TOML file nor one of {', '.join(system_names())}"
    )


def _with_base(path: Path, seen: tuple[Path, ...] = ()) -> dict[str, Any]:
    content = read_toml(path)
    base = content.pop("base", None)
    if base is None:
        return content
    if path in seen:
        raise InputError(f"{path}: base: systems build on each other in a circle")
    sibling = path.parent / str(base)
    found = sibling if sibling.is_file() else _find(base)
    return _merged(_with_base(found, (*seen, path)), content)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        section = isinstance(value, dict) and "value" not in value
        known = base.get(key)
        merged[key] = _merged(known if isinstance(known, dict) else {}, value) if section else value
    return merged
