"""What tracing a scene comes to: contributions, some of them paths by name; roles, assumptions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hardware.described import Described
from hardware.read_only import cached_read_only
from hardware.waveform import C_M_PER_S
from twin.accuracy import Decision
from twin.radar.propagation.facets.convergence import BodyEcho
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.scene.scattering_models import Assignment
from twin.radar.synthesis import Contributions


@dataclass(frozen=True)
class PathName:
    """Names of the objects that a path meets, in order, and of its target if it has one."""

    via: tuple[str, ...]
    target: str | None = None


@dataclass(frozen=True)
class Path(PathName):
    """One contribution, by name: figures as of `Contributions`, gains and losses included."""

    amplitude: complex = 0j
    delay_s: float = 0.0
    delay_rate: float = 0.0
    delay_acceleration_per_s: float = 0.0
    departure: tuple[float, ...] = (0.0, 0.0, 0.0)
    arrival: tuple[float, ...] = (0.0, 0.0, 0.0)
    departure_per_s: tuple[float, ...] = (0.0, 0.0, 0.0)
    arrival_per_s: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def range_m(self) -> float:
        """Half the length."""
        return self.delay_s * C_M_PER_S / 2


@dataclass(frozen=True)
class Heard:
    """What came back from one object: the number of contributions, or of paths to its table, and
    the power of their sum at the carrier over the sent one.
    """

    name: str
    contributions: int
    power: float


@dataclass(frozen=True, eq=False)
class Instant:
    """Contributions traced at a time after an interval's middle, from which their delays count."""

    time_s: float
    contributions: Contributions


@dataclass(frozen=True, repr=False)
class Propagation(Described):
    """All contributions, and how the scene was understood.

    ``names``: of the first contributions, which are single paths, the nearest first. ``heard`` sums
    up the others per object. ``objects`` names what ``object`` of the contributions numbers, but of
    paths. ``bodies``: those that scatter, the strongest first, with the errors estimated of their
    surfaces' echoes. ``decisions``: what was taken or left out, with the bounds that decided.
    ``instants``: where an interval was traced at several, those of all in order, between which its
    echoes go over; all else is told of its middle.
    ``traced``: what later frames may keep of this one, if that was asked for;
    ``reused_share``: share of the contributions of surfaces that is an earlier frame's.
    """

    contributions: Contributions = field(default_factory=Contributions.none)
    names: tuple[PathName, ...] = ()
    roles: tuple[Assignment, ...] = ()
    assumptions: tuple[str, ...] = ()
    heard: tuple[Heard, ...] = ()
    warnings: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    bodies: tuple[BodyEcho, ...] = ()
    decisions: tuple[Decision, ...] = ()
    traced: TracedFrame | None = None
    reused_share: float = 0.0
    instants: tuple[Instant, ...] = ()

    @cached_property
    def paths(self) -> tuple[Path, ...]:
        """Single paths, for tables and reports."""
        c = self.contributions.take(slice(len(self.names)))
        columns = (
            c.amplitude.tolist(),
            c.delay_s.tolist(),
            c.delay_rate.tolist(),
            c.delay_acceleration_per_s.tolist(),
            *(map(tuple, c.departure.tolist()), map(tuple, c.arrival.tolist())),
            *(map(tuple, c.departure_per_s.tolist()), map(tuple, c.arrival_per_s.tolist())),
        )
        rows = zip(self.names, *columns, strict=True)
        return tuple(Path(name.via, name.target, *values) for name, *values in rows)

    @cached_read_only
    def echoes(self) -> Contributions:
        """All but the paths: of surfaces, of tables, of edges and of rough surfaces."""
        return self.contributions.take(slice(len(self.names), None))

    @cached_read_only
    def surfaces(self) -> Contributions:
        """Of these, what no carrier step changes in proportion to the wavelength."""
        return self.echoes.take(np.flatnonzero(self.echoes.wavelength_power == 0))


def by_delay(
    names: Sequence[PathName], paths: Contributions
) -> tuple[tuple[PathName, ...], Contributions]:
    """Paths, the nearest first, without those of which nothing comes back."""
    some = np.flatnonzero(paths.amplitude)
    order = some[np.argsort(paths.delay_s[some], kind="stable")]
    return tuple(names[k] for k in order), paths.take(order).in_proportion_to_wavelength()
