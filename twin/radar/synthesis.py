"""Contributions to the channel: type-1 non-uniform FFTs with range migration.

H[n, m] = sum_i a_i exp(-j 2 pi (fc + f_n) (tau_i + rate_i t_m))

The carrier's phase is taken in float64 before anything else. Contributions of nearly the same rate
move as one body: their bulk motion through Doppler and range cells (5 of them for 20 m/s in 10 ms
at 4 GHz) is taken out in closed form. What is left of the motion is slow: transforms along
frequency at a few times within the interval hold it all, and the slots in between are interpolated;
a world at rest takes one. Where that would take too many, one transform along frequency and Doppler
does it, with a short Taylor series for what still couples them. Where rates differ too much for
bodies, one transform per slot is exact.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SERIES_RAD = 0.35  # coupled phase left to the series, at most
_MOST_BODIES = 6  # beyond that the exact way is faster
_MANY_POINTS = 200_000  # from which several threads are used
_HANDFUL = 64  # echoes times terms up to which their sum is a matrix product
_ANEW = 1.5  # times as long an echo takes at a new time as in one more term of the series
_SMALL = 2**15  # multiplications that BLAS does not share out: its threads wait on a busy machine
_BLOCK = 64  # subcarriers whose migration shares its coarse steps


@dataclass(frozen=True, eq=False)
class Contributions:
    """Echoes, each (n,): amplitude, delay in s, and its rate in s/s (positive: receding).

    The amplitude is that of the wave relative to the sent one, without the phase of the delay; of a
    radar that steps its carrier it may be (n_steps, n).
    Delays belong to the middle of the interval and to the antenna's origin. ``departure`` and
    ``arrival`` (n, 3) are unit vectors from the antenna towards where a path begins and whence it
    comes back, in its own frame: x ahead, y left, z up; zero where the way does not depend on where
    the antennas stand.
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
        amplitude = np.concatenate([part.amplitude for part in parts], axis=-1)
        others = (f.name for f in fields(Contributions) if f.name != "amplitude")
        return Contributions(
            amplitude, *(np.concatenate([getattr(p, name) for p in parts]) for name in others)
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
        return _at_times(contributions, waveform.slot_times_s, waveform, tolerance)
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


def _bodies(
    contributions: Contributions, waveform: OfdmWaveform
) -> "list[NDArray[np.intp] | slice]":
    """Groups of contributions whose rates are so close that the series converges at once."""
    rates = contributions.delay_rate
    if not rates.size:
        return []
    half_band = waveform.bandwidth_hz / 2
    half_time = waveform.n_slots * waveform.slot_period_s / 2
    width = 2 * _SERIES_RAD / (2 * np.pi * half_band * half_time)
    if np.ptp(rates) <= width:
        return [slice(None)]
    order = np.argsort(rates, kind="stable")
    groups: list[NDArray[np.intp] | slice] = []
    start, rates = 0, rates[order]
    while start < len(order) and len(groups) <= _MOST_BODIES:
        stop = int(np.searchsorted(rates, rates[start] + width, side="right"))
        groups.append(order[start:stop])
        start = stop
    return groups


def _body(part: Contributions, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """One group: bulk motion in closed form, the spread around it by the cheapest way."""
    bulk = (part.delay_rate.max() + part.delay_rate.min()) / 2
    spread = part.delay_rate - bulk
    phase_per_hz = 2 * np.pi * float(np.abs(waveform.slot_times_s).max() * np.abs(spread).max())
    highest = waveform.bandwidth_hz / 2
    terms = _terms(phase_per_hz * highest, tolerance)
    if len(spread) * terms <= _HANDFUL:
        return _by_series(part, bulk, terms, _products, waveform, tolerance)
    times = _times(phase_per_hz * (waveform.carrier_hz + highest), waveform, tolerance)
    n, cells = waveform.n_subcarriers, waveform.n_subcarriers * waveform.n_slots
    if len(times) * (_ANEW * len(spread) + n) > terms * (len(spread) + cells):
        return _by_series(part, bulk, terms, _grids, waveform, tolerance)
    found = _at_times(replace(part, delay_rate=spread), times, waveform, tolerance)
    if 1 < len(times) < waveform.n_slots:
        found = _product(found, _interpolation(times, waveform.slot_times_s))
    return found * _migration(bulk, waveform, waveform.carrier_hz) if bulk else found


def _by_series(
    part: Contributions,
    bulk: float,
    terms: int,
    transform: Callable[[Contributions, Array, OfdmWaveform, float], Complex],
    waveform: OfdmWaveform,
    tolerance: float,
) -> Complex:
    """Transforms along frequency and Doppler, with what couples both as a series around the bulk.

    exp(-j 2 pi f t d) = sum_k (-j 2 pi f t)^k d^k / k! with d a rate's distance from the bulk.
    """
    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    spread = part.delay_rate - bulk
    unit = max(float(np.abs(spread).max()), np.finfo(float).tiny)  # keeps powers of d near 1
    powers = np.stack([(spread / unit) ** k / factorial(k) for k in range(terms)])
    channel, *grids = transform(part, powers, waveform, tolerance)[::-1]
    if grids:
        coupling = (-2j * np.pi * unit * f)[:, None] * t
        for grid in grids:  # Horner
            channel *= coupling
            channel += grid
    return channel * _migration(bulk, waveform) if bulk else channel


def _grids(part: Contributions, powers: Array, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """Transforms along frequency and Doppler, ``(n_powers, n_subcarriers, n_slots)``.

    finufft's slots run from -M // 2, ours are centred on (M - 1) / 2: the half slot between them
    goes into the strengths.
    """
    import finufft

    first = waveform.slot_times_s[waveform.n_slots // 2]  # time of finufft's slot 0
    carrier, rate = waveform.carrier_hz, part.delay_rate
    strengths = part.amplitude * _turned(-_wrapped(carrier * part.delay_s) - carrier * rate * first)
    x = 2 * np.pi * _wrapped(waveform.subcarrier_spacing_hz * part.delay_s)
    y = 2 * np.pi * _wrapped(carrier * rate * waveform.slot_period_s)
    shape = (waveform.n_subcarriers, waveform.n_slots)
    grids = finufft.nufft2d1(x, y, strengths * powers, shape, **_options(tolerance, len(x)))
    return np.reshape(grids, (len(powers), *shape))


def _products(
    part: Contributions, powers: Array, waveform: OfdmWaveform, tolerance: float
) -> Complex:
    """The same by its definition: for a handful of echoes a matrix product is faster."""
    carrier, f, t = waveform.carrier_hz, waveform.frequency_offsets_hz, waveform.slot_times_s
    along_f = _turned(-f[:, None] * part.delay_s)
    doppler = carrier * part.delay_rate[:, None] * t
    along_t = _turned(-_wrapped(carrier * part.delay_s)[:, None] - doppler)
    return np.stack([along_f @ ((part.amplitude * p)[:, None] * along_t) for p in powers])


def _at_times(
    part: Contributions, times: Array, waveform: OfdmWaveform, tolerance: float
) -> Complex:
    """One transform along frequency per time, ``(n_subcarriers, n_times)``: exact in the motion."""
    import finufft

    n, options = waveform.n_subcarriers, _options(tolerance, len(part.delay_s))
    found = np.empty((len(times), n), dtype=np.complex128)
    for row, time in zip(found, times, strict=True):
        delay = part.delay_s + part.delay_rate * time
        strengths = part.amplitude * _turned(-_wrapped(waveform.carrier_hz * delay))
        x = 2 * np.pi * _wrapped(waveform.subcarrier_spacing_hz * delay)
        row[:] = finufft.nufft1d1(x, strengths, n, **options)
    return found.T


def _times(phase_rad: float, waveform: OfdmWaveform, tolerance: float) -> Array:
    """Times that hold a motion of up to a phase either way from the interval's middle.

    Chebyshev's points; K of them leave of exp(j phase x) at most 4 J_K(phase) on average, and
    J_K(phase) <= (phase / 2)^K / K! (Trefethen, Approximation Theory and Practice, 2013, ch. 4).
    The slots themselves where they are no more.
    """
    count, rest = 1, 4 * phase_rad / 2
    while rest > tolerance / 4 and count < waveform.n_slots:
        count += 1
        rest *= phase_rad / 2 / count
    if count == waveform.n_slots:
        return waveform.slot_times_s
    nodes: Array = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return nodes * np.abs(waveform.slot_times_s).max()


def _interpolation(times: Array, wanted: Array) -> Array:
    """Values at wanted times from those at Chebyshev's points, ``(n_times, n_wanted)``.

    Barycentric formula of the first kind of points (Berrut and Trefethen, SIAM Review 46, 2004).
    """
    k = np.arange(len(times))
    weights = (-1.0) ** k * np.sin(np.pi * (k + 0.5) / len(times))
    away = wanted - times[:, None]
    met = np.abs(away) < 1e-14 * np.abs(times).max()
    share = weights[:, None] / np.where(met, 1.0, away)
    share = np.where(met.any(axis=0), met, share)
    found: Array = share / share.sum(axis=0)
    return found


def _product(columns: Complex, weights: Array) -> Complex:
    """Matrix product, some rows at a time."""
    found = np.empty((len(columns), weights.shape[1]), dtype=np.complex128)
    weights, rows = weights.astype(np.complex128), max(_SMALL // weights.size, 1)
    for start in range(0, len(columns), rows):
        np.matmul(columns[start : start + rows], weights, out=found[start : start + rows])
    return found


def _migration(rate: float, waveform: OfdmWaveform, carrier_hz: float = 0.0) -> Complex:
    """exp(-j 2 pi (carrier + f) rate t): coarse steps between blocks of subcarriers, fine ones
    within.
    """
    n, turns = waveform.n_subcarriers, -rate * waveform.slot_times_s
    step = waveform.subcarrier_spacing_hz * turns
    coarse = _turned(carrier_hz * turns + (np.arange(0, n, _BLOCK) - n // 2)[:, None] * step)
    fine = _turned(np.arange(_BLOCK)[:, None] * step)
    return (coarse[:, None] * fine).reshape(-1, waveform.n_slots)[:n]


def _options(tolerance: float, points: int) -> dict[str, Any]:
    """Of finufft: its tolerance, with room for the largest error of a bin; a finer grid below what
    the small one reaches (1e-9); threads where they pay, for they wait on each other.
    """
    return {
        "eps": tolerance / 20,
        "upsampfac": 1.25 if tolerance >= 2e-7 else 2.0,
        "nthreads": 0 if points > _MANY_POINTS else 1,
        "isign": -1,
    }


def _wrapped(cycles: Array) -> Array:
    """Without whole turns."""
    return cycles - np.floor(cycles)


def _turned(cycles: Array) -> Complex:
    """exp(j 2 pi cycles)."""
    phasor = np.empty(np.shape(cycles), dtype=np.complex128)
    np.cos(2 * np.pi * cycles, out=phasor.real)
    np.sin(2 * np.pi * cycles, out=phasor.imag)
    return phasor


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
