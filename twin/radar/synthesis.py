"""Contributions to the channel: a type-1 non-uniform FFT with range migration.

H[n, m] = sum_i a_i exp(-j 2 pi (fc + f_n) (tau_i + rate_i t_m))

The carrier's phase is taken in float64 before anything else. What couples n and m, f_n rate_i t_m,
is the migration through range cells (5 of them for 20 m/s in 10 ms at 4 GHz): it is taken out in
bulk for contributions of nearly the same rate, and the rest is a short Taylor series. Where rates
differ too much for that, one one-dimensional transform per slot is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hardware.radar.waveform import OfdmWaveform

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SERIES_RAD = 0.35  # coupled phase left to the series, at most
_MOST_BODIES = 6  # beyond that the exact way is faster


@dataclass(frozen=True, eq=False)
class Contributions:
    """Echoes, each (n,): amplitude, delay in s, and its rate in s/s (positive: receding).

    The amplitude is that of the wave relative to the sent one, without the phase of the delay.
    Delays belong to the middle of the interval and to the antenna's origin. ``departure`` and
    ``arrival`` (n, 3) are unit vectors from the antenna towards where a path begins and whence it
    comes back, in its own frame: x ahead, y left, z up.
    """

    amplitude: Complex
    delay_s: Array
    delay_rate: Array
    departure: Array
    arrival: Array

    @staticmethod
    def ahead(amplitude: Complex, delay_s: Array, delay_rate: Array) -> "Contributions":
        """Echoes from straight ahead."""
        forward = np.tile([1.0, 0.0, 0.0], (len(delay_s), 1)).reshape(-1, 3)
        return Contributions(amplitude, delay_s, delay_rate, forward, forward)

    @staticmethod
    def none() -> "Contributions":
        """No echo at all."""
        empty = np.zeros(0)
        return Contributions.ahead(empty.astype(np.complex128), empty, empty)

    @staticmethod
    def joined(parts: Sequence["Contributions"]) -> "Contributions":
        """Echoes of all parts together."""
        return Contributions(
            *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Contributions))
        )


def synthesize(
    contributions: Contributions, waveform: OfdmWaveform, tolerance: float = 1e-6
) -> Complex:
    """Channel of all contributions, ``(n_subcarriers, n_slots)``.

    Parameters
    ----------
    contributions
        Amplitudes already hold what a slot's averaging leaves (`OfdmWaveform.slot_gain`).
    waveform
        Frequencies and times.
    tolerance
        Bounds the error relative to the channel's root mean square (NUFFT and Taylor series).
    """
    bodies = _bodies(contributions, waveform)
    if len(bodies) > _MOST_BODIES:
        return _slot_by_slot(contributions, waveform, tolerance)
    channel = np.zeros((waveform.n_subcarriers, waveform.n_slots), dtype=np.complex128)
    for members in bodies:
        channel += _body(_chosen(contributions, members), waveform, tolerance)
    return channel


def direct_sum(
    contributions: Contributions, frequencies_hz: Array, times_s: Array, carrier_hz: float
) -> Complex:
    """The definition, in float64, for chosen frequencies and times: the reference."""
    channel = np.zeros((len(frequencies_hz), len(times_s)), dtype=np.complex128)
    for start in range(0, len(contributions.delay_s), 4096):
        part = _chosen(contributions, slice(start, start + 4096))
        moved = part.delay_s[:, None] + part.delay_rate[:, None] * times_s
        for row, frequency in enumerate(frequencies_hz):
            cycles = (carrier_hz + frequency) * moved
            channel[row] += part.amplitude @ np.exp(-2j * np.pi * (cycles % 1.0))
    return channel


def _bodies(contributions: Contributions, waveform: OfdmWaveform) -> list[NDArray[np.intp]]:
    """Groups of contributions whose rates are so close that the series converges at once."""
    half_band = waveform.bandwidth_hz / 2
    half_time = waveform.n_slots * waveform.slot_period_s / 2
    width = 2 * _SERIES_RAD / (2 * np.pi * half_band * half_time)
    order = np.argsort(contributions.delay_rate, kind="stable")
    groups: list[NDArray[np.intp]] = []
    start = 0
    rates = contributions.delay_rate[order]
    while start < len(order) and len(groups) <= _MOST_BODIES:
        stop = int(np.searchsorted(rates, rates[start] + width, side="right"))
        groups.append(order[start:stop])
        start = stop
    return groups


def _body(part: Contributions, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """One group: bulk migration in closed form, the spread around it as a series."""
    import finufft

    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    bulk = (part.delay_rate.max() + part.delay_rate.min()) / 2
    spread = part.delay_rate - bulk
    coupled = 2 * np.pi * np.abs(f).max() * np.abs(t).max() * np.abs(spread).max()
    terms = _terms(float(coupled), tolerance)
    strengths, x, y = _points(part, waveform)
    # exp(-j 2 pi f t d) = sum_k (-j 2 pi f t)^k d^k / k!; d in units that keep powers near 1.
    unit = max(float(np.abs(spread).max()), np.finfo(float).tiny)
    stacked = np.stack([strengths * (spread / unit) ** k for k in range(terms)])
    shape = (waveform.n_subcarriers, waveform.n_slots)
    grids = finufft.nufft2d1(x, y, stacked, shape, eps=tolerance / 10, isign=-1, nthreads=0)
    grids = grids.reshape(terms, *shape)
    coupling = -2j * np.pi * unit * f[:, None] * t
    channel = grids[-1]
    for k in range(terms - 1, 0, -1):  # Horner
        channel = grids[k - 1] + channel * coupling / k
    if bulk:
        channel = channel * np.exp(-2j * np.pi * bulk * f[:, None] * t)
    return channel


def _slot_by_slot(part: Contributions, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """Exact in the coupling: one transform along frequency per slot."""
    import finufft

    channel = np.empty((waveform.n_subcarriers, waveform.n_slots), dtype=np.complex128)
    for slot, time in enumerate(waveform.slot_times_s):
        delay = part.delay_s + part.delay_rate * time
        strengths = part.amplitude * np.exp(-2j * np.pi * (waveform.carrier_hz * delay % 1.0))
        x = 2 * np.pi * (waveform.subcarrier_spacing_hz * delay % 1.0)
        channel[:, slot] = finufft.nufft1d1(
            x, strengths, waveform.n_subcarriers, eps=tolerance / 10, isign=-1
        )
    return channel


def _points(part: Contributions, waveform: OfdmWaveform) -> tuple[Complex, Array, Array]:
    """Strengths with the carrier's phase, and the two angles per subcarrier and slot.

    finufft's slots run from -M // 2, ours are centred on (M - 1) / 2: the half slot between them
    goes into the strengths.
    """
    carrier = waveform.carrier_hz
    first = waveform.slot_times_s[waveform.n_slots // 2]  # time of finufft's slot 0
    cycles = carrier * part.delay_s % 1.0 + carrier * part.delay_rate * first
    strengths = part.amplitude * np.exp(-2j * np.pi * cycles)
    x = 2 * np.pi * (waveform.subcarrier_spacing_hz * part.delay_s % 1.0)
    y = 2 * np.pi * (carrier * part.delay_rate * waveform.slot_period_s % 1.0)
    return strengths, x, y


def _terms(phase_rad: float, tolerance: float) -> int:
    """Terms of the series of exp(j phase) until the rest is below the tolerance."""
    terms, rest = 1, phase_rad
    while rest > tolerance / 2:
        terms += 1
        rest *= phase_rad / terms
    return terms


def _chosen(part: Contributions, which: "NDArray[np.intp] | slice") -> Contributions:
    return Contributions(
        part.amplitude[which],
        part.delay_s[which],
        part.delay_rate[which],
        part.departure[which],
        part.arrival[which],
    )
