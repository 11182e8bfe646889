"""Faults of a receiver's two branches, estimated from the received signal and compensated.

After division by the sent symbols, echoes occupy the delays up to the farthest one. What the
branches add is spread over all delays, and is told at those with the weakest echoes.

A mixer whose branches differ in gain or phase adds an image to every signal x: the record is
x + b conj(x), up to a common factor (Valkama, Renfors, Koivunen, IEEE Trans. Signal Processing 49,
2001). An offset of the converters is on the middle subcarrier alone, and so the same at all delays.
The record is b times its own conjugate, plus the offset, plus what echoes and noise make of it, so
that both are found by one regression over delays. Delays count the less the more is left of them:
echoes are hardly in what is found, and the offset is what the middle subcarrier has beyond the
value that its neighbours make likely for echoes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.demodulation import Complex
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
#: By receiver, step and delay, (n_receivers, n_steps, n_delays).
ByDelay = NDArray[np.complex128]

_CERTAIN = 5.0  # standard errors above which an image or an offset is significant; of many delays
_SUSPECTED = 2.5  # and above which it is worth more than a first look
_FEWEST = 8  # subcarriers, with which anything is told
_DEPENDENT = 0.9  # amplitude of an image, from which on the branches tell no two things
_HALF = 0.5  # of `_alike`, from which on samples of such branches are dependent, and of others:
_NEARLY = 0.95  # honest echoes at rest reach 0.91 on 9 to 12 subcarriers, of symbols
_UNLIKE = 0.45  # whose echo has an image below this amplitude at any delay; 8 subcarriers have 0.5
_SOME = 2**16  # samples of a branch that are looked at
_ROUNDED = 1.0  # counts rms, below which the converters' rounding makes branches alike
_DRIFT = 2  # degree in time up to which an offset changes within a burst
_SPREAD = 4.0  # delays over which an image spreads, at least
_QUIET = 0.25  # quantile over delays that holds noise alone
_ROUNDS = 30  # of the regression, at most
_SETTLED = 1e-3  # change of the residue, relative to the noise, at which it ends


def without_faults(steps: Sequence[Complex], waveform: OfdmWaveform) -> list[Complex]:
    """Samples (n_slots, n_receivers, n_subcarriers) of every carrier step without the offset of
    each receiver and its images, where these are significant.

    Raises InputError for a receiver whose I and Q depend on each other, or whose samples are all
    the same and not 0.
    """
    if waveform.n_subcarriers < _FEWEST:
        return list(steps)
    _check_changing(steps)
    direct, image = by_delay(steps, waveform)
    spread = image_spreads(waveform)
    offsets, ratios = branch_faults(direct, image, spread)
    _check_independent(np.abs(ratios), steps, waveform)
    if (is_alike := np.abs(ratios) > _DEPENDENT).any():
        offsets, ratios = branch_faults(direct, image * ~is_alike[:, None, None], spread)
    if ratios.any():
        b = ratios.astype(steps[0].dtype)[:, None]
        steps = [np.asarray((step - b * step.conj()) / (1 - np.abs(b) ** 2)) for step in steps]
    if not offsets.any():
        return list(steps)
    shifts = (offsets / (1 - np.abs(ratios[:, None]) ** 2)).T[..., None] / _sent_back(waveform)[0]
    steps = [step - shift.astype(step.dtype) for step, shift in zip(steps, shifts, strict=True)]
    return _without_drift(steps, waveform)


def _check_changing(steps: Sequence[Complex]) -> None:
    first = steps[0][0, :, 0]
    for receiver in np.flatnonzero(first == steps[0][0, :, 1]).tolist():
        value = first[receiver]
        if value and all((step[:, receiver] == value).all() for step in steps):
            raise InputError(
                f"receiver {receiver}: all samples are the same, expected a signal: the converter "
                "is stuck, or at its rail"
            )


def _check_independent(size: Array, steps: Sequence[Complex], waveform: OfdmWaveform) -> None:
    """Raise InputError where I and Q are one signal, as their samples tell: nearly, or by half
    where an image of that ``size`` tells it as well.

    Quiet delays of few subcarriers look alike by chance, 1 in 300; honest echoes where the image of
    one is as strong as itself; branches that change by less than a count by rounding.
    """
    unlike = np.abs(_image_of_echo(waveform)).max() < _UNLIKE
    for receiver, image in enumerate(size.tolist()):
        least = _HALF if image > _DEPENDENT else _NEARLY if unlike else np.inf
        alike = max(_alike(step[:, receiver]) for step in steps)
        if alike > least:
            raise InputError(
                f"receiver {receiver}: I and Q depend on each other, as where a branch is dead: "
                f"{100 * alike:.0f} % of their power is one signal's, expected far less"
            )


def _alike(samples: Complex) -> float:
    """How far two branches (n_slots, n_samples) are one signal: 1 where one is the other's
    multiple, or dead; near 0 of echoes and noise, and of less than a count. Offsets of slots do not
    count.
    """
    some = samples[:: max(1, samples.size // _SOME)]
    changing = some - some.mean(axis=1, keepdims=True)
    power = np.mean(np.abs(changing) ** 2)
    return float(np.abs(np.mean(changing * changing)) / power) if power > _ROUNDED**2 else 0.0


def _without_drift(steps: Sequence[Complex], waveform: OfdmWaveform) -> list[Complex]:
    """Samples without what of an offset changes within a burst, where that is significant."""
    times = np.linspace(-1, 1, len(steps[0]))
    courses = np.linalg.qr(np.polynomial.legendre.legvander(times, min(_DRIFT, len(times) - 1)))[0]
    corrected = list(steps)
    for course in courses.T[1:].astype(steps[0].real.dtype):
        changes = [np.tensordot(course, step, 1) for step in corrected]
        direct = _delays(np.stack(changes, axis=1), waveform)
        offsets = branch_faults(direct, np.zeros_like(direct), False)[0].T / _sent_back(waveform)[0]
        if offsets.any():
            corrected = [
                step - np.multiply.outer(course, shift.astype(step.dtype))[..., None]
                for step, shift in zip(corrected, offsets, strict=True)
            ]
    return corrected


def branch_faults(
    direct: ByDelay, image: ByDelay, spread: bool
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Offset that is left of each receiver in each step (n_receivers, n_steps) after subtraction of
    the image, as it is at every delay, and the amplitude of the image over the conjugate of the
    signal (n_receivers,), in all steps together; 0 where they are not significant. Arguments as of
    `by_delay` and `image_spreads`.

    Where an image is at the delays of its echo, it must not explain the echo away: it counts in
    what is left at a delay only where it spreads.
    """
    explained = image if spread else np.zeros_like(image)
    for rounds, certain in ((1, _SUSPECTED), (_ROUNDS, _CERTAIN)):
        weight = _weights(direct, explained, rounds)
        offsets, ratios = _significant(direct, image, weight, certain)
        if not (offsets.any() or ratios.any()):
            break
    return offsets, ratios


