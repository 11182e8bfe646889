"""Echoes over an interval in which bodies turn, accelerate and pass near.

Every echo has its own delay over time, to second order about the instant at which it was traced.
What else changes, which facets are lit and how strongly, and delays beyond second order, is known
at that instant alone. Where a bound says that this is not enough, the scene is traced at several
instants, and in between echoes go over from one to the next, each with the phase of its own delay:

H(t) = sum_k w_k(t) sum_i a_i,k exp(-j 2 pi f tau_i,k(t)), w_k falling linearly to 0 at the instants
before and after t_k. Amplitudes change to first order about each instant, so that half of the
change from either side cancels: what is left is of second order.

Bounds know how far bodies turn and how their ways bend, but neither shadows that pass nor surfaces
that come into sight. Where one instant is taken, direct echoes are traced at both ends of the
interval too, and in between wherever something has moved on by its own size, as a check: what they
change by, and what is reflected between parts that turn, is warned of where it is more than is
permitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import (
    BodyEcho,
    band_of,
    percent,
    reference_levels,
    summed_by,
)
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
#: Of spans, at most, between whose ends the echo is compared with one traced in the middle.
_COMPARED = 5
#: Times, at most, at which direct echoes are compared over an interval.
_MOST_PROBES = 33
#: Solvers of which direct echoes are traced at the ends of an interval, as a check.
_CHECKED = ("optics", "rough")
_HOW = "fidelity.radar_motion_tolerance has it traced at several instants"


@dataclass(frozen=True)
class _Change:
    """What leaving motion within an interval to one instant does to the echo of an object, relative
    to it: by the phase beyond second order, and by the angle it turns; and what was found to
    change: its direct echo, or, at most, all reflections between its parts.
    """

    name: str
    bend_rad: float
    turned_rad: float
    changed: float = 0.0

    @property
    def error(self) -> float:
        """Phase and angle together, or what was found to change."""
        return max(self.bend_rad + _OVER_ANGLE * self.turned_rad, self.changed)


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
    began_s = perf_counter()
    probes = 2
    if worst.error <= permitted:
        found = trace(scene, radar, fidelity=fidelity, seed=seed, earlier=earlier, keep=keep)
        if fidelity.radar in _CHECKED and _moved_m(scene, half_s) > radar.ofdm.wavelength_m / 4:
            sizes = _sizes_passed(scene, half_s)
            probes = _probes(sizes)
            worst, remarks = _checked(scene, radar, fidelity, found, worst, permitted, probes)
            if 2 * sizes > probes:
                remarks += (
                    f"motion within an interval: something moves by {2 * sizes:.2g} times its own "
                    f"size; echoes were compared at {probes + 1} times, and what is seen only "
                    "between them is left out",
                )
            found = replace(found, warnings=found.warnings + remarks)
        if worst.error <= permitted or fidelity.radar_motion_tolerance is None:
            decision = _decision(worst, permitted, False)
            return replace(found, decisions=(*found.decisions, decision))
    spans = _spans(scene, radar, half_s, permitted, probes)
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


def _moved_m(scene: Scene, half_s: float) -> float:
    """Farthest that anything moves against the radar from the middle of an interval to its ends."""
    return max((moved for moved, _ in _ways(scene, half_s)), default=0.0)


def _sizes_passed(scene: Scene, half_s: float) -> float:
    """By how many of its own sizes anything moves from the middle of an interval to its ends."""
    return max((moved / max(size, 1e-9) for moved, size in _ways(scene, half_s)), default=0.0)


def _probes(sizes: float) -> int:
    """Spans, a power of two, in each of which nothing moves on by more than its own size: what is
    hidden at the times between them is not seen in between.
    """
    return 2 * 2 ** int(np.ceil(np.log2(np.clip(sizes, 1, _MOST_PROBES // 2))))


def _ways(scene: Scene, half_s: float) -> list[tuple[float, float]]:
    """Of each object that moves against the radar, the farthest that it does from the middle of an
    interval to its ends, and its size: of a plate its shorter edge, of a rod its thickness, m.
    """
    first, last = (float(time) for time in np.clip([-half_s, half_s], *scene.span_s))
    mount = np.asarray(scene.rig.radar.position_m, float)
    rig = scene.rig.course.path_bound_m(mount, 0.0, first, last)
    ways = []
    for item in scene.objects:
        if not (item.moves or scene.rig.moves) or not len(item.geometry.faces):
            continue
        low, high = item.geometry.vertices_m.min(axis=0), item.geometry.vertices_m.max(axis=0)
        radius = float(np.linalg.norm(high - low)) / 2
        own = item.course.path_bound_m((low + high) / 2, radius, first, last)
        ways.append((rig + own, float(np.sort(high - low)[1])))
    return ways


def _checked(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    found: Propagation,
    worst: _Change,
    permitted: float,
    probes: int,
) -> tuple[_Change, tuple[str, ...]]:
    """The largest change, direct echoes at the interval's ends considered and in between, and what
    to warn of; ``probes``: spans between the times considered.

    Of each body the direct echoes of all times are followed to the middle, where they and its own
    would be the same if nothing changed: the largest of their differences from the middle's, and of
    both ends, is told.
    """
    direct = fidelity.with_(
        radar="optics", radar_bounces=1, radar_images=0, radar_edges=0, radar_shadowed=0
    )
    half_s, bodies = radar.burst_s / 2, found.bodies
    whole = _by_body(radar, bodies, found, found.contributions, paths=False)
    sums = []
    for time in _within(scene, half_s * np.linspace(-1, 1, probes + 1)).tolist():
        there = trace(scene.after(time), radar, fidelity=direct, followed_s=half_s)
        echoes = there.contributions
        followed = replace(echoes, delay_s=echoes.delays_at(-time))
        sums.append(_by_body(radar, bodies, there, followed, paths=False))
        if time == 0:
            middle = sums[-1]
    level = reference_levels(whole, fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar))
    changes = np.max(
        [_over(one - middle, level) for one in sums] + [_over(sums[0] - sums[-1], level)], axis=0
    )
    reflected = _over(whole - middle, level)
    remarks = []
    names = [*(body.name for body in bodies), "what the middle does not hear"]
    for number, name in enumerate(names):
        objects = bodies[number].objects if number < len(bodies) else ()
        turning = reflected[number] > permitted and _parts_turn(scene, radar, objects)
        changed = float(max(changes[number], reflected[number] if turning else 0.0))
        if changed > worst.error:
            worst = replace(worst, name=name, changed=changed)
        if changes[number] > permitted:
            remarks.append(_unheard(name, float(changes[number]), permitted, number < len(bodies)))
        if turning:
            remarks.append(
                f"motion within an interval: {percent(reflected[number])} % of the echo of "
                f"{name} are reflections between parts that turn, of which only delays "
                f"change: {_HOW}"
            )
    return worst, tuple(remarks)


def _unheard(name: str, changed: float, permitted: float, is_heard: bool) -> str:
    """That a direct echo changes within an interval, by how much, and what to do."""
    if not is_heard:
        return (
            f"motion within an interval: {name} has an echo of {changed:.2g} times what counts at "
            f"other times, which is left out: {_HOW}"
        )
    return (
        f"motion within an interval: the direct echo of {name} changes by {percent(changed)} % of "
        f"its echo beyond its delays, which is left out; {percent(permitted)} % permitted: {_HOW}"
    )


def _over(echo: NDArray[np.complex128], level: Array) -> Array:
    """Root mean square of echoes (n_bodies, n_frequencies) over levels (n_bodies,)."""
    return np.asarray(np.sqrt(np.mean(np.abs(echo) ** 2, axis=1)) / np.maximum(level, 1e-300))


def _parts_turn(scene: Scene, radar: RadarDesign, names: Sequence[str]) -> bool:
    """Whether a body has parts that turn against each other by so much that a reflection between
    them goes past the radar: a quarter of a wavelength over their size.
    """
    parts = [item for item in scene.objects if item.name in names]
    spins = [
        item.state.angular_velocity_rad_per_s * item.geometry.shape.size_m
        for item in parts
        if len(item.geometry.faces)
    ]
    if len(spins) < 2:
        return False
    against = np.ptp(np.array(spins), axis=0).max() * radar.burst_s / 2
    return bool(against > radar.ofdm.wavelength_m / 4)


def _by_body(
    radar: RadarDesign,
    bodies: Sequence[BodyEcho],
    found: Propagation,
    echoes: Contributions,
    *,
    paths: bool = True,
) -> NDArray[np.complex128]:
    """Echoes summed by body in the order of ``bodies``, all others the last; so are single paths,
    or they count for none.
    """
    body_of = {name: number for number, body in enumerate(bodies) for name in body.objects}
    count = len(bodies) + 1
    of_object = np.array([body_of.get(name, count - 1) for name in found.objects], dtype=np.int64)
    owner = np.full(len(echoes), count - 1)
    dense = slice(len(found.names), None)
    if not paths:
        owner[: len(found.names)] = -1
    if len(of_object):
        owner[dense] = of_object[echoes.object[dense]]
    wave = radar.ofdm
    return summed_by(owner, count, echoes, wave.carrier_hz, band_of(wave))


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


def _spans(scene: Scene, radar: RadarDesign, half_s: float, permitted: float, least: int) -> int:
    """Number of spans, a power of two and not below ``least``, in each of which either end alone
    would be enough for the nearer half of it.
    """
    spans = 2 ** int(np.ceil(np.log2(least)))
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

        Compared in the middle of up to `_COMPARED` spans, where the scene is traced, root mean
        square over them; these instants are kept.
        """
        while True:
            spans = list(pairwise(sorted(self._traced)))
            some = np.linspace(0, len(spans) - 1, _COMPARED).round().astype(int)
            found = [self._compared(*spans[k]) for k in np.unique(some)]
            off, exact = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
            floor = OF_NOISE * noise_amplitude(self._radar)
            level = reference_levels(exact, self._fidelity.radar_tolerance, floor)
            error = float(_over(off, level).max(initial=0.0))
            if error <= permitted or 2 * len(spans) > _MOST_SPANS:
                return error
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
        return _by_body(self._radar, self._traced[0.0].bodies, found, echoes)


def weights(instants_s: Sequence[float], times_s: Array) -> Array:
    """Of each instant at times, (n_instants, n_times): they fall linearly to the neighbours'
    instants, and stay 1 beyond the first and the last.
    """
    one: Array = np.array([np.interp(times_s, instants_s, row) for row in np.eye(len(instants_s))])
    return one
