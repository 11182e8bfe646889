"""Knobs of both chains in one object, and the presets."""

from dataclasses import dataclass

from twin.errors import InputError
from twin.fidelity.knobs import is_number
from twin.fidelity.light import LightFidelity
from twin.fidelity.radar import RadarFidelity


@dataclass(frozen=True)
class Fidelity(RadarFidelity, LightFidelity):
    """Knobs of both chains, those of light first. ``a | b`` takes the stricter of each.

    >>> fine = PRESETS["draft"] | Fidelity(radar_tolerance=0.03)
    >>> fine.samples, fine.radar_tolerance
    (64, 0.03)
    """

    @classmethod
    def within(cls, share: float) -> "Fidelity":
        """Knobs for a model error of a share of the sensors' own noise, 0.002 to 2.

        Light: as `light_tolerance`, root mean square over the image. Radar: half of it as
        `radar_tolerance`, relative to each body's own echo: echoes may stand far above the noise,
        and their model as exact as that would take hours. Reflections are followed as far as bounds
        of what further ones add ask for, and edges diffract where a bound says that they count.

        >>> knobs = Fidelity.within(0.2)
        >>> knobs.light_tolerance, knobs.radar_tolerance
        (0.2, 0.1)
        """
        if not is_number(share) or not 0.002 <= share <= 2:
            raise InputError(f"tolerance: {share!r:.60} is not in 0.002 to 2")
        return cls(
            light_tolerance=share,
            radar_tolerance=share / 2,
            radar_bounces=None,
            radar_images=None,
            radar_edges=None,
        )


#: A look at a design; most cells far below the sensor's own noise, though on the yard the rms over
#: cells is half of it (`twin trade` measures that); comparison.
PRESETS = {
    "draft": Fidelity(
        samples=4, max_depth=1, nufft_tolerance=1e-3, noise="gaussian", radar_tolerance=0.3
    ),
    "standard": Fidelity(),
    "reference": Fidelity(
        samples=1024,
        max_depth=8,
        nufft_tolerance=1e-10,
        radar="rough",
        radar_tolerance=0.03,
        radar_edges=2_000_000,
        radar_shadow_db=60.0,
        radar_shadowed=2000,
    ),
}


def preset(name: str | Fidelity) -> Fidelity:
    """A preset by name; a fidelity as it is. Raises InputError for a name that is none."""
    if isinstance(name, Fidelity):
        return name
    if name not in PRESETS:
        raise InputError(f"fidelity: {name!r} is none of {', '.join(PRESETS)}")
    return PRESETS[name]
