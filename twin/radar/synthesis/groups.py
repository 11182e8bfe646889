"""Groups of contributions that move nearly alike, as wide as is cheapest."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.radar.synthesis.contributions import Array, Contributions
from twin.radar.synthesis.times import times_of

Indices = NDArray[np.intp]

#: Subcarriers over which a group's common motion turns by the phase at their middle.
BLOCK = 64

#: Phase that rates in one group leave at the interval's end, at most: the candidates.
_SPREADS_RAD = (0.5, 2.0, 8.0, 32.0, np.inf)
_MOST_GROUPS = 256
_STEPS = 2**16  # of rates, to which groups are told apart
#: Cells of a matrix product, and of a sum, that take as long as one contribution at one time.
_CELLS, _SUMMED_CELLS = 70, 6
#: Subcarriers of a transform without its contributions, of three powers of falloff, likewise.
_TRANSFORMED = 3


@dataclass(frozen=True, eq=False)
class Group:
    """``members`` by index, the middle of their rates and accelerations, and the times (n_times,)
    that tell what is left of their motion.
    """

    members: Indices
    rate: float
    acceleration_per_s: float
    times_s: Array

    @property
    def moves(self) -> bool:
        """Whether there is a common motion."""
        return bool(self.rate or self.acceleration_per_s)

    def delays_at(self, times_s: Array) -> Array:
        """By how much the common motion lengthens delays from the interval's middle on."""
        moved: Array = (self.rate + self.acceleration_per_s / 2 * times_s) * times_s
        return moved


def groups_of(
    contributions: Contributions, waveform: OfdmWaveform, tolerance: float
) -> list[Group]:
    """What is at rest, and what moves, divided so that the whole takes least work."""
    moving = contributions.moving
    found, movers = [], np.flatnonzero(moving)
    if len(movers) < len(moving):
        found.append(Group(np.flatnonzero(~moving), 0.0, 0.0, np.zeros(1)))
    if len(movers):
        rates = contributions.delay_rate[movers]
        steps = _steps(rates, contributions.delay_acceleration_per_s[movers])
        divisions = _divisions(steps, waveform, tolerance)
        spans = min(divisions, key=lambda spans: _work(spans, steps, waveform))
        for members, span in zip(_members(movers, steps, spans), spans, strict=True):
            found.append(Group(members, span.rate, span.acceleration_per_s, span.times_s))
    return found


@dataclass(frozen=True, eq=False)
class _Steps:
    """What moves by its rates, in many steps that have any: ``step`` (n,) of each; how many they
    are, and between which rates and accelerations, each (n_steps,), ascending.
    """

    step: NDArray[np.uint16]
    count: Indices
    low: Array
    high: Array
    slowest: Array
    fastest: Array


def _steps(rates: Array, accelerations: Array) -> _Steps:
    first, last = rates.min(), rates.max()
    width = (last - first) / (_STEPS - 1)
    every = ((rates - first) / (width or 1.0)).astype(np.uint16)
    slowest, fastest = np.full(_STEPS, np.inf), np.full(_STEPS, -np.inf)
    np.minimum.at(slowest, every, accelerations)
    np.maximum.at(fastest, every, accelerations)
    count = np.bincount(every, minlength=_STEPS)
    some = np.flatnonzero(count)
    number = np.zeros(_STEPS, dtype=np.uint16)
    number[some] = np.arange(len(some))
    low = first + width * some
    high = np.minimum(low + width, last)
    return _Steps(number[every], count[some], low, high, slowest[some], fastest[some])


@dataclass(frozen=True, eq=False)
class _Span:
    """A group before its members are looked up: the first step and the one after its last."""

    start: int
    stop: int
    rate: float
    acceleration_per_s: float
    times_s: Array


def _work(spans: Sequence[_Span], steps: _Steps, waveform: OfdmWaveform) -> float:
    """In contributions at one time."""
    n, cells = waveform.n_subcarriers, waveform.n_subcarriers * waveform.n_slots
    work = 0.0
    for span in spans:
        count = len(span.times_s)
        work += count * (steps.count[span.start : span.stop].sum() + _TRANSFORMED * n)
        work += count * cells / _CELLS if count < waveform.n_slots else cells / _SUMMED_CELLS
    return work


def _divisions(steps: _Steps, waveform: OfdmWaveform, tolerance: float) -> Iterator[list[_Span]]:
    """By rate into groups of every spread, the widest being all in one."""
    latest = float(np.abs(waveform.slot_times_s).max())
    top = waveform.carrier_hz + waveform.bandwidth_hz / 2
    beside = BLOCK / 2 * waveform.subcarrier_spacing_hz
    for spread in _SPREADS_RAD:
        with np.errstate(divide="ignore"):
            width = float(spread / (np.pi * top * np.float64(latest)))
        starts = _starts(steps, width)
        if len(starts) > _MOST_GROUPS:
            continue
        stops = [*starts[1:], len(steps.low)]
        slowest = np.minimum.reduceat(steps.slowest, starts)
        fastest = np.maximum.reduceat(steps.fastest, starts)
        spans = []
        for start, stop, least, most in zip(starts, stops, slowest, fastest, strict=True):
            rate, half_rate = _middle(steps.low[start], steps.high[stop - 1])
            acceleration, half = _middle(least, most)
            linear = 2 * np.pi * latest * (top * half_rate + beside * abs(rate))
            square = np.pi * latest**2 * (top * half + beside * abs(acceleration))
            times = times_of(linear, square, waveform, tolerance)
            spans.append(_Span(start, stop, rate, acceleration, times))
        yield spans


def _starts(steps: _Steps, width: float) -> list[int]:
    """Steps that begin groups no wider; breaks off beyond the most groups."""
    starts = [0]
    while len(starts) <= _MOST_GROUPS:
        stop = int(np.searchsorted(steps.high, steps.low[starts[-1]] + width, side="right"))
        stop = max(stop, starts[-1] + 1)
        if stop == len(steps.high):
            break
        starts.append(stop)
    return starts


def _members(movers: Indices, steps: _Steps, spans: Sequence[_Span]) -> list[Indices]:
    """Of every group."""
    if len(spans) == 1:
        return [movers]
    number = np.repeat(np.arange(len(spans)), [span.stop - span.start for span in spans])
    whose = number.astype(np.uint8)[steps.step]
    order = np.argsort(whose, kind="stable")  # by radix
    return np.split(movers[order], np.cumsum(np.bincount(whose, minlength=len(spans)))[:-1])


def _middle(low: float, high: float) -> tuple[float, float]:
    """And half of what lies between."""
    return float(low + high) / 2, float(high - low) / 2
