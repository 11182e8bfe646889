"""From records to what the vehicle wants to know, as messages in a log."""

import numpy as np

from hardware.calibration import CameraCalibration, RadarCalibration
from hardware.radar import Detection, channel, detect, range_doppler
from hardware.reconstruction import reconstruct
from hardware.recording import Log, Received, ros
from hardware.records import RadarRecord, SpiRecord


def process(
    received: Received,
    log: Log,
    *,
    method: str = "lmmse",
    camera: CameraCalibration | None = None,
    radar: RadarCalibration | None = None,
) -> str:
    """Append the image of a camera's record, or the detections of a radar's; what they are, in
    words.

    Images are in electrons or, with a calibration, reflectance at the target's distance.
    """
    sensor = received.topic.rsplit("/", 1)[0] or "/sensor"
    if isinstance(received.record, SpiRecord):
        return _image(received, received.record, log, sensor, method, camera)
    return _detections(received, received.record, log, sensor, radar)


def _image(
    received: Received,
    record: SpiRecord,
    log: Log,
    sensor: str,
    method: str,
    calibration: CameraCalibration | None,
) -> str:
    cells, unit = reconstruct(record, method).image, "e-"
    if calibration:
        cells = calibration.reflectance(cells, record, calibration.target.distance_m)
        unit = "reflectance"
    stamp = stamp_ns(received)
    picture = ros.image(np.hstack(list(cells)), stamp, sensor.strip("/"))
    log.message(f"{sensor}/image", ros.IMAGE, picture, received.host_ns, stamp)
    return f"image {cells.min():.3g} to {cells.max():.3g} {unit}"


def _detections(
    received: Received,
    record: RadarRecord,
    log: Log,
    sensor: str,
    calibration: RadarCalibration | None,
) -> str:
    found = detections(record)
    if calibration:
        if calibration.device != record.device:
            raise ValueError(
                f"device: calibrated {calibration.device!r}, measured {record.device!r}"
            )
        found = [calibration.corrected(one) for one in found]
    n = len(found)
    columns = {
        "x": np.array([one.range_m for one in found]),
        "y": np.zeros(n),
        "z": np.zeros(n),
        "range_rate": np.array([one.range_rate_m_per_s for one in found]),
        "power": np.array([one.power_w for one in found]),
        "snr_db": np.array([one.snr_db for one in found]),
    }
    stamp = stamp_ns(received)
    cloud = ros.points(columns, stamp, sensor.strip("/"))
    log.message(f"{sensor}/detections", ros.POINTS, cloud, received.host_ns, stamp)
    return f"{n} detections" + (f", the strongest at {found[0].range_m:.3f} m" if n else "")


def detections(record: RadarRecord) -> list[Detection]:
    """Detections of a record's first burst, carrier and receiver: along the range alone."""
    received = channel(record)
    image = range_doppler(received, record.waveform)
    return detect(received, record.waveform, image)


def stamp_ns(received: Received) -> int:
    """Time of a record on the host's clock: the device's where its clock is known."""
    first = received.record.device_time_ns.reshape(-1)[0]
    return received.clock.host_ns(int(first)) if received.clock else received.host_ns
