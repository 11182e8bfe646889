"""What throws the patterns."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from twin.errors import InputError
from twin.toml import Finite, Fraction, NonNegative, Positive, Sourced, Strict

#: Float32 directions have steps of 3e-6 deg: below, a cell's edges are lost in them.
FieldAngle = Annotated[Positive, Field(ge=2e-3, lt=170)]
GridSize = Annotated[int, Field(strict=True, ge=1, le=1024)]
#: What may be meant for light: a number in nm or um in place of m is beyond.
_WAVELENGTHS_M = (1e-7, 1e-4)
#: Bare elements are all told apart by a matrix of cells x cells.
_MOST_BARE = 4096


class Emitter(Strict):
    """Pattern projector: equal cells in a square field, lit or dark.

    With all cells lit it has ``radiant_intensity_w_per_sr`` on its axis and, without
    ``viewing_angle_deg``, in every direction of the field; a single lit cell has that same radiant
    intensity inside its own solid angle.
    """

    limits: ClassVar = {"peak_wavelength_m": _WAVELENGTHS_M, "line_fwhm_m": (1e-24, 1e-4)}

    rows: Sourced[GridSize]
    """Rows of cells, top to bottom."""
    columns: Sourced[GridSize]
    """Columns of cells, left to right; 1 with a line sensor, whose pixels are the columns."""
    field_of_view_deg: Sourced[FieldAngle]
    """Full angle of the square field that is lit, from edge to edge."""
    radiant_intensity_w_per_sr: Sourced[Annotated[NonNegative, Field(le=1e9)]]
    """Radiant intensity on the axis with all cells lit; of a single lit cell the same inside its
    own solid angle.
    """
    peak_wavelength_m: Sourced[Positive]
    """Wavelength at which the emission line peaks."""
    line_fwhm_m: Sourced[Positive]
    """Full width at half maximum of the emission line, a Gaussian."""
    spectrum_csv: Sourced[str] | None = None
    """File of the emission line as the vendor gives it, wavelength and any unit, in place of the
    Gaussian.
    """
    viewing_angle_deg: Sourced[FieldAngle] | None = None
    """Full angle at which a lobe cos^m has fallen to one half. Default: a flat field."""
    projection: Sourced[Literal["lens", "none"]] | None = None
    """`lens` (default) images each cell into the field; `none`: bare LEDs at `pitch_m`, each with
    its lobe over the whole field and its share of the radiant intensity.
    """
    pitch_m: Sourced[Positive] | None = None
    """Distance between bare LEDs; with `projection` none alone."""
    blur_rms_deg: Sourced[Annotated[NonNegative, Field(lt=45)]] | None = None
    """Standard deviation of the projection's Gaussian blur. Default: none."""
    fill_factor: Sourced[Fraction] | None = None
    """Share of a cell that is lit, a square in its middle, which holds all of the cell's light.
    Default: 1.
    """
    contrast_ratio: Sourced[Annotated[Finite, Field(gt=1)]] | None = None
    """Light of a lit cell over that of a dark one. Default: dark cells emit nothing."""
    intensity_spread: Sourced[Annotated[NonNegative, Field(lt=1)]] | None = None
    """Relative standard deviation of unequal cells. Default: all are equal."""
    intensity_seed: Sourced[Annotated[int, Field(strict=True, ge=0)]] | None = None
    """Seed of the draw that makes the cells unequal. Default: 0."""
    intensity_noise: Sourced[Annotated[NonNegative, Field(lt=1)]] | None = None
    """Relative fluctuation of the whole emitter from exposure to exposure, rms. Default: none."""
    switching_time_s: Sourced[Annotated[NonNegative, Field(le=1e3)]] | None = None
    """Time in which a cell is switched on or off, 10 to 90 %, exponential. Default: at once."""
    kind: Sourced[Literal["led", "laser"]] | None = None
    """For eye safety alone, `led` (IEC 62471) or `laser` (IEC 60825-1)."""
    source_diameter_m: Sourced[Positive] | None = None
    """For eye safety alone: diameter of the apparent source. Default: too small to be resolved, the
    worst case.
    """

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
