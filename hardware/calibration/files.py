"""Files of calibrations, of either kind."""

import math
import time
from pathlib import Path

import numpy as np

from hardware.calibration.camera import CameraCalibration
from hardware.calibration.radar import RadarCalibration
from hardware.calibration.target import CalibrationTarget
from hardware.errors import InputError
from hardware.records import container

Calibration = CameraCalibration | RadarCalibration

_TARGET = ("distance_m", "size")
#: Settings of a radar's calibration that its first version did not have.
_RADAR = (
    "range_offset_m",
    "range_offset_error_m",
    "two_way_gain_db",
    "two_way_gain_error_db",
    "carrier_hz",
    "antenna_gain_dbi",
    "losses_db",
)
_LAYOUTS = {
    CameraCalibration: container.Layout(
        format="ugv-camera-calibration",
        version=2,
        settings=("device", "made_ns", "warning_lines"),
        arrays={
            "dark": (np.float64, "electrons per second, (n_detectors, rows, columns)"),
            "flat": (np.float64, "electrons per second, (n_detectors, rows, columns)"),
        },
        added={"warning_lines": 2},
        group="target",
        parameters=_TARGET,
    ),
    RadarCalibration: container.Layout(
        format="ugv-radar-calibration",
        version=2,
        settings=("device", "made_ns", *_RADAR, "warning_lines"),
        arrays={},
        added=dict.fromkeys((*_RADAR, "warning_lines"), 2),
        group="target",
        parameters=_TARGET,
    ),
}


def write_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write to one HDF5 file, whole or not at all."""
    container.write(_LAYOUTS[type(calibration)], calibration, path)


def read_calibration(path: str | Path, *, max_age_s: float = math.inf) -> Calibration:
    """Read a file of either kind.

    Raises FileNotFoundError; InputError for a file that is none, of another version, or older than
    ``max_age_s``.
    """
    faults = []
    for kind, layout in _LAYOUTS.items():
        try:
            fields, target = container.read(layout, path)
        except InputError as error:
            faults.append(str(error))
            continue
        if kind is RadarCalibration and "carrier_hz" not in fields:
            raise InputError(
                f"{path}: a radar's calibration of version 1, which holds at one transmit power "
                "and carrier and does not tell them, expected version 2: calibrate anew (`ugv "
                "calibrate radar`)"
            )
        fields["warnings"] = tuple(fields.pop("warning_lines", "").splitlines())
        calibration: Calibration = kind(**fields, target=CalibrationTarget(**target))
        age_s = (time.time_ns() - calibration.made_ns) * 1e-9
        if age_s > max_age_s:
            raise InputError(
                f"{path}: {age_s / 86400:.3g} days old, at most {max_age_s / 86400:.3g} are allowed"
            )
        return calibration
    raise InputError("; ".join(faults))
