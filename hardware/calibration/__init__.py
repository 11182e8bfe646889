"""Calibration against a reference target at a known distance: stored, dated, applied."""

from hardware.calibration.camera import CameraCalibration
from hardware.calibration.files import Calibration, read_calibration, write_calibration
from hardware.calibration.radar import RadarCalibration
from hardware.calibration.target import CalibrationTarget

__all__ = [
    "Calibration",
    "CalibrationTarget",
    "CameraCalibration",
    "RadarCalibration",
    "read_calibration",
    "write_calibration",
]
