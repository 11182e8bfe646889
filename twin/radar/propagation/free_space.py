"""The cheap rung: declared targets straight ahead in empty space, in closed form."""

import numpy as np

from hardware.waveform import C_M_PER_S
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.rays import lengthening, turning
from twin.radar.propagation.result import Path, Propagation
from twin.scene import Scene


def straight_paths(scene: Scene, radar: RadarDesign) -> Propagation:
    """One path to each target that the antenna looks at, by the radar equation.

    What is left out: multipath, clutter, shadows.
    """
    offset, axes = scene.rig.device("radar")
    sent = radar.front_end.transmit_power_w.value
    paths = []
    for target in scene.targets:
        towards = np.asarray(target.position_m) - scene.rig.position_m - offset
        distance = float(np.linalg.norm(towards))
        ahead, left, up = (float(x) for x in axes @ towards / distance)
        received = radar.received_power_w(distance, target.rcs_m2, (ahead, left, up))
        if received == 0:
            continue
        velocity = np.asarray(target.velocity_m_per_s)
        rate, acceleration = lengthening(velocity, towards / distance, distance)
        turn = axes @ turning(velocity, towards / distance, distance)
        aside = float(turn[0]), float(turn[1]), float(turn[2])
        paths.append(
            Path(
                via=(target.name,),
                target=target.name,
                amplitude=complex(np.sqrt(received / sent)),
                delay_s=2 * distance / C_M_PER_S,
                delay_rate=2 * float(rate) / C_M_PER_S,
                delay_acceleration_per_s=2 * float(acceleration) / C_M_PER_S,
                departure=(ahead, left, up),
                arrival=(ahead, left, up),
                departure_per_s=aside,
                arrival_per_s=aside,
            )
        )
    return Propagation(
        paths=tuple(sorted(paths, key=lambda p: p.delay_s)),
        roles=(),
        assumptions=("the scene itself is left out: no multipath, no clutter, no shadows",),
    )
