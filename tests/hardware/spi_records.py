"""Records of a given signal, and a picture to make one of."""

import numpy as np

from hardware import PatternSet, SpiRecord
from hardware.records import QuaternionPose


def record_of(electrons: np.ndarray, patterns: PatternSet, bits: int = 31) -> SpiRecord:
    n = patterns.n_exposures
    return SpiRecord(
        counts=np.rint(electrons).astype(np.int32).reshape(n, -1),
        device_time_ns=np.arange(n, dtype=np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1e-4,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=bits,
        device="test",
        pose=QuaternionPose(),
    )


def scene(rows: int, columns: int) -> np.ndarray:
    """A bright box on a slope, whole even numbers."""
    picture = 200.0 * np.add.outer(np.arange(rows), np.arange(columns)) // 4 * 2
    picture[rows // 4 : rows // 2, columns // 4 : columns // 2] += 4000
    return picture
