"""Knobs of both chains in one object, and the presets."""

from dataclasses import dataclass

from twin.fidelity.light import LightFidelity
from twin.fidelity.radar import RadarFidelity


@dataclass(frozen=True)
class Fidelity(RadarFidelity, LightFidelity):
    """Knobs of both chains, those of light first. ``a | b`` takes the stricter of each.

    >>> fine = PRESETS["draft"] | Fidelity(radar_tolerance=0.03)
    >>> fine.samples, fine.radar_tolerance
    (64, 0.03)
    """


#: A look at a design; most cells far below the sensor's own noise, though on the yard the rms over
#: cells is half of it (`twin trade` measures that); comparison.
PRESETS = {
    "draft": Fidelity(
        samples=4,
        max_depth=1,
        motion_tolerance=1.0,
        noise="gaussian",
        radar_tolerance=0.3,
    ),
    "standard": Fidelity(),
    "reference": Fidelity(
        samples=1024,
        max_depth=8,
        motion_tolerance=0.03,
        nufft_tolerance=1e-10,
        radar="rough",
        radar_tolerance=0.03,
        radar_bounces=None,
        radar_images=None,
        radar_edges=2_000_000,
        radar_shadow_db=60.0,
        radar_shadowed=2000,
    ),
}
