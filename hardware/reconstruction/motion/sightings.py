"""Which of the objects that a radar tells move in a camera's image, and where their edges are.

A radar tells distance, direction and velocity, not how large an object is, and it sees what a
camera does not. So its objects are proposals: boxes about them are fitted to the measurements by
their `Evidence`, and only what makes the measurements likelier is taken.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction.measurements import measurements
from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.compensated import hardly_told
from hardware.reconstruction.motion.evidence import ALL_ROWS, REST, Evidence
from hardware.reconstruction.motion.layers import Layers, MovingBox
from hardware.reconstruction.motion.model import Motion
from hardware.reconstruction.motion.timing import exposure_times_s, middle_ns, timed_rows
from hardware.records import SpiRecord

#: Least gain of the log-likelihood by all of a motion over rest, and over the opposite one: detail
#: that the prior does not expect makes any motion likelier than rest, but forth as much as back.
#: And by each object in it, which is to be shown twice, so that many chances do not make a motion.
EVIDENCE, _EACH = 30.0, 5.0
#: Share of a box that an edge is moved by, outwards and inwards, in each round.
_ROUNDS = (0.3, 0.3, 0.12, 0.06)
#: Shares of its distance that a background is moved by, to and fro.
_DISTANCES = (0.2, 0.1, 0.05)
#: Objects that are looked at, the nearest first.
MOST_OBJECTS = 6


@dataclass(frozen=True)
class Sighting:
    """An object that a radar tells, as a box of a camera's image at the reference time.

    Parameters
    ----------
    edges_cells
        Top, left, bottom and right, to begin with; the first cell from -0.5 to 0.5.
    motion
        Of the plane that it is taken as.
    across_error_m_per_s
        Standard error of its velocity to the left.
    offset_errors
        Velocity to the left beside that of the radar, in standard errors.
    """

    edges_cells: tuple[float, float, float, float]
    motion: PlaneMotion
    across_error_m_per_s: float
    offset_errors: float = 0.0

    def box(self, part: tuple[float, float] = (1.0, 1.0)) -> MovingBox:
        """In an image whose cells are so many of these high and wide."""
        top, left, bottom, right = (
            np.rint(2 * edge + 1) / 2 / n - 0.5  # as the unknowns of the image have them
            for edge, n in zip(self.edges_cells, part * 2, strict=True)
        )
        ahead, across, up = self.motion.velocity_m_per_s
        across += self.offset_errors * self.across_error_m_per_s
        moving = replace(self.motion, velocity_m_per_s=(ahead, across, up))
        return MovingBox(top, left, bottom, right, moving)

    @property
    def reversed(self) -> "Sighting":
        """On its way back."""
        return replace(self, motion=_reversed_plane(self.motion), offset_errors=-self.offset_errors)

    def variants(self, share: float) -> "Iterator[Sighting]":
        """With an edge moved by a share of the box, or another velocity."""
        top, left, bottom, right = self.edges_cells
        for edge, size, k in (
            (left, right - left, 1),
            (right, left - right, 3),
            (top, bottom - top, 0),
            (bottom, top - bottom, 2),
        ):
            for sign in (-1, 1):
                edges = [top, left, bottom, right]
                edges[k] = edge + sign * share * size
                yield replace(self, edges_cells=(edges[0], edges[1], edges[2], edges[3]))
        for sign in (-1, 1):
            step = sign * share / _ROUNDS[0]
            yield replace(self, offset_errors=self.offset_errors + step)


def _reversed(behind: Motion) -> Motion:
    return _reversed_plane(behind) if isinstance(behind, PlaneMotion) else behind


def _reversed_plane(motion: PlaneMotion) -> PlaneMotion:
    ahead, across, up = motion.velocity_m_per_s
    roll, pitch, yaw = motion.turn_rad_per_s
    return replace(
        motion, velocity_m_per_s=(-ahead, -across, -up), turn_rad_per_s=(-roll, -pitch, -yaw)
    )


@dataclass(frozen=True)
class SupportedMotion:
    """The motion that measurements support, None: rest; its gain of log-likelihood over rest and
    over its opposite, and what was asked of it; how many of the objects proposed are in it;
    whether anything was tried, and why the measurements may not tell any motion.
    """

    motion: Motion | None
    evidence: float
    objects: int
    warnings: tuple[str, ...] = ()
    asked: float = EVIDENCE
    tried: bool = True


def supported_motion(
    evidence: Evidence,
    cells: tuple[int, int],
    backgrounds: tuple[Motion, ...],
    sightings: tuple[Sighting, ...],
    whole: Evidence | None = None,
) -> SupportedMotion:
    """The likeliest motion of a background and of objects before it, if it is likelier than rest,
    and than the opposite motion.

    ``cells`` are the image's rows and columns, ``backgrounds`` what the background may do beside
    resting, and ``sightings`` the objects proposed, the nearest first. What is found by
    ``evidence`` must not be refuted by ``whole``, of more measurements: a box that is too large
    moves detail of the background, of which the coarsest of them tell little. Where it is less
    likely than rest by these, edges are fitted to all of them.
    """
    if not (backgrounds or sightings):
        return SupportedMotion(None, 0.0, 0, tried=False)
    part = cells[0] / evidence.shape[0], cells[1] / evidence.shape[1]
    search, objects = _Search(evidence, part), sightings[:MOST_OBJECTS]
    behind = min(backgrounds, key=lambda one: search.cost(one, objects), default=REST)
    objects = search.fitted(behind, objects)
    behind = min((behind, *backgrounds), key=lambda one: search.cost(one, objects))
    behind = search.placed(behind, objects)
    found = search.believed(behind, objects)
    if found.motion is None or whole is None:
        return found
    search = _Search(whole, part)
    gain = search.gain(behind, objects)
    if gain > 0:
        return found
    again = search.believed(behind, search.fitted(behind, objects))
    return found if again.motion is None and gain > -EVIDENCE else again


@dataclass(frozen=True)
class _Search:
    evidence: Evidence
    part: tuple[float, float]

    def cost(self, behind: Motion, objects: tuple[Sighting, ...]) -> float:
        """Minus the log of likelihood, of the radar's own knowledge, and what an object takes."""
        boxes = tuple(one.box(self.part) for one in objects)
        prior = sum(one.offset_errors**2 / 2 + _EACH for one in objects)
        return self.evidence.cost(Layers(behind, boxes) if boxes else behind) + prior

    def gain(self, behind: Motion, objects: tuple[Sighting, ...]) -> float:
        """Of log-likelihood over rest and over the opposite motion."""
        back = self.cost(_reversed(behind), tuple(one.reversed for one in objects))
        return float(min(self.evidence.cost(REST), back) - self.cost(behind, objects))

    def believed(self, behind: Motion, objects: tuple[Sighting, ...]) -> SupportedMotion:
        """A motion, if its gain is what is asked of it."""
        gain, asked = self.gain(behind, objects), EVIDENCE + _EACH * len(objects)
        if gain < asked:
            return SupportedMotion(None, gain, 0, asked=asked)
        boxes = tuple(one.box() for one in objects)
        motion = Layers(behind, boxes) if boxes else behind
        return SupportedMotion(motion, gain, len(boxes), asked=asked)

    def placed(self, behind: Motion, objects: tuple[Sighting, ...]) -> Motion:
        """A background at the distance that fits better, with the objects as they are."""
        for share in _DISTANCES if isinstance(behind, PlaneMotion) else ():
            assert isinstance(behind, PlaneMotion)
            depths = [behind.depth_m * part for part in (1.0, 1 + share, 1 / (1 + share))]
            tried = [replace(behind, depth_m=depth) for depth in depths]
            behind = min(tried, key=lambda one: self.cost(one, objects))
        return behind

    def fitted(self, behind: Motion, objects: tuple[Sighting, ...]) -> tuple[Sighting, ...]:
        """Objects with edges and velocities that fit better, without those that explain nothing."""
        cost = self.cost(behind, objects)
        for n, share in enumerate(_ROUNDS):
            for one in objects:
                k = objects.index(one)
                near, far = objects[:k], objects[k + 1 :]
                tried = [(*near, other, *far) for other in one.variants(share)]
                if n > 0:  # after all have had their edges fitted
                    tried.append(near + far)
                costs = [self.cost(behind, each) for each in tried]
                if min(costs) < cost:
                    cost, objects = min(costs), tried[int(np.argmin(costs))]
        return objects


def motion_by_sightings(
    record: SpiRecord, backgrounds: tuple[Motion, ...], sightings: tuple[Sighting, ...]
) -> SupportedMotion:
    """`supported_motion` of a camera's record, its middle the reference time; rest, and why, where
    the order of the patterns hardly tells motion.

    Raises InputError for patterns that are no rows of the Hadamard matrix.
    """
    received = record.received
    patterns = received.patterns
    if not isinstance(patterns, PatternSet):
        raise InputError(
            "motion: needs rows of the Hadamard matrix, these patterns are a user's own"
        )
    time_s = exposure_times_s(received, middle_ns(record))
    timed = timed_rows(patterns, received.electrons, time_s, pairs_apart=False)
    if told := tuple(hardly_told(patterns, timed)):
        return SupportedMotion(None, 0.0, 0, told, tried=False)
    noise = measurements(received).noise_variance
    evidence = Evidence.of(patterns, timed, noise)
    whole = Evidence.of(patterns, timed, noise, ALL_ROWS)
    more = whole if whole.timed.count > evidence.timed.count else None
    cells = patterns.rows, patterns.columns
    return supported_motion(evidence, cells, backgrounds, sightings, more)
