"""The contract between whoever measures and whoever processes: raw counts with their settings.

A record holds what a device can send and nothing else: integers, settings, clocks, flags, the
pose. On disk it is one HDF5 file; ``FORMAT`` and ``SCHEMA_VERSION`` are its first attributes.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet

FORMAT = "ugv-spi-record"
SCHEMA_VERSION = 1


class Flag(IntFlag):
    """What may be wrong with one exposure."""

    SATURATED = 1
    OVERRUN = 2
    RESET = 4


@dataclass(frozen=True, eq=False)
class SpiRecord:
    """One acquisition of a single-pixel camera.

    Parameters
    ----------
    counts : (n_exposures, n_detectors) int32
        ADC output, one row per pattern shown, in the order of ``patterns``.
    device_time_ns : (n_exposures,) int64
        Device clock at the start of each exposure.
    sequence : (n_exposures,) uint32
        The device's own numbering; a gap is a lost exposure.
    flags : (n_exposures,) uint8
        Bits of `Flag`.
    patterns
        What was shown.
    integration_time_s
        Length of each exposure.
    electrons_per_count, offset_counts
        The front end's conversion: photo-electrons = (counts - offset) * electrons_per_count.
    adc_bits
        Counts run from 0 to 2**adc_bits - 1.
    device
        Identification, as the device reports it.
    pose : (7,) float64
        Rig in the world at the start: x, y, z in metres, unit quaternion w, x, y, z (REP 103).
    """

    counts: NDArray[np.int32]
    device_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    flags: NDArray[np.uint8]
    patterns: PatternSet
    integration_time_s: float
    electrons_per_count: float
    offset_counts: float
    adc_bits: int
    device: str
    pose: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = self.patterns.n_exposures
        expected = {"device_time_ns": (n,), "sequence": (n,), "flags": (n,), "pose": (7,)}
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name}: shape {getattr(self, name).shape}, expected {shape}")
        if self.counts.ndim != 2 or self.counts.shape[0] != n:
            raise ValueError(f"counts: shape {self.counts.shape}, expected ({n}, n_detectors)")
        if not np.issubdtype(self.counts.dtype, np.integer):
            raise ValueError(f"counts: dtype {self.counts.dtype}, expected integers")
        if not 1 <= self.adc_bits <= 31:
            raise ValueError(f"adc_bits: {self.adc_bits} is not between 1 and 31")
        top = 2**self.adc_bits - 1
        if self.counts.size and not (self.counts.min() >= 0 and self.counts.max() <= top):
            raise ValueError(f"counts: outside 0 to {top}, the range of {self.adc_bits} bits")
        for name in ("integration_time_s", "electrons_per_count"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value} is not a positive number")

    @property
    def electrons(self) -> NDArray[np.float64]:
        """Photo-electrons of each exposure, shape ``(n_exposures, n_detectors)``."""
        return (self.counts - np.float64(self.offset_counts)) * self.electrons_per_count


_ARRAYS = {
    "counts": (np.int32, "ADC counts, (n_exposures, n_detectors)"),
    "device_time_ns": (np.int64, "device clock at the start of each exposure, ns"),
    "sequence": (np.uint32, "exposure number given by the device"),
    "flags": (np.uint8, "1 saturated, 2 overrun, 4 reset"),
    "pose": (np.float64, "rig in the world: x y z (m), quaternion w x y z"),
}
_SETTINGS = ("integration_time_s", "electrons_per_count", "offset_counts", "adc_bits", "device")
_PATTERNS = ("rows", "columns", "count", "order", "mode")


def write_record(record: SpiRecord, path: str | Path) -> None:
    """Write a record to one HDF5 file; an existing file is replaced at the very end, or not at all.

    The same record gives the same bytes.
    """
    import h5py

    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with h5py.File(partial, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["schema_version"] = SCHEMA_VERSION
            for name in _SETTINGS:
                file.attrs[name] = getattr(record, name)
            patterns = file.create_group("patterns")
            for name in _PATTERNS:
                patterns.attrs[name] = getattr(record.patterns, name)
            for name, (dtype, meaning) in _ARRAYS.items():
                data = np.asarray(getattr(record, name), dtype=dtype)
                file.create_dataset(name, data=data).attrs["meaning"] = meaning
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def read_record(path: str | Path) -> SpiRecord:
    """Read a record written by `write_record`, on any platform.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        The file is no record, one of another schema version, or incomplete.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such record")
    try:
        with h5py.File(path, "r") as file:
            _check_schema(file.attrs)
            arrays: dict[str, Any] = {
                name: file[name][()].astype(dtype) for name, (dtype, _) in _ARRAYS.items()
            }
            settings: dict[str, Any] = {name: _plain(file.attrs[name]) for name in _SETTINGS}
            shown: dict[str, Any] = {
                name: _plain(file["patterns"].attrs[name]) for name in _PATTERNS
            }
        return SpiRecord(patterns=PatternSet(**shown), **arrays, **settings)
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _check_schema(attributes: Mapping[str, Any]) -> None:
    if attributes.get("format") != FORMAT:
        raise ValueError(f"not a record: its format is {attributes.get('format')!r}")
    if attributes["schema_version"] != SCHEMA_VERSION:
        raise ValueError(
            f"schema version {attributes['schema_version']}, this software reads {SCHEMA_VERSION}"
        )


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
