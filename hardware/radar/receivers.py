"""Receivers that hold nothing of their own: dead ones, copies of another.

Their noise is none, or that of another. Levels, errors and directions count every receiver as one
more look at the echo, and false alarms follow.
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import complex_samples, demodulate_samples
from hardware.radar.range_doppler import complex_map, mean_power, noise_level
from hardware.radar.windows import noise_gain
from hardware.waveform import OfdmWaveform

#: (n_steps, n_slots, n_receivers, n_subcarriers, 2), of one burst.
Counts = NDArray[np.int16]

LEAST_NOISE = 0.5  # counts rms of a branch, rounding included: 0.29 of it
_HEARD = 1.0  # counts rms of a branch, of which 16 values are all 0 once in 5 million
_FEWEST = 16  # values, of which anything is told
_WINDOW = "blackmanharris"
_SOME = 2**16  # samples of a branch that are looked at


def fault_of_receivers(burst: int, iq: Counts, waveform: OfdmWaveform) -> str:
    """That samples of a receiver are all 0 while another has signals, or that two have the same
    samples, noise included; empty where neither is so.

    Without noise all receivers of an echo straight ahead have the same samples.
    """
    n_receivers = iq.shape[2]
    if n_receivers == 1 or iq.size < _FEWEST * n_receivers:
        return ""
    silent = np.flatnonzero(~iq[0, 0].any(axis=(1, 2))).tolist()
    dead = [receiver for receiver in silent if not iq[:, :, receiver].any()]
    if dead and (loudest := branch_scatter(iq).max()) >= _HEARD:
        return (
            f"burst {burst}: receiver {', '.join(map(str, dead))}: all samples are 0, while others "
            f"have signals of {loudest:.2g} counts rms: dead, or not connected"
        )
    for one, other in _alike(iq):
        noise = noise_of_branch(iq[0, :, one], waveform)
        if noise >= LEAST_NOISE:
            return (
                f"burst {burst}: receivers {one} and {other}: all samples are the same, their "
                f"noise of {noise:.2g} counts rms included: one is a copy of the other"
            )
    return ""


def silent_slots(burst: int, iq: Counts) -> list[str]:
    """Warnings of slots that are all 0, in all receivers, or in one while others have signals."""
    has_samples = np.asarray(iq.any(axis=(3, 4)))
    sent = has_samples.any(axis=2)
    warnings = []
    if silent := int(np.count_nonzero(~sent)):
        warnings.append(f"burst {burst}: IQ of {silent} slots is all zero")
    partly = np.asarray(sent & ~has_samples.all(axis=2))
    if not partly.any() or 2 * iq.shape[3] < _FEWEST:
        return warnings
    heard = iq[partly].std(axis=(2, 3)).max(axis=1) >= _HEARD
    counts = np.count_nonzero(~has_samples[partly][heard], axis=0).tolist()
    return warnings + [
        f"burst {burst}: receiver {receiver}: IQ of {count} slots is all zero, while others have "
        "signals"
        for receiver, count in enumerate(counts)
        if count
    ]


def branch_scatter(iq: Counts) -> NDArray[np.float64]:
    """Scatter of the samples of both branches of each receiver (2 n_receivers,), counts rms; of at
    most some of them.
    """
    branches = np.moveaxis(iq, (2, 4), (0, 1)).reshape(iq.shape[2] * 2, -1)
    return np.asarray(branches[:, :: max(1, branches.shape[1] // _SOME)].std(axis=1))


def noise_of_branch(iq: Counts, waveform: OfdmWaveform) -> float:
    """Noise of a branch of one receiver's slots (n_slots, n_subcarriers, 2), counts rms."""
    channel = demodulate_samples(complex_samples(iq), waveform, 1.0).T
    level = noise_level(mean_power([complex_map(channel, _WINDOW)]), 1)
    return noise_in_counts(level / noise_gain(_WINDOW, channel.shape), channel.size)


def noise_in_counts(level: float, n_samples: int) -> float:
    """Noise of a branch, counts rms, from that of a cell of a map without a window of so many
    samples, counts^2.
    """
    return float(np.sqrt(level * n_samples / 2))


def _alike(iq: Counts) -> list[tuple[int, int]]:
    """Pairs of receivers that have the same samples."""
    first = [iq[0, 0, receiver].tobytes() for receiver in range(iq.shape[2])]
    return [
        (one, other)
        for one, other in combinations(range(iq.shape[2]), 2)
        if first[one] == first[other] and np.array_equal(iq[:, :, one], iq[:, :, other])
    ]
