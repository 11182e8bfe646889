"""Direction of a target from its amplitude on every pair of transmitter and receiver.

Each pair acts as one antenna at the sum of their places (the virtual array). Transmitters take
turns, so a moving target turns the phase between them: that is taken out with its rate, and as the
turns fold the rate, every rate that folds to the same is tried.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar.burst import Burst
from hardware.waveform import C_M_PER_S

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Direction:
    """Direction cosines to the left and up, their standard errors, and the unfolded rate.

    NaN along an axis on which the array has no extent.
    """

    left: float
    up: float
    left_error: float
    up_error: float
    range_rate_m_per_s: float

    @property
    def elevation_rad(self) -> float:
        """Positive: up."""
        return float(np.arcsin(np.clip(self.up, -1, 1)))

    @property
    def azimuth_rad(self) -> float:
        """Positive: left; the elevation is taken as 0 where it is unknown."""
        level = np.cos(0.0 if np.isnan(self.up) else self.elevation_rad)
        return float(np.arcsin(np.clip(self.left / max(level, 1e-9), -1, 1)))

    @property
    def azimuth_error_rad(self) -> float:
        """To first order."""
        level = np.cos(0.0 if np.isnan(self.up) else self.elevation_rad)
        return float(self.left_error / max(level * np.cos(self.azimuth_rad), 1e-9))

    @property
    def elevation_error_rad(self) -> float:
        """To first order."""
        return float(self.up_error / max(np.cos(self.elevation_rad), 1e-9))


def direction(amplitude: Complex, burst: Burst, range_rate_m_per_s: float, snr: float) -> Direction:
    """Direction of a lone target by beamforming: maximum likelihood in white noise.

    Parameters
    ----------
    amplitude : (n_channels,)
        Of the target, from `detected`.
    burst
        Places and turns of the channels.
    range_rate_m_per_s
        As the turns fold it.
    snr
        Of the target on one channel, after all processing.
    """
    places = virtual_places(burst)[:, 1:] / burst.waveform.wavelength_m
    seen = extents(places) > 1e-3
    best: tuple[float, float, Array] = (-1.0, range_rate_m_per_s, np.zeros(2))
    for rate in unfolded_rates(burst, range_rate_m_per_s):
        still = compensated(amplitude, burst, rate)
        cosines = _strongest(still, places, seen)
        power = float(np.abs(np.vdot(steering(places, cosines), still)))
        if power > best[0] * (1 + 1e-6):
            best = power, rate, cosines
    _, rate, cosines = best
    centred = places[:, seen] - places[:, seen].mean(axis=0)
    information = 2 * snr * (2 * np.pi) ** 2 * centred.T @ centred
    errors = np.full(2, np.nan)
    errors[seen] = np.sqrt(np.diag(np.linalg.pinv(information))) if seen.any() else np.nan
    left, up = np.where(seen, cosines, np.nan)
    return Direction(float(left), float(up), float(errors[0]), float(errors[1]), float(rate))


def virtual_places(burst: Burst) -> Array:
    """Sum of each pair's places, (n_channels, 3), in metres."""
    return burst.transmitter_m + burst.receiver_m


def extents(places: Array) -> Array:
    """Extent along each axis."""
    return np.asarray(np.ptp(places, axis=0))


def steering(places: Array, cosines: Array) -> Complex:
    """What a target from direction cosines (2,) or (n, 2) gives: (..., n_channels).

    Path lengths shorten towards the target: +2 pi times places in wavelengths.
    """
    return np.asarray(np.exp(2j * np.pi * (cosines @ places.T)))


def unfolded_rates(burst: Burst, range_rate_m_per_s: float) -> Array:
    """Rates that the transmitters' turns cannot tell apart, those of the slots' ambiguity."""
    turns = len(np.unique(burst.late_s))
    fold = 2 * burst.waveform.max_velocity_m_per_s
    rates = range_rate_m_per_s + fold * np.arange(-turns, turns + 1)
    # The slots themselves fold at `turns` times the rate; the nearest to standstill wins a tie.
    rates = rates[np.abs(rates) <= turns * fold / 2 * (1 + 1e-9)]
    return np.asarray(rates[np.argsort(np.abs(rates), kind="stable")])


def compensated(amplitude: Complex, burst: Burst, range_rate_m_per_s: float) -> Complex:
    """Amplitudes as if all transmitters had sent at once."""
    doppler = 2 * range_rate_m_per_s * burst.waveform.carrier_hz / C_M_PER_S
    return np.asarray(amplitude * np.exp(2j * np.pi * doppler * burst.late_s))


def _strongest(amplitude: Complex, places: Array, seen: NDArray[np.bool_]) -> Array:
    """Direction cosines (2,) of the highest beam: a grid, then Newton's method."""
    axes = [
        np.arange(-1, 1, 0.25 / max(extent, 0.25)) if there else np.zeros(1)
        for extent, there in zip(extents(places), seen, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[np.sum(grid**2, axis=1) <= 1]
    cosines = grid[np.argmax(np.abs(steering(places, grid).conj() @ amplitude))].copy()
    if not seen.any():
        return cosines
    turn = 2j * np.pi * places[:, seen]
    for _ in range(20):
        part = steering(places, cosines).conj() * amplitude
        total = part.sum()
        first = -turn.T @ part / total
        second = turn.T @ (turn * part[:, None]) / total
        gradient = 2 * first.real
        curved = 2 * np.real(second - np.outer(first, first))
        change = -np.linalg.lstsq(curved, gradient, rcond=None)[0]
        cosines[seen] += np.clip(change, -0.1, 0.1)
        if np.abs(change).max() < 1e-9:
            break
    return np.asarray(cosines)
