"""From records to what the vehicle wants to know, as messages in a log."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hardware.calibration import CameraCalibration, RadarCalibration
from hardware.errors import InputError
from hardware.formatting import counted, number, quantity_text, si
from hardware.motion_of_tracks import MotionOfTracks
from hardware.radar import Detection
from hardware.radar.process import Frame, frames
from hardware.radar.settings import Processing
from hardware.reconstruction import Method, Reconstruction, reconstruct
from hardware.reconstruction.motion import Motion, Search
from hardware.reconstruction.registry import Solve
from hardware.recording import Log, Received, ros
from hardware.recording.mounting import sensor_of
from hardware.records import RadarRecord, SpiRecord
from hardware.sliding_images import SlidingImages
from hardware.tracks import RadarTracks
from hardware.tracks import cloud as track_cloud
from hardware.words_of_motion import motion_in_words


@dataclass(frozen=True)
class RecordSummary:
    """What a record showed: a line for each message written, and what was wrong with it."""

    lines: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def process(
    received: Received,
    log: Log,
    *,
    method: str | Method | Solve = "lmmse",
    how: Processing | None = None,
    camera: CameraCalibration | None = None,
    radar: RadarCalibration | None = None,
    tracks: RadarTracks | None = None,
    sliding: SlidingImages | None = None,
    motion: Motion | Search | MotionOfTracks | None = None,
    distance_m: float | None = None,
) -> RecordSummary:
    """Append the image of a camera's record, or each burst's detections of a radar's.

    Images are in electrons or, with a calibration, the reflectance of surfaces that all stand at
    ``distance_m``, None: as far as the calibration's target. One at another distance d is wrong by
    the factor (distance_m / d)^2. NaN where cells are not measured. The radar's are those of
    `hardware.radar.process.process`, as ``ugv detect`` lists them, as `cloud`.

    With ``tracks`` the confirmed tracks of each burst follow, in the world's frame
    (`hardware.tracks.cloud`); with ``sliding`` the images are those of its window instead of
    ``method``'s. ``motion`` is what images of whole sets are compensated for
    (`hardware.reconstruct`); `MotionOfTracks` takes it from the poses and ``tracks`` of the records
    before, and needs these.

    Raises InputError for a calibration that does not hold for the record.
    """
    sensor = sensor_of(received.topic)
    if isinstance(received.record, SpiRecord):
        if sliding:
            return _images(received, received.record, log, sensor, sliding, camera, distance_m)
        return _image(received, received.record, log, sensor, method, camera, motion, distance_m)
    follows = motion if isinstance(motion, MotionOfTracks) else None
    return _detections(received, received.record, log, sensor, how, radar, tracks, follows)


def _image(
    received: Received,
    record: SpiRecord,
    log: Log,
    sensor: str,
    method: str | Method | Solve,
    calibration: CameraCalibration | None,
    motion: Motion | Search | MotionOfTracks | None,
    distance_m: float | None,
) -> RecordSummary:
    told, warnings = tuple[str, ...](), tuple[str, ...]()
    if isinstance(motion, MotionOfTracks):
        supported, words = motion.supported(received, sensor)
        image, failed = _supported(record, method, supported.motion)
        told, warnings = (words,), (*supported.warnings, *failed)
    else:
        image = reconstruct(record, method, motion=motion)
        if isinstance(motion, Search):
            told = (f"motion: {motion_in_words(image.motion)}",)
    cells, unit = image.image, "e-"
    if calibration:
        distance_m = distance_m or calibration.target.distance_m
        cells = calibration.reflectance(cells, record, distance_m)
        unit = _reflectance_at(distance_m)
    stamp = _frame_ns(received)
    picture = ros.image(np.hstack(list(cells)), stamp, sensor.strip("/"))
    log.message(f"{sensor}/image", ros.IMAGE, picture, received.host_ns, stamp)
    return RecordSummary(
        (f"image {number(np.nanmin(cells))} to {number(np.nanmax(cells))} {unit}", *told),
        (*image.warnings, *warnings),
    )


def _reflectance_at(distance_m: float) -> str:
    return f"reflectance of surfaces at {quantity_text(distance_m, 'm')}"


def _supported(
    record: SpiRecord, method: str | Method | Solve, motion: Motion | None
) -> tuple[Reconstruction, tuple[str, ...]]:
    """The image by a motion that was found, as at rest where it leads too far, and a warning."""
    try:
        return reconstruct(record, method, motion=motion), ()
    except InputError as error:
        if motion is None:
            raise
        return reconstruct(record, method), (f"motion not compensated: {error}",)


def _images(
    received: Received,
    record: SpiRecord,
    log: Log,
    sensor: str,
    sliding: SlidingImages,
    calibration: CameraCalibration | None,
    distance_m: float | None,
) -> RecordSummary:
    n, kind = 0, "images"
    if calibration:
        distance_m = distance_m or calibration.target.distance_m
        kind = f"images of {_reflectance_at(distance_m)}"
    between = sliding.update(sensor, record)
    for time_ns, cells in between.images:
        if calibration and distance_m:
            cells = calibration.reflectance(cells, record, distance_m)
        stamp = received.clock.host_ns(time_ns) if received.clock else received.host_ns
        picture = ros.image(np.hstack(list(cells)), stamp, sensor.strip("/"))
        log.message(f"{sensor}/image", ros.IMAGE, picture, received.host_ns, stamp)
        n += 1
    told = (
        (f"motion: {motion_in_words(between.motion)}",)
        if isinstance(sliding.motion, Search)
        else ()
    )
    return RecordSummary((f"{n} {kind}", *told), between.warnings)


def _detections(
    received: Received,
    record: RadarRecord,
    log: Log,
    sensor: str,
    how: Processing | None,
    calibration: RadarCalibration | None,
    tracks: RadarTracks | None,
    follows: MotionOfTracks | None,
) -> RecordSummary:
    lines: list[str] = []
    warnings: list[str] = []
    for frame in frames(record, how):
        detections = calibrated(frame, record, calibration)
        stamp = _burst_ns(received, record, frame.middle_ns)
        points = ros.points(cloud(detections), stamp, sensor.strip("/"))
        log.message(f"{sensor}/detections", ros.POINTS, points, received.host_ns, stamp)
        ranged = bool(detections) and not np.isnan(detections[0].range_m)
        strongest = f", the strongest at {si(detections[0].range_m, 'm', 4)}" if ranged else ""
        followed = ""
        if tracks:
            pose = record.pose[frame.burst]
            confirmed = tracks.update(sensor, detections, frame.middle_ns, pose)
            if follows:
                follows.burst(sensor, stamp, pose, confirmed)
            points = ros.points(track_cloud(confirmed), stamp, "world")
            log.message(f"{sensor}/tracks", ros.POINTS, points, received.host_ns, stamp)
            followed = f", {counted(len(confirmed), 'track')}"
            if more := tracks.bursts_to_first(sensor):
                followed += f" (needs {counted(more, 'more burst')})"
        lines.append(
            f"burst {frame.burst}: {len(detections)} detections{frame.by}{strongest}{followed}"
        )
        warnings += frame.warnings
    return RecordSummary(tuple(lines), tuple(warnings))


def calibrated(
    frame: Frame, record: RadarRecord, calibration: RadarCalibration | None
) -> tuple[Detection, ...]:
    """Detections of a burst, with ranges and cross-sections by a calibration where there is one.

    Raises InputError for a calibration that does not hold for the record.
    """
    if calibration is None:
        return frame.detections
    calibration.check(record)
    return tuple(
        calibration.corrected(one, frame.waveform, record.front_end) for one in frame.detections
    )


def cloud(detections: Sequence[Detection]) -> dict[str, NDArray[np.float64]]:
    """Columns of a point cloud: ``x``, ``y``, ``z`` in the antenna's frame, and every number of a
    `Detection` under its own name, (n_detections,) each; of the range rates that the record cannot
    exclude ``range_rate_alternatives`` is the number and ``range_rate_alternative_K_m_per_s``, K
    from 1, the K-th, as many columns as the most ambiguous detection needs; the same of directions,
    ``azimuth_alternative_K_rad`` and ``elevation_alternative_K_rad``.

    What was not measured is NaN: x and y without an azimuth, z without an elevation; x and y are
    then those of a target at the antenna's height.
    """
    columns = {}
    for name in (field.name for field in fields(Detection) if field.type is float):
        values = np.array([getattr(one, name) for one in detections], np.float64)
        columns[name] = np.where(np.isfinite(values), values, np.nan)
    for name in ("range_rate_alternatives_m_per_s", "azimuth_alternatives_rad",
                 "elevation_alternatives_rad"):  # fmt: skip
        quantity, unit = name.split("_alternatives_")
        others = [getattr(one, name) for one in detections]
        columns[f"{quantity}_alternatives"] = np.array([len(own) for own in others], np.float64)
        for k in range(max(map(len, others), default=0)):
            own = [values[k] if k < len(values) else np.nan for values in others]
            columns[f"{quantity}_alternative_{k + 1}_{unit}"] = np.array(own)
    range_m, azimuth, elevation = (
        columns[name] for name in ("range_m", "azimuth_rad", "elevation_rad")
    )
    level_m = range_m * np.cos(np.where(np.isnan(elevation), 0.0, elevation))
    place = {
        "x": level_m * np.cos(azimuth),
        "y": level_m * np.sin(azimuth),
        "z": range_m * np.sin(elevation),
    }
    return place | columns


def _frame_ns(received: Received) -> int:
    """Time of a camera's record on the host's clock: that of its first exposure where the device's
    clock is known, else when it came.
    """
    if received.clock:
        return received.clock.host_ns(int(received.record.device_time_ns.flat[0]))
    return received.host_ns


def _burst_ns(received: Received, record: RadarRecord, middle_ns: int) -> int:
    """A burst's middle on the host's clock; where the device's is not known, as long before the
    record came as before its end.
    """
    if received.clock:
        return received.clock.host_ns(middle_ns)
    end_ns = int(record.device_time_ns[-1, -1, -1]) + round(1e9 * record.waveform.slot_period_s)
    return received.host_ns + middle_ns - end_ns
