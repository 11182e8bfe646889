"""Measurements of moving scenes in closed form: blobs and boxes, integrated over each cell."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from hardware import PatternSet, SpiRecord
from hardware.patterns import hadamard_rows
from hardware.records import QuaternionPose

#: Where the image's places go within a frame: (time_s) to cells down and to the right.
Path = Callable[[float], tuple[float, float]]


@dataclass(frozen=True)
class AnalyticScene:
    """Gaussian blobs (row, column, standard deviation, height) and boxes (first row, last row,
    first column, last column, height), in cells, on a background; wider than any image of it.
    """

    blobs: np.ndarray
    boxes: np.ndarray
    background: float

    @classmethod
    def of(cls, seed: int, n: int, reach: float, finest: float = 1.0) -> "AnalyticScene":
        """Drawn over an image of n x n cells and ``reach`` cells around it."""
        rng = np.random.default_rng(seed)
        low, high = -reach, n + reach
        many = int(40 * ((high - low) / n) ** 2)
        places = rng.uniform(low, high, (many, 2))
        sizes = finest * np.exp(rng.uniform(0, np.log(n / 6), many))
        blobs = np.column_stack([places, sizes, rng.normal(0, 0.3, many)])
        corner = rng.uniform(low, high, (many // 5, 2))
        extent = n * rng.uniform(0.08, 0.35, (many // 5, 2))
        boxes = np.column_stack(
            [
                corner[:, 0],
                corner[:, 0] + extent[:, 0],
                corner[:, 1],
                corner[:, 1] + extent[:, 1],
                rng.normal(0, 0.4, many // 5),
            ]
        )
        return cls(blobs, boxes, 2.0)

    def cells(self, n: int, down: float, right: float) -> np.ndarray:
        """Light of n x n cells when the scene has moved by so many cells."""
        edges = np.arange(n + 1)[:, None] - 0.5
        row, column, size, height = self.blobs.T
        down_parts, along_parts = (
            np.diff(erf((edges - at) / (np.sqrt(2) * size)), axis=0) * size * np.sqrt(np.pi / 2)
            for at in (row + down, column + right)
        )
        image = self.background + (down_parts * height) @ along_parts.T
        top, bottom, left, end, height = self.boxes.T
        down_parts, along_parts = (
            np.diff(np.clip(edges, first, last), axis=0)
            for first, last in ((top + down, bottom + down), (left + right, end + right))
        )
        return image + (down_parts * height) @ along_parts.T


def moving_record(
    scene: Callable[[float], np.ndarray],
    patterns: PatternSet,
    *,
    electrons: float = 1e5,
    noise: float = 0.0,
    seed: int = 0,
    frame_s: float = 1.0,
    background: float = 1e4,
) -> SpiRecord:
    """Exposures of cells ``scene(time_s)`` (n_cells,), each at its own time within the frame.

    ``electrons`` of a cell of light 1; ``noise`` of a cell of a full set's plain inverse, light.
    """
    rng = np.random.default_rng(seed)
    rows, signs = patterns.exposures
    n = len(rows)
    time_ns = np.rint(1e9 * frame_s * np.arange(n) / n).astype(np.int64)
    exposure_s = frame_s / n
    middle_s = 1e-9 * (time_ns[0] + time_ns[-1]) / 2
    light = np.empty(n)
    for k in range(n):
        walsh = hadamard_rows(rows[k : k + 1], patterns.n_cells)[0] * signs[k]
        light[k] = scene(1e-9 * time_ns[k] - middle_s)[walsh > 0].sum()
    # A value's noise is 2 exposures' when differential, twice one exposure's else.
    deviation = noise * np.sqrt(patterns.n_cells / (2 if patterns.mode == "differential" else 4))
    counts = electrons * (light + deviation * rng.normal(size=n)) + background
    return SpiRecord(
        counts=np.rint(counts).astype(np.int32)[:, None],
        device_time_ns=time_ns,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=exposure_s,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=31,
        device="moving",
        pose=QuaternionPose(),
    )


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """Peak: the truth's range."""
    return float(20 * np.log10(np.ptp(truth) / np.sqrt(np.mean((image - truth) ** 2))))
