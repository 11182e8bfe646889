"""Where points on moving bodies are, in mpmath: the reference of the radar's micro-Doppler."""

from collections.abc import Callable, Sequence

import mpmath
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from hardware.waveform import OfdmWaveform

Place = Callable[[mpmath.mpf], mpmath.matrix]

mpmath.mp.dps = 30


def vector(values: Sequence[float]) -> mpmath.matrix:
    return mpmath.matrix([mpmath.mpf(float(x)) for x in values])


def about_z(angle: mpmath.mpf) -> mpmath.matrix:
    c, s = mpmath.cos(angle), mpmath.sin(angle)
    return mpmath.matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def about_y(angle: mpmath.mpf) -> mpmath.matrix:
    c, s = mpmath.cos(angle), mpmath.sin(angle)
    return mpmath.matrix([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def on_rotor(centre: Sequence[float], arm: Sequence[float], rate: float) -> Place:
    """At ``arm`` from the centre at time 0, turning about z."""
    return lambda t: vector(centre) + about_z(mpmath.mpf(rate) * t) * vector(arm)


def on_rolling_wheel(centre: Sequence[float], radius: float, speed: float, angle: float) -> Place:
    """On the rim of a wheel that rolls along x on a road below, ``angle`` past the top at time 0:
    the rim's speed is between 0 and twice that of the axle.
    """

    def place(t: mpmath.mpf) -> mpmath.matrix:
        turn = mpmath.mpf(angle) + mpmath.mpf(speed) * t / mpmath.mpf(radius)
        axle = vector(centre) + vector((speed, 0, 0)) * t
        return axle + about_y(turn) * vector((0, 0, radius))

    return place


def on_pendulum(pivot: Sequence[float], length: float, amplitude: float, period: float) -> Place:
    """Below a pivot, swinging about y, upright at time 0."""

    def place(t: mpmath.mpf) -> mpmath.matrix:
        angle = mpmath.mpf(amplitude) * mpmath.sin(2 * mpmath.pi * t / mpmath.mpf(period))
        return vector(pivot) + about_y(angle) * vector((0, 0, -length))

    return place


def distances_m(one: Place, other: Place, times_s: NDArray[np.float64]) -> list[mpmath.mpf]:
    """Between two points at times."""
    at = [mpmath.mpf(float(t)) for t in times_s]
    return [mpmath.norm(one(t) - other(t)) for t in at]


def two_way(
    one: Place, radar: Place, times_s: NDArray[np.float64], frequencies_hz: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """exp(-j 2 pi f 2 r(t) / c), (n_frequencies, n_times)."""
    cycles = [2 * r / mpmath.mpf(speed_of_light) for r in distances_m(one, radar, times_s)]
    turns = [[float(mpmath.frac(mpmath.mpf(float(f)) * c)) for c in cycles] for f in frequencies_hz]
    return np.exp(-2j * np.pi * np.array(turns))


def demodulated(
    one: Place, radar: Place, rates_m_per_s: NDArray[np.float64], wave: OfdmWaveform
) -> NDArray[np.complex128]:
    """What is found of a point by division by the sent symbols, (n_subcarriers, n_slots): within
    each symbol it goes on at the slot's range rate.
    """
    distances = np.array([float(r) for r in distances_m(one, radar, wave.slot_times_s)])
    frequencies = wave.carrier_hz + wave.frequency_offsets_hz
    channel = np.exp(-4j * np.pi * np.outer(frequencies, distances) / speed_of_light)
    n = wave.n_subcarriers
    doppler_hz = -2 * rates_m_per_s * wave.carrier_hz / speed_of_light
    turns = np.outer(np.arange(n) - (n - 1) / 2, doppler_hz) / wave.bandwidth_hz
    sent = wave.sent()[:, None]
    samples = np.fft.ifft(np.fft.ifftshift(sent * channel, axes=0), axis=0)
    samples *= np.exp(2j * np.pi * turns)
    return np.fft.fftshift(np.fft.fft(samples, axis=0), axes=0) * sent.conj()
