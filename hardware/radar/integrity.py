"""Integrity of a burst: it ends at the first loss of data; silence and clipping give warnings."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_index
from hardware.radar.receivers import check_receivers, silent_slots
from hardware.records.container import Flag, unknown_flags

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

_RAIL = 32767
_CLOCK = 0.01  # of a slot, by which its start may be off
#: What leaves a slot without the samples of its time, and its name in messages.
_WITHOUT_SAMPLES = {Flag.OVERRUN: "overrun", Flag.RESET: "reset", Flag.LOST: "lost"}


@dataclass(frozen=True)
class UsablePart:
    """The part of a burst before the first loss of data, and its warnings.

    Either all slots of the first ``n_steps`` steps, or the first ``n_slots`` of the first step.
    """

    n_steps: int
    n_slots: int
    whole: bool
    warnings: tuple[str, ...]


def usable_part(record: "RadarRecord", burst: int = 0) -> UsablePart:
    """The part of a burst that can be processed coherently: up to the first gap, overflow, reset or
    lost slot.

    Slots behind a lost one are left out with it: in the gap's place the transforms would take zeros
    for echoes, which lowers levels and raises side lobes.

    Raises InputError where there is no such part, for receivers that hold nothing of their own in
    it, see `check_receivers`, and for a burst that the record does not have.
    """
    check_index("burst", burst, len(record.iq))
    n_steps, n_slots = record.flags[burst].shape
    lost = _lost(record, burst)
    warnings = _levels(record, burst)
    if not lost.any():
        check_receivers(burst, record.iq[burst], record.waveform)
        return UsablePart(n_steps, n_slots, True, tuple(warnings))
    step, slot = (int(i) for i in np.unravel_index(np.argmax(lost), lost.shape))
    flags = int(record.flags[burst, step, slot])
    names = [name for flag, name in _WITHOUT_SAMPLES.items() if flags & flag]
    why = f"flagged as {' and '.join(names)}" if names else "after a gap"
    n_steps, n_slots = (step, n_slots) if step else (1, slot)
    where = f"burst {burst}, step {step}, slot {slot}: {why}"
    if n_slots < 2 * len(record.front_end.transmitters_m):
        raise InputError(f"{where}; too little comes before it")
    check_receivers(burst, record.iq[burst, :n_steps, :n_slots], record.waveform)
    done = f"the {n_steps} steps before it" if step else f"the {n_slots} slots before it"
    return UsablePart(n_steps, n_slots, False, (f"{where}; processed are {done}", *warnings))


def _lost(record: "RadarRecord", burst: int) -> NDArray[np.bool_]:
    """Slots (n_steps, n_slots) that did not come at their time, or are flagged."""
    times = record.device_time_ns[burst]
    slot_ns = 1e9 * record.waveform.slot_period_s
    lost = np.asarray((record.flags[burst] & sum(_WITHOUT_SAMPLES)) != 0)
    lost[:, 1:] |= np.abs(np.diff(times, axis=1) - slot_ns) > 1 + _CLOCK * slot_ns
    # The duration of a retune is not checked, but no step may begin before the last one has ended.
    lost[1:, 0] |= times[1:, 0] - times[:-1, -1] < slot_ns * (1 - _CLOCK) - 1
    return lost


def _levels(record: "RadarRecord", burst: int) -> list[str]:
    iq, flags = record.iq[burst], record.flags[burst]
    highest, lowest = iq.max(initial=0), iq.min(initial=0)
    if highest == lowest == 0:
        return [f"burst {burst}: IQ is all zero"]
    warnings = [f"burst {burst}: {told}" for told in unknown_flags(flags, "slots")]
    warnings += silent_slots(burst, iq)
    if told := saturation(record, burst):
        warnings.append(told)
    return warnings


def saturation(record: "RadarRecord", burst: int) -> str:
    """Samples at the converter's rail and slots that are flagged for it; empty where none is."""
    iq, flags = record.iq[burst], record.flags[burst]
    clipped = 0
    if iq.max(initial=0) >= _RAIL or iq.min(initial=0) <= -_RAIL:
        clipped = int(np.count_nonzero(iq >= _RAIL) + np.count_nonzero(iq <= -_RAIL))
    flagged = int(np.count_nonzero(flags & Flag.SATURATED))
    if not (clipped or flagged):
        return ""
    return (
        f"burst {burst}: {clipped} of {iq.size} samples stand at the converter's rail, "
        f"{flagged} slots are flagged as saturated"
    )
