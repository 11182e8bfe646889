"""Distance from gates: which beginning of an echo explains what all gates took of it.

A rectangular pulse that comes back after t fills the share R(t) of a gate: the overlap of
[t, t + pulse] with [delay, delay + width], over the pulse's length. One surface of amplitude A in
a cell gives A R_k(t) in gate k, whether gates overlap, join or leave gaps. Least squares over A,
and over a constant in all gates where there is one, leaves a likelihood of t alone; its mean is the
distance, its width the error. For two gates side by side that is the range from their ratio
(Laurenzis, Christnacher and Monnin, Optics Letters 32, 2007).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.depth import contradiction

Array = NDArray[np.float64]

_PER_SEGMENT = 16  # points of the first search between two corners of the gates' responses
_POINTS = 65  # of each closer look
_LOOKS = 5  # each narrows the range at least 20 times, where the data do
_AT_ONCE = 2**22  # points of all cells in memory
#: Relative error that images are taken to have at least: that of a pulse's and a gate's own shape.
_LEAST = 1e-6
#: Share of an echo that gates may differ by from a rectangular pulse's without contradicting it.
_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Echo:
    """The echo of each cell, (n_cells,): its amplitude, as a gate takes it that holds all of the
    pulse, its beginning and the standard error of that, s, and the probability that it is there.
    """

    amplitude: Array
    delay_s: Array
    error_s: Array
    confidence: Array


def share(delay_s: Array, gate_delay_s: float, gate_width_s: float, pulse_width_s: float) -> Array:
    """Share of a pulse that comes back while a gate is open, for beginnings of the echo."""
    first = np.maximum(delay_s, gate_delay_s)
    last = np.minimum(delay_s + pulse_width_s, gate_delay_s + gate_width_s)
    return np.maximum(last - first, 0) / pulse_width_s


def echo(
    images: Array, errors: Array, gates: Array, pulse_width_s: float, *, background: bool = False
) -> Echo:
    """The most likely echo of each cell.

    Parameters
    ----------
    images, errors : (n_gates, n_cells)
        What each gate took, with its standard error.
    gates : (n_gates, 2)
        Delay and width of each, s.
    pulse_width_s
        Of the light's rectangular pulse.
    background
        Whether each cell has a constant of its own in all of its gates, which is fitted along.

    The mean and the standard deviation are those of the posterior within reach of the gate that
    holds most of the likeliest echo, all beginnings alike before; what is left of one gate alone is
    its whole reach. Where the gates contradict each other (two surfaces in a cell, a pulse that is
    no rectangle, air that sends light back), errors grow by the root of chi^2 over its degrees of
    freedom. ``confidence`` is the posterior probability of that reach, "no echo at all" being as
    probable before as all beginnings together; where gates differ from one echo by more than 2 % of
    it, it falls with the probability of that by chance. Two surfaces that the same two gates hold,
    or a slope, contradict nothing: their mean is told, with the error and the confidence of one.
    """
    errors = np.maximum(errors, _LEAST * np.abs(images).max(initial=0.0) or 1.0)
    if background:
        images = images - _mean(images, errors)
    place, step = _search(gates, pulse_width_s)
    n_blocks = -(-images.shape[1] * len(place) // _AT_ONCE)
    blocks = [
        _echo(*block, gates, pulse_width_s, place, step, background)
        for block in zip(
            np.array_split(images, n_blocks, axis=1),
            np.array_split(errors, n_blocks, axis=1),
            strict=True,
        )
    ]
    return Echo(*np.hstack([np.stack(block) for block in blocks]))


def _echo(
    images: Array,
    errors: Array,
    gates: Array,
    pulse_width_s: float,
    place: Array,
    step: Array,
    background: bool,
) -> tuple[Array, Array, Array, Array]:
    """The fields of `Echo` for some of the cells; of ``images`` a background is taken out."""
    own, freedom = errors, len(gates) - 2 - background
    responses = np.stack([share(place, d, g, pulse_width_s) for d, g in gates])
    gain = _gain(responses, images, errors, background)
    nearest = gates[responses[:, gain.argmax(axis=1)].argmax(axis=0)]
    low, high = np.maximum(nearest[:, 0] - pulse_width_s, 0), nearest.sum(axis=1)
    if freedom > 0:
        *_, best = _closer(images, errors, gates, pulse_width_s, low, high, background)
        chi2 = ((images / errors) ** 2).sum(axis=0) - 2 * best
        scale = np.sqrt(np.maximum(chi2 / freedom, 1))
        gain, errors = gain / scale[:, None] ** 2, errors * scale
    weight = np.exp(gain - gain.max(axis=1, keepdims=True)) * step
    within = (place > low[:, None]) & (place < high[:, None])
    none = np.exp(-gain.max(axis=1)) * step.sum()
    confidence = (weight * within).sum(axis=1) / (weight.sum(axis=1) + none)
    mean, spread, _ = _closer(images, errors, gates, pulse_width_s, low, high, background)
    there = np.stack([share(mean, d, g, pulse_width_s) for d, g in gates])
    if background:
        there = there - _mean(there, errors)
    wanted = (there * images / errors**2).sum(axis=0)
    amplitude = np.divide(
        wanted, ((there / errors) ** 2).sum(axis=0), out=np.zeros_like(mean), where=wanted > 0
    )
    loose = np.hypot(own, _TOLERANCE * amplitude)
    chi2 = (((images - amplitude * there) / loose) ** 2).sum(axis=0)
    _, doubt = contradiction(chi2, freedom)
    return amplitude, mean, spread, confidence * doubt


def _search(gates: Array, pulse_width_s: float) -> tuple[Array, Array]:
    """Beginnings that some gate would notice, and the length that each stands for."""
    delay, end = gates[:, 0], gates.sum(axis=1)
    corners = np.concatenate([delay, end, delay - pulse_width_s, end - pulse_width_s, [0.0]])
    corners = np.unique(np.maximum(corners, 0))
    step = np.repeat(np.diff(corners) / _PER_SEGMENT, _PER_SEGMENT)
    place = corners[0] + np.cumsum(step) - step / 2
    noticed = ((place[:, None] > delay - pulse_width_s) & (place[:, None] < end)).any(axis=1)
    return place[noticed], step[noticed]


def _mean(values: Array, errors: Array) -> Array:
    """Weighted mean of the gates, by cell."""
    weight = 1 / errors**2
    return np.asarray((weight * values).sum(axis=0) / weight.sum(axis=0))


def _gain(responses: Array, images: Array, errors: Array, background: bool) -> Array:
    """Log-likelihood over that of no echo, the amplitude being the best one that is not negative:
    (n_cells, n) for responses (n_gates, n).
    """
    wanted = (images / errors**2).T @ responses
    power = (1 / errors**2).T @ responses**2
    if background:  # what of a response is no constant
        power -= ((1 / errors**2).T @ responses) ** 2 / (1 / errors**2).sum(axis=0)[:, None]
    return np.maximum(wanted, 0) ** 2 / np.maximum(power, np.finfo(float).tiny) / 2


def _closer(
    images: Array,
    errors: Array,
    gates: Array,
    pulse_width_s: float,
    low: Array,
    high: Array,
    background: bool,
) -> tuple[Array, Array, Array]:
    """Mean and standard deviation of the posterior from ``low`` to ``high``, looked at ever closer
    where it is narrow; and the log-likelihood of the best beginning over that of no echo.
    """
    middle = (np.arange(_POINTS) + 0.5) / _POINTS
    best = np.zeros_like(low)
    for _ in range(_LOOKS):
        place = low[:, None] + (high - low)[:, None] * middle
        wanted, power = np.zeros_like(place), np.full_like(place, np.finfo(float).tiny)
        shared = np.zeros_like(place)
        for image, error, (delay, width) in zip(images, errors, gates, strict=True):
            response = share(place, delay, width, pulse_width_s)
            wanted += (image / error**2)[:, None] * response
            power += (response / error[:, None]) ** 2
            shared += response / error[:, None] ** 2
        if background:
            power -= shared**2 / (1 / errors**2).sum(axis=0)[:, None]
            power = np.maximum(power, np.finfo(float).tiny)
        gain = np.maximum(wanted, 0) ** 2 / power / 2
        best = np.maximum(best, gain.max(axis=1))
        weight = np.exp(gain - gain.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        mean = (weight * place).sum(axis=1)
        variance = (weight * (place - mean[:, None]) ** 2).sum(axis=1)
        # Between two points lies a part of the range that is as wide as their distance.
        spread = np.sqrt(variance + ((high - low) / _POINTS) ** 2 / 12)
        low, high = np.maximum(low, mean - 5 * spread), np.minimum(high, mean + 5 * spread)
    return mean, spread, best


def delay_weights(echoes: Echo, errors: Array, gates: Array, pulse_width_s: float) -> Array:
    """Weights of the gates' images, (n_gates, n_cells), in the delay by least squares over
    amplitude and delay, to a factor that is common to a cell's; 0 where no gate that holds part of
    the echo has a slope.
    """
    here, slope = _responses(echoes.delay_s, gates, pulse_width_s)
    weight = 1 / np.maximum(errors, _LEAST * errors.max(initial=0.0) or 1.0) ** 2
    own, both = (weight * here**2).sum(axis=0), (weight * here * slope).sum(axis=0)
    steady = np.divide(both, own, out=np.zeros_like(own), where=own > 0)  # amplitude's part
    moves = weight * (slope - here * steady)
    largest = np.abs(moves).max(axis=0)
    return np.divide(moves, largest, out=np.zeros_like(moves), where=largest > 0)


def _responses(delay_s: Array, gates: Array, pulse_width_s: float) -> tuple[Array, Array]:
    """Shares of the gates, and their slopes, 1/s, for beginnings of the echo."""
    step = 1e-4 * pulse_width_s
    late, early, here = (
        np.stack([share(delay_s + shift, d, g, pulse_width_s) for d, g in gates])
        for shift in (step, -step, 0.0)
    )
    return here, (late - early) / (2 * step)


def bounds(
    amplitude: Array,
    delay_s: Array,
    variance: Array,
    gates: Array,
    pulse_width_s: float,
    *,
    background: bool = False,
) -> tuple[Array, Array]:
    """Cramer-Rao bounds of an echo's amplitude and of its beginning, s, both (n_cells,): what no
    unbiased estimate falls below whose noise is normal, of variance (n_gates, n_cells).

    With W the inverse variances and R, R' the gates' responses and their slopes, less their
    weighted means where there is a background: 1 / var A = R W R - (R W R')^2 / (R' W R'), and the
    same with R and A R' exchanged (Kay, Fundamentals of Statistical Signal Processing I, 1993,
    section 3.7). Where no response has a slope the delay's bound is infinite.
    """
    here, slope = _responses(delay_s, gates, pulse_width_s)
    weight = 1 / variance
    if background:
        errors = np.sqrt(variance)
        here, slope = here - _mean(here, errors), slope - _mean(slope, errors)
    tiny = np.finfo(float).tiny
    both, own = (weight * here * slope).sum(axis=0), (weight * here**2).sum(axis=0)
    steep = np.maximum((weight * slope**2).sum(axis=0), tiny)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_amplitude = 1 / np.sqrt(np.maximum(own - both**2 / steep, 0))
        of_delay = 1 / np.sqrt(np.maximum(steep - both**2 / own, 0)) / amplitude
    return of_amplitude, of_delay
