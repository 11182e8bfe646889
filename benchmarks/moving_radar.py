"""The radar of what moves: micro-Doppler against closed forms in 30 digits, and a moving frame of
`scenes/crossing`: its time over the same at rest, and its errors against traces of single slots.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import mpmath
import numpy as np

from benchmarks.timing import Figure
from hardware.radar.process import process
from tests.physics import micro_doppler as exact
from tests.physics.radar_worlds import CARRIER_HZ, OPTICS, RADAR, ball, world
from tests.physics.retraced import errors_by_body
from tests.physics.test_radar_rotation import (
    PENDULUM,
    ROTOR,
    ROWS,
    STILL,
    WHEEL,
    at_slots,
    carried,
    dihedral,
    off,
)
from twin.fidelity import DEFAULT
from twin.motion import Still, Turning
from twin.radar import radar_capture
from twin.radar.acquisition import channel
from twin.radar.propagation.interval.instants import traced_interval
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.scene import Scene, load_scene

_RUNS = 3
#: Of the interval at which `scenes/crossing` is traced anew.
_SLOTS_S = np.array([-4.9e-3, -3.1e-3, -1.2e-3, 0.7e-3, 2.6e-3, 4.4e-3])


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for name, moved in (("rotor, 6 rad/s", ROTOR), ("pendulum", PENDULUM), ("wheel", WHEEL)):
        yield f"micro-Doppler: {name}, complex error rms", 100 * _point(*moved), "%"
    for rate in (2.0, 20.0, 60.0):
        error = 100 * _dihedral(rate)
        yield f"micro-Doppler: dihedral, {rate:g} rad/s, complex error rms", error, "%"
    moving = load_scene("crossing")
    resting = at_rest(moving)
    took = {name: _frame_s(scene) for name, scene in (("moving", moving), ("at rest", resting))}
    for name, taken_s in took.items():
        yield f"crossing, {name}: rays to detections, processor time", taken_s, "s"
    yield "crossing: moving over at rest (asked: 1.5)", took["moving"] / took["at rest"], ""
    smooth = DEFAULT.with_(radar_edges=0, radar_shadowed=0)
    found = traced_interval(moving, RADAR, smooth, 1)
    for line in found.warnings:
        if line.startswith("motion"):
            print(f"  warned: {line}")
    errors = errors_by_body(moving, RADAR, found, smooth, _SLOTS_S)
    for name, error in errors.items():
        yield (
            f"crossing: {name}, one instant against {len(_SLOTS_S)} slots traced anew, rms",
            100 * error,
            "%",
        )


def at_rest(scene: Scene) -> Scene:
    """The same scene, stopped."""
    objects = tuple(item.following(Still(item.pose), item.parent) for item in scene.objects)
    targets = tuple(replace(one, velocity_m_per_s=(0.0, 0.0, 0.0)) for one in scene.targets)
    return replace(scene.at(scene.rig.pose), objects=objects, targets=targets)


def _point(reference: exact.Place, course: Turning) -> float:
    """Of a point on a body, over all slots and 4 GHz."""
    place = np.array([float(x) for x in reference(mpmath.mpf(0))])
    item = ball("hub", (12.0, 3.0, 0.0), 0.05, 1).following(course)
    scene = world(item, targets=(carried("t", place, item),))
    wave = RADAR.ofdm
    frequencies = CARRIER_HZ + wave.frequency_offsets_hz[ROWS]
    phases = exact.two_way(reference, STILL, wave.slot_times_s, frequencies)
    return off(at_slots(scene, "targets"), phases)


def _dihedral(rate: float) -> float:
    """Its double bounce 0.3 m before an axis 100.3 m away, over all slots."""
    item = dihedral("d", (100.0, 0, 0), 0.1).following(Turning((0, 0, 1), (100.3, 0, 0), rate))
    found = traced_interval(world(item), RADAR, OPTICS.with_(radar_tolerance=0.03), 1)
    wave = RADAR.ofdm
    received = channel(found, RADAR, Atmosphere())[0, :, 0, wave.n_subcarriers // 2]
    times = wave.slot_times_s
    corner = exact.on_rotor((100.3, 0, 0), (-0.3, 0, 0), rate)
    phase = exact.two_way(corner, STILL, times, np.array([CARRIER_HZ]))[0]
    closed = np.cos(np.pi / 4 + abs(rate * times)) * phase
    return off(received, np.vdot(closed, received) / np.vdot(closed, closed) * closed)


def _frame_s(scene: Scene) -> float:
    """Median processor time of a frame, warm."""

    def frame() -> None:
        process(radar_capture(scene, RADAR, seed=1).record)

    frame()
    return float(np.median([_processor_s(frame) for _ in range(_RUNS)]))


def _processor_s(work: Callable[[], None]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun
