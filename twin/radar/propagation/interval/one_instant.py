"""Whether the echoes of one instant hold over an interval: direct echoes traced at other times.

Bounds know how far bodies turn and how their ways bend, but neither shadows that pass nor surfaces
that come into sight. Direct echoes are therefore traced at both ends of the interval too, and in
between wherever something has moved on by its own size.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import BodyEcho, of_echo, percent, reference_levels
from twin.radar.propagation.interval.affected import unaffected, ways_m, with_silent
from twin.radar.propagation.interval.bounds import Change, times_within
from twin.radar.propagation.interval.reflected import changes_with_reflections
from twin.radar.propagation.interval.sums import by_body, over_level
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.scene import Scene

Array = NDArray[np.float64]

#: Times, at most, at which direct echoes are compared over an interval.
_MOST_TIMES = 33
#: Solvers that find direct echoes as `optics` does.
_CHECKED = ("optics", "auto", "rough")
_HOW = (
    "radar_motion_tolerance (of Fidelity in Python, or [set] of a study) has it traced at several "
    "instants"
)


@dataclass(frozen=True, eq=False)
class Checked:
    """What one instant leaves out: the ``worst`` change, what other times show considered;
    ``remarks`` to warn of; ``spans`` between the times, at least 2; and what every body's echo
    ``changes`` by, (n_bodies,), relative to the level that its error is relative to.
    """

    worst: Change
    remarks: tuple[str, ...]
    spans: int
    changes: Array

    def stated(self, bodies: Sequence[BodyEcho]) -> tuple[BodyEcho, ...]:
        """Bodies with these changes in their stated errors."""
        changes = zip(bodies, self.changes.tolist(), strict=True)
        return tuple(body.off_by(change) for body, change in changes)


def checked(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    found: Propagation,
    worst: Change,
    permitted: float,
) -> Checked:
    """What one instant leaves out, by echoes at other times.

    ``found``: echoes of the middle; ``worst``: the largest change by bounds; ``permitted``: of an
    echo. Nothing is traced where nothing moves by a quarter of a wavelength against the radar.
    """
    farthest = ways_m(scene, radar.burst_s / 2)
    ways = _ways(scene, farthest)
    if fidelity.radar not in _CHECKED or not np.any(ways[:, 0] > radar.ofdm.wavelength_m / 4):
        return Checked(worst, (), 2, np.zeros(len(found.bodies)))
    sizes = float(np.max(ways[:, 0] / np.maximum(ways[:, 1], 1e-9)))
    spans = _spans(sizes)
    differences = _differences(scene, radar, fidelity, found, spans, farthest)
    worst, remarks, changes = _told(scene, radar, found.bodies, differences, worst, permitted)
    if 2 * sizes > spans:
        remarks += (
            f"motion within an interval: something moves by {2 * sizes:.2g} times its own size; "
            f"echoes were compared at {spans + 1} times, and what is seen only between them is "
            "left out",
        )
    return Checked(worst, remarks, spans, changes)


def _ways(scene: Scene, farthest: Mapping[str, float]) -> Array:
    """Of each object that moves against the radar, the farthest that it does from the middle of an
    interval to its ends, and its size: of a plate its shorter edge, of a rod its thickness, m,
    (n_moving, 2).
    """
    ways = []
    for item in scene.objects:
        if item.name in farthest:
            extent = np.ptp(item.geometry.vertices_m, axis=0)
            ways.append((farthest[item.name], float(np.sort(extent)[1])))
    return np.array(ways).reshape(-1, 2)


def _spans(sizes: float) -> int:
    """Spans, a power of two, in each of which nothing moves on by more than its own size: what is
    hidden at the times between them is not seen in between.
    """
    return 2 * 2 ** int(np.ceil(np.log2(np.clip(sizes, 1, _MOST_TIMES // 2))))


@dataclass(frozen=True, eq=False)
class _Differences:
    """What echoes at other times differ by, ``direct`` ones and those ``with_reflections``, and
    what is ``reflected`` more than once: of every body, and last of what the middle does not hear,
    (n_bodies + 1,) each.
    """

    direct: Array
    with_reflections: Array
    reflected: Array


def _differences(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    found: Propagation,
    spans: int,
    ways: Mapping[str, float],
) -> _Differences:
    """What echoes at other times differ by from the middle's; ``ways`` as of `ways_m`. Of direct
    echoes of bodies that nothing moves, and that nothing that moves may hide, nothing changes.

    The direct echoes of all times are followed to the middle, where they and its own would be the
    same if nothing changed: the largest difference from the middle's, and of both ends, is told.
    """
    direct = fidelity.with_(
        radar="optics", radar_bounces=1, radar_images=0, radar_edges=0, radar_shadowed=0
    )
    half_s, bodies = radar.burst_s / 2, found.bodies
    silent = unaffected(scene, ways, found.roles, bodies)
    times = times_within(scene, half_s * np.linspace(-1, 1, spans + 1)).tolist()
    worlds, sums = {time: scene.after(time) for time in times}, {}
    for time, world in worlds.items():
        there = trace(with_silent(world, silent), radar, fidelity=direct, followed_s=half_s)
        echoes = there.contributions
        followed = replace(echoes, delay_s=echoes.delays_at(-time))
        sums[time] = by_body(radar, bodies, there, followed, paths=False)
    middle, (first, *_, last) = sums[0.0], sums.values()
    whole = by_body(radar, bodies, found, found.contributions, paths=False)
    level = reference_levels(whole, fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar))
    changes = [over_level(one - middle, level) for one in sums.values()]
    return _Differences(
        np.max([*changes, over_level(first - last, level)], axis=0),
        np.append(changes_with_reflections(worlds, radar, fidelity, bodies, level[:-1]), 0.0),
        over_level(whole - middle, level),
    )


def _told(
    scene: Scene,
    radar: RadarDesign,
    bodies: Sequence[BodyEcho],
    differences: _Differences,
    worst: Change,
    permitted: float,
) -> tuple[Change, tuple[str, ...], Array]:
    """The largest change, what to warn of, and what every body's echo changes by at the times that
    are compared. Where parts of a body turn, at most all that is reflected between them changes.
    """
    remarks, largest = [], []
    by_reflections: list[str] = []
    names = [*(body.name for body in bodies), "what the middle does not hear"]
    rows = differences.direct, differences.with_reflections, differences.reflected
    for number, (name, direct, both, reflected) in enumerate(zip(names, *rows, strict=True)):
        is_heard = number < len(bodies)
        objects = bodies[number].objects if is_heard else ()
        turning = reflected > permitted and _parts_turn(scene, radar, objects)
        largest.append(float(max(direct, both)))
        changed = max(largest[-1], float(reflected) if turning else 0.0)
        if changed > worst.error:
            worst = replace(worst, name=name, changed=changed)
        faint = bodies[number].level_over_echo if is_heard else 1.0
        if direct > permitted:
            remarks.append(_changed_remark(name, float(direct), permitted, is_heard, faint))
        if turning:
            remarks.append(
                f"motion within an interval: {of_echo(float(reflected), faint)} of the echo of "
                f"{name} are reflections between parts that turn, of which only delays "
                f"change; from the middle to the end the echo changes by "
                f"{of_echo(float(both), faint)}: "
                f"{_HOW}"
            )
        elif both > max(permitted, direct):
            by_reflections.append(f"the echo of {name} by {of_echo(float(both), faint)}")
    if by_reflections:
        remarks.append(
            f"motion within an interval changes, reflections included, {', '.join(by_reflections)} "
            f"beyond delays, which is left out; {percent(permitted)} % permitted; the stated "
            f"errors contain it: {_HOW}"
        )
    return worst, tuple(remarks), np.array(largest[: len(bodies)])


def _changed_remark(
    name: str, changed: float, permitted: float, is_heard: bool, level_over_echo: float
) -> str:
    """That a direct echo changes within an interval, by how much, and what to do."""
    if not is_heard:
        return (
            f"motion within an interval: {name} has an echo of {changed:.2g} times what counts at "
            f"other times, which is left out: {_HOW}"
        )
    return (
        f"motion within an interval: the direct echo of {name} changes by "
        f"{of_echo(changed, level_over_echo)} of its echo beyond its delays, which is left out; "
        f"{percent(permitted)} % permitted: {_HOW}"
    )


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
