"""Echoes near each other, whose targets are told apart together by `resolve`."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.measurement import EchoMeasurement, cells_apart, without_duplicates
from hardware.radar.superresolution import REACH, highest_side_lobe, resolve
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_OF_A_PART = 2.0  # cells: half of a window's main lobe
_UNFELT = 0.01  # of a cell's noise: side lobes of others elsewhere that are left out
_LINKED = 12.0  # cells between echoes that are split together: two reaches, and their side lobes
_FAR, _MOST_TOGETHER = 16.0, 8  # cells from the first, and number, of echoes split together
_ROUNDS = 2  # in which groups are split, since one may hide targets whose side lobes reach others


def split_targets(
    echoes: Sequence[EchoMeasurement],
    channel: Complex,
    waveform: OfdmWaveform,
    noise_w: float,
    false_alarm: float,
    *,
    fastest: float,
    beside_static: bool = False,
    least_at: Callable[[Array], Array] | None = None,
) -> list[EchoMeasurement]:
    """Echoes of the targets that each consists of, at rates up to ``fastest`` in s/s.

    Echoes near each other are split together: each may hide targets that the others' side lobes
    contain. An echo stays as it is where no target is found near it: without a window, what a
    strong body has beside points hides weak echoes around it. ``beside_static``: see `JointModel`.
    ``least_at``: see `resolve`.
    """
    groups = groups_of(echoes, waveform)
    parts = [list(group) for group in groups]

    beside = [-1] * len(groups)  # number of other targets when a group was split
    for i in [*range(len(groups))] * _ROUNDS:
        others = [part for j, some in enumerate(parts) if j != i for part in some]
        others = _felt(others, groups[i], waveform, noise_w)
        if len(others) == beside[i]:
            continue
        beside[i] = len(others)
        parts[i] = resolve(
            channel,
            waveform,
            groups[i][0],
            noise_w,
            fastest=fastest,
            false_alarm=false_alarm,
            together=groups[i][1:],
            others=others,
            beside_static=beside_static,
            least_at=least_at,
        )
    found = [part for some in parts for part in some]
    found += _without_parts(echoes, found, waveform)
    return without_duplicates(found, waveform, folded=False)


def _without_parts(
    echoes: Sequence[EchoMeasurement], parts: Sequence[EchoMeasurement], waveform: OfdmWaveform
) -> list[EchoMeasurement]:
    """Echoes near which no part is."""
    apart = cells_apart(echoes, parts, waveform).max(axis=-1).min(axis=1, initial=np.inf)
    return [echo for echo, cells in zip(echoes, apart, strict=True) if cells >= _OF_A_PART]


def groups_of(
    echoes: Sequence[EchoMeasurement], waveform: OfdmWaveform
) -> list[list[EchoMeasurement]]:
    """Each echo that is in no group yet with those that follow each other near it."""
    groups, waiting = list[list[EchoMeasurement]](), list(echoes)
    while waiting:
        apart = cells_apart(waiting, waiting, waveform).max(axis=-1)
        order = np.argsort(apart[0], kind="stable")
        near = [0]
        for i in order[1:]:
            is_linked = apart[i, near].min() <= _LINKED and apart[i, 0] <= _FAR
            if len(near) < _MOST_TOGETHER and is_linked:
                near.append(int(i))
        groups.append([waiting[i] for i in near])
        waiting = [echo for i, echo in enumerate(waiting) if i not in near]
    return groups


def _felt(
    others: Sequence[EchoMeasurement],
    echoes: Sequence[EchoMeasurement],
    waveform: OfdmWaveform,
    noise_w: float,
) -> list[EchoMeasurement]:
    """Those of the others whose side lobes near any of some echoes stand out of the noise."""
    cells = np.maximum(cells_apart(others, echoes, waveform) - REACH, 0).min(axis=1)
    lobes = np.prod(highest_side_lobe(cells), axis=-1)
    return [
        other
        for other, lobe in zip(others, lobes, strict=True)
        if other.power_w * lobe > _UNFELT * noise_w
    ]
