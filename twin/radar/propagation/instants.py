"""Echoes over an interval in which bodies turn, accelerate and pass near.

Every echo has its own delay over time, to second order about the instant at which it was traced.
What else changes, which facets are lit and how strongly, and delays beyond second order, is known
at that instant alone. Where a bound says that this is not enough, the scene is traced at several
instants, and in between echoes go over from one to the next, each with the phase of its own delay:

H(t) = sum_k w_k(t) sum_i a_i,k exp(-j 2 pi f tau_i,k(t)), w_k falling linearly to 0 at the instants
before and after t_k. Amplitudes change to first order about each instant, so that half of the
change from either side cancels: what is left is of second order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import band_of, percent, reference_levels, summed_by
from twin.radar.propagation.one_way.motion import RigidMotions, lengthening, radar_motion
from twin.radar.propagation.result import Instant, Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]

#: Change of an echo over the angle by which its body turns, in rad: of dihedrals, boxes and balls
#: 0.1 to 1.5.
_OVER_ANGLE = 1.5
_SAMPLES = 9  # times within the interval at which motions are looked at
#: Spans between instants, at first and at most: 2^7 of 1.4 deg each are half a turn.
_MOST_SPANS = 2**7
#: Of spans, between whose ends the echo is compared with one traced in the middle.
_COMPARED = 3


@dataclass(frozen=True)
class _Change:
    """What leaving motion within an interval to one instant does to the echo of an object, relative
    to it: by the phase beyond second order, and by the angle it turns.
    """

    name: str
    bend_rad: float
    turned_rad: float

    @property
    def error(self) -> float:
        """Both together."""
        return self.bend_rad + _OVER_ANGLE * self.turned_rad


def traced_interval(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    seed: int,
    earlier: Propagation | None = None,
    *,
    keep: bool = False,
) -> Propagation:
    """Echoes of a burst whose middle is the scene's present, to ``radar_motion_tolerance``.

    Parameters as of `trace`. Where one instant is enough, that is what it gives, bit for bit.
    Raises InputError as `trace` does.
    """
    half_s = radar.burst_s / 2
    times = _within(scene, half_s * np.linspace(-1, 1, _SAMPLES))
    worst = _worst(scene, radar, times)
    if worst is None:
        return trace(scene, radar, fidelity=fidelity, seed=seed, earlier=earlier, keep=keep)
    permitted = fidelity.radar_motion_tolerance or fidelity.radar_tolerance
    if worst.error <= permitted:
        found = trace(scene, radar, fidelity=fidelity, seed=seed, earlier=earlier, keep=keep)
        return replace(found, decisions=(*found.decisions, _decision(worst, permitted, False)))
    began_s = perf_counter()
    spans = _spans(scene, radar, half_s, permitted)
    step_s = 2 * half_s / spans
    search = _Search(scene, radar, fidelity, seed, step_s, earlier, keep)
    middle = search.at(0.0)
    for time in _within(scene, step_s * (np.arange(spans + 1) - spans / 2)).tolist():
        search.at(time)
    error = search.refine(permitted)
    cost_s = perf_counter() - began_s
    remarks = middle.warnings
    if error > permitted:
        remarks += (
            f"motion of {worst.name} within an interval: echoes between two instants are off by "
            f"{percent(error)} %, asked for {percent(permitted)} % "
            "(fidelity.radar_motion_tolerance)",
        )
    return replace(
        middle,
        instants=search.instants,
        decisions=(*middle.decisions, _decision(worst, permitted, True, cost_s)),
        warnings=remarks,
    )


def _within(scene: Scene, times_s: NDArray[np.floating]) -> Array:
    """Different times, those beyond the scene's trajectories at their ends."""
    times: Array = np.unique(np.clip(times_s.astype(np.float64), *scene.span_s))
    return times


def _worst(scene: Scene, radar: RadarDesign, times_s: Array) -> _Change | None:
    """The largest change within an interval; None where nothing moves."""
    items = [item for item in scene.objects if item.moves or scene.rig.moves]
    changes = [_change(scene, item, radar, times_s) for item in items if len(item.geometry.faces)]
    return max(changes, key=lambda change: change.error, default=None)


