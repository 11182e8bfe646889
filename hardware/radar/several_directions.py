"""Several targets of one range and rate: directions, levels and errors by joint maximum likelihood.

Targets are added one by one until they leave noise alone. Each time all directions are fitted
together by least squares, with the amplitudes that are best for them, from those of `music` and
from the ones before with the highest beam of what they leave: MUSIC on a single snapshot is biased
by what its smoothing leaves coherent. Standard errors are those of the joint fit in the
noise of the cell: in white noise the Cramer-Rao bound for unknown amplitudes (Stoica and Nehorai,
IEEE Trans. ASSP 37, 1989).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.angles import angle_error, at_one_time, fit_explains, steering
from hardware.radar.array_plane import extents, virtual_array
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.music import line_spacing, most_targets, music

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_TOLD = 4.3  # standard errors of an amplitude: by chance one of 1e-4 exceeds them
_APART = 8.0  # standard errors between directions; nearer ones the errors hold no more
_ALIKE = 1e-7  # share of the strongest change of the channels that counts as none
_SAME_PHASES = 1e-3  # radians between rates that differ by whole turns from turn to turn
_PER_LOBE = 4  # directions of the beam that are looked at


@dataclass(frozen=True)
class CellTarget:
    """One of several targets of a cell: direction, power on one antenna, and their errors.

    ``alternatives_rad``: azimuths that a line of antennas more than half a wavelength apart does
    not tell from it.
    """

    azimuth_rad: float
    azimuth_error_rad: float
    power_w: float
    power_error_w: float
    alternatives_rad: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class CellTargets:
    """The targets of a cell that one direction does not explain, the strongest first; none where
    two or more cannot be told from each other. ``fits``: whether what they leave, ``rest_w`` on all
    channels together, may be noise. ``delay_rate``: for which they hold.
    """

    targets: list[CellTarget]
    fits: bool
    rest_w: float
    delay_rate: float


@dataclass(frozen=True, eq=False)
class _Fit:
    """Direction cosines to the left (n,), amplitudes (n,), and what they leave (n_channels,)."""

    left: Array
    amplitude: Complex
    rest: Complex

    @property
    def rest_w(self) -> float:
        return float(np.vdot(self.rest, self.rest).real)


def targets_of_cell(
    amplitude: Complex,
    burst: DemodulatedBurst,
    delay_rates: Sequence[float],
    noise: ChannelNoise,
    at_most: int,
) -> CellTargets:
    """The targets of a cell at the one of its delay rates, likeliest first, at which they explain
    most of the amplitudes: at another one a single direction may explain more.
    """
    cells = [
        _targets_at(amplitude, burst, rate, noise, at_most)
        for rate in _of_unlike_phases(delay_rates, burst)
    ]
    return min(cells, key=lambda cell: (not cell.targets, cell.rest_w))


def check_per_cell(at_most: int, burst: DemodulatedBurst) -> None:
    """Raise InputError where the antennas are no evenly spaced line to the left, or resolve fewer
    targets of a cell.
    """
    try:
        most = most_targets(burst)
    except InputError as error:
        raise InputError(f"per_cell: {at_most}: {error}") from None
    if at_most > most:
        raise InputError(f"per_cell: {at_most}, expected at most {most} with the record's antennas")


def _of_unlike_phases(delay_rates: Sequence[float], burst: DemodulatedBurst) -> list[float]:
    """Rates that turn the phases between the transmitters' turns each in another way."""
    turns = np.exp(
        2j * np.pi * burst.waveform.carrier_hz * np.outer(delay_rates, burst.tdm_offset_s)
    )
    turns /= turns[:, :1]
    unlike: list[int] = []
    for i, turn in enumerate(turns):
        if not unlike or np.abs(turns[unlike] - turn).max(axis=1).min() > _SAME_PHASES:
            unlike.append(i)
    return [delay_rates[i] for i in unlike]


def _targets_at(
    amplitude: Complex,
    burst: DemodulatedBurst,
    delay_rate: float,
    noise: ChannelNoise,
    at_most: int,
) -> CellTargets:
    """The targets of a cell at one delay rate."""
    still, noise = at_one_time(amplitude, noise, burst, delay_rate)
    places = virtual_array(burst)[:, 1] / burst.waveform.wavelength_m
    spacing = line_spacing(burst)
    fit = _joint_fit(_highest(still, places), still, places)
    cell = CellTargets([], False, fit.rest_w, delay_rate)
    for n_targets in range(2, at_most + 1):
        starts = (
            np.sin(music(still, burst, n_targets)),
            np.append(fit.left, _highest(fit.rest, places)),
        )
        fit = min((_joint_fit(s, still, places) for s in starts), key=lambda one: one.rest_w)
        if (told := _told(fit, places, spacing, noise)) is None:
            break
        fits = fit_explains(still, _steering(fit.left, places), noise)
        cell = CellTargets(told, fits, fit.rest_w, delay_rate)
        if fits:
            break
    return cell


