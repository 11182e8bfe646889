"""The cheap rung: declared targets straight ahead in empty space, in closed form."""

import numpy as np

from hardware.waveform import C_M_PER_S
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import (
    lengthening,
    radar_motion,
    relative_motion,
    turning,
)
from twin.radar.propagation.result import PathName, Propagation, by_delay
from twin.radar.synthesis import Contributions
from twin.scene import Scene


def straight_paths(scene: Scene, radar: RadarDesign) -> Propagation:
    """One path to each target that the antenna looks at, by the radar equation.

    What is left out: multipath, clutter, shadows.
    """
    offset, axes = scene.rig.device("radar")
    spin = radar_motion(scene).spin_rad_per_s
    sent = radar.front_end.transmit_power_w.value
    names, paths = [], []
    for target in scene.targets:
        towards = np.asarray(target.position_m) - scene.rig.position_m - offset
        distance = float(np.linalg.norm(towards))
        ahead, left, up = (float(x) for x in axes @ towards / distance)
        received = radar.received_power_w(distance, target.rcs_m2, (ahead, left, up))
        if received == 0:
            continue
        velocity, faster = relative_motion(scene, target)
        rate, acceleration = lengthening(velocity, towards / distance, distance, faster)
        turn = turning(velocity, towards / distance, distance)
        turn = (axes @ (turn - np.cross(spin, towards / distance))).reshape(1, 3)
        direction = np.array([[ahead, left, up]])
        names.append(PathName((target.name,), target.name))
        paths.append(
            Contributions(
                amplitude=np.array([np.sqrt(received / sent)], dtype=np.complex128),
                delay_s=np.array([2 * distance / C_M_PER_S]),
                delay_rate=np.array([2 * float(rate) / C_M_PER_S]),
                delay_acceleration_per_s=np.array([2 * float(acceleration) / C_M_PER_S]),
                departure=direction,
                arrival=direction,
                departure_per_s=turn,
                arrival_per_s=turn,
            )
        )
    sorted_names, contributions = by_delay(names, Contributions.concatenate(paths))
    return Propagation(
        contributions,
        sorted_names,
        assumptions=("the scene itself is left out: no multipath, no clutter, no shadows",),
    )
