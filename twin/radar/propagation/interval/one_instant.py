"""Whether the echoes of one instant hold over an interval: direct echoes traced at other times.

Bounds know how far bodies turn and how their ways bend, but neither shadows that pass nor surfaces
that come into sight. Direct echoes are therefore traced at both ends of the interval too, and in
between wherever something has moved on by its own size.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.convergence import BodyEcho, percent, reference_levels
from twin.radar.propagation.interval.affected import affected_alone, ways_m
from twin.radar.propagation.interval.bounds import Change, times_within
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
_HOW = "fidelity.radar_motion_tolerance has it traced at several instants"


def checked(
    scene: Scene,
    radar: RadarDesign,
    fidelity: Fidelity,
    found: Propagation,
    worst: Change,
    permitted: float,
) -> tuple[Change, tuple[str, ...], int]:
    """The largest change, what direct echoes at other times differ by considered; what to warn of;
    and the number of spans between these times, at least 2.

    ``found``: echoes of the middle; ``worst``: the largest change by bounds; ``permitted``: of an
    echo. Nothing is traced where nothing moves by a quarter of a wavelength against the radar.
    """
    ways = _ways(scene, radar.burst_s / 2)
    if fidelity.radar not in _CHECKED or not np.any(ways[:, 0] > radar.ofdm.wavelength_m / 4):
        return worst, (), 2
    sizes = float(np.max(ways[:, 0] / np.maximum(ways[:, 1], 1e-9)))
    spans = _spans(sizes)
    changes, reflected = _differences(scene, radar, fidelity, found, spans)
    worst, remarks = _told(scene, radar, found.bodies, changes, reflected, worst, permitted)
    if 2 * sizes > spans:
        remarks += (
            f"motion within an interval: something moves by {2 * sizes:.2g} times its own size; "
            f"echoes were compared at {spans + 1} times, and what is seen only between them is "
            "left out",
        )
    return worst, remarks, spans


def _ways(scene: Scene, half_s: float) -> Array:
    """Of each object that moves against the radar, the farthest that it does from the middle of an
    interval to its ends, and its size: of a plate its shorter edge, of a rod its thickness, m,
    (n_moving, 2).
    """
    farthest, ways = ways_m(scene, half_s), []
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


def _differences(
    scene: Scene, radar: RadarDesign, fidelity: Fidelity, found: Propagation, spans: int
) -> tuple[Array, Array]:
    """Of each body's echo, what direct echoes at other times differ by, and what is reflected more
    than once; the last row is of what the middle does not hear, (n_bodies + 1,) each. Of bodies
    that nothing moves, and that nothing that moves may hide, nothing changes.

    The direct echoes of all times are followed to the middle, where they and its own would be the
    same if nothing changed: the largest difference from the middle's, and of both ends, is told.
    """
    direct = fidelity.with_(
        radar="optics", radar_bounces=1, radar_images=0, radar_edges=0, radar_shadowed=0
    )
    half_s, bodies = radar.burst_s / 2, found.bodies
    changing = affected_alone(scene, half_s, found.roles, bodies)
    sums = {}
    for time in times_within(scene, half_s * np.linspace(-1, 1, spans + 1)).tolist():
        there = trace(changing.after(time), radar, fidelity=direct, followed_s=half_s)
        echoes = there.contributions
        followed = replace(echoes, delay_s=echoes.delays_at(-time))
        sums[time] = by_body(radar, bodies, there, followed, paths=False)
    middle, (first, *_, last) = sums[0.0], sums.values()
    whole = by_body(radar, bodies, found, found.contributions, paths=False)
    level = reference_levels(whole, fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar))
    changes = [over_level(one - middle, level) for one in sums.values()]
    return (
        np.max([*changes, over_level(first - last, level)], axis=0),
        over_level(whole - middle, level),
    )


def _told(
    scene: Scene,
    radar: RadarDesign,
    bodies: Sequence[BodyEcho],
    changes: Array,
    reflected: Array,
    worst: Change,
    permitted: float,
) -> tuple[Change, tuple[str, ...]]:
    """The largest change, and what to warn of: of every body what its direct echo changes by, and
    what is reflected between its parts where these turn.
    """
    remarks = []
    names = [*(body.name for body in bodies), "what the middle does not hear"]
    for number, name in enumerate(names):
        objects = bodies[number].objects if number < len(bodies) else ()
        turning = reflected[number] > permitted and _parts_turn(scene, radar, objects)
        changed = float(max(changes[number], reflected[number] if turning else 0.0))
        if changed > worst.error:
            worst = replace(worst, name=name, changed=changed)
        if changes[number] > permitted:
            is_heard = number < len(bodies)
            remarks.append(_changed_remark(name, float(changes[number]), permitted, is_heard))
        if turning:
            remarks.append(
                f"motion within an interval: {percent(reflected[number])} % of the echo of "
                f"{name} are reflections between parts that turn, of which only delays "
                f"change: {_HOW}"
            )
    return worst, tuple(remarks)


def _changed_remark(name: str, changed: float, permitted: float, is_heard: bool) -> str:
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
