"""Calibration against a reference target at a known distance: stored, dated, applied.

Camera: flat-field correction. A dark record (lens covered, emitter running) shows what is no light,
a flat one the target filling the view; between them lies the target's reflectance. Radar: the
strongest echo near the target's distance tells the delay of the cables, and what power a square
metre sends back from a metre away.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar import Detection
from hardware.reconstruction import reconstruct
from hardware.records import SpiRecord, container
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

#: The target's echo is looked for within this distance of where it stands.
_NEAR_M = 1.0


@dataclass(frozen=True)
class CalibrationTarget:
    """Reference: ``size`` is a Lambertian reflectance for the camera, a radar cross section in
    square metres for the radar.
    """

    distance_m: float
    size: float

    def __post_init__(self) -> None:
        container.check_positive(self, "distance_m", "size")


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Images of the dark and of the target.

    Parameters
    ----------
    device, made_ns
        Which camera, and when (Unix time).
    dark, flat : (n_detectors, rows, columns)
        Photo-electrons per second of exposure.
    target
    """

    device: str
    made_ns: int
    dark: Array
    flat: Array
    target: CalibrationTarget

    @classmethod
    def of(cls, dark: SpiRecord, flat: SpiRecord, target: CalibrationTarget) -> Self:
        """From two records.

        Raises InputError for records of two cameras, or a cell no brighter than in the dark.
        """
        if dark.device != flat.device:
            raise InputError(f"device: the dark is of {dark.device!r}, the flat of {flat.device!r}")
        unlit, lit = (
            reconstruct(r, "zero-fill").image / r.integration_time_s for r in (dark, flat)
        )
        if unlit.shape != lit.shape or (lit <= unlit).any():
            raise InputError("flat: a cell is no brighter than in the dark, or is missing there")
        return cls(flat.device, time.time_ns(), unlit, lit, target)

    def reflectance(self, image: Array, record: SpiRecord, distance_m: float) -> Array:
        """Lambertian reflectance of a surface at a distance, from an image in electrons.

        A cell's beam lights more surface farther away, with the same power in all; what comes back
        into the lens falls with one square of the distance.

        Raises InputError for another camera or other cells.
        """
        _check_device(self.device, record.device)
        if image.shape != self.flat.shape:
            raise InputError(f"image: shape {image.shape}, calibrated {self.flat.shape}")
        light = image / record.integration_time_s - self.dark
        scale = self.target.size * (distance_m / self.target.distance_m) ** 2
        return np.asarray(light / (self.flat - self.dark) * scale)


@dataclass(frozen=True, eq=False)
class RadarCalibration:
    """What the radar made of the target.

    ``range_offset_m`` is measured minus true range, ``constant_w_m2`` the received power of one
    square metre times the fourth power of its range: P = constant sigma / R^4.
    """

    device: str
    made_ns: int
    range_offset_m: float
    constant_w_m2: float
    target: CalibrationTarget

    @classmethod
    def of(cls, device: str, detections: Sequence[Detection], target: CalibrationTarget) -> Self:
        """From the strongest detection near the target. Raises InputError where there is none."""
        away = target.distance_m
        near = [detection for detection in detections if abs(detection.range_m - away) < _NEAR_M]
        if not near:
            raise InputError(f"detections: none within {_NEAR_M:g} m of the target at {away:g} m")
        best = max(near, key=lambda detection: detection.power_w)
        constant = best.power_w * away**4 / target.size
        return cls(device, time.time_ns(), best.range_m - away, constant, target)

    def corrected(self, detection: Detection, waveform: OfdmWaveform) -> Detection:
        """Detection with its true range, and the cross-section that its power says from there.

        For a target in the direction that the reference stood in. What averaging over a slot takes
        from a moving target's echo is put back; ``waveform`` is the one that was processed.
        """
        range_m = detection.range_m - self.range_offset_m
        rate = detection.range_rate_m_per_s if np.isfinite(detection.range_rate_m_per_s) else 0.0
        slot_gain = float(waveform.slot_gain(np.array(2 * rate / waveform.wavelength_m))) ** 2
        rcs_m2 = (
            detection.power_w * range_m**4 / (self.constant_w_m2 * slot_gain)
            if slot_gain
            else math.nan
        )
        return replace(detection, range_m=range_m, rcs_m2=rcs_m2)


Calibration = CameraCalibration | RadarCalibration

_TARGET = ("distance_m", "size")
_LAYOUTS = {
    CameraCalibration: container.Layout(
        format="ugv-camera-calibration",
        version=1,
        settings=("device", "made_ns"),
        arrays={
            "dark": (np.float64, "electrons per second, (n_detectors, rows, columns)"),
            "flat": (np.float64, "electrons per second, (n_detectors, rows, columns)"),
        },
        group="target",
        parameters=_TARGET,
    ),
    RadarCalibration: container.Layout(
        format="ugv-radar-calibration",
        version=1,
        settings=("device", "made_ns", "range_offset_m", "constant_w_m2"),
        arrays={},
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
        calibration: Calibration = kind(**fields, target=CalibrationTarget(**target))
        age_s = (time.time_ns() - calibration.made_ns) * 1e-9
        if age_s > max_age_s:
            raise InputError(
                f"{path}: {age_s / 86400:.3g} days old, at most {max_age_s / 86400:.3g} are allowed"
            )
        return calibration
    raise InputError("; ".join(faults))


def _check_device(calibrated: str, measured: str) -> None:
    if calibrated != measured:
        raise InputError(f"device: calibrated {calibrated!r}, measured {measured!r}")