def _change(scene: Scene, item: SceneObject, radar: RadarDesign, times_s: Array) -> _Change:
    """Of the way to the corners of the box of an object and back, and of the angles that it and the
    rig turn by.
    """
    own, rig = item.course.at(times_s), scene.rig.course.at(times_s)
    low, high = item.geometry.vertices_m.min(axis=0), item.geometry.vertices_m.max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    here = scene.rig.position_m + scene.rig.device("radar")[0]
    mounted = scene.rig.pose.rotation.inv().apply(here - scene.rig.position_m)
    exact = np.linalg.norm(own.of_points(corners)[0] - rig.of_points(mounted[None])[0], axis=2)
    places = item.pose.apply(corners) - here
    length = np.linalg.norm(places, axis=1)
    moving, radar_moves = RigidMotions.of([item], here).at(0, places), radar_motion(scene)
    rate, faster = lengthening(
        moving[0] - radar_moves.velocity_m_per_s,
        places / np.maximum(length, 1e-12)[:, None],
        length,
        moving[1] - radar_moves.acceleration_m_per_s2,
    )
    parabola = length + (rate + faster / 2 * times_s[:, None]) * times_s[:, None]
    bend = float(np.abs(exact - parabola).max())
    turned = [
        (state.pose.rotation * now.rotation.inv()).magnitude().max()
        for state, now in ((own, item.pose), (rig, scene.rig.pose))
    ]
    return _Change(item.name, 4 * np.pi * bend / radar.ofdm.wavelength_m, float(sum(turned)))


def _spans(scene: Scene, radar: RadarDesign, half_s: float, permitted: float) -> int:
    """Number of spans, a power of two, in each of which either end alone would be enough for the
    nearer half of it.
    """
    spans = 2
    while spans < _MOST_SPANS:
        reach_s = half_s / spans * np.linspace(-1, 1, 3)
        starts = _within(scene, half_s * (2 * np.arange(spans + 1) / spans - 1))
        errors = []
        for start in starts[:: max(1, len(starts) // _SAMPLES)].tolist():
            then = scene.after(start)
            worst = _worst(then, radar, _within(then, reach_s))
            errors.append(worst.error if worst else 0.0)
        if max(errors) <= permitted:
            break
        spans *= 2
    return spans


def _decision(worst: _Change, permitted: float, taken: bool, cost_s: float = np.nan) -> Decision:
    how = "turns" if worst.turned_rad * _OVER_ANGLE > worst.bend_rad else "moves"
    effect = f"what changes within an interval beyond delays of second order: {worst.name} {how}"
    return Decision("radar", effect, worst.error, permitted, "of the echo", taken, cost_s)


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
                followed_s=self._step_s,
            )
        return self._traced[time_s]

    @property
    def instants(self) -> tuple[Instant, ...]:
        """All of them in order."""
        times = sorted(self._traced)
        return tuple(Instant(time, self._traced[time].contributions) for time in times)

    def refine(self, permitted: float) -> float:
        """Halve spans until the echo in between is within what is permitted; returns its error.

        Compared in the middle of the first, the middle and the last span. An instant halves the
        error of amplitudes to a quarter: what is left is a quarter of what was found.
        """
        while True:
            times = np.array(sorted(self._traced))
            middles = (times[1:] + times[:-1]) / 2
            chosen = np.unique(np.linspace(0, len(middles) - 1, _COMPARED).round().astype(int))
            error = max(self._error(times[k], times[k + 1]) for k in chosen)
            if error <= permitted or 2 * len(middles) > _MOST_SPANS:
                return error
            for middle in middles.tolist():
                self.at(middle)

    def _error(self, start_s: float, end_s: float) -> float:
        """Of the echo half way, over the band, relative to that of each body."""
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
        floor = OF_NOISE * noise_amplitude(self._radar)
        level = reference_levels(exact, self._fidelity.radar_tolerance, floor)
        off = np.sqrt(np.mean(np.abs(between - exact) ** 2, axis=1)) / np.maximum(level, 1e-300)
        return float(off.max(initial=0.0))

    def _by_body(self, found: Propagation, echoes: Contributions) -> NDArray[np.complex128]:
        """Echoes summed by body in the order of the middle's, single paths together the last."""
        middle = self._traced[0.0]
        body_of = {
            name: number for number, body in enumerate(middle.bodies) for name in body.objects
        }
        count = len(middle.bodies) + 1
        of_object = np.array([body_of.get(name, -1) for name in found.objects], dtype=np.int64)
        owner = np.full(len(echoes), count - 1)
        dense = slice(len(found.names), None)
        if len(of_object):
            owner[dense] = of_object[echoes.object[dense]]
        wave = self._radar.ofdm
        return summed_by(owner, count, echoes, wave.carrier_hz, band_of(wave))


def weights(instants_s: Sequence[float], times_s: Array) -> Array:
    """Of each instant at times, (n_instants, n_times): they fall linearly to the neighbours'
    instants, and stay 1 beyond the first and the last.
    """
    one: Array = np.array([np.interp(times_s, instants_s, row) for row in np.eye(len(instants_s))])
    return one
