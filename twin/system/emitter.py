"""What throws the patterns."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.errors import InputError
from twin.toml import Finite, Fraction, NonNegative, Positive, Sourced, Strict

#: Float32 directions have steps of 3e-6 deg: below, a cell's edges are lost in them.
FieldAngle = Annotated[Positive, Field(ge=2e-3, lt=170)]
GridSize = Annotated[int, Field(strict=True, ge=1, le=1024)]
#: Bare elements are all told apart by a matrix of cells x cells.
_MOST_BARE = 4096


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
    def _line_is_at_its_peak(self) -> "Emitter":
        if self.line_fwhm_m.value >= self.peak_wavelength_m.value:
            raise InputError(
                f"line_fwhm_m = {self.line_fwhm_m.value:g} is wider than peak_wavelength_m, "
                f"{self.peak_wavelength_m.value:g}"
            )
        return self

    @model_validator(mode="after")
    def _bare_leds_are_described(self) -> "Emitter":
        if self.has_lens:
            if self.pitch_m is not None:
                raise InputError(
                    f"pitch_m = {self.pitch_m.value:g}: expected none behind a lens, where the "
                    "field of view says where cells are; bare LEDs have projection none"
                )
            return self
        if self.rows.value * self.columns.value > _MOST_BARE:
            raise InputError(f"rows x columns: at most {_MOST_BARE} elements without a lens")
        if self.pitch_m is None or self.viewing_angle_deg is None:
            raise InputError("projection none needs pitch_m and viewing_angle_deg")
        if self.blur_rms_deg is not None or self.fill_factor is not None:
            raise InputError("projection none: without a lens there is no blur and no fill factor")
        return self

    @property
    def has_lens(self) -> bool:
        """Whether cells are imaged into the field."""
        return self.projection is None or self.projection.value == "lens"
