"""Filter and lens."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from twin.errors import InputError
from twin.system.emitter import FieldAngle
from twin.toml import Fraction, NonNegative, Positive, Sourced, Strict

#: Range of the solar spectrum's table (ASTM G-173).
_SUN_BAND_M = (280e-9, 4000e-9)


class Filter(Strict):
    """Band-pass filter, flat inside its width."""

    limits: ClassVar = {"width_m": (1e-15, 1e-3)}

    center_wavelength_m: Sourced[Positive]
    """Middle of the pass band at normal incidence."""
    width_m: Sourced[Positive]
    """Full width of the pass band, which is flat."""
    transmission: Sourced[Fraction]
    """Transmission inside the band; with `transmission_csv` a factor beside the curve."""
    transmission_csv: Sourced[str] | None = None
    """File of the vendor's curve, wavelength and transmission, in place of the flat top."""
    effective_index: Sourced[Annotated[Positive, Field(gt=1)]] | None = None
    """Refractive index of the interference stack, which moves the band to shorter wavelengths with
    angle. Default: the band does not move.
    """
    place: Sourced[Literal["before lens", "behind lens"]] | None = None
    """`before lens` (default): light meets the filter at the angle of the field; `behind lens`: in
    the cone of the f-number.
    """

    @model_validator(mode="after")
    def _in_the_table(self) -> "Filter":
        center, half = self.center_wavelength_m.value, self.width_m.value / 2
        if not _SUN_BAND_M[0] <= center - half <= center + half <= _SUN_BAND_M[1]:
            raise InputError(
                f"band {center - half:g} to {center + half:g} m is outside the solar spectrum, "
                f"{_SUN_BAND_M[0]:g} to {_SUN_BAND_M[1]:g} m"
            )
        return self


#: A lens that obeys the sine condition has a pupil of 2 f sin(theta), at most twice its focal
#: length (Born and Wolf, Principles of Optics, section 4.5.1).
FASTEST_F_NUMBER = 0.5


class Optics(Strict):
    """Lens before the detector."""

    limits: ClassVar = {"f_number": (FASTEST_F_NUMBER, 1e6)}

    f_number: Sourced[Annotated[Positive, Field(ge=FASTEST_F_NUMBER)]]
    """Focal length over diameter of the pupil."""
    transmission: Sourced[Fraction]
    """Of the lens."""
    field_of_view_deg: Sourced[FieldAngle]
    """Full angle that the detector sees, from edge to edge."""
    field_stop: Sourced[Literal["matched", "detector", "scanned"]]
    """`matched`: the detector's area is spread over a square field; `detector`: the detector's own
    outline behind the lens is what is seen; `scanned`, of a raster scan: the area is spread over
    `receiver_cells` x `receiver_cells` cells around the lit one, which it follows.
    """
    receiver_cells: Sourced[Annotated[int, Field(strict=True, ge=1, le=1024)]] | None = None
    """Cells to a side that a scanned detector sees at one time. Default: 1."""
    edge_illumination: Sourced[Fraction] | None = None
    """Vignetting beyond cos^4: what is left of the light at the middle of the field's edge.
    Default: 1.
    """
    blur_rms_deg: Sourced[Annotated[NonNegative, Field(lt=45)]] | None = None
    """Standard deviation of the lens's Gaussian blur, some 0.1 deg for a Fresnel lens. Default:
    none.
    """
    focus_m: Sourced[Positive] | None = None
    """Distance at which the lens is focused, with a pupil of its true size. Default: a pinhole in
    position, in focus everywhere. Of surfaces nearer than 100 of its radii its area is taken into
    account by a form factor, whose error is warned of.
    """

    @model_validator(mode="after")
    def _cells_are_of_a_scan(self) -> "Optics":
        if self.receiver_cells is not None and not self.is_scanned:
            raise InputError(
                f"receiver_cells = {self.receiver_cells.value}: belongs to field_stop scanned"
            )
        return self

    @property
    def is_scanned(self) -> bool:
        """Whether the detector's field follows the lit cell."""
        return self.field_stop.value == "scanned"
