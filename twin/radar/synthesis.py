"""Contributions to the channel: type-1 non-uniform FFTs with range migration.

H[n, m] = sum_i a_i exp(-j 2 pi (fc + f_n) (tau_i + rate_i t_m + acceleration_i t_m^2 / 2))

The carrier's phase is taken in float64 before anything else. What is at rest, and contributions of
nearly the same rate, are bodies: their bulk motion through Doppler and range cells (5 of them for
20 m/s in 10 ms at 4 GHz) is taken out in closed form. What is left of the motion is slow:
transforms along frequency at a few times within the interval hold it all, and the slots in between
are interpolated; a world at rest takes one. Where that would take too many, one transform along
frequency and Doppler does it, with a short Taylor series for what still couples them and for
accelerations. Where rates differ too much for bodies, one transform per slot is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SERIES_RAD = 0.35  # coupled phase left to the series, at most
_MOST_BENT_RAD = 4.0  # phase that accelerations leave, at most, for a series of it
_MOST_BODIES = 6  # beyond that the exact way is faster
_MANY_POINTS = 200_000  # from which several threads are used
_HANDFUL = 64  # echoes times terms up to which their sum is a matrix product
_ANEW = 1.5  # times as long an echo takes at a new time as in one more term of the series
_SMALL = 2**15  # multiplications that BLAS does not share out: its threads wait on a busy machine
_BLOCK = 64  # subcarriers whose migration shares its coarse steps


@dataclass(frozen=True, eq=False)
class Contributions:
    """Echoes, each (n,): amplitude, delay in s, its rate in s/s (positive: receding) and the rate's
    rate in 1/s: a target that crosses at v in R has 2 v^2 / (R c).

    The amplitude is that of the wave relative to the sent one, without the phase of the delay; of a
    radar that steps its carrier it may be (n_steps, n).
    Delays belong to the middle of the interval and to the antenna's origin. ``departure`` and
    ``arrival`` (n, 3) are unit vectors from the antenna towards where a path begins and whence it
    comes back, in its own frame: x ahead, y left, z up; zero where the way does not depend on where
    the antennas stand. ``departure_per_s`` and ``arrival_per_s`` (n, 3) are their derivatives in
    time, 1/s: where a target crosses, elements of an array do not hear the same rate; default: 0.
    ``falloff`` (n,): over the band the amplitude goes as the carrier over the frequency to this
    power; default: 0.
    """

    amplitude: Complex
    delay_s: Array
    delay_rate: Array
    delay_acceleration_per_s: Array
    departure: Array
    arrival: Array
    departure_per_s: Array = None  # type: ignore[assignment]
    arrival_per_s: Array = None  # type: ignore[assignment]
    falloff: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n = len(self.delay_s)
        for name, shape in (("departure_per_s", (n, 3)), ("arrival_per_s", (n, 3)), ("falloff", n)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(shape))

    @staticmethod
    def ahead(
        amplitude: Complex,
        delay_s: Array,
        delay_rate: Array,
        delay_acceleration_per_s: Array | None = None,
    ) -> "Contributions":
        """Echoes from straight ahead; without acceleration by default."""
        forward = np.tile([1.0, 0.0, 0.0], (len(delay_s), 1)).reshape(-1, 3)
        faster = np.zeros(len(delay_s))
        if delay_acceleration_per_s is not None:
            faster = delay_acceleration_per_s
        return Contributions(amplitude, delay_s, delay_rate, faster, forward, forward)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the delay of each changes at all, (n,)."""
        found: NDArray[np.bool_] = (self.delay_rate != 0) | (self.delay_acceleration_per_s != 0)
        return found

    def delays_at(self, time_s: float) -> Array:
        """Delays at a time, (n,)."""
        if time_s == 0:
            return self.delay_s
        moved = (time_s / 2) * self.delay_acceleration_per_s
        moved += self.delay_rate
        moved *= time_s
        moved += self.delay_s
        return moved

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
    channel = _flat(contributions, waveform, tolerance)
    sloping = np.flatnonzero(contributions.falloff)
    if len(sloping):
        # (1 + u)^p = 1 + p u, u the wavelength's excess: 2 GHz off 79 GHz 6e-4 off for p = 2.
        part = _chosen(contributions, sloping)
        part = replace(part, amplitude=part.amplitude * part.falloff)
        offset = waveform.frequency_offsets_hz
        excess = -offset / (waveform.carrier_hz + offset)
        channel += excess[:, None] * _flat(part, waveform, tolerance)
    return channel


