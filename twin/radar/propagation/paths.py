"""What finding paths comes to: single ones by name, dense echoes as arrays, roles, assumptions."""

from dataclasses import dataclass, field

from hardware.waveform import C_M_PER_S
from twin.radar.propagation.roles import Assignment
from twin.radar.synthesis import Contributions


@dataclass(frozen=True)
class Path:
    """One way from the radar and back.

    ``via`` names the objects in order; ``amplitude`` is the wave relative to the sent one, antenna
    gains and losses included, without the phase of the delay. ``departure`` and ``arrival`` are
    unit vectors from the antenna to the first and the last object, in its own frame.
    """

    via: tuple[str, ...]
    target: str | None
    amplitude: complex
    delay_s: float
    delay_rate: float
    departure: tuple[float, float, float]
    arrival: tuple[float, float, float]

    @property
    def range_m(self) -> float:
        """Half the length."""
        return self.delay_s * C_M_PER_S / 2


@dataclass(frozen=True)
class Heard:
    """What came back from one object over all its rays: their number, and the power of their sum
    at the carrier over the sent one.
    """

    name: str
    rays: int
    power: float


@dataclass(frozen=True)
class Propagation:
    """All paths, and how the scene was understood.

    ``echoes`` are those of meshes and rough surfaces, with the same conventions as a path's;
    ``heard`` sums them up per object.
    """

    paths: tuple[Path, ...]
    roles: tuple[Assignment, ...]
    assumptions: tuple[str, ...]
    echoes: Contributions = field(default_factory=Contributions.none)
    heard: tuple[Heard, ...] = ()
    warnings: tuple[str, ...] = ()