def _significant(
    direct: ByDelay, image: ByDelay, weight: Array, certain: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """`_regression`, with 0 for what is below ``certain`` standard errors.

    Of few delays the noise is not well known, and weights favour delays that agree by chance: more
    standard errors are as certain then.
    """
    everywhere = np.ones(direct.shape[:2], dtype=bool)
    window = normalised_window("blackmanharris", direct.shape[-1])
    power = np.mean(window**2)
    # The window makes neighbouring delays alike, a signal and its conjugate two subcarriers.
    alike = 2 * np.mean(window**4) / power**2
    n, used = weight.sum(), weight.sum() ** 2 / np.sum(weight**2) / len(weight)
    independent = used * len(weight) / alike
    of_mean = (window.max() ** 2 / power + 1 / used - 1) / len(weight)

    offsets, ratios = _regression(direct, image, weight, everywhere, everywhere[:, 0])
    left = np.abs(direct - ratios[:, None, None] * image - offsets[..., None]) ** 2
    noise = np.quantile(left, _QUIET, axis=-1) / -np.log1p(-_QUIET)
    centred = np.abs(image - (image @ weight / n)[..., None]) ** 2
    error = np.sum(centred @ weight**2 * noise, axis=1) * alike
    least = _certain(certain, independent * direct.shape[1])
    has_image = np.abs(ratios) ** 2 * np.sum(centred @ weight, axis=1) ** 2 > least * error
    offsets, _ = _regression(direct, image, weight, everywhere, has_image)
    has_offset = np.abs(offsets) ** 2 > _certain(certain, independent / 2) * of_mean * noise
    return _regression(direct, image, weight, has_offset, has_image)


def _certain(errors: float, independent: float) -> float:
    """Square of the standard errors that are as unlikely in noise of so many independent values as
    ``errors`` are where the noise is known: of the F distribution, with two degrees of freedom over
    twice ``independent``. In simulated noise of 8 to 256 subcarriers 1 image in 1000 is as large as
    that says of 1 in 1000, and so are offsets with half as many.
    """
    return independent * float(np.expm1(min(errors**2 / independent, 600.0)))


def _weights(direct: ByDelay, image: ByDelay, rounds: int) -> Array:
    """Of every delay (n_delays,): the less, the more the regression leaves there beyond noise."""
    everywhere = np.ones(direct.shape[:2], dtype=bool)
    middle = np.median(direct.real, axis=-1) + 1j * np.median(direct.imag, axis=-1)
    left = direct - middle[..., None]
    weight = np.zeros(direct.shape[-1])
    for _ in range(rounds):
        energy = np.sum(np.abs(left) ** 2, axis=(0, 1))
        noise = max(2 * float(np.quantile(energy, _QUIET)), 1e-300)
        before, weight = weight, (noise / (energy + noise)) ** 2
        if np.abs(weight - before).max() < _SETTLED:
            break
        offsets, ratios = _regression(direct, image, weight, everywhere, everywhere[:, 0])
        left = direct - ratios[:, None, None] * image - offsets[..., None]
    return weight


def _regression(
    direct: ByDelay,
    image: ByDelay,
    weight: Array,
    has_offset: NDArray[np.bool_],
    has_image: NDArray[np.bool_],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Offsets (n_receivers, n_steps) and ratios (n_receivers,) by weighted least squares."""
    means = [np.where(has_offset, part @ weight / weight.sum(), 0) for part in (direct, image)]
    direct, image = direct - means[0][..., None], image - means[1][..., None]
    power = np.sum(np.abs(image) ** 2 @ weight, axis=1)
    ratios = np.sum((image.conj() * direct) @ weight, axis=1) / np.maximum(power, 1e-300)
    ratios = np.where(has_image, ratios, 0)
    return means[0] - ratios[:, None] * means[1], ratios


def image_spreads(waveform: OfdmWaveform) -> bool:
    """Whether the image of an echo spreads over many delays; of flat symbols, and of all that are
    real and symmetric, it is where the echo is.
    """
    power = np.abs(_image_of_echo(waveform)) ** 2
    return bool(_SPREAD * np.sum(power**2) < np.sum(power) ** 2)


def _image_of_echo(waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """Image of an echo over the echo, by delay from where it would be of flat symbols."""
    sent = np.fft.ifftshift(waveform.sent().conj())
    return np.asarray(np.fft.ifft(sent * np.roll(sent[::-1], 1)))


def by_delay(steps: Sequence[Complex], waveform: OfdmWaveform) -> tuple[ByDelay, ByDelay]:
    """The mean over slots and its conjugate at all delays: of static echoes."""
    still = np.stack([step.mean(axis=0) for step in steps], axis=1).astype(np.complex128)
    return _delays(still, waveform), _delays(still.conj(), waveform)


def _delays(samples: NDArray[np.complexfloating], waveform: OfdmWaveform) -> ByDelay:
    return np.asarray(np.fft.ifft(np.fft.fft(samples) * _sent_back(waveform)), np.complex128)


def _sent_back(waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """What undoes the sent symbols, by subcarrier, the middle one first; with a window, which keeps
    the side lobes of echoes out of quiet delays.
    """
    window = normalised_window("blackmanharris", waveform.n_subcarriers)
    return np.asarray(np.fft.ifftshift(waveform.sent().conj() * window))
