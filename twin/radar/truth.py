"""What a detection is judged by."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import (
    RigidMotions,
    lengthening,
    radar_motion,
    relative_motion,
)
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.scene import Scene, Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrueTarget:
    """One target at the first burst.

    Parameters
    ----------
    name
        As the scene names it.
    range_m
        From the radar.
    range_rate_m_per_s
        Positive: receding.
    azimuth_deg
        In the radar's frame, positive to the left.
    rcs_m2
        Declared cross-section.
    received_w
        Power of the direct path at the first carrier, air and slot loss included.
    visible
        Whether a direct path exists, or its mesh is heard.
    wrapped_range_m
        The range as the subcarriers' spacing wraps it.
    nearer_m
        By how much the surface of its object comes closer.
    farther_m
        By how much the surface of its object reaches beyond.
    slower_m_per_s
        By how much rates of its object are below its own within the interval.
    faster_m_per_s
        By how much rates of its object are above its own within the interval.
    rate_change_m_per_s
        By which the range rate of a target that crosses grows from the interval's middle to its
        end.
    """

    name: str
    range_m: float
    range_rate_m_per_s: float
    azimuth_deg: float
    rcs_m2: float
    received_w: float
    visible: bool
    wrapped_range_m: float
    nearer_m: float = 0.0
    farther_m: float = 0.0
    slower_m_per_s: float = 0.0
    faster_m_per_s: float = 0.0
    rate_change_m_per_s: float = 0.0

    def beside(self, range_m: float, range_rates_m_per_s: Array) -> tuple[float, float]:
        """By how much a range and the nearest of several rates lie beyond those of its object.

        In m and m/s; 0 for what is not measured, NaN.
        """
        off = float(np.nan_to_num(range_m - self.wrapped_range_m))
        rates = np.nan_to_num(range_rates_m_per_s - self.range_rate_m_per_s)
        off_rates = np.maximum(-rates - self.slower_m_per_s, rates - self.faster_m_per_s)
        return (
            max(-off - self.nearer_m, off - self.farther_m, 0.0),
            max(float(off_rates.min()), 0.0),
        )


def true_targets(
    scene: Scene, radar: RadarDesign, propagation: Propagation, air: Atmosphere
) -> tuple[TrueTarget, ...]:
    """All declared targets of a scene."""
    return tuple(_true(target, scene, radar, propagation, air) for target in scene.targets)


def _true(
    target: Target, scene: Scene, radar: RadarDesign, propagation: Propagation, air: Atmosphere
) -> TrueTarget:
    offset, axes = scene.rig.device("radar")
    towards = np.asarray(target.position_m) - scene.rig.position_m - offset
    distance = float(np.linalg.norm(towards))
    ahead, left, up = (float(x) for x in axes @ towards / distance)
    wave = radar.ofdm
    half_s = wave.n_slots * wave.slot_period_s / 2
    velocity, faster = relative_motion(scene, target)
    rate, acceleration = map(float, lengthening(velocity, towards / distance, distance, faster))
    change = abs(acceleration) * half_s
    gain = float(wave.slot_gain(np.array(2 * rate / wave.wavelength_m)))
    gain *= float(air.amplitude_transmission(np.array(2 * distance / C_M_PER_S), wave.carrier_hz))
    power = radar.received_power_w(distance, target.rcs_m2, (ahead, left, up))
    ranges, rates = _spans(target, scene, scene.rig.position_m + offset, half_s)
    return TrueTarget(
        name=target.name,
        range_m=distance,
        range_rate_m_per_s=rate,
        azimuth_deg=float(np.degrees(np.arctan2(left, ahead))),
        rcs_m2=target.rcs_m2,
        received_w=power * gain**2,
        visible=any(path.via == (target.name,) for path in propagation.paths)
        or any(heard.name == target.object for heard in propagation.heard),
        wrapped_range_m=distance % wave.max_range_m,
        nearer_m=max(0.0, distance - ranges[0]),
        farther_m=max(0.0, ranges[1] - distance),
        slower_m_per_s=max(change, rate - rates[0]),
        faster_m_per_s=max(change, rates[1] - rate),
        rate_change_m_per_s=change,
    )


def _spans(target: Target, scene: Scene, radar_m: Array, half_s: float) -> tuple[Array, Array]:
    """Least and most range and range rate (2,) of the surface of a target's object, the rate within
    an interval of twice ``half_s``; of a target without one, infinite and of no extent.
    """
    item = next((item for item in scene.objects if item.name == target.object), None)
    if item is None or not len(item.geometry.faces):
        return np.array([np.inf, -np.inf]), np.array([np.inf, -np.inf])
    offset_m = item.vertices_m - radar_m
    ranges = np.linalg.norm(offset_m, axis=1)
    own = radar_motion(scene)
    velocity, faster = RigidMotions.of([item], radar_m).at(0, offset_m)
    rates, accelerations = lengthening(
        velocity - own.velocity_m_per_s,
        offset_m / ranges[:, None],
        ranges,
        faster - own.acceleration_m_per_s2,
    )
    change = np.abs(accelerations) * half_s
    nearest = _nearest(offset_m[item.geometry.faces])
    return (
        np.array([nearest, ranges.max()]),
        np.array([(rates - change).min(), (rates + change).max()]),
    )


def _nearest(triangles_m: Array) -> float:
    """Least distance of triangles (n, 3 corners, 3) from the origin."""
    edges = np.roll(triangles_m, -1, axis=1) - triangles_m
    lengths = np.maximum(np.sum(edges**2, axis=-1), 1e-300)
    along = np.clip(-np.sum(triangles_m * edges, axis=-1) / lengths, 0, 1)
    to_edges = np.linalg.norm(triangles_m + along[..., None] * edges, axis=-1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(size, 1e-300)[:, None]
    height = np.sum(normal * triangles_m[:, 0], axis=1)
    # The foot of the perpendicular lies within where it is on the same side of all edges.
    foot = height[:, None, None] * normal[:, None] - triangles_m
    side = np.sum(np.cross(edges, foot) * normal[:, None], axis=-1)
    inside = (side >= 0).all(axis=1) & (size > 0)
    return float(min(to_edges.min(), np.abs(height[inside]).min(initial=np.inf)))
