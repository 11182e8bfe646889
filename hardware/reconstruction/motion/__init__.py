"""Images of what moves while it is measured: motion given, or found in the measurements."""

from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.estimation import EstimatedShift, Search, estimated_shift
from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.layers import Layers, MovingBox
from hardware.reconstruction.motion.model import (
    CellMotion,
    Homography,
    Motion,
    Shift,
    ShiftTrack,
)
from hardware.reconstruction.motion.odometry import RigMotion, twist_between

__all__ = [
    "CellMotion",
    "Compensation",
    "EstimatedShift",
    "Homography",
    "Layers",
    "Motion",
    "MovingBox",
    "PlaneMotion",
    "RigMotion",
    "Search",
    "Shift",
    "ShiftTrack",
    "estimated_shift",
    "twist_between",
]
