"""Direction of a target from its amplitude on every pair of transmitter and receiver.

Each pair acts as one antenna at the sum of their positions (the virtual array). Transmitters send
one after another (TDM), so a moving target rotates the phase between them; its range rate
compensates that. The schedule makes the rate ambiguous, so every rate that the range migration
cannot exclude is tested.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.radar.ambiguity import CERTAIN
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.channel_noise import ChannelNoise

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_UNEVEN = 1e-3  # power that calibration errors of the channels take from a single target's beam


@dataclass(frozen=True)
class Direction:
    """Direction cosines to the left and up, their standard errors, and the delay rate.

    NaN along an axis on which the array has no extent. ``delay_rate_alternatives``: rates that the
    phases across the TDM schedule cannot exclude, likeliest first; the direction holds for
    ``delay_rate``.
    """

    left: float
    up: float
    left_error: float
    up_error: float
    delay_rate: float
    delay_rate_alternatives: tuple[float, ...] = ()

    @property
    def elevation_rad(self) -> float:
        """Positive: up."""
        return float(np.arcsin(np.clip(self.up, -1, 1)))

    @property
    def azimuth_rad(self) -> float:
        """Positive: left; an unknown elevation counts as 0."""
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


def direction(
    amplitude: Complex, burst: DemodulatedBurst, delay_rates: ArrayLike, noise: ChannelNoise
) -> Direction:
    """Direction of a single target by beamforming: maximum likelihood in white noise; of noise that
    channels share the errors are larger or smaller.

    Parameters
    ----------
    amplitude : (n_channels,)
        Of the target, from `detect_echoes`.
    burst
        Places and TDM offsets of the channels.
    delay_rates : (n_rates,) or one
        Rates that the target's delay may have, in s/s, likeliest first.
    noise
        Of the amplitudes.
    """
    rates = np.atleast_1d(np.asarray(delay_rates, dtype=np.float64))
    places = virtual_array(burst)[:, 1:] / burst.waveform.wavelength_m
    seen = extents(places) > 1e-3
    cosines = np.empty((len(rates), 2))
    share = np.empty(len(rates))  # of the power that one direction explains
    for i, rate in enumerate(rates):
        still = compensate_motion(amplitude, burst, rate)
        cosines[i] = _beam_maximum(still, places, seen)
        beam = np.vdot(steering(places, cosines[i]), still)
        share[i] = np.abs(beam) ** 2 / max(len(still) * np.vdot(still, still).real, 1e-300)
    best = int(np.argmax(share * (1 - 1e-6 * np.arange(len(rates)))))
    phases = compensate_motion(steering(places, cosines[best]).conj(), burst, rates[best]).conj()
    errors = np.full(2, np.nan)
    errors[seen] = noise.cosine_errors(amplitude, phases, places[:, seen])
    left, up = np.where(seen, cosines[best], np.nan)
    apart_w = _between_transmitters(noise, phases, burst)
    snr = noise.signal_w(amplitude) / apart_w if apart_w else np.inf
    left_open = _possible_rates(share, snr * len(amplitude), len(amplitude))
    left_open[best] = False
    return Direction(
        float(left),
        float(up),
        float(errors[0]),
        float(errors[1]),
        float(rates[best]),
        tuple(float(rate) for rate in rates[left_open]),
    )


def _possible_rates(share: Array, snr: float, n_channels: int) -> NDArray[np.bool_]:
    """Which rates (n_rates,) the phases cannot exclude, by the shares one direction explains.

    The residual of a single target is noise, half a chi-squared variable of 2 n - 4 degrees of
    freedom. A larger residual means that several echoes share the cell: no rate is excluded then.
    """
    from scipy.stats import chi2

    residual = snr * (1 - share.max())
    freedom = max(2 * n_channels - 4, 1)
    if residual > chi2.isf(1e-3, freedom) / 2 + _UNEVEN * snr:
        return np.ones(len(share), dtype=bool)
    return np.asarray(snr * (share.max() - share) < CERTAIN)


def _between_transmitters(noise: ChannelNoise, phases: Complex, burst: DemodulatedBurst) -> float:
    """Mean noise of an echo's amplitudes on each transmitter, which tell its rate: of a channel if
    the noise is white.
    """
    turns = np.unique(burst.tdm_offset_s)
    return float(np.mean([noise.along(phases * (burst.tdm_offset_s == turn)) for turn in turns]))


def virtual_array(burst: DemodulatedBurst) -> Array:
    """Positions of the virtual array, the sum of each pair's, (n_channels, 3), in metres."""
    return burst.transmitter_m + burst.receiver_m


def extents(places: Array) -> Array:
    """Extent along each axis."""
    return np.asarray(np.ptp(places, axis=0))


def steering(places: Array, cosines: Array) -> Complex:
    """Steering vectors (..., n_channels) for direction cosines (2,) or (n, 2).

    Path lengths decrease towards the target: +2 pi times positions in wavelengths.
    """
    return np.asarray(np.exp(2j * np.pi * (cosines @ places.T)))


def compensate_motion(amplitude: Complex, burst: DemodulatedBurst, delay_rate: float) -> Complex:
    """Amplitudes as if all transmitters had sent at the same time."""
    cycles = burst.waveform.carrier_hz * delay_rate * burst.tdm_offset_s
    return np.asarray(amplitude * np.exp(2j * np.pi * cycles))


def _beam_maximum(amplitude: Complex, places: Array, seen: NDArray[np.bool_]) -> Array:
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
