"""One acquisition of the single-pixel camera: counts per pattern and detector."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.errors import InputError, is_whole
from hardware.patterns import Patterns, PatternSet, RasterScan
from hardware.patterns.from_record import patterns_from_record
from hardware.records import container
from hardware.records.container import Flag
from hardware.records.exposure_times import check_order, time_warnings
from hardware.records.state import ALWAYS_OPEN, QuaternionPose, Shutter

Array = NDArray[np.int64]

#: Times (s) and factors of a camera below and above these are none: their squares are numbers.
LEAST_NUMBER, MOST_NUMBER = 1e-150, 1e9
MOST_ELECTRONS = 1e15  # of a count

_BY_EXPOSURE = ("counts", "device_time_ns", "sequence", "flags")


@dataclass(frozen=True, eq=False, repr=False)
class SpiRecord(Described):
    """One acquisition of a single-pixel camera.

    Parameters
    ----------
    counts : (n_exposures, n_detectors) int32
        ADC output, one row per pattern shown, in the order of ``patterns``.
    device_time_ns : (n_exposures,) int64
        Device clock at the start of each exposure. It rises as ``sequence`` does: times of a
        regular series in another order are refused, others that contradict the numbers warned of
        (`time_warnings`).
    sequence : (n_exposures,) uint32
        The device's own numbering of its exposures: it rises, and begins anew after 2**32 - 1. An
        exposure that was lost keeps its row and its number, with `Flag.LOST`; or it is left out
        together with its pattern, which leaves a gap (`received`). So patterns of a named order,
        none of which is left out, have no gap.
    flags : (n_exposures,) uint8
        Bits of `Flag`.
    patterns
        What was shown: Hadamard rows by name, a user's own patterns whole.
    integration_time_s
        Length of each exposure.
    electrons_per_count, offset_counts
        The front end's conversion: photo-electrons = (counts - offset) * electrons_per_count.
    adc_bits
        Counts run from 0 to 2**adc_bits - 1.
    device
        Identification, as the device reports it.
    pose
        Rig in the world at the start.
    shutters
        Every pattern is shown once with each shutter, one after another.
    pulse_width_s
        Length of the light's pulse, of gates; 0: none, or not stated.
    """

    counts: NDArray[np.int32]
    device_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    flags: NDArray[np.uint8]
    patterns: Patterns
    integration_time_s: float
    electrons_per_count: float
    offset_counts: float
    adc_bits: int
    device: str
    pose: QuaternionPose
    shutters: tuple[Shutter, ...] = (ALWAYS_OPEN,)
    pulse_width_s: float = 0.0

    def __post_init__(self) -> None:
        container.check_types(self, pose=QuaternionPose, patterns=Patterns, counts=np.ndarray)
        container.check_tuples(self, shutters=Shutter)
        if not self.shutters:
            raise InputError("shutters: none, expected at least one")
        if not all(0 <= value < np.inf for shutter in self.shutters for value in shutter):
            raise InputError("shutters: a value is negative or no number")
        container.check_between(self, 0, MOST_NUMBER, "pulse_width_s")
        n = self.patterns.n_exposures * len(self.shutters)
        shapes = {"device_time_ns": (n,), "sequence": (n,), "flags": (n,)}
        container.check_shapes(self, shapes)
        if self.counts.ndim != 2 or self.counts.shape[0] != n:
            raise InputError(f"counts: shape {self.counts.shape}, expected ({n}, n_detectors)")
        if self.counts.shape[1] == 0 or self.counts.shape[1] % self.patterns.n_arms:
            raise InputError(
                f"counts: {self.counts.shape[1]} detectors, expected {self.patterns.n_arms} "
                "for each image"
            )
        container.check_whole_numbers(self, *_BY_EXPOSURE)
        if not is_whole(self.adc_bits) or not 1 <= self.adc_bits <= 31:
            raise InputError(
                f"adc_bits: {self.adc_bits!r:.60} is not a whole number between 1 and 31"
            )
        top = 2**self.adc_bits - 1
        if self.counts.size and not (self.counts.min() >= 0 and self.counts.max() <= top):
            raise InputError(f"counts: outside 0 to {top}, the range of {self.adc_bits} bits")
        container.check_within(self, sequence=2**32 - 1, flags=2**8 - 1)
        self._check_sequence()
        if not (self.flags & Flag.RESET).any():
            check_order(*self._times_of_patterns((self.flags & Flag.LOST) == 0))
        container.check_positive(self, "integration_time_s", "electrons_per_count")
        container.check_between(self, LEAST_NUMBER, MOST_NUMBER, "integration_time_s")
        container.check_between(self, LEAST_NUMBER, MOST_ELECTRONS, "electrons_per_count")
        container.check_between(self, -MOST_NUMBER, MOST_NUMBER, "offset_counts")
        if not np.isfinite(self.pose).all():
            raise InputError("pose: a value is no number")

    def _check_sequence(self) -> None:
        """Raise InputError for numbers that contradict that row k shows pattern k."""
        steps = self._steps
        wrong = (steps == 0) | (steps >= 2**31)  # a step back is one forward by nearly 2**32
        named = isinstance(self.patterns, PatternSet | RasterScan) and self.patterns.subset is None
        if named and not wrong.any():
            wrong = steps != steps.min(initial=2**32)  # `by_shutter` gives larger ones, all alike
        if not wrong.any():
            return
        row = int(np.argmax(wrong)) + 1
        before, number = int(self.sequence[row - 1]), int(self.sequence[row])
        raise InputError(
            f"sequence: exposure {number} in row {row} follows {before}, expected "
            f"{(before + 1) % 2**32}: one that was lost keeps its row, with Flag.LOST"
        )

    @property
    def _steps(self) -> NDArray[np.int64]:
        """From one exposure's number to the next one's, in numbers of 32 bits."""
        return np.asarray(np.mod(np.diff(self.sequence.astype(np.int64)), 2**32))

    def _times_of_patterns(self, exposures: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Times and rising numbers of the first shutter of each pattern, of some exposures alone:
        shutters may be open in the same exposure.
        """
        first = np.flatnonzero(exposures[:: len(self.shutters)]) * len(self.shutters)
        numbers = np.concatenate([[0], np.cumsum(self._steps)])
        return self.device_time_ns.astype(np.int64)[first], numbers[first]

    @property
    def time_warnings(self) -> list[str]:
        """Warnings of times that contradict the numbers of the exposures."""
        every = np.ones(self.flags.shape, np.bool_)
        times, numbers = self._times_of_patterns(every)
        return time_warnings(times, numbers, self.flags[:: len(self.shutters)])

    @property
    def n_at_rail(self) -> int:
        """Exposures at an end of the converter's range that are not marked saturated or lost; 0 is
        no end where no light is 0 counts.
        """
        ends = self.counts == 2**self.adc_bits - 1
        if self.offset_counts > 0:
            ends |= self.counts == 0
        unmarked = (self.flags & (Flag.SATURATED | Flag.LOST)) == 0
        return int(np.count_nonzero(ends.any(axis=1) & unmarked))

    @property
    def n_left_out(self) -> int:
        """Exposures that the device numbered between those of this record and that have no row."""
        steps = self._steps
        return int((steps // steps.min() - 1).sum()) if steps.size else 0

    @property
    def received(self) -> "SpiRecord":
        """The record of the patterns that arrived whole: itself, where nothing is lost.

        A pattern goes with its complement and with all its shutters. Raises InputError where one
        is lost that the others need (the references), or all are.
        """
        if not (self.flags & Flag.LOST).any():
            return self
        patterns, n_shutters = self.patterns, len(self.shutters)
        here = ((self.flags & Flag.LOST) == 0).reshape(-1, n_shutters).all(axis=1)
        head = 2 if patterns.mode == "reference" else 0
        each = 2 if patterns.mode == "differential" else 1
        whole = here[head:].reshape(patterns.count, each).all(axis=1)
        if not (here[:head].all() and whole.any()):
            raise InputError("flags: exposures are lost without which nothing can be measured")
        exposures = np.concatenate([here[:head], np.repeat(whole, each)])
        rows = np.repeat(exposures, n_shutters)
        return replace(
            self,
            patterns=patterns.take(whole),
            **{name: getattr(self, name)[rows] for name in _BY_EXPOSURE},
        )

    @property
    def electrons(self) -> NDArray[np.float64]:
        """Photo-electrons of each pattern, all its shutters together, ``(n_patterns shown,
        n_detectors)``.
        """
        return self.electrons_by_shutter.sum(axis=1)

    @property
    def by_shutter(self) -> "tuple[SpiRecord, ...]":
        """What each shutter took, as a record of its own."""
        n = len(self.shutters)
        return tuple(
            replace(
                self,
                counts=self.counts[i::n],
                device_time_ns=self.device_time_ns[i::n],
                sequence=self.sequence[i::n],
                flags=self.flags[i::n],
                shutters=self.shutters[i : i + 1],
            )
            for i in range(n)
        )

    @property
    def electrons_by_shutter(self) -> NDArray[np.float64]:
        """Photo-electrons, ``(n_patterns shown, n_shutters, n_detectors)``."""
        electrons = (self.counts - np.float64(self.offset_counts)) * self.electrons_per_count
        return electrons.reshape(self.patterns.n_exposures, len(self.shutters), -1)


def exposures_between(before: SpiRecord | None, after: SpiRecord) -> int:
    """How many exposures a device numbered between two of its records: those of whole sets that
    never came. 0 for the first record, for another device, and where numbers begin anew.
    """
    if before is None or before.device != after.device:
        return 0
    step = (int(after.sequence[0]) - int(before.sequence[-1]) - 1) % 2**32
    return step if step < 2**31 else 0


def _shutters(rows: NDArray[np.float64]) -> tuple[Shutter, ...]:
    if rows.ndim != 2:
        raise InputError(f"an array of shape {rows.shape}, expected four numbers for each shutter")
    return tuple(map(Shutter.from_numbers, rows.tolist()))


LAYOUT = container.Layout(
    format="ugv-spi-record",
    version=4,
    settings=(
        "integration_time_s",
        "electrons_per_count",
        "offset_counts",
        "adc_bits",
        "device",
        "pulse_width_s",
    ),
    arrays={
        "counts": (np.int32, "ADC counts, (n_exposures, n_detectors)"),
        "device_time_ns": (np.int64, "device clock at the start of each exposure, ns"),
        "sequence": (np.uint32, "exposure number given by the device"),
        "flags": (np.uint8, "1 saturated, 2 overrun, 4 reset, 8 lost"),
        "pose": (np.float64, "rig in the world: x y z (m), quaternion w x y z"),
        "shutters": (np.float64, "per shutter: modulation Hz, phase rad, gate delay s, width s"),
    },
    added={"shutters": 2, "pulse_width_s": 3, "digest": 4, "packed": 4, "grey_levels": 4},
    objects={"pose": QuaternionPose.from_numbers, "shutters": _shutters},
    group="patterns",
    parameters=("rows", "columns", "count", "order", "mode", "digest"),
    optional=("subset",),
    group_arrays={"packed": np.uint8, "grey_levels": np.uint16},
    make_group=patterns_from_record,
)


def write_record(record: SpiRecord, path: str | Path) -> None:
    """Write a record to one HDF5 file; an existing file is replaced at the very end, or not at all.

    The same record gives the same bytes.
    """
    container.write(LAYOUT, record, path)


def read_record(path: str | Path) -> SpiRecord:
    """Read a record written by `write_record`, on any platform.

    Raises FileNotFoundError; InputError for a file that is no record, of another schema version,
    or incomplete.
    """
    fields, patterns = container.read(LAYOUT, path)
    try:
        return SpiRecord(patterns=patterns_from_record(**patterns), **LAYOUT.arguments(fields))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error
