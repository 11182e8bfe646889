"""Which pattern each measurement takes of the moving image, and when."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.records import SpiRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TimedRows:
    """Measurements as sums of Hadamard rows of the image at times of their own.

    Measurement k is the sum over terms of ``weight[t, k]`` times row ``rows[t, k]`` of the image at
    ``time_s[t, k]``, all ``(n_terms, n_measurements)``, with the mean of all measurements taken out
    where ``centred``. ``values`` (n_measurements, n_images) are what was measured.
    """

    rows: NDArray[np.intp]
    time_s: Array
    weight: Array
    values: Array
    centred: bool

    @property
    def count(self) -> int:
        """Measurements."""
        return len(self.values)


def middle_ns(record: SpiRecord) -> int:
    """The middle of a record's exposures on the device's clock."""
    first, last = int(record.device_time_ns[0]), int(record.device_time_ns[-1])
    return (first + last) // 2 + round(5e8 * record.integration_time_s)


def exposure_times_s(record: SpiRecord, reference_ns: int) -> Array:
    """Mean time of each pattern's exposures, all its shutters together, after a reference on the
    device's clock, ``(n_patterns shown,)``.
    """
    since_ns = record.device_time_ns - reference_ns
    middles = 1e-9 * since_ns + record.integration_time_s / 2
    return np.asarray(middles.reshape(-1, len(record.shutters)).mean(axis=1))


def timed_rows(
    patterns: PatternSet, electrons: Array, time_s: Array, *, pairs_apart: bool
) -> TimedRows:
    """Measurements of exposures ``(n_exposures, n_detectors)`` at times ``(n_exposures,)``.

    Complementary: lit minus complement is the row at one time. Differential: the same at the mean
    time of the two, or with ``pairs_apart`` (1/2) (row at t1 + row at t2) + (1/2) (all cells at t1
    - all cells at t2). All others: twice the light of an exposure is its row with its sign, plus
    all cells at its time, plus background, which goes with the mean.
    """
    rows, signs = patterns.exposures
    if patterns.mode == "complementary":
        lit, complement = np.split(electrons, 2, axis=1)
        one = np.ones((1, len(rows)))
        return TimedRows(rows[None], time_s[None], one, lit - complement, False)
    if patterns.mode != "differential":
        weight = np.stack([signs.astype(np.float64), np.ones(len(rows))])
        both = np.stack([rows, np.zeros_like(rows)])
        values = 2 * (electrons - electrons.mean(axis=0))
        return TimedRows(both, np.stack([time_s] * 2), weight, values, True)
    values, rows = electrons[0::2] - electrons[1::2], rows[0::2]
    first, second = time_s[0::2], time_s[1::2]
    if not pairs_apart:
        mean = (first + second) / 2
        return TimedRows(rows[None], mean[None], np.ones((1, len(rows))), values, False)
    half = np.full(len(rows), 0.5)
    all_cells = np.zeros_like(rows)
    return TimedRows(
        np.stack([rows, rows, all_cells, all_cells]),
        np.stack([first, second, first, second]),
        np.stack([half, half, half, -half]),
        values,
        False,
    )
