"""Images of what moves while it is measured: motion given, or found in the measurements."""

from hardware.reconstruction.motion.knobs import Compensation
from hardware.reconstruction.motion.model import (
    CellMotion,
    Homography,
    Motion,
    Shift,
    ShiftTrack,
)

__all__ = ["CellMotion", "Compensation", "Homography", "Motion", "Shift", "ShiftTrack"]
