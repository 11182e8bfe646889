"""Integrity of a burst: its longest part without a loss; warnings of silence and clipping."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_index
from hardware.radar.clutter import too_few_slots
from hardware.radar.receivers import fault_of_receivers, silent_slots
from hardware.radar.windows import has_weight
from hardware.records.container import Flag, unknown_flags
from hardware.records.radar import RAIL

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

_CLOCK = 0.01  # of a slot, by which its start may be off
#: What leaves a slot without the samples of its time, and its name in messages.
_WITHOUT_SAMPLES = {Flag.OVERRUN: "overrun", Flag.RESET: "reset", Flag.LOST: "lost"}


#: Bursts that a warning names one by one.
_MOST_NAMED = 10


class UnusableBurstError(InputError):
    """A burst of which nothing can be processed, for what is in it; others of its record may be."""


@dataclass(frozen=True)
class UsablePart:
    """The longest part of a burst without a loss of data, and its warnings.

    Either all slots of some ``steps``, or some ``slots`` of one of them, one after another.
    """

    steps: slice
    slots: slice
    whole: bool
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Intact:
    """The longest part without a loss, as in `UsablePart`; ``loss``: as of `first_loss`;
    ``is_enough``: whether the part can be processed.
    """

    steps: slice
    slots: slice
    loss: str
    is_enough: bool


def usable_part(record: "RadarRecord", burst: int = 0) -> UsablePart:
    """The part of a burst that can be processed coherently: the longest without a gap, overflow,
    reset or lost slot.

    What is beyond a lost slot is left out with it: in the gap's place the transforms would take
    zeros for echoes, which lowers levels and raises side lobes.

    Raises UnusableBurstError where no part is long enough, and for receivers that hold nothing of
    their own in it, see `fault_of_receivers`; InputError for a burst that the record does not have.
    """
    check_index("burst", burst, len(record.iq))
    part = _intact_part(record, burst)
    steps, slots = part.steps, part.slots
    if fault := _fault_of_part(record, burst, part):
        raise UnusableBurstError(fault)
    warnings = _levels(record, burst)
    if part.loss:
        of = f"slots {slots.start} to {slots.stop - 1} of step {steps.start}"
        if slots.stop - slots.start == record.flags.shape[2]:
            of = f"steps {steps.start} to {steps.stop - 1}"
        warnings.insert(0, f"burst {burst}, {part.loss}; processed are {of}")
    return UsablePart(steps, slots, not part.loss, tuple(warnings))


def _fault_of_part(record: "RadarRecord", burst: int, part: _Intact) -> str:
    """Why the longest part without a loss cannot be processed; empty where it can."""
    if not part.is_enough:
        return f"burst {burst}, {part.loss}; too little is left without a loss"
    return fault_of_receivers(burst, record.iq[burst, part.steps, part.slots], record.waveform)


def first_loss(record: "RadarRecord", burst: int) -> str:
    """Step, slot and kind of a burst's first loss of data, and how many slots are lost; empty where
    it is whole.
    """
    return _intact_part(record, burst).loss


def unusable_bursts(
    record: "RadarRecord", window: str = "boxcar", *, moving_only: bool = False
) -> dict[int, str]:
    """Bursts that hold nothing, or receivers without signals of their own, or of which a loss of
    data leaves too little to be processed with a window over slots, or beside their mean, and why.
    """
    faults = {burst: _fault(record, burst, window, moving_only) for burst in range(len(record.iq))}
    return {burst: fault for burst, fault in faults.items() if fault}


def _fault(record: "RadarRecord", burst: int, window: str, moving_only: bool) -> str:
    part = _intact_part(record, burst)
    if fault := _fault_of_part(record, burst, part) or silence(record, burst):
        return fault
    senders = record.transmitter[part.slots]
    n_slots = len(senders) // len(np.unique(senders))
    what = too_few_slots(n_slots) if moving_only else ""
    if not what and not has_weight(window, n_slots):
        what = f"the window {window!r} has no weight on {n_slots} slots of a transmitter"
    if not what:
        return ""
    return f"burst {burst}, {part.loss}; {what}" if part.loss else f"burst {burst}: {what}"


def told_left_out(why: Mapping[int, str], n_bursts: int) -> str:
    """Warning of bursts that are left out, of so many in all: which, and ``why`` the first is."""
    numbers = ", ".join(map(str, list(why)[:_MOST_NAMED])) + ", ..." * (len(why) > _MOST_NAMED)
    return (
        f"{len(why)} of {n_bursts} bursts left out ({numbers}), the first since: "
        f"{next(iter(why.values()))}"
    )


def _intact_part(record: "RadarRecord", burst: int) -> _Intact:
    lost = np.asarray((record.flags[burst] & sum(_WITHOUT_SAMPLES)) != 0)
    late = _behind_gaps(record, burst)
    steps, slots = _longest_part(lost, late)
    loss = _first_loss(record, burst, lost | late) if (lost | late).any() else ""
    if lost.any():
        loss += f" ({np.count_nonzero(lost)} of {lost.size} slots lost)"
    is_enough = slots.stop - slots.start >= 2 * len(record.front_end.transmitters_m)
    return _Intact(steps, slots, loss, is_enough or not loss)


def _behind_gaps(record: "RadarRecord", burst: int) -> NDArray[np.bool_]:
    """Slots (n_steps, n_slots) that did not come at their time after the one before."""
    times = record.device_time_ns[burst]
    slot_ns = 1e9 * record.waveform.slot_period_s
    late = np.zeros(times.shape, dtype=np.bool_)
    late[:, 1:] = np.abs(np.diff(times, axis=1) - slot_ns) > 1 + _CLOCK * slot_ns
    # The duration of a retune is not checked, but no step may begin before the last one has ended.
    late[1:, 0] = times[1:, 0] - times[:-1, -1] < slot_ns * (1 - _CLOCK) - 1
    return late


def _longest_part(lost: NDArray[np.bool_], late: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Steps and slots of the longest part, of slots that are lost or behind a gap (n_steps,
    n_slots): whole steps, or where none is whole the slots of one.
    """
    broken = np.asarray(lost.any(axis=1) | late[:, 1:].any(axis=1))
    steps = _longest_run(broken, late[:, 0])
    if steps.stop > steps.start:
        return steps, slice(0, lost.shape[1])
    runs = [_longest_run(*step) for step in zip(lost, late, strict=True)]
    step = int(np.argmax([run.stop - run.start for run in runs]))
    return slice(step, step + 1), runs[step]


