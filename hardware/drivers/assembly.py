"""Assembly of measurement frames to sets of exposures; lost exposures are reported and flagged."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.clock import MOST_TIME_NS
from hardware.drivers.messages import Configured, Measurement
from hardware.records.container import Flag

_LOST = int(Flag.LOST)
#: A frame is as late after the one before, or after Start, as its number says, and has come by the
#: device's clock when it arrives; half of that is enough, less ns.
_EARLY_NS = 1e6
#: Times between two frames are smaller.
_LONGEST_GAP_NS = 86_400 * 10**9


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
    begun_ns
        The device's clock before it was started; None: not known.
    clock_has_come_to
        Whether the device's clock has come to a time, ns; it is asked as a frame arrives.
    """

    def __init__(
        self,
        run: int,
        configured: Configured,
        adc_bits: int,
        on_loss: Callable[[range], None] = lambda lost: None,
        *,
        begun_ns: int | None = None,
        clock_has_come_to: Callable[[int], bool] = lambda time_ns: True,
    ) -> None:
        self.run, self.configured = run, configured
        self.next_sequence = 0
        #: Frames that came late or twice, of other runs or with faults; the latest of these faults.
        self.refused, self.fault = 0, ""
        self._top = 2**adc_bits - 1
        self._on_loss = on_loss
        self._begun_ns, self._clock_has_come_to = begun_ns, clock_has_come_to
        self._frames_per_set = -(-configured.exposures // configured.exposures_per_frame)
        self._since_ns = np.rint(
            np.arange(configured.exposures) * configured.pattern_period_s * 1e9
        ).astype(np.int64)
        self._open: list[Measurement] = []
        #: The latest frame; and the latest that its time or number contradicts.
        self._last: Measurement | None = None
        self._doubted: Measurement | None = None

    def take(self, frame: Measurement) -> Iterator[ExposureSet]:
        """Sets that this frame completes or ends: at most two."""
        if frame.run != self.run or frame.sequence < self.next_sequence:
            self.refused += 1
            return
        fault = self._fault(frame) or self._clock_fault(frame)
        if not fault and (fault := self._contradiction(frame, self._last)):
            if self._agree(frame):
                self._drop_last()
                fault = ""
            else:
                self._doubted = frame
        if fault:
            self.refused, self.fault = self.refused + 1, f"frame {frame.sequence}: {fault}"
            return
        if frame.sequence > self.next_sequence:
            self._on_loss(range(self.next_sequence, frame.sequence))
        self.next_sequence = frame.sequence + 1
        self._last, self._doubted = frame, None
        if self._open and self._set_of(self._open[0]) != self._set_of(frame):
            yield self._close()
        self._open.append(frame)
        if self.next_sequence % self._frames_per_set == 0:
            yield self._close()

    def cut_off(self) -> Iterator[ExposureSet]:
        """End of a run that the device has given up: the set that was being measured."""
        if self._open:
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

    def _exposures_before(self, frame: Measurement) -> int:
        return self._set_of(frame) * self.configured.exposures + frame.first

    def _fault(self, frame: Measurement) -> str:
        """What is wrong with a frame by itself; empty if nothing."""
        configured = self.configured
        first = frame.sequence % self._frames_per_set * configured.exposures_per_frame
        n = min(configured.exposures_per_frame, configured.exposures - first)
        shape = (n, configured.detectors)
        if frame.first != first or frame.counts.shape != shape:
            return (
                f"{frame.counts.shape} exposures and detectors from exposure {frame.first} on, "
                f"expected {shape} from {first} on"
            )
        least, most = int(frame.counts.min()), int(frame.counts.max())
        if least < 0 or most > self._top:
            return f"counts from {least} to {most}, expected 0 to {self._top}"
        if abs(frame.time_ns) > MOST_TIME_NS:
            return f"device time of {frame.time_ns} ns, expected at most {MOST_TIME_NS:g}"
        return ""

    def _clock_fault(self, frame: Measurement) -> str:
        """What a frame's time says that the device's clock contradicts."""
        period_ns, time_s = 1e9 * self.configured.pattern_period_s, frame.time_ns * 1e-9
        takes_ns = self._exposures_before(frame) * period_ns
        if self._begun_ns is not None:
            passed_ns = frame.time_ns - self._begun_ns
            if passed_ns < takes_ns / 2 - _EARLY_NS:
                return (
                    f"begins at {time_s:.6f} s of the device's clock, {passed_ns * 1e-9:.6g} s "
                    f"after it was started, which by its number takes {takes_ns * 1e-9:.6g} s"
                )
        middle_ns = frame.time_ns + round(len(frame.counts) * period_ns / 2 - _EARLY_NS)
        if not self._clock_has_come_to(middle_ns):
            return (
                f"begins at {time_s:.6f} s of the device's clock, to which that has not come when "
                "the frame arrives"
            )
        return ""

    def _contradiction(self, frame: Measurement, before: Measurement | None) -> str:
        """What a frame's number and time say that those of one before contradict."""
        period_ns, exposures = 1e9 * self.configured.pattern_period_s, self._exposures_before(frame)
        if before is None:
            takes_ns = exposures * period_ns
            is_late = takes_ns > _LONGEST_GAP_NS
            return f"is {takes_ns * 1e-9:.6g} s into its run by its number" if is_late else ""
        takes_ns = (exposures - self._exposures_before(before)) * period_ns
        passed_ns = frame.time_ns - before.time_ns
        if takes_ns / 2 - _EARLY_NS <= passed_ns <= max(2 * takes_ns, _LONGEST_GAP_NS):
            return ""
        return (
            f"begins {passed_ns * 1e-9:.6g} s after the one before, which by its number takes "
            f"{takes_ns * 1e-9:.6g} s"
        )

    def _agree(self, frame: Measurement) -> bool:
        """Whether a frame and the one refused before it agree, so that the one between is false."""
        doubted = self._doubted
        if doubted is None or doubted.sequence >= frame.sequence:
            return False
        return not self._contradiction(frame, doubted)

    def _drop_last(self) -> None:
        """Take the latest frame for lost, if its set is still open."""
        self._open = [frame for frame in self._open if frame is not self._last]

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
