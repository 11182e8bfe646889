"""Micro-Doppler of a run's first interval: what turns or swings in it, beside its true rates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Spectrogram, spectrogram
from hardware.radar.burst import demodulate
from hardware.records import RadarRecord
from twin.motion import Motion
from twin.radar.device.design import RadarDesign
from twin.radar.truth import TrueTarget
from twin.scene import Scene, SceneObject

Array = NDArray[np.float64]

#: Below the strongest rate down to which others are heard, where the noise is fainter.
DEEPEST_DB = 40.0
_INSTANTS = 9  # of the interval at which rates are looked at
#: In an interval: rates are told apart half as finely as by all of it.
WINDOWS = 2
_LEAST_CELLS = 3.0  # of a window's rates over which those of a body must spread to show


@dataclass(frozen=True)
class PartRates:
    """Least and greatest true range rate (m/s) of a part's surface within the interval."""

    name: str
    least_m_per_s: float
    greatest_m_per_s: float


@dataclass(frozen=True, eq=False)
class MicroDoppler:
    """Spectrogram of a body whose parts move by themselves, over all ranges that it takes up, by
    the first antenna; and the true rates of its parts.
    """

    name: str
    seen: Spectrogram
    parts: tuple[PartRates, ...]

    @property
    def least_m_per_s(self) -> float:
        """Of all parts."""
        return min(part.least_m_per_s for part in self.parts)

    @property
    def greatest_m_per_s(self) -> float:
        """Of all parts."""
        return max(part.greatest_m_per_s for part in self.parts)

    @property
    def heard_m_per_s(self) -> tuple[float, float]:
        """Least and greatest rate within `depth_db` of the strongest, in the mean over time; NaN
        where no echo is above the noise.
        """
        mean, faintest = self._levels
        rates = self.seen.range_rate_m_per_s[mean >= faintest]
        return (float(rates.min()), float(rates.max())) if len(rates) else (np.nan, np.nan)

    @property
    def depth_db(self) -> float:
        """Below the strongest rate, in the mean over time, to which rates are heard: `DEEPEST_DB`,
        or down to the noise; 0 where none is.
        """
        mean, faintest = self._levels
        return max(float(10 * np.log10(max(mean.max(), 1e-300) / max(faintest, 1e-300))), 0.0)

    @property
    def _levels(self) -> tuple[Array, float]:
        """The mean over time of every rate, and the faintest that is heard."""
        mean = self.seen.power_w.mean(axis=1)
        deepest = float(mean.max()) * 10 ** (-DEEPEST_DB / 10)
        return mean, max(deepest, float(self.seen.threshold_w.mean()))


def micro_doppler(
    scene: Scene, radar: RadarDesign, record: RadarRecord, truth: Sequence[TrueTarget]
) -> tuple[MicroDoppler, ...]:
    """Of each target on a body of which a part turns or swings, and whose rates spread so far that
    the interval tells them apart.

    ``scene`` as it is in the middle of the record's first burst. Empty where there is none, and
    where the burst is not whole.
    """
    half_s = radar.burst_s / 2
    times = np.clip(np.linspace(-half_s, half_s, _INSTANTS), *scene.span_s)
    cell = radar.channel_waveform.velocity_cell_m_per_s
    on = {target.name: target.object for target in scene.targets}
    bodies: dict[str, tuple[list[str], list[tuple[Array, Array]]]] = {}
    for name in dict.fromkeys(on[target.name] for target in truth):
        parts = _family(scene, name)
        if not any(_own_speed(part) > cell for part in parts):
            continue
        known = [_of_part(part, scene, times) for part in parts]
        spread = np.ptp(np.concatenate([rate.ravel() for _, rate in known]))
        if spread > _LEAST_CELLS * WINDOWS * cell:
            bodies[parts[0].name] = [part.name for part in parts], known
    if not bodies:
        return ()
    interval = demodulate(record, 0)
    if not interval.whole:
        return ()
    waveform, found = interval.waveform, []
    for name, (names, known) in bodies.items():
        ranges = np.concatenate([r[_INSTANTS // 2] for r, _ in known])
        span = min(float(np.ptp(ranges)) + waveform.range_cell_m, waveform.max_range_m)
        middle = float(ranges.min() + ranges.max()) / 2 % waveform.max_range_m
        window = max(2, waveform.n_slots // WINDOWS)
        seen = spectrogram(interval.channel[0], waveform, middle, window, span_m=span)
        found.append(
            MicroDoppler(
                name,
                seen,
                tuple(
                    PartRates(part, float(rate.min()), float(rate.max()))
                    for part, (_, rate) in zip(names, known, strict=True)
                ),
            )
        )
    return tuple(found)


def ranges_and_rates(
    course: Motion, points_m: Array, scene: Scene, times_s: Array
) -> tuple[Array, Array]:
    """Ranges (m) and range rates (m/s) of points (k, 3) of a body's own frame from the radar at
    times, (n_times, k) each.
    """
    place, velocity, _ = course.at(times_s).of_points(points_m)
    mount = np.reshape(scene.rig.radar.position_m, (1, 3))
    radar, moving, _ = scene.rig.course.at(times_s).of_points(mount)
    offset = place - radar
    ranges = np.linalg.norm(offset, axis=-1)
    rates = np.sum((velocity - moving) * offset, axis=-1) / np.maximum(ranges, 1e-12)
    return ranges, rates


def _family(scene: Scene, name: str | None) -> list[SceneObject]:
    """An object with meshes, what carries it, and all that is carried with it."""
    by_name = {item.name: item for item in scene.objects}

    def root(item: SceneObject) -> str:
        while item.parent in by_name:
            item = by_name[item.parent]
        return item.name

    if name not in by_name:
        return []
    top = root(by_name[name])
    ordered = sorted(scene.objects, key=lambda item: item.name != top)  # the body first
    return [item for item in ordered if len(item.geometry.faces) and root(item) == top]


def _own_speed(item: SceneObject) -> float:
    """Of its points against the middle of its box, now: 0 of what goes straight on."""
    spin = np.linalg.norm(item.state.angular_velocity_rad_per_s)
    return float(spin) * item.geometry.shape.size_m / 2


def _of_part(item: SceneObject, scene: Scene, times_s: Array) -> tuple[Array, Array]:
    points = item.geometry.vertices_m[item.geometry.shape.hull]
    return ranges_and_rates(item.course, points, scene, times_s)
