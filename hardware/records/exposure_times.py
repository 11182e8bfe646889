"""What the times of a camera's exposures say of their order.

A device numbers its exposures and stamps them with its clock. Where both disagree, either rows are
out of place, or the clock is not what it should be.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.formatting import counted
from hardware.records.container import Flag

Array = NDArray[np.int64]

#: Share of a period by which a step may be off: jitter.
_JITTER = 0.25
_WITHOUT_TIME = Flag.LOST | Flag.OVERRUN | Flag.RESET


def check_order(times_ns: Array, numbers: Array) -> None:
    """Raise InputError for the times (n,) of a regular series in another order than their numbers
    (n,), which rise: what runs back otherwise may be the clock's own fault (`time_warnings`).
    """
    steps = np.diff(times_ns)
    if not (steps < 0).any():
        return
    ordered = np.sort(times_ns)
    share = (numbers - numbers[0]) / (numbers[-1] - numbers[0])
    off = ordered - ordered[0] - share * (ordered[-1] - ordered[0])
    period = (ordered[-1] - ordered[0]) / (numbers[-1] - numbers[0])
    if np.abs(off).max() <= _JITTER * period:
        row = int(np.argmax(steps < 0)) + 1
        raise InputError(
            f"device_time_ns: exposure {row} begins {-steps[row - 1] * 1e-9:.6g} s before the one "
            "that its number follows, and all times together are those of a regular series: rows "
            "are in another order than the exposures"
        )


def time_warnings(times_ns: Array, numbers: Array, flags: NDArray[np.uint8]) -> list[str]:
    """Warnings of times (n,) that their numbers (n,), which rise, contradict. Exposures that are
    lost, late or behind a reset, by their flags (n,), do not count, nor do equal pauses after every
    so many exposures: a device's frames.
    """
    there = (flags & Flag.LOST) == 0
    times, own = times_ns[there], flags[there]
    if len(times) < 3:
        return []
    steps, apart = np.diff(times), np.diff(numbers[there])
    known = (own[1:] & _WITHOUT_TIME) == 0
    n = len(steps)
    if back := int(np.count_nonzero(known & (steps < 0))):
        return [
            f"the device's clock runs back {counted(back, 'time')} between {n + 1} exposures, as "
            "one that is set or begins anew does: the image is right only if the rows are in order"
        ]
    period = float(np.median(steps / apart))
    if period <= 0:
        return ["the device's clock stands still: it tells nothing of the exposures' order"]
    off = np.flatnonzero(known & (np.abs(steps - apart * period) > _JITTER * period))
    if not len(off) or _are_pauses(off, steps, period):
        return []
    worst = steps[off[np.argmax(np.abs(steps[off] - apart[off] * period))]]
    return [
        f"{len(off)} of {n + 1} exposures begin {worst * 1e-9:.4g} s at worst after the one before "
        f"by the device's clock, where the others' period is {period * 1e-9:.4g} s: the image is "
        "right only if none is missing or doubled"
    ]


def _are_pauses(off: NDArray[np.intp], steps: Array, period: float) -> bool:
    """Whether steps that are off are longer ones, after equal numbers of exposures."""
    every = np.diff(off, prepend=-1)
    return len(off) > 1 and bool(np.ptp(every) == 0 and (steps[off] > period).all())