def _steering(left: Array, places: Array) -> Complex:
    """Steering vectors (n_channels, n)."""
    return steering(places[:, None], left[:, None]).T


def _highest(amplitude: Complex, places: Array) -> Array:
    """Direction cosine (1,) of the highest beam."""
    n = int(np.ceil(2 * _PER_LOBE * max(float(extents(places)), 1.0)))
    grid = np.linspace(-1, 1, n + 1)
    return grid[[np.argmax(np.abs(_steering(grid, places).conj().T @ amplitude))]]


def _joint_fit(start: Array, amplitude: Complex, places: Array) -> _Fit:
    """Directions by least squares from a start (n,), with the best amplitudes of each."""
    from scipy.optimize import least_squares

    def fit(left: Array) -> _Fit:
        vectors = _steering(left, places)
        best = np.linalg.lstsq(vectors, amplitude)[0].astype(np.complex128)
        return _Fit(left, best, amplitude - vectors @ best)

    scale = max(float(np.linalg.norm(amplitude)), 1e-300)
    found = least_squares(
        lambda left: (fit(left).rest / scale).view(np.float64),
        np.clip(start, -1 + 1e-6, 1 - 1e-6),
        bounds=(-1, 1),
        xtol=1e-10,
        ftol=1e-12,
        gtol=1e-12,
    )
    return fit(found.x)


def _told(fit: _Fit, places: Array, spacing: float, noise: ChannelNoise) -> list[CellTarget] | None:
    """The targets of a fit; None if one is not told from noise, or from another one."""
    n = len(fit.left)
    weights = _weights(fit, places)
    if weights is None:
        return None
    left_error = noise.errors(weights[:, :n])
    power_w = np.abs(fit.amplitude) ** 2
    along = weights[:, n : 2 * n] * fit.amplitude.real + weights[:, 2 * n :] * fit.amplitude.imag
    power_error_w = noise.errors(2 * along)
    if (power_error_w * _TOLD > 2 * power_w).any():  # twice the relative error of the amplitude
        return None
    order = np.argsort(fit.left)
    for a, b in pairwise(order):
        apart_error = noise.errors((weights[:, b] - weights[:, a])[:, None])[0]
        if fit.left[b] - fit.left[a] < _APART * apart_error:
            return None
    targets = []
    for i in np.argsort(-power_w):
        azimuth_rad = float(np.arcsin(fit.left[i]))
        targets.append(
            CellTarget(
                azimuth_rad,
                angle_error(left_error[i], float(np.cos(azimuth_rad))),
                float(power_w[i]),
                float(power_error_w[i]),
                _grating_lobes(fit.left[i], spacing),
            )
        )
    return targets


def _weights(fit: _Fit, places: Array) -> Complex | None:
    """Weights (n_channels, 3 n) of the noise of amplitudes in the errors Re(w^H n) of directions
    and of real and imaginary parts of amplitudes, to first order; None of directions that are one
    to rounding.
    """
    vectors = _steering(fit.left, places)
    turned = 2j * np.pi * places[:, None] * vectors
    changes = np.hstack([turned, vectors, 1j * vectors])
    size = np.concatenate([np.abs(fit.amplitude), np.ones(2 * len(fit.left))])
    changes[:, : len(fit.left)] *= np.exp(1j * np.angle(fit.amplitude))
    left, values, right = np.linalg.svd(np.vstack([changes.real, changes.imag]), False)
    if values[-1] <= _ALIKE * values[0] or not size.all():
        return None
    inverse = right.T @ (left / values).T / size[:, None]
    return np.asarray((inverse[:, : len(places)] + 1j * inverse[:, len(places) :]).T)


def _grating_lobes(left: float, spacing: float) -> tuple[float, ...]:
    """Azimuths of the directions whose phases are the same on a line of this spacing, the nearest
    to the boresight first.
    """
    reach = int(2 * spacing)
    lobes = left + np.delete(np.arange(-reach, reach + 1), reach) / spacing
    lobes = lobes[np.abs(lobes) <= 1]
    return tuple(float(one) for one in np.arcsin(lobes[np.argsort(np.abs(lobes))]))
