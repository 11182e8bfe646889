"""Direction of a target from its amplitude on every pair of transmitter and receiver.

Each pair acts as one antenna at the sum of their positions (the virtual array). Transmitters send
one after another (TDM), so a moving target rotates the phase between them; its range rate
compensates that. The schedule makes the rate ambiguous, so every rate that the range migration
cannot exclude is tested.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.radar.array_plane import ArrayPlane, extents
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.rate_evidence import CERTAIN

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

#: What a lobe may have more than the nearest place of the grid, of the power: an eighth of a lobe
#: off along both axes of an array of four corners.
_BETWEEN = 0.3
_ALIKE = 1e-4  # difference of direction cosines of one lobe
_UNEVEN = 1e-3  # power that calibration errors of the channels take from a single target's beam
_FALSE_ALARM = 1e-4  # of a single target that is taken for several
_ROUNDING = 1e-9  # of the power, where there is no noise
_ROUNDS = 4  # for antennas up to a tenth of a wavelength before or behind their plane
_EQUALLY_LIKELY = 0.1  # difference of the logarithms of likelihoods that tells nothing


@dataclass(frozen=True)
class Direction:
    """Direction cosines to the left and up, their standard errors with the ``correlation`` of
    these, and the delay rate.

    NaN along an axis on which the array has no extent. ``delay_rate_alternatives``: rates that the
    phases across the TDM schedule cannot exclude, likeliest first; the direction holds for
    ``delay_rate``. ``others``: direction cosines of other lobes of the array that noise may have
    raised above the true one, and mirror images by the array's plane, likeliest first. ``fits``:
    whether what one direction leaves of the amplitudes may be noise; else several targets, or one
    that is no point, share the cell.
    """

    left: float
    up: float
    left_error: float
    up_error: float
    delay_rate: float
    delay_rate_alternatives: tuple[float, ...] = ()
    others: tuple[tuple[float, float], ...] = ()
    fits: bool = True
    correlation: float = 0.0

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
    def alternatives(self) -> "tuple[Direction, ...]":
        """The directions of the other lobes, each without alternatives."""
        return tuple(
            replace(self, left=left, up=up, delay_rate_alternatives=(), others=())
            for left, up in self.others
        )

    @property
    def azimuth_error_rad(self) -> float:
        """With what the elevation's error does to it, as sin(az) = left / cos(el): to first order;
        near the array's axis from the interval of the sine.
        """
        level, slope, up_error = 1.0, 0.0, 0.0
        if not np.isnan(self.up):
            level = max(float(np.cos(self.elevation_rad)), 1e-9)
            slope, up_error = self.left * self.up / level**2, self.up_error
        both = 2 * self.correlation * self.left_error * slope * up_error
        square = self.left_error**2 + (slope * up_error) ** 2 + both
        return angle_error(float(np.sqrt(max(square, 0.0))) / level, np.cos(self.azimuth_rad))

    @property
    def elevation_error_rad(self) -> float:
        """To first order; near the array's axis from the interval of the cosine."""
        return angle_error(self.up_error, np.cos(self.elevation_rad))


def angle_error(error: float, cosine: float) -> float:
    """Standard error of an angle, of that of its sine; near a right angle, where the first order
    has no bound, the farther of both ends of the sine's interval.
    """
    if cosine**2 > 8 * error or np.isnan(error):
        return float(error / cosine)
    sine = np.sqrt(max(1 - cosine**2, 0.0))
    ends = np.arcsin(np.clip([sine - error, sine + error], -1, 1))
    return float(np.abs(ends - np.arcsin(sine)).max())


