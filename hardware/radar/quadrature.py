"""Faults of a receiver's two branches, estimated from the received signal and compensated.

After division by the sent symbols, echoes occupy the delays up to the farthest one. What the
branches add is spread over all delays, and is told at those with the weakest echoes.

A mixer whose branches differ in gain or phase adds an image to every signal x: the record is
x + b conj(x), up to a common factor (Valkama, Renfors, Koivunen, IEEE Trans. Signal Processing 49,
2001). There, b is the regression of the record on its conjugate.

An offset of the converters is on the middle subcarrier alone, and so the same at all delays: it is
the mean over the quiet ones. It is its own image but for a factor, and counts for no image.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.demodulation import Complex
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform

#: By receiver, step and delay, (n_receivers, n_steps, n_delays).
ByDelay = NDArray[np.complex128]

_CERTAIN = 6.0  # standard errors above which an image or an offset is significant
_FEWEST = 8  # subcarriers, with which anything is told
_DEPENDENT = 0.9  # amplitude of an image, from which on the branches tell no two things


def without_faults(steps: Sequence[Complex], waveform: OfdmWaveform) -> list[Complex]:
    """Samples (n_slots, n_receivers, n_subcarriers) of every carrier step without the offset of
    each receiver and its images, where these are significant.

    Raises InputError for a receiver whose I and Q depend on each other, or whose samples are all
    the same and not 0.
    """
    if waveform.n_subcarriers < _FEWEST:
        return list(steps)
    _check_changing(steps)
    direct, image = at_quiet_delays(steps, waveform)
    offset, ratios = _offsets(direct, waveform), image_ratios(direct, image)
    if (worst := float(np.abs(ratios).max())) > _DEPENDENT:
        raise InputError(
            f"receiver {int(np.abs(ratios).argmax())}: the image is {worst:.3g} times the signal, "
            "expected far less: I and Q depend on each other, as where a branch is dead"
        )
    if offset.any():
        shifts = offset.T[..., None].astype(steps[0].dtype)
        steps = [step - shift for step, shift in zip(steps, shifts, strict=True)]
    if not ratios.any():
        return list(steps)
    b = ratios.astype(steps[0].dtype)[:, None]
    return [np.asarray((step - b * step.conj()) / (1 - np.abs(b) ** 2)) for step in steps]


def _check_changing(steps: Sequence[Complex]) -> None:
    first = steps[0][0, :, 0]
    for receiver in np.flatnonzero(first == steps[0][0, :, 1]).tolist():
        value = first[receiver]
        if value and all((step[:, receiver] == value).all() for step in steps):
            raise InputError(
                f"receiver {receiver}: all samples are the same, expected a signal: the converter "
                "is stuck, or at its rail"
            )


def _offsets(direct: ByDelay, waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """Of each receiver in each step, (n_receivers, n_steps); 0 where it is not significant."""
    mean = direct.mean(axis=-1)
    rest = np.mean(np.abs(direct - mean[..., None]) ** 2, axis=-1) / direct.shape[-1]
    is_certain = np.abs(mean) ** 2 > _CERTAIN**2 * rest
    return np.where(is_certain, mean / _sent_back(waveform)[0], 0)


def image_ratios(direct: ByDelay, image: ByDelay) -> NDArray[np.complex128]:
    """Amplitude of the image over the conjugate of the signal, (n_receivers,), in all steps
    together, given both as of `at_quiet_delays`; 0 where it is not significant.
    """
    direct, image = (
        (part - part.mean(axis=-1, keepdims=True)).reshape(len(part), -1)
        for part in (direct, image)
    )
    power = np.maximum(np.sum(np.abs(image) ** 2, axis=1), 1e-300)
    b = np.sum(image.conj() * direct, axis=1) / power
    rest = np.mean(np.abs(direct - b[:, None] * image) ** 2, axis=1)
    return np.asarray(np.where(np.abs(b) ** 2 > _CERTAIN**2 * rest / power, b, 0))


def at_quiet_delays(steps: Sequence[Complex], waveform: OfdmWaveform) -> tuple[ByDelay, ByDelay]:
    """The mean over slots and its conjugate at the half of all delays with less energy over all
    steps and receivers: of static echoes.
    """
    still = np.stack([step.mean(axis=0) for step in steps], axis=1).astype(np.complex128)
    sent_back = _sent_back(waveform)
    direct, image = (
        np.fft.ifft(np.fft.fft(samples) * sent_back) for samples in (still, still.conj())
    )
    energy = np.sum(np.abs(direct) ** 2, axis=(0, 1))
    quiet = energy <= np.median(energy)
    return direct[..., quiet], image[..., quiet]


def _sent_back(waveform: OfdmWaveform) -> NDArray[np.complex128]:
    """What undoes the sent symbols, by subcarrier, the middle one first; with a window, which keeps
    the side lobes of echoes out of quiet delays.
    """
    window = normalised_window("blackmanharris", waveform.n_subcarriers)
    return np.asarray(np.fft.ifftshift(waveform.sent().conj() * window))
