"""How the sensors of a drive are mounted, as a vehicle's log tells it."""

from collections.abc import Iterator
from math import radians

from hardware.recording import ros
from hardware.recording.ros import Definition
from hardware.records import QuaternionPose
from twin.drive.plan import Drive


def mounting_of(drive: Drive, stamp_ns: int) -> Iterator[tuple[str, Definition, bytes]]:
    """Topic, definition and message: poses on the rig, and the camera's field where its image is
    that of one detector.
    """
    system, rig = drive.system, drive.scene.rig
    for frame, mounted in (("spi", rig.emitter), ("radar", rig.radar)):
        pose = QuaternionPose.of(mounted.position_m, mounted.rotation)
        yield "/tf_static", ros.TRANSFORMS, ros.transform(pose, stamp_ns, "rig", frame)
    if system is not None and system.n_detectors == 1:
        angle = radians(system.emitter.field_of_view_deg.value)
        info = ros.camera_info((angle, angle), system.image_shape, stamp_ns, "spi")
        yield "/spi/camera_info", ros.CAMERA_INFO, info
