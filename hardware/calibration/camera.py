"""Flat-field correction of a camera.

A dark record (lens covered, emitter running) shows what is no light, a flat one the target filling
the view; between them lies the target's reflectance.
"""

import time
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hardware.calibration.target import CalibrationTarget, Warned, check_device, distinct
from hardware.errors import InputError
from hardware.reconstruction import reconstruct
from hardware.reconstruction.imaging import marked_exposures
from hardware.records import SpiRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraCalibration(Warned):
    """Images of the dark and of the target.

    Parameters
    ----------
    device, made_ns
        Which camera, and when (Unix time).
    dark, flat : (n_detectors, rows, columns)
        Photo-electrons per second of exposure.
    target
    warnings
        What was wrong with the two images, for whoever uses them.
    """

    device: str
    made_ns: int
    dark: Array
    flat: Array
    target: CalibrationTarget
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        dark: SpiRecord,
        flat: SpiRecord,
        target: CalibrationTarget,
        names: tuple[str, str] = ("dark", "flat"),
    ) -> Self:
        """From two records, which messages call by their ``names``.

        Raises InputError for records of two cameras, for one with an exposure that is saturated or
        missing (through the transform a single one is in every cell, and all that is measured later
        is divided by it), and for a cell no brighter than in the dark.
        """
        if dark.device != flat.device:
            raise InputError(f"device: the dark is of {dark.device!r}, the flat of {flat.device!r}")
        made, warnings = [], []
        for name, record in zip(names, (dark, flat), strict=True):
            if marked := "; ".join(marked_exposures(record)):
                raise InputError(
                    f"{name}: {marked}: expected none in a calibration; take it anew, and where it "
                    "is saturated with less light or a shorter exposure"
                )
            image = reconstruct(record, "zero-fill")
            made.append(image.image / record.integration_time_s)
            warnings += [f"{name}: {warning}" for warning in image.warnings]
        unlit, lit = made
        if unlit.shape != lit.shape or (lit <= unlit).any():
            raise InputError(
                f"{names[1]}: a cell is no brighter than in the dark, or is missing there"
            )
        return cls(flat.device, time.time_ns(), unlit, lit, target, distinct(warnings))

    def reflectance(self, image: Array, record: SpiRecord, distance_m: float) -> Array:
        """Lambertian reflectance of a surface at a distance, from an image in electrons.

        A cell's beam lights more surface farther away, with the same power in all; what comes back
        into the lens falls with one square of the distance.

        Raises InputError for another camera or other cells.
        """
        check_device(self.device, record.device)
        if image.shape != self.flat.shape:
            raise InputError(f"image: shape {image.shape}, calibrated {self.flat.shape}")
        light = image / record.integration_time_s - self.dark
        scale = self.target.size * (distance_m / self.target.distance_m) ** 2
        return np.asarray(light / (self.flat - self.dark) * scale)
