"""Echoes over an interval in which bodies turn, accelerate and pass near.

Every echo has its own delay over time, to second order about the instant at which it was traced.
What else changes, which facets are lit and how strongly, and delays beyond second order, is known
at that instant alone. Where a bound says that this is not enough, the scene is traced at several
instants, and in between echoes go over from one to the next, each with the phase of its own delay:

H(t) = sum_k w_k(t) sum_i a_i,k exp(-j 2 pi f tau_i,k(t)), w_k falling linearly to 0 at the instants
before and after t_k. Amplitudes change to first order about each instant, so that half of the
change from either side cancels: what is left is of second order.

Where one instant is taken, echoes at others are a check of it: direct ones, and coarsely those of a
few reflections. What they change by counts in the stated errors, and is warned of where it is more
than is permitted.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.decisions import UNIT
from twin.radar.propagation.elements_aside import with_elements_aside
from twin.radar.propagation.facets.convergence import percent, reference_levels
from twin.radar.propagation.interval.bounds import OVER_ANGLE, Change, largest_change, times_within
from twin.radar.propagation.interval.one_instant import checked
from twin.radar.propagation.interval.sums import by_body, over_level
from twin.radar.propagation.result import Instant, Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.scene import Scene

Array = NDArray[np.float64]

_SAMPLES = 9  # times within the interval at which motions are looked at
#: Spans between instants, at first and at most: 2^7 of 1.4 deg each are half a turn.
_MOST_SPANS = 2**7
#: Of a span, for which facets are divided so that each moves as one point: what changes to first
#: order cancels between both ends, so that division for all of it makes the echoes 30 times as many
#: and no more exact.
_FOLLOWED = 1 / 8
#: Of spans, at most, between whose ends the echo is compared with one traced in the middle.
_COMPARED = 5


def traced_interval(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: Propagation | None = None,
    *,
    keep: bool = False,
) -> Propagation:
    """Echoes of a burst whose middle is the scene's present, to ``radar_motion_tolerance``, with
    what antennas aside see otherwise in the stated errors.

    Parameters as of `trace`. Where one instant is enough, that is what it gives, bit for bit.
    Raises InputError as `trace` does.
    """
    found = _traced(scene, radar, fidelity, seed, earlier, keep=keep)
    return with_elements_aside(scene, radar, fidelity, seed, found)


def _traced(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: Propagation | None,
    *,
    keep: bool,
) -> Propagation:
    half_s = radar.burst_s / 2
    times = times_within(scene, half_s * np.linspace(-1, 1, _SAMPLES))
    worst = largest_change(scene, radar, times)
    if worst is None:
        return trace(scene, radar, fidelity=fidelity, seed=seed, earlier=earlier, keep=keep)
    permitted = fidelity.radar_motion_tolerance or fidelity.radar_tolerance
    began_s = perf_counter()
    spans = 2
    if worst.error <= permitted:
        found = trace(scene, radar, fidelity=fidelity, seed=seed, earlier=earlier, keep=keep)
        looked_s = perf_counter()
        left_out = checked(scene, radar, fidelity, found, worst, permitted)
        cost_s = perf_counter() - looked_s
        worst, spans = left_out.worst, left_out.spans
        found = replace(
            found,
            bodies=left_out.stated(found.bodies),
            warnings=found.warnings + left_out.remarks,
        )
        if worst.error <= permitted or fidelity.radar_motion_tolerance is None:
            decision = _decision(worst, permitted, False, cost_s)
            return replace(found, decisions=(*found.decisions, decision))
    spans = _spans(scene, radar, half_s, permitted, spans)
    step_s = 2 * half_s / spans
    search = _Search(scene, radar, fidelity, seed, step_s, earlier, keep)
    middle = search.at(0.0)
    for time in times_within(scene, step_s * (np.arange(spans + 1) - spans / 2)).tolist():
        search.at(time)
    errors = search.refine(permitted)
    cost_s = perf_counter() - began_s
    remarks, largest = middle.warnings, max(errors)
    if largest > permitted:
        remarks += (
            f"motion of {worst.name} within an interval: echoes between two instants are off by "
            f"{percent(largest)} %, asked for {percent(permitted)} % "
            "(fidelity.radar_motion_tolerance)",
        )
    between = zip(middle.bodies, errors[:-1], strict=True)
    return replace(
        middle,
        bodies=tuple(body.off_by(error) for body, error in between),
        instants=search.instants,
        decisions=(*middle.decisions, _decision(worst, permitted, True, cost_s)),
        warnings=remarks,
    )


def _spans(scene: Scene, radar: RadarDesign, half_s: float, permitted: float, least: int) -> int:
    """Number of spans, a power of two and not below ``least``, in each of which either end alone
    would be enough for the nearer half of it.
    """
    spans = 2 ** int(np.ceil(np.log2(least)))
    while spans < _MOST_SPANS:
        reach_s = half_s / spans * np.linspace(-1, 1, 3)
        starts = times_within(scene, half_s * (2 * np.arange(spans + 1) / spans - 1))
        errors = []
        for start in starts[:: max(1, len(starts) // _SAMPLES)].tolist():
            then = scene.after(start)
            worst = largest_change(then, radar, times_within(then, reach_s))
            errors.append(worst.error if worst else 0.0)
        if max(errors) <= permitted:
            break
        spans *= 2
    return spans


def _decision(worst: Change, permitted: float, taken: bool, cost_s: float) -> Decision:
    how = "turns" if worst.turned_rad * OVER_ANGLE > worst.bend_rad else "moves"
    effect = f"what changes within an interval beyond delays of second order: {worst.name} {how}"
    is_told = not taken and worst.changed == worst.error > permitted  # by the remarks of `checked`
    return Decision("radar", effect, worst.error, permitted, UNIT, taken, cost_s, is_told=is_told)


class _Search:
    """Instants of an interval that have been traced."""

    def __init__(
        self,
        scene: Scene,
        radar: RadarDesign,
        fidelity: Fidelity,
        seed: int,
        step_s: float,
        earlier: Propagation | None,
        keep: bool,
    ) -> None:
        self._scene, self._radar, self._fidelity, self._seed = scene, radar, fidelity, seed
        self._step_s, self._earlier, self._keep = step_s, earlier, keep
        self._traced: dict[float, Propagation] = {}

    def at(self, time_s: float) -> Propagation:
        """What is traced at a time, once."""
        if time_s not in self._traced:
            self._traced[time_s] = trace(
                self._scene.after(time_s),
                self._radar,
                fidelity=self._fidelity,
                seed=self._seed,
                earlier=self._earlier,
                keep=self._keep and self._earlier is None and time_s == 0,
                followed_s=_FOLLOWED * self._step_s,
            )
        return self._traced[time_s]

    @property
    def instants(self) -> tuple[Instant, ...]:
        """All of them in order."""
        times = sorted(self._traced)
        return tuple(Instant(time, self._traced[time].contributions) for time in times)

    def refine(self, permitted: float) -> list[float]:
        """Halve spans until echoes in between are within what is permitted; returns their errors,
        of every body, and last of what the middle does not hear.

        Compared in the middle of up to `_COMPARED` spans, where the scene is traced, root mean
        square over them; these instants are kept, so that the errors left are smaller.
        """
        while True:
            spans = list(pairwise(sorted(self._traced)))
            some = np.linspace(0, len(spans) - 1, _COMPARED).round().astype(int)
            found = [self._compared(*spans[k]) for k in np.unique(some)]
            off, exact = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
            floor = OF_NOISE * noise_amplitude(self._radar)
            level = reference_levels(exact, self._fidelity.radar_tolerance, floor)
            errors = over_level(off, level)
            if errors.max() <= permitted or 2 * len(spans) > _MOST_SPANS:
                return list(errors.tolist())
            for start, end in spans:
                self.at((start + end) / 2)

    def _compared(
        self, start_s: float, end_s: float
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Of each body over the band, half way: the echo in between less that traced, and that."""
        middle_s = (start_s + end_s) / 2
        ends = [self._traced[start_s], self._traced[end_s]]
        moved = [
            replace(end.contributions, delay_s=end.contributions.delays_at(middle_s - time))
            for end, time in zip(ends, (start_s, end_s), strict=True)
        ]
        between = sum(
            self._by_body(end, echoes) for end, echoes in zip(ends, moved, strict=True)
        ) * np.complex128(0.5)
        there = self.at(middle_s)
        exact = self._by_body(there, there.contributions)
        return between - exact, exact

    def _by_body(self, found: Propagation, echoes: Contributions) -> NDArray[np.complex128]:
        """As of the middle's bodies."""
        return by_body(self._radar, self._traced[0.0].bodies, found, echoes)


def weights(instants_s: Sequence[float], times_s: Array) -> Array:
    """Of each instant at times, (n_instants, n_times): they fall linearly to the neighbours'
    instants, and stay 1 beyond the first and the last.
    """
    one: Array = np.array([np.interp(times_s, instants_s, row) for row in np.eye(len(instants_s))])
    return one