def _longest_run(broken: NDArray[np.bool_], begins: NDArray[np.bool_]) -> slice:
    """The longest run of items that are not broken, of which none but the first ``begins`` anew;
    the first of equals.
    """
    number = np.cumsum(broken | begins)
    length = np.bincount(number, weights=~broken)
    (own,) = np.nonzero((number == np.argmax(length)) & ~broken)
    return slice(int(own[0]), int(own[-1]) + 1) if own.size else slice(0, 0)


def _first_loss(record: "RadarRecord", burst: int, lost: NDArray[np.bool_]) -> str:
    """Where the first loss is, and of what kind."""
    step, slot = (int(i) for i in np.unravel_index(np.argmax(lost), lost.shape))
    flags = int(record.flags[burst, step, slot])
    names = [name for flag, name in _WITHOUT_SAMPLES.items() if flags & flag]
    why = f"flagged as {' and '.join(names)}" if names else "after a gap"
    return f"step {step}, slot {slot}: {why}"


def silence(record: "RadarRecord", burst: int) -> str:
    """That a burst holds nothing; empty where it does."""
    return "" if record.iq[burst].any() else f"burst {burst}: IQ is all zero"


def _levels(record: "RadarRecord", burst: int) -> list[str]:
    iq, flags = record.iq[burst], record.flags[burst]
    if told := silence(record, burst):
        return [told]
    warnings = [f"burst {burst}: {told}" for told in unknown_flags(flags, "slots")]
    warnings += silent_slots(burst, iq)
    if told := saturation(record, burst):
        warnings.append(told)
    return warnings


def saturation(record: "RadarRecord", burst: int) -> str:
    """Samples at the converter's rail and slots that are flagged for it; empty where none is."""
    iq, flags = record.iq[burst], record.flags[burst]
    clipped = 0
    if iq.max(initial=0) >= RAIL or iq.min(initial=0) <= -RAIL:
        clipped = int(np.count_nonzero(iq >= RAIL) + np.count_nonzero(iq <= -RAIL))
    flagged = int(np.count_nonzero(flags & Flag.SATURATED))
    if not (clipped or flagged):
        return ""
    return (
        f"burst {burst}: {clipped} of {iq.size} samples stand at the converter's rail, "
        f"{flagged} slots are flagged as saturated"
    )
