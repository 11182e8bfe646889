"""Assembly of measurement frames to sets of exposures; lost exposures are reported and flagged."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.messages import Configured, Measurement
from hardware.records.container import Flag

_LOST = int(Flag.LOST)


@dataclass(frozen=True, eq=False)
class ExposureSet:
    """One set of all patterns: arrays of a `SpiRecord`, lost exposures marked in ``flags``."""

    number: int
    counts: NDArray[np.int32]
    device_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    flags: NDArray[np.uint8]


class Assembly:
    """Assembles sets from the frames of one run.

    Parameters
    ----------
    run
        Frames of other runs are ignored.
    configured
        Reply of the device.
    adc_bits
        Larger counts are invalid.
    on_loss
        Called with the sequence numbers of lost frames, as soon as a later frame shows the gap.
        Late and duplicate frames are ignored.
    """

    def __init__(
        self,
        run: int,
        configured: Configured,
        adc_bits: int,
        on_loss: Callable[[range], None] = lambda lost: None,
    ) -> None:
        self.run, self.configured = run, configured
        self.next_sequence = 0
        self.refused = 0
        self._top = 2**adc_bits - 1
        self._on_loss = on_loss
        self._frames_per_set = -(-configured.exposures // configured.exposures_per_frame)
        self._since_ns = np.rint(
            np.arange(configured.exposures) * configured.pattern_period_s * 1e9
        ).astype(np.int64)
        self._open: list[Measurement] = []

    def take(self, frame: Measurement) -> Iterator[ExposureSet]:
        """Sets that this frame completes or ends: at most two."""
        if frame.run != self.run or frame.sequence < self.next_sequence or not self._fits(frame):
            self.refused += 1
            return
        if frame.sequence > self.next_sequence:
            self._on_loss(range(self.next_sequence, frame.sequence))
        self.next_sequence = frame.sequence + 1
        if self._open and self._set_of(self._open[0]) != self._set_of(frame):
            yield self._close()
        self._open.append(frame)
        if self.next_sequence % self._frames_per_set == 0:
            yield self._close()

    def finish(self, frames: int) -> Iterator[ExposureSet]:
        """End of the run after ``frames`` frames: the last set, if it was measured to its end."""
        if frames > self.next_sequence:
            self._on_loss(range(self.next_sequence, frames))
            self.next_sequence = frames
        if self._open and self._set_of(self._open[0]) < frames // self._frames_per_set:
            yield self._close()
        self._open = []

    def _set_of(self, frame: Measurement) -> int:
        return frame.sequence // self._frames_per_set

    def _fits(self, frame: Measurement) -> bool:
        """Whether the frame has the exposures expected from its sequence number."""
        configured = self.configured
        first = frame.sequence % self._frames_per_set * configured.exposures_per_frame
        shape = (
            min(configured.exposures_per_frame, configured.exposures - first),
            configured.detectors,
        )
        if frame.first != first or frame.counts.shape != shape:
            return False
        return bool(frame.counts.min() >= 0 and frame.counts.max() <= self._top)

    def _close(self) -> ExposureSet:
        n, number = self.configured.exposures, self._set_of(self._open[0])
        counts = np.zeros((n, self.configured.detectors), np.int32)
        flags = np.full(n, _LOST, np.uint8)
        # Lost exposures get the time at which they took place.
        anchor = self._open[0]
        time_ns = anchor.time_ns - self._since_ns[anchor.first] + self._since_ns
        for frame in self._open:
            part = slice(frame.first, frame.first + len(frame.counts))
            counts[part], flags[part] = frame.counts, frame.flags
            time_ns[part] = frame.time_ns + self._since_ns[: len(frame.counts)]
        self._open = []
        sequence = (np.arange(n, dtype=np.uint64) + np.uint64(number * n % 2**32)).astype(np.uint32)
        return ExposureSet(number, counts, time_ns, sequence, flags)
