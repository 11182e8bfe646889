"""Knobs of the camera chain."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self

from twin.fidelity.knobs import Knobs, one_of, optional_tolerance, whole
from twin.optics.paths import RAYS, TracingQuality

Noise = Literal["none", "gaussian", "full"]
Start = Literal["auto", "dual", "scatter"]


def _named_side(one: Start, other: Start) -> Start:
    """The side to start from, when only one of the two names it: neither is stricter."""
    return one if other == "auto" else other


@dataclass(frozen=True)
class LightFidelity(Knobs):
    """Knobs of the camera chain.

    samples
        Paths per cell, a square number: noise of direct light, falling as samples^-0.75.
    max_depth
        Bounces of light: light of further ones, up to the reflectance's next power, is lost.
    indirect_samples
        Paths per cell for further bounces: their noise, falling as samples^-0.5. Default: a
        quarter of ``samples``.
    start
        Side on which paths to a line sensor start: noise alone, for the same number of paths.
        ``auto`` is the side with more cells.
    light_tolerance
        Error that light transport may add to the image, root mean square over the cells, as a share
        of the noise of a pixel, or of a quarter of the image's own root mean square where that is
        less (a sensor far below its noise): paths are added cell by cell until their own scatter
        says that it is less, and bounces end by chance, so that no light is lost; ``samples``,
        ``max_depth`` and ``indirect_samples`` then do not count. Line sensors and time of flight
        have as many paths in every cell, and bounces up to ``max_depth``. Indirect light is left
        out where a bound of it is below a tenth of the tolerance. None: as many paths as
        ``samples`` says.
    light_rays
        Rays to surfaces that all paths of a render to a tolerance take at most, three quarters of
        them for the emitter's light and one for the sun's: some minute of one core. After these
        light is as exact as they made it: the error that was reached is stated, and warned of. A
        number of rays, not a time, so that the same light follows on every machine. A first look is
        taken even with 1. More of them also let each cell have more paths, and each path more
        bounces, in proportion. Each part of the light that changes during a frame, direct and
        indirect, has as many again.
    light_tolerance_relative
        The same as a share of the light itself: of each cell's, or of the cells' mean where that is
        more. With both, each cell's error is within the stricter one.
    motion_tolerance
        Error of an exposure's light by interpolation between instants, where something moves during
        a frame, root mean square over patterns, as a share of the exposure's noise: light is
        rendered at as many instants as that takes, each cell at its own, and at none where motion
        changes counts by less. None, or "none" in a study: nothing moves during a frame, with a
        warning where motion may change counts by more than their noise.
    noise
        ``none``: counts of the mean, rounded. ``gaussian``: shot noise as a normal distribution,
        wrong in shape below some 100 electrons. ``full``: Poisson.
    air_orders
        Scatterings that are followed in the air on the way to a surface, and as many back: light of
        more is lost. Of a wall's light, at an optical depth of 1 each way, less than 0.1 % (mean
        cosine 0.85) and 0.6 % (0); at 3 0.8 % and 43 %, a systematic error. 0: what is scattered
        forward stays in its cell, whose contrast is then too high by the optical depth.
    """

    samples: int = field(default=64, metadata=whole(1))
    max_depth: int = field(default=4, metadata=whole(1))
    indirect_samples: int | None = field(default=None, metadata=whole(1, optional=True))
    start: Start = field(default="auto", metadata=one_of(Start, _named_side))
    light_tolerance: float | None = field(default=None, metadata=optional_tolerance(1e-4, 10.0))
    light_tolerance_relative: float | None = field(
        default=None, metadata=optional_tolerance(1e-5, 1.0)
    )
    light_rays: int = field(default=RAYS, metadata=whole(1, most=10**14))
    motion_tolerance: float | None = field(default=0.1, metadata=optional_tolerance(1e-4, 10.0))
    noise: Noise = field(default="full", metadata=one_of(Noise))
    air_orders: int = field(default=12, metadata=whole(0))

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.quality  # has its own checks

    def _said(self) -> Self:
        return replace(self, indirect_samples=self.quality.further_samples)

    @property
    def has_light_tolerance(self) -> bool:
        """Whether light is rendered to an error instead of with a number of paths."""
        return self.light_tolerance is not None or self.light_tolerance_relative is not None

    @property
    def quality(self) -> TracingQuality:
        """Knobs of the path tracer."""
        return TracingQuality(
            self.samples, self.max_depth, self.indirect_samples, self.air_orders, self.light_rays
        )