def direction(
    amplitude: Complex,
    burst: DemodulatedBurst,
    delay_rates: ArrayLike,
    noise: ChannelNoise,
    plane: ArrayPlane,
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
    plane
        That of the channels.
    """
    rates = np.atleast_1d(np.asarray(delay_rates, dtype=np.float64))
    cosines = np.empty((len(rates), 2))
    share = np.empty(len(rates))  # of the power that one direction explains
    alike = _UNEVEN + _EQUALLY_LIKELY * noise.mean_w / max(_power_w(amplitude), 1e-300)
    for i, rate in enumerate(rates):
        still = compensate_motion(amplitude, burst, rate)
        cosines[i], share[i] = _found(still, plane, alike)
    best = int(np.argmax(share * (1 - 1e-6 * np.arange(len(rates)))))
    wave = plane.flattened(steering(plane.places, cosines[best]).conj(), cosines[best])
    phases = compensate_motion(wave, burst, rates[best]).conj()
    left, up = _left_and_up(plane, plane.directions(cosines[[best]])[0, 0])
    left_error, up_error, correlation = _errors(plane, cosines[best], amplitude, phases, noise)
    apart_w = _between_transmitters(noise, phases, burst)
    snr = noise.signal_w(amplitude) / apart_w if apart_w else np.inf
    snr *= len(amplitude)
    fits = fit_explains(amplitude, phases[:, None], noise)
    left_open = snr * (share.max() - share) < CERTAIN if fits else np.ones(len(share), dtype=bool)
    left_open[best] = False
    still, at_rest = at_one_time(amplitude, noise, burst, rates[best])
    flat = plane.flattened(still, cosines[best])
    others = _other_directions(flat, cosines[best], plane, at_rest)
    return Direction(
        left,
        up,
        left_error,
        up_error,
        float(rates[best]),
        tuple(float(rate) for rate in rates[left_open]),
        tuple(_left_and_up(plane, other) for other in others),
        fits,
        correlation,
    )


def _found(amplitude: Complex, plane: ArrayPlane, alike: float) -> tuple[Array, float]:
    """Direction cosines (2,) that explain most, and of which share of the power. What channels
    before the plane add is taken out as found so far, at first as of a target ahead of it.
    """
    cosines = np.zeros(2)
    for _ in range(1 if plane.is_flat else _ROUNDS):
        cosines = _most_likely(plane.flattened(amplitude, cosines), plane, alike)
    flat = plane.flattened(amplitude, cosines)
    return cosines, float(_shares(cosines, flat, plane.places))


def _left_and_up(plane: ArrayPlane, toward: Array) -> tuple[float, float]:
    """Direction cosines to the left and up of a unit vector (3,), NaN of that which is not seen."""
    left, up = np.where(plane.seen, toward[1:], np.nan)
    return float(left), float(up)


def _errors(
    plane: ArrayPlane, cosines: Array, amplitude: Complex, phases: Complex, noise: ChannelNoise
) -> tuple[float, float, float]:
    """Standard errors of the direction cosines to the left and up, and their correlation."""
    seen = plane.seen
    covariance = np.zeros((2, 2))
    covariance[np.ix_(seen, seen)] = noise.cosine_covariance(
        amplitude, phases, plane.places[:, seen]
    )
    slopes = plane.slopes(cosines)
    turned = slopes @ covariance @ slopes.T
    errors = np.where(seen, np.sqrt(np.diag(turned)), np.nan)
    both = float(errors.prod()) if seen.all() else 0.0
    return float(errors[0]), float(errors[1]), float(turned[0, 1] / both) if both else 0.0


def _other_directions(
    amplitude: Complex, best: Array, plane: ArrayPlane, noise: ChannelNoise
) -> Array:
    """Unit vectors (n, 3) of the directions ahead that noise does not tell from the best one: those
    of other lobes, the largest first, and mirror images by the array's plane.
    """
    lobes = np.concatenate([best[None], _other_lobes(amplitude, best, plane, noise)])
    every = plane.directions(lobes)
    if plane.faces_ahead:
        return every[1:, 0]
    return every.reshape(-1, 3)[1:][every[..., 0].reshape(-1)[1:] > 0]


def _other_lobes(amplitude: Complex, best: Array, plane: ArrayPlane, noise: ChannelNoise) -> Array:
    """Direction cosines (n, 2) of lobes of which noise along their beam, or along the best one, may
    make up the difference to that, the largest first.
    """
    power_w, places = max(_power_w(amplitude), 1e-300), plane.places
    highest = float(_shares(best, amplitude, places))
    most_w = max(float(np.linalg.eigvalsh(noise.covariance_w)[-1]), noise.least_w)
    lobes = _lobes(amplitude, plane, highest - CERTAIN * most_w / power_w - _ROUNDING)
    lobes = lobes[np.abs(lobes - best).max(axis=1) > _ALIKE]
    beam_w = noise.along(steering(places, best))
    noise_w = np.array([max(beam_w, noise.along(steering(places, lobe))) for lobe in lobes])
    lower = highest - _shares(lobes, amplitude, places)
    return lobes[lower <= CERTAIN * noise_w / power_w + _ROUNDING]


def fit_explains(amplitude: Complex, phases: Complex, noise: ChannelNoise) -> bool:
    """Whether echoes of phases (n_channels, n), fitted to the amplitudes, leave noise alone, and
    what calibration errors of the channels make.
    """
    rest = amplitude - phases @ np.linalg.lstsq(phases, amplitude)[0]
    return noise.explains(rest, phases, _UNEVEN * _power_w(amplitude), _FALSE_ALARM)


def _between_transmitters(noise: ChannelNoise, phases: Complex, burst: DemodulatedBurst) -> float:
    """Mean noise of an echo's amplitudes on each transmitter, which tell its rate: of a channel if
    the noise is white.
    """
    turns = np.unique(burst.tdm_offset_s)
    return float(np.mean([noise.along(phases * (burst.tdm_offset_s == turn)) for turn in turns]))


def steering(places: Array, cosines: Array) -> Complex:
    """Steering vectors (..., n_channels) for direction cosines (2,) or (n, 2).

    Path lengths decrease towards the target: +2 pi times positions in wavelengths.
    """
    return np.asarray(np.exp(2j * np.pi * (cosines @ places.T)))


def compensate_motion(amplitude: Complex, burst: DemodulatedBurst, delay_rate: float) -> Complex:
    """Amplitudes as if all transmitters had sent at the same time."""
    cycles = burst.waveform.carrier_hz * delay_rate * burst.tdm_offset_s
    return np.asarray(amplitude * np.exp(2j * np.pi * cycles))


def at_one_time(
    amplitude: Complex, noise: ChannelNoise, burst: DemodulatedBurst, delay_rate: float
) -> tuple[Complex, ChannelNoise]:
    """Amplitudes and their noise by `compensate_motion`."""
    turn = compensate_motion(np.ones_like(amplitude), burst, delay_rate)
    turned = turn[:, None] * noise.covariance_w * turn.conj()
    return turn * amplitude, replace(noise, covariance_w=turned)


def _power_w(amplitude: Complex) -> float:
    """Of all channels together."""
    return float(np.vdot(amplitude, amplitude).real)


def _most_likely(amplitude: Complex, plane: ArrayPlane, alike: float) -> Array:
    """Direction cosines (2,) of the highest beam; of those that explain as much of the power to
    within ``alike`` the nearest to the boresight, where antennas are most sensitive: beams of
    antennas a wavelength or more apart are equal.
    """
    lobes = _lobes(amplitude, plane, None)
    shares = _shares(lobes, amplitude, plane.places)
    equal = lobes[shares >= shares[0] - alike]
    return np.asarray(equal[np.argmax(plane.directions(equal)[:, 0, 0])])


def _lobes(amplitude: Complex, plane: ArrayPlane, least: float | None) -> Array:
    """Direction cosines (n, 2) of all lobes that explain at least a share of the power, the largest
    first; of those that may be the largest if no share is named. Of directions that are not ahead
    only where no lobe is of one that is.

    Of a lobe whose highest place no direction has, that one on the horizon which explains most.
    """
    from scipy.ndimage import maximum_filter

    places, seen = plane.places, plane.seen
    grid, beam = _beam(amplitude, places, seen)
    if least is None:
        lowest = beam[np.sum(grid**2, axis=-1) <= 1].max() * (1 - _BETWEEN)
    else:
        lowest = least - _BETWEEN
    tops = (beam == maximum_filter(beam, 3)) & (beam >= lowest)
    cosines = _refined(grid[tops], amplitude, places, seen)
    beyond = np.sum(cosines**2, axis=1) > 1
    cosines[beyond] = _on_horizon(cosines[beyond], amplitude, places, seen)
    shares = _shares(cosines, amplitude, places)
    if least is None:
        likely = np.full(len(shares), True)
    else:
        within = _shares((1 - _ALIKE) * cosines, amplitude, places)
        likely = (shares >= least) & ~(beyond & (within > shares))
    if (ahead := likely & plane.is_ahead(cosines)).any():
        likely = ahead
    found = cosines[likely][np.argsort(-shares[likely])]
    _, first = np.unique(np.round(found, 5), axis=0, return_index=True)  # of several starts of one
    return found[np.sort(first)]


def _beam(amplitude: Complex, places: Array, seen: Flags) -> tuple[Array, Array]:
    """Direction cosines (n_left, n_up, 2) a quarter of a lobe apart, and the share of the power
    that each explains; -1 of those that are farther from all directions than the next of them.
    """
    apart = 0.25 / np.maximum(extents(places), 0.25)
    axes = [
        np.linspace(-1, 1, int(np.ceil(2 / step)) + 1) if there else np.zeros(1)
        for step, there in zip(apart, seen, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    beyond = np.sum(np.maximum(np.abs(grid) - apart, 0.0) ** 2, axis=-1) > 1
    return grid, np.where(beyond, -1.0, _shares(grid, amplitude, places))


def _shares(cosines: Array, amplitude: Complex, places: Array) -> Array:
    """Of the power, what each direction (..., 2) explains."""
    beam = np.abs(steering(places, cosines).conj() @ amplitude) ** 2
    return np.asarray(beam / max(len(amplitude) * np.vdot(amplitude, amplitude).real, 1e-300))


def _refined(start: Array, amplitude: Complex, places: Array, seen: Flags) -> Array:
    """Direction cosines (n, 2) of the lobes on which some starts (n, 2) lie, by Newton's method."""
    cosines = start.copy()
    if not seen.any():
        return cosines
    turn = 2j * np.pi * places[:, seen]
    for _ in range(20):
        part = steering(places, cosines).conj() * amplitude
        total = part.sum(axis=1)[:, None]
        first = -(part @ turn) / total
        second = np.einsum("nc,ci,cj->nij", part, turn, turn) / total[:, :, None]
        curved = 2 * np.real(second - first[:, :, None] * first[:, None, :])
        change = -(np.linalg.pinv(curved) @ (2 * first.real)[:, :, None])[:, :, 0]
        cosines[:, seen] += np.clip(change, -0.1, 0.1)
        if np.abs(change).max() < 1e-9:
            break
    return np.asarray(cosines)


def _on_horizon(start: Array, amplitude: Complex, places: Array, seen: Flags) -> Array:
    """Direction cosines (n, 2) of modulus 1 near some starts (n, 2) that explain most, by Newton's
    method over the angle about the boresight.
    """
    if not seen.all():
        return np.asarray(np.sign(start))
    angle = np.arctan2(start[:, 1], start[:, 0])
    turn = 2j * np.pi * places
    at_most = 0.25 / max(float(extents(places).max()), 0.25)
    for _ in range(20):
        cosines = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        along = np.stack([-cosines[:, 1], cosines[:, 0]], axis=1) @ turn.T
        part = steering(places, cosines).conj() * amplitude
        total = part.sum(axis=1)
        first = -(part * along).sum(axis=1) / total
        second = (part * (along**2 + cosines @ turn.T)).sum(axis=1) / total
        curved = 2 * np.real(second - first**2)
        change = 2 * first.real / np.maximum(np.abs(curved), 1e-300)
        angle = angle + np.clip(change, -at_most, at_most)
        if np.abs(change).max(initial=0.0) < 1e-9:
            break
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
