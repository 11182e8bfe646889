"""What is driven: a scene, its sensors, their clocks, and when each of them measures."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path

from twin.camera.stream import moves
from twin.digest import digest, source_digest, versions
from twin.drive.clocks import DeviceClock
from twin.errors import InputError, check_seed
from twin.fidelity import Accuracy, Fidelity, knobs_of_sensors
from twin.radar import RadarDesign
from twin.scene import Scene
from twin.system import System

#: Of one drive, and of a period; at 1e9 s a float64 still tells 1e-7 s.
_LONGEST_S = 1e6
#: A clock without offset and drift.
ON_TIME = DeviceClock()


@dataclass(frozen=True, order=True)
class Event:
    """A measurement of a drive: number ``number`` of its kind, complete at ``end_ns`` of the
    reference; with both sensors at the same time in the order camera, radar, truth.
    """

    end_ns: int
    order: int
    kind: str = field(compare=False)
    number: int = field(compare=False)
    begin_ns: int = field(compare=False)

    @property
    def middle_ns(self) -> int:
        """Between beginning and end."""
        return (self.begin_ns + self.end_ns) // 2


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive, as far as what it records depends on it.

    Parameters
    ----------
    scene, system, radar
        The world from its own instant on; the camera and the radar, None for one that is not there.
    duration_s
        All that is complete by then is recorded.
    fidelity
        Of both sensors, as `twin.run` takes it: knobs, a preset's name, or a `Tolerance`.
    seed
        Of every random draw: frame k of a sensor depends on it and on k alone.
    radar_period_s
        From the beginning of one burst of the radar to the next, of its own clock.
    truth_period_s
        From one sample of the objects' states to the next; those of frames and bursts come beside.
    camera_clock, radar_clock
        Of the devices.

    Raises InputError for a duration in which no sensor measures anything, or which a trajectory
    does not cover, and for an accuracy that `twin.run` refuses.
    """

    scene: Scene
    system: System | None
    radar: RadarDesign | None
    duration_s: float
    fidelity: Accuracy | None
    seed: int = 0
    radar_period_s: float = 0.1
    truth_period_s: float = 0.1
    camera_clock: DeviceClock = ON_TIME
    radar_clock: DeviceClock = ON_TIME

    def __post_init__(self) -> None:
        if self.system is None and self.radar is None:
            raise InputError("system, radar: both are none, expected at least one of them")
        check_seed(self.seed)
        _ = self.knobs  # refused before time is spent
        if not 0 < self.duration_s <= _LONGEST_S:
            raise InputError(
                f"duration: {self.duration_s:g} s: expected a time above 0, up to {_LONGEST_S:g} s"
            )
        if not 1e-3 <= self.truth_period_s <= _LONGEST_S:
            raise InputError(
                f"truth period: {self.truth_period_s:g} s: expected 1 ms or more, up to "
                f"{_LONGEST_S:g} s"
            )
        if self.radar and not self.radar.burst_s <= self.radar_period_s <= _LONGEST_S:
            raise InputError(
                f"radar period: {self.radar_period_s:g} s: expected at least a burst of "
                f"{self.radar.name}, {self.radar.burst_s:g} s, up to {_LONGEST_S:g} s"
            )
        last_s = self.scene.span_s[1]
        if self.duration_s > last_s:
            raise InputError(
                f"duration: {self.duration_s:g} s: the trajectories of {self.scene.name} end after "
                f"{last_s:g} s"
            )
        if next((e for e in self.events() if e.kind != "truth"), None) is None:
            raise InputError(
                f"duration: {self.duration_s:g} s: shorter than the first frame of every sensor"
            )

    @cached_property
    def knobs(self) -> Fidelity:
        """Of both sensors, as the accuracy and the radar's bandwidth ask for."""
        return knobs_of_sensors(
            self.fidelity,
            camera=self.system is not None,
            bandwidth_hz=self.radar.total_bandwidth_hz if self.radar else None,
        )

    @property
    def moves(self) -> bool:
        """Whether anything does."""
        return moves(self.scene)

    def events(self) -> Iterator[Event]:
        """All measurements in the order in which they are complete."""
        end_ns = round(1e9 * self.duration_s)
        kinds = [self._truth()]
        if self.system is not None:
            frame_s = self.system.frame_time_s
            kinds.append(_events("camera", 0, frame_s, frame_s, self.camera_clock))
        if self.radar is not None:
            period_s, burst_s = self.radar_period_s, self.radar.burst_s
            kinds.append(_events("radar", 1, period_s, burst_s, self.radar_clock))
        for event in heapq.merge(*kinds):
            if event.end_ns > end_ns:
                return
            yield event

    def _truth(self) -> Iterator[Event]:
        for number in count():
            at_ns = self.truth_ns(number)
            yield Event(at_ns, 2, "truth", number, at_ns)

    def burst_ns(self, number: int) -> int:
        """Time of the middle of a radar's burst, when the world is what it measures."""
        assert self.radar is not None
        since_s = number * self.radar_period_s + self.radar.middle_s
        return self.radar_clock.reference_ns(round(1e9 * since_s))

    def truth_ns(self, number: int) -> int:
        """Time of a sample of the objects' states."""
        return round(number * 1e9 * self.truth_period_s)

    @property
    def digest(self) -> str:
        """Of all that the log's bytes depend on, this software and its engines among them."""
        packages = (Path(__file__).parents[1], Path(__file__).parents[2] / "hardware")
        return digest(replace(self, fidelity=self.knobs), versions(), source_digest(*packages))


def _events(
    kind: str, order: int, period_s: float, length_s: float, clock: DeviceClock
) -> Iterator[Event]:
    for number in count():
        begin = round(number * 1e9 * period_s)
        ends = begin + round(1e9 * length_s)
        yield Event(clock.reference_ns(ends), order, kind, number, clock.reference_ns(begin))
