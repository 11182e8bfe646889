"""Sun and air."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from twin.errors import InputError
from twin.own_parts import OwnCode
from twin.toml import Finite, NonNegative, Positive, Sourced, Strict

#: Above the atmosphere the sun gives some 1.3e5 lx.
_Illuminance = Annotated[NonNegative, Field(le=1e7)]

#: Mean cosine of the lobe towards the light that stands for glory and internal reflection;
#: assumed, with a half width of some 10 deg. Its weight comes from the lidar ratio.
BACKWARD_ASYMMETRY = -0.8

_VAPOUR_J_PER_KG_K = 461.5
#: Clouds are supersaturated by less than 1 per cent; the rest is for rounded figures.
_SUPERSATURATED = 1.05


class Sky(Strict):
    """The sun a system is meant for; takes precedence over the scene's. A low sun is redder, with
    2.2 times as much at 1550 nm per lux at 10 deg.
    """

    alternatives: ClassVar = (("illuminance_lx",), ("sun_elevation_deg",))

    illuminance_lx: Sourced[_Illuminance] | None = None
    """On the plane normal to the sun, with the direct spectrum of ASTM G-173 (that of a sun 42 deg
    high).
    """
    sun_elevation_deg: Sourced[Annotated[Finite, Field(ge=-90, le=90)]] | None = None
    """Height of the sun in a clear sky, which gives both illuminance and spectrum; negative: below
    the horizon.
    """

    @model_validator(mode="after")
    def _one_of_them(self) -> "Sky":
        if (self.illuminance_lx is None) == (self.sun_elevation_deg is None):
            raise InputError("needs either illuminance_lx or sun_elevation_deg")
        return self


class Weather(Strict):
    """The air between the devices and what they look at, the same everywhere.

    Extinction comes from what is named: fog, haze and clear air by their visibility, rain and snow
    by their rates, smoke by its mass per volume. They add up. Albedo, asymmetry and lidar ratio
    belong to the particles together; temperature, pressure and water vapour are the radar's.
    """

    visibility_m: Sourced[Annotated[Positive, Field(ge=1)]] | None = None
    """Distance of 2 % contrast at 550 nm in fog, haze or clear air."""
    visibility_model: Sourced[Literal["kim", "kruse"]] | None = None
    """How extinction at the emitter's wavelength follows from the visibility. Default: `kim`."""
    rain_mm_per_h: Sourced[Annotated[NonNegative, Field(le=1000)]] | None = None
    """Rate of rain. Default: none."""
    snow_mm_per_h: Sourced[Annotated[NonNegative, Field(le=1000)]] | None = None
    """Rate of snow, melted. Default: none."""
    snow_kind: Sourced[Literal["dry", "wet"]] | None = None
    """Needed with snow."""
    smoke_kg_per_m3: Sourced[Annotated[NonNegative, Field(le=1)]] | None = None
    """Mass of smoke per volume. Default: none."""
    single_scattering_albedo: Sourced[Annotated[NonNegative, Field(le=1)]]
    """Share of the particles' extinction that is scattered; the rest is absorbed."""
    asymmetry: Sourced[Annotated[Finite, Field(gt=-1, lt=1)]]
    """Mean cosine of the scattering angle, of all particles together."""
    lidar_ratio_sr: Sourced[Positive] | None = None
    """Extinction over backscatter of all particles together. Default: the phase function is that of
    Henyey and Greenstein.
    """
    temperature_k: Sourced[Annotated[Positive, Field(ge=150, le=350)]] | None = None
    """Of the air, for the radar. Default: 288.15 K (ITU-R P.835)."""
    pressure_pa: Sourced[Annotated[Positive, Field(ge=1e3, le=2e5)]] | None = None
    """Of the air, for the radar. Default: 101 325 Pa (ITU-R P.835)."""
    water_vapour_kg_per_m3: Sourced[Annotated[NonNegative, Field(le=0.1)]] | None = None
    """Of the air, for the radar. Default: 7.5e-3 kg/m^3 (ITU-R P.835)."""
    function: Sourced[OwnCode] | None = None
    """A user's own air in place of all these laws: a class or function that makes a
    `twin.OwnWeather` of this section, whose numbers it may read, as `file.py:name`, the name of an
    entry point of the group `twin.weather`, or in Python itself.
    """

    @model_validator(mode="before")
    @classmethod
    def _leaves_particles_to_its_function(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("function") is None:
            return data
        unused = {"value": 0.0, "source": "not used: function says how air scatters"}
        return {"single_scattering_albedo": unused, "asymmetry": unused, **data}

    @model_validator(mode="after")
    def _says_what_is_needed(self) -> "Weather":
        if (self.snow_mm_per_h is None) != (self.snow_kind is None):
            raise InputError("snow needs both snow_mm_per_h and snow_kind")
        if self.visibility_model is not None and self.visibility_m is None:
            raise InputError("visibility_model needs visibility_m")
        return self

    @model_validator(mode="after")
    def _scatters_back_what_it_may(self) -> "Weather":
        albedo, ratio = self.single_scattering_albedo.value, self.lidar_ratio_sr
        if ratio is None or albedo == 0:
            return self
        g = self.asymmetry.value
        ends = (backward_phase(g, most_backward_share(g)), backward_phase(g))
        low, high = (1 / end / albedo if end else math.inf for end in ends)
        if not low <= ratio.value <= high:
            raise InputError(
                f"lidar_ratio_sr = {ratio.value:g}: expected {low:.3g} to {high:.3g} with this "
                "asymmetry and single_scattering_albedo"
            )
        return self

    @model_validator(mode="after")
    def _holds_its_vapour(self) -> "Weather":
        if self.temperature_k is None or self.water_vapour_kg_per_m3 is None:
            return self
        vapour, most = (
            self.water_vapour_kg_per_m3.value,
            saturated_kg_per_m3(self.temperature_k.value),
        )
        if vapour > _SUPERSATURATED * most:
            raise InputError(
                f"water_vapour_kg_per_m3 = {vapour:g}: air of {self.temperature_k.value:g} K holds "
                f"{most:.2g}"
            )
        return self


def most_backward_share(asymmetry: float) -> float:
    """Largest share of the backward lobe: beyond it nothing is left to keep the mean cosine."""
    ends = ((1 + sign * asymmetry) / (1 + sign * BACKWARD_ASYMMETRY) for sign in (1, -1))
    return min(*ends, 1.0) * (1 - 1e-6)


def backward_phase(asymmetry: float, share: float = 0.0) -> float:
    """Phase function at 180 degrees, 1/sr, of two lobes of Henyey and Greenstein (1941), of which
    the one towards the light has this share, at the mean cosine of both together.
    """
    forward = (asymmetry - share * BACKWARD_ASYMMETRY) / (1 - share)
    lobes = ((1 - share, forward), (share, BACKWARD_ASYMMETRY))
    return sum(part * (1 - g) / (4 * math.pi * (1 + g) ** 2) for part, g in lobes)


def saturated_kg_per_m3(temperature_k: float) -> float:
    """Water vapour in saturated air, over liquid water (Buck, J. Appl. Meteorol. 20, 1981)."""
    celsius = temperature_k - 273.15
    pressure_pa = 611.21 * math.exp(17.502 * celsius / (240.97 + celsius))
    return pressure_pa / (_VAPOUR_J_PER_KG_K * temperature_k)
