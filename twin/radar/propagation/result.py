"""What finding paths comes to: single ones by name, dense echoes as arrays, roles, assumptions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.propagation.facets.convergence import BodyEcho
from twin.radar.propagation.facets.earlier import Traced
from twin.radar.propagation.scene.scattering_models import Assignment
from twin.radar.synthesis import Contributions


@dataclass(frozen=True)
class Path:
    """One way from the radar and back.

    ``via`` names the objects in order; ``amplitude`` is the wave relative to the sent one, antenna
    gains and losses included, without the phase of the delay; ``delay_rate`` (s/s) and
    ``delay_acceleration_per_s`` are the delay's derivatives. ``departure`` and ``arrival`` are
    unit vectors from the antenna to the first and the last object, in its own frame;
    ``departure_per_s`` and ``arrival_per_s`` their derivatives.
    """

    via: tuple[str, ...]
    target: str | None
    amplitude: complex
    delay_s: float
    delay_rate: float
    delay_acceleration_per_s: float
    departure: tuple[float, float, float]
    arrival: tuple[float, float, float]
    departure_per_s: tuple[float, float, float]
    arrival_per_s: tuple[float, float, float]

    @property
    def range_m(self) -> float:
        """Half the length."""
        return self.delay_s * C_M_PER_S / 2


def contributions_of_paths(paths: Sequence[Path]) -> Contributions:
    """Paths as the synthesis takes them."""
    return Contributions(
        amplitude=np.array([path.amplitude for path in paths], dtype=np.complex128),
        delay_s=np.array([path.delay_s for path in paths]),
        delay_rate=np.array([path.delay_rate for path in paths]),
        delay_acceleration_per_s=np.array([path.delay_acceleration_per_s for path in paths]),
        **{
            name: np.array([getattr(path, name) for path in paths]).reshape(-1, 3)
            for name in ("departure", "arrival", "departure_per_s", "arrival_per_s")
        },
    )


@dataclass(frozen=True)
class Heard:
    """What came back from one object: the number of contributions, or of ways to its table, and
    the power of their sum at the carrier over the sent one.
    """

    name: str
    contributions: int
    power: float


@dataclass(frozen=True)
class Propagation:
    """All paths, and how the scene was understood.

    ``surfaces`` and ``diffuse`` are echoes of meshes, and of their edges and rough surfaces, with
    the same conventions as a path's; at other carriers the former keep their amplitude, the latter
    grow with the wavelength, as paths do. ``heard`` sums both up per object. ``objects`` names
    what ``object_of_surface`` numbers, of each of ``surfaces`` the object that it was met at last.
    ``bodies``: those that scatter, the strongest first, with the errors estimated of their
    surfaces' echoes. ``traced``: what later frames may keep of this one, if that was asked for;
    ``kept``: share of the contributions of surfaces that is an earlier frame's.
    """

    paths: tuple[Path, ...]
    roles: tuple[Assignment, ...]
    assumptions: tuple[str, ...]
    surfaces: Contributions = field(default_factory=Contributions.none)
    diffuse: Contributions = field(default_factory=Contributions.none)
    heard: tuple[Heard, ...] = ()
    warnings: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    object_of_surface: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))
    bodies: tuple[BodyEcho, ...] = ()
    traced: Traced | None = None
    kept: float = 0.0

    @cached_property
    def echoes(self) -> Contributions:
        """All but the paths, at the first carrier."""
        return Contributions.joined([self.surfaces, self.diffuse])
