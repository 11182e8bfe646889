"""What a detection is judged by."""

from dataclasses import dataclass

import numpy as np

from twin.radar.device.design import RadarDesign
from twin.radar.propagation.atmosphere import Air
from twin.radar.propagation.paths import Propagation
from twin.scene import Scene, Target


@dataclass(frozen=True)
class TrueTarget:
    """One target at the first burst. ``received_w`` is the direct path's at the first carrier, air
    and slot loss included.

    ``visible``: a direct path exists, or its mesh is heard. ``wrapped_range_m`` is the range as
    the subcarriers' spacing wraps it.
    """

    name: str
    range_m: float
    range_rate_m_per_s: float
    azimuth_deg: float
    rcs_m2: float
    received_w: float
    visible: bool
    wrapped_range_m: float


def true_targets(
    scene: Scene, radar: RadarDesign, found: Propagation, air: Air
) -> tuple[TrueTarget, ...]:
    """All declared targets of a scene."""
    return tuple(_true(target, scene, radar, found, air) for target in scene.targets)


def _true(
    target: Target, scene: Scene, radar: RadarDesign, found: Propagation, air: Air
) -> TrueTarget:
    offset, axes = scene.rig.device("radar")
    towards = np.asarray(target.position_m) - scene.rig.position_m - offset
    distance = float(np.linalg.norm(towards))
    ahead, left, up = (float(x) for x in axes @ towards / distance)
    rate = float(np.asarray(target.velocity_m_per_s) @ towards / distance)
    wave = radar.ofdm
    gain = float(wave.slot_gain(np.array(2 * rate / wave.wavelength_m)))
    gain *= float(air.amplitude(np.array(2 * distance), wave.carrier_hz))
    power = radar.received_power_w(distance, target.rcs_m2, (ahead, left, up))
    return TrueTarget(
        name=target.name,
        range_m=distance,
        range_rate_m_per_s=rate,
        azimuth_deg=float(np.degrees(np.arctan2(left, ahead))),
        rcs_m2=target.rcs_m2,
        received_w=power * gain**2,
        visible=any(path.via == (target.name,) for path in found.paths)
        or any(heard.name == target.object for heard in found.heard),
        wrapped_range_m=distance % wave.max_range_m,
    )