def _flat(contributions: Contributions, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """The channel with all amplitudes as they are at the carrier."""
    channel = np.zeros((waveform.n_subcarriers, waveform.n_slots), dtype=np.complex128)
    for members, is_body in _groups(contributions, waveform):
        part = _chosen(contributions, members)
        if is_body:
            channel += _body(part, waveform, tolerance)
        else:
            channel += _at_times(part, waveform.slot_times_s, waveform, tolerance)
    return channel


def direct_sum(
    contributions: Contributions, frequencies_hz: Array, times_s: Array, carrier_hz: float
) -> Complex:
    """The definition, in float64, for chosen frequencies and times: the reference."""
    channel = np.zeros((len(frequencies_hz), len(times_s)), dtype=np.complex128)
    for start in range(0, len(contributions.delay_s), 4096):
        part = _chosen(contributions, slice(start, start + 4096))
        moved = np.stack([part.delays_at(time) for time in times_s], axis=1)
        for row, frequency in enumerate(frequencies_hz):
            cycles = (carrier_hz + frequency) * moved
            amplitude = part.amplitude * (carrier_hz / (carrier_hz + frequency)) ** part.falloff
            channel[row] += amplitude @ np.exp(-2j * np.pi * (cycles % 1.0))
    return channel


def _groups(
    contributions: Contributions, waveform: OfdmWaveform
) -> "list[tuple[NDArray[np.intp] | slice, bool]]":
    """What is at rest; and what moves, as bodies of which the rates are so close that the series
    converges at once. True: a body; False: what would make too many of them.
    """
    rates, is_moving = contributions.delay_rate, contributions.moving
    if not rates.size:
        return []
    half_band = waveform.bandwidth_hz / 2
    half_time = waveform.n_slots * waveform.slot_period_s / 2
    width = 2 * _SERIES_RAD / (2 * np.pi * half_band * half_time)
    if not is_moving.any() or (is_moving.all() and np.ptp(rates) <= width):
        return [(slice(None), True)]
    at_rest, moving = np.flatnonzero(~is_moving), np.flatnonzero(is_moving)
    rest: list[tuple[NDArray[np.intp] | slice, bool]] = [(at_rest, True)] if at_rest.size else []
    order = moving[np.argsort(rates[moving], kind="stable")]
    bodies: list[tuple[NDArray[np.intp] | slice, bool]] = []
    start, rates = 0, rates[order]
    while start < len(order):
        if len(bodies) == _MOST_BODIES:
            return [*rest, (moving, False)]
        stop = int(np.searchsorted(rates, rates[start] + width, side="right"))
        bodies.append((order[start:stop], True))
        start = stop
    return rest + bodies


def _body(part: Contributions, waveform: OfdmWaveform, tolerance: float) -> Complex:
    """One group: bulk motion in closed form, the spread around it by the cheapest way."""
    bulk = _middle(part.delay_rate), _middle(part.delay_acceleration_per_s)
    spread = replace(
        part,
        delay_rate=part.delay_rate - bulk[0],
        delay_acceleration_per_s=part.delay_acceleration_per_s - bulk[1],
    )
    n, points = waveform.n_subcarriers, len(part.delay_s)
    latest, highest = float(np.abs(waveform.slot_times_s).max()), waveform.bandwidth_hz / 2
    top = waveform.carrier_hz + highest
    # Per Hz: phases at the interval's end that rates and accelerations leave.
    linear = 2 * np.pi * latest * float(np.abs(spread.delay_rate).max())
    square = np.pi * latest**2 * float(np.abs(spread.delay_acceleration_per_s).max())
    terms = _terms((linear + square) * highest, tolerance)
    if points * terms <= _HANDFUL:
        return _by_products(part, spread, bulk, terms, waveform)
    times = _times(linear * top, square * top, waveform, tolerance)
    counts = _counts(linear * highest, square * top, tolerance)
    at_times = len(times) * (_ANEW * points + n)
    if counts and at_times > sum(counts) * (points + n * waveform.n_slots):
        return _by_series(part, spread, bulk, counts, waveform, tolerance)
    found = _at_times(spread, times, waveform, tolerance)
    if 1 < len(times) < waveform.n_slots:
        found = _product(found, _interpolation(times, waveform.slot_times_s))
    return found * _migration(bulk, waveform, _turns(bulk, waveform)) if any(bulk) else found


def _middle(values: Array) -> float:
    return float(values.max() + values.min()) / 2


def _by_products(
    part: Contributions,
    spread: Contributions,
    bulk: tuple[float, float],
    terms: int,
    waveform: OfdmWaveform,
) -> Complex:
    """The definition as matrix products, for a handful of echoes; what moves them through the band
    apart from each other as a series: exp(-j 2 pi f s) = sum_k (-j 2 pi f)^k s^k / k!.

    ``spread``: the part without its bulk motion.
    """
    carrier, f, t = waveform.carrier_hz, waveform.frequency_offsets_hz, waveform.slot_times_s
    along_f = _turned(-f[:, None] * part.delay_s)
    doppler = carrier * _moved(part, t)
    along_t = _turned(-_wrapped(carrier * part.delay_s)[:, None] - doppler)
    along_t = part.amplitude[:, None] * along_t
    unit, moved = _scaled(_moved(spread, t))
    grids = [
        along_f @ (along_t * (moved**k / factorial(k)) if k else along_t) for k in range(terms)
    ]
    channel = _horner(grids, -2j * np.pi * unit * f, np.ones(len(t)))
    return channel * _migration(bulk, waveform, np.zeros(len(t))) if any(bulk) else channel


def _by_series(
    part: Contributions,
    spread: Contributions,
    bulk: tuple[float, float],
    counts: Sequence[int],
    waveform: OfdmWaveform,
    tolerance: float,
) -> Complex:
    """Transforms along frequency and Doppler, with what couples both as a series around the bulk.

    exp(-j 2 pi f t d) = sum_k (-j 2 pi f t)^k d^k / k! with d a rate's distance from the bulk, and
    the same of accelerations in (fc + f) t^2 / 2. ``counts``: of terms of the former with each
    power of the latter; ``spread``: the part without its bulk motion.
    """
    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    slow, rates = _scaled(spread.delay_rate)
    bent, accelerations = _scaled(spread.delay_acceleration_per_s)
    powers = [
        rates**i / factorial(i) * (accelerations**k / factorial(k))
        for k, count in enumerate(counts)
        for i in range(count)
    ]
    grids = _grids(part, np.stack(powers), waveform, tolerance)
    series = np.split(grids, np.cumsum(counts)[:-1])
    coupled = [_horner(some, -2j * np.pi * slow * f, t) for some in series]
    channel = _horner(coupled, -1j * np.pi * bent * (waveform.carrier_hz + f), t**2)
    # What rates do to the carrier is in the transforms.
    turns = _turns((0.0, bulk[1]), waveform)
    return channel * _migration(bulk, waveform, turns) if any(bulk) else channel


def _horner(grids: list[Complex] | Complex, along_f: NDArray[Any], along_t: Array) -> Complex:
    """Sum of grids times powers of a product of both."""
    channel, *rest = grids[::-1]
    if rest:
        factor = along_f[:, None] * along_t
        for grid in rest:
            channel *= factor
            channel += grid
    return channel


def _scaled(values: Array) -> tuple[float, Array]:
    """The largest of some values, and all of them over it: powers of these stay near 1."""
    unit = max(float(np.abs(values).max()), np.finfo(float).tiny)
    return unit, values / unit


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


def _at_times(
    part: Contributions, times: Array, waveform: OfdmWaveform, tolerance: float
) -> Complex:
    """One transform along frequency per time, ``(n_subcarriers, n_times)``: exact in the motion."""
    import finufft

    n, options = waveform.n_subcarriers, _options(tolerance, len(part.delay_s))
    found = np.empty((len(times), n), dtype=np.complex128)
    for row, time in zip(found, times, strict=True):
        delay = part.delays_at(time)
        strengths = part.amplitude * _turned(-_wrapped(waveform.carrier_hz * delay))
        x = 2 * np.pi * _wrapped(waveform.subcarrier_spacing_hz * delay)
        row[:] = finufft.nufft1d1(x, strengths, n, **options)
    return found.T


def _times(linear_rad: float, square_rad: float, waveform: OfdmWaveform, tolerance: float) -> Array:
    """Times that hold a motion of up to a phase either way from the interval's middle, linear and
    square in time.

    Chebyshev's points; K of them leave of exp(j a x) at most 4 J_K(a) on average, and
    J_K(a) <= (a / 2)^K / K! (Trefethen, Approximation Theory and Practice, 2013, ch. 4). As
    x^2 = (1 + T_2(x)) / 2, exp(j (a x + b x^2)) leaves at most the coefficient of z^K in
    exp(a z / 2 + b z^2 / 4). The slots themselves where they are no more.
    """
    count, last, rest = 1, 1.0, linear_rad / 2
    following = (linear_rad / 2 * rest + square_rad / 2 * last) / 2
    # Written so that what overflows, even to NaN, takes all slots.
    while not 4 * max(rest, following) <= tolerance / 4 and count < waveform.n_slots:
        count += 1
        last, rest = rest, following
        following = (linear_rad / 2 * rest + square_rad / 2 * last) / (count + 1)
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


def _moved(part: Contributions, times: Array) -> Array:
    """By how much delays grow from the interval's middle on, ``(n, n_times)``."""
    rate, faster = part.delay_rate[:, None], part.delay_acceleration_per_s[:, None]
    found: Array = (rate + faster / 2 * times) * times
    return found


def _turns(bulk: tuple[float, float], waveform: OfdmWaveform) -> Array:
    """Cycles by which a bulk motion turns the carrier, (n_slots,)."""
    rate, acceleration = bulk
    t = waveform.slot_times_s
    return waveform.carrier_hz * (rate + acceleration / 2 * t) * t


def _migration(bulk: tuple[float, float], waveform: OfdmWaveform, turns: Array) -> Complex:
    """exp(-j 2 pi (turns + f (rate t + acceleration t^2 / 2))): coarse steps between blocks of
    subcarriers, fine ones within.
    """
    n = waveform.n_subcarriers
    step = -waveform.subcarrier_spacing_hz / waveform.carrier_hz * _turns(bulk, waveform)
    coarse = _turned((np.arange(0, n, _BLOCK) - n // 2)[:, None] * step - turns)
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
    """Terms of the series of exp(j phase) until the rest is below the tolerance, or they are too
    many to be of use.
    """
    terms, rest = 1, phase_rad
    while rest > tolerance / 2 and terms <= _HANDFUL:
        terms += 1
        rest *= phase_rad / terms
    return terms


def _counts(coupled_rad: float, bent_rad: float, tolerance: float) -> list[int]:
    """Terms of the series of exp(j coupled) with each power of the series of exp(j bent), until
    the rest is below the tolerance; none where ``bent`` is too much for a series.
    """
    counts: list[int] = []
    if bent_rad > _MOST_BENT_RAD:
        return counts
    bent, enough = 1.0, tolerance
    while 2 * bent > enough:
        counts.append(_terms(coupled_rad, enough / bent))
        bent *= bent_rad / len(counts)
        enough = tolerance / 4  # several rests are left
    return counts


def _chosen(part: Contributions, which: "NDArray[np.intp] | slice") -> Contributions:
    return Contributions(
        part.amplitude[which],
        part.delay_s[which],
        part.delay_rate[which],
        part.delay_acceleration_per_s[which],
        part.departure[which],
        part.arrival[which],
        part.departure_per_s[which],
        part.arrival_per_s[which],
        part.falloff[which],
    )
