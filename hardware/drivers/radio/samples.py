"""Samples of the radio: transmit samples of a waveform, and counts of received samples.

A slot is a cyclic prefix, the repeats of one symbol, and silence up to its end.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import FULL_SCALE_COUNTS, Reception
from hardware.errors import InputError
from hardware.records.container import Flag
from hardware.waveform import OfdmWaveform

_GRID = 1e-6  # of a sample: tolerance of prefix and slot on the sampling grid


@dataclass(frozen=True)
class SlotGrid:
    """A slot in samples at the waveform's bandwidth."""

    prefix: int
    symbol: int
    repeats: int
    slot: int

    @staticmethod
    def of(waveform: OfdmWaveform) -> "SlotGrid":
        """Grid of a waveform. Raises InputError where prefix or slot are not on it."""
        prefix, slot = (
            _whole(name, getattr(waveform, name), waveform.bandwidth_hz)
            for name in ("prefix_s", "slot_period_s")
        )
        return SlotGrid(prefix, waveform.n_subcarriers, waveform.repeats, slot)

    @property
    def useful(self) -> slice:
        """The repeats within a slot."""
        return slice(self.prefix, self.prefix + self.repeats * self.symbol)


def symbol(waveform: OfdmWaveform, level: float) -> NDArray[np.complex64]:
    """One symbol in time, (n_subcarriers,).

    Parameters
    ----------
    waveform
        Has the symbols of its subcarriers.
    level
        Root mean square, of full scale.

    Raises InputError where it peaks above full scale.
    """
    wave = np.fft.ifft(np.fft.ifftshift(waveform.sent())) * np.sqrt(waveform.n_subcarriers)
    samples = (level * wave).astype(np.complex64)
    peak = float(np.abs(samples).max())
    if not 0 < peak <= 1 + 1e-6:
        raise InputError(f"level: {level:g} makes the symbol peak at {peak:g} of full scale")
    return samples


def highest_level(waveform: OfdmWaveform) -> float:
    """Highest power of two up to 1/2 at which no sample clips: it scales without rounding."""
    peak = float(np.abs(np.fft.ifft(waveform.sent())).max()) * np.sqrt(waveform.n_subcarriers)
    return float(2.0 ** -max(1, np.ceil(np.log2(peak) - 1e-9)))


def spectrum(symbols: NDArray[np.complex64], level: float) -> NDArray[np.complex128]:
    """Subcarriers (..., n_subcarriers) of symbols in time, as in `OfdmWaveform.sent`."""
    n = symbols.shape[-1]
    subcarriers = np.fft.fft(symbols.astype(np.complex128), axis=-1) / (level * np.sqrt(n))
    return np.asarray(np.fft.fftshift(subcarriers, axes=-1))


def burst(waveform: OfdmWaveform, level: float) -> NDArray[np.complex64]:
    """All slots of one burst, (n_slots x samples of a slot,)."""
    grid = SlotGrid.of(waveform)
    one = np.zeros(grid.slot, dtype=np.complex64)
    # The prefix continues the repeats backwards, over as many symbols as it is long.
    places = np.arange(-grid.prefix, grid.repeats * grid.symbol) % grid.symbol
    one[: len(places)] = symbol(waveform, level)[places]
    return np.tile(one, waveform.n_slots)


def counts(
    reception: Reception, waveform: OfdmWaveform
) -> tuple[NDArray[np.int16], NDArray[np.uint8]]:
    """IQ (n_slots, n_receivers, n_subcarriers, 2) and flags (n_slots,) of one burst.

    The prefix is removed, the repeats are averaged. A slot with a missing sample is zero and
    flagged as overrun.
    """
    grid = SlotGrid.of(waveform)
    n_receivers = len(reception.samples)
    slots = reception.samples.reshape(n_receivers, waveform.n_slots, grid.slot)[..., grid.useful]
    mean = (
        slots.reshape(n_receivers, waveform.n_slots, grid.repeats, grid.symbol)
        .astype(np.complex128)
        .mean(axis=2)
    )
    exact = np.stack([mean.real, mean.imag], axis=-1) * FULL_SCALE_COUNTS
    # Two's complement reaches one further down than up.
    iq = np.clip(np.rint(exact), -FULL_SCALE_COUNTS - 1, FULL_SCALE_COUNTS).astype(np.int16)
    iq = np.ascontiguousarray(iq.transpose(1, 0, 2, 3))

    rail = np.maximum(np.abs(slots.real), np.abs(slots.imag)) * FULL_SCALE_COUNTS
    flags = np.zeros(waveform.n_slots, dtype=np.uint8)
    flags[(rail > FULL_SCALE_COUNTS - 0.5).any(axis=(0, 2))] = Flag.SATURATED
    missing = ~reception.there.reshape(waveform.n_slots, grid.slot)[:, grid.useful]
    if reception.faults and reception.there.all():
        missing[:] = True  # a fault without a position
    lost = missing.any(axis=1)
    iq[lost], flags[lost] = 0, Flag.OVERRUN
    return iq, flags


def _whole(name: str, duration_s: float, rate_hz: float) -> int:
    samples = duration_s * rate_hz
    if abs(samples - round(samples)) > _GRID * max(samples, 1):
        raise InputError(f"{name}: {duration_s:g} s is no whole number of samples ({samples:.6g})")
    return round(samples)
