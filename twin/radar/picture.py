"""What back-projection over a track shows, beside what is really there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import ConvexHull, QhullError

from hardware.formatting import si
from hardware.radar.imaging import RadarImage, image
from hardware.records import QuaternionPose, RadarRecord
from hardware.records.state import positions, rotations
from twin.radar.device.design import RadarDesign
from twin.scene import Scene, Target

Array = NDArray[np.float64]

_CELLS = 161  # along each side
_MARGIN_M = 0.4  # around the true targets


@dataclass(frozen=True)
class Seen:
    """The highest point of the picture near a true target, and the cross-section it stands for.

    ``off_m`` is its distance from the target: of a body, which reflects with its front, not zero;
    ``cross_off_m`` across alone.
    """

    name: str
    down_range_m: float
    cross_range_m: float
    off_m: float
    cross_off_m: float
    rcs_m2: float
    declared_rcs_m2: float


@dataclass(frozen=True, eq=False)
class TrackPicture:
    """Image over a track, true outlines as polygons (n, 2) of down- and cross-range, and targets.

    Axes are those of the antenna in the middle of its track.
    """

    image: RadarImage
    outlines: dict[str, Array]
    seen: tuple[Seen, ...]

    @property
    def told_apart(self) -> tuple[Seen, ...]:
        """Targets with a peak of their own, within a resolution cell, across within half of one."""
        peaks = [(s.down_range_m, s.cross_range_m) for s in self.seen]
        return tuple(
            s
            for s, peak in zip(self.seen, peaks, strict=True)
            if peaks.count(peak) == 1
            and abs(s.cross_off_m) <= self.image.cross_resolution_m / 2
            and s.off_m <= max(self.image.down_resolution_m, self.image.cross_resolution_m)
        )

    def __str__(self) -> str:
        """What the picture shows."""
        resolution = si(self.image.cross_resolution_m, "m")
        text = f"image over the track: {len(self.told_apart)} of {len(self.seen)} targets"
        if not self.told_apart:
            return f"{text} (resolution across {resolution})"
        worst = max(abs(s.cross_off_m) for s in self.told_apart)
        return f"{text}, within {si(worst, 'm', 2)} across (resolution {resolution})"


def track_picture(scene: Scene, radar: RadarDesign, record: RadarRecord) -> TrackPicture | None:
    """Picture of the true targets' surroundings; None without a track or targets, and where these
    lie beyond what the radar's subcarriers can tell.
    """
    if len(record.iq) == 1 or not scene.targets:
        return None
    origin, axes = _middle(record.pose)
    places = (np.array([t.position_m for t in scene.targets]) - origin) @ axes.T
    low, high = places[:, :2].min(axis=0) - _MARGIN_M, places[:, :2].max(axis=0) + _MARGIN_M
    down, cross = (np.linspace(a, b, _CELLS) for a, b in zip(low, high, strict=True))
    far_m = np.hypot(high[0], np.abs([low[1], high[1]]).max()) + np.ptp(positions(record.pose))
    if far_m > record.waveform.max_range_m:
        return None
    focused = image(record, down[down > 0], cross)
    return TrackPicture(
        image=focused,
        outlines={
            item.name: outline
            for item in scene.objects
            if (outline := _outline((item.vertices_m - origin) @ axes.T, low, high)) is not None
        },
        seen=tuple(
            _seen(focused, place, target, _unit_wave(radar, record, target))
            for place, target in zip(places, scene.targets, strict=True)
        ),
    )


def _middle(poses: Sequence[QuaternionPose]) -> tuple[Array, Array]:
    """Origin and axes (rows) of the picture."""
    return positions(poses).mean(axis=0), poses[len(poses) // 2].rotation.as_matrix().T


def _outline(vertices: Array, low: Array, high: Array) -> Array | None:
    """Convex outline from above of what lies in the picture."""
    flat = vertices[:, :2]
    if not ((flat > low) & (flat < high)).all(axis=1).any():
        return None
    try:
        return np.asarray(flat[ConvexHull(flat).vertices], dtype=np.float64)
    except QhullError:  # seen edge on
        return None


def _unit_wave(radar: RadarDesign, record: RadarRecord, target: Target) -> float:
    """What 1 m^2 in the target's place would show in the picture, root watts: the mean over stops,
    at the middle of the band.
    """
    offsets_m = (
        rotations(record.pose).inv().apply(np.asarray(target.position_m) - positions(record.pose))
    )
    ranges = np.linalg.norm(offsets_m, axis=1)
    powers = [
        radar.received_power_w(float(r), 1.0, (float(x), float(y), float(z)))
        for r, (x, y, z) in zip(ranges, offsets_m / ranges[:, None], strict=True)
    ]
    wavelengths = record.carriers_hz[0] / record.carriers_hz.mean()
    return float(np.mean(np.sqrt(powers)) * wavelengths)


def _seen(focused: RadarImage, place: Array, target: Target, unit_wave: float) -> Seen:
    """Of all local maxima the nearest that is not 10 dB below the highest."""
    power = np.abs(focused.value) ** 2
    peaks = (power == maximum_filter(power, 5)) & (power > 0.1 * power.max())
    rows, columns = np.nonzero(peaks)
    down, cross = focused.down_range_m[rows], focused.cross_range_m[columns]
    off = np.hypot(down - place[0], cross - place[1])
    best = int(np.argmin(off))
    return Seen(
        name=target.name,
        down_range_m=float(down[best]),
        cross_range_m=float(cross[best]),
        off_m=float(off[best]),
        cross_off_m=float(cross[best] - place[1]),
        rcs_m2=float(power[rows[best], columns[best]] / unit_wave**2),
        declared_rcs_m2=target.rcs_m2,
    )
