"""The radar's electronics as data: front end, leakage, oscillator."""

from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from twin.files import InputError
from twin.toml import Finite, NonNegative, Positive, Sourced, Strict


class FrontEndDesign(Strict):
    """Power, noise figure, losses, mixer and converter."""

    transmit_power_w: Sourced[Positive]
    """At the antenna's port."""
    noise_figure_db: Sourced[Annotated[NonNegative, Field(le=100)]]
    """Of the receiver, over 290 K."""
    losses_db: Sourced[Annotated[NonNegative, Field(le=300)]]
    """Two-way, all told."""
    noise_counts: Sourced[Positive]
    """Root mean square of one averaged sample's noise, in counts of 16 bits: the gain. Full scale
    is +/- 2^15 counts.
    """
    adc_bits: Sourced[Annotated[int, Field(strict=True, ge=1, le=16)]] | None = None
    """Of the converter, whose full scale is the record's. It takes every repeat by itself, noise
    included, before they are averaged. Default: nothing but the record's own 16 bits.
    """
    iq_gain_db: Sourced[Annotated[Finite, Field(ge=-20, le=20)]] | None = None
    """Gain of the receiver's quadrature branch over the in-phase one. Default: 0."""
    iq_phase_deg: Sourced[Annotated[Finite, Field(gt=-90, lt=90)]] | None = None
    """Phase of the receiver's quadrature branch against the in-phase one, beyond 90 deg. Default:
    0.
    """


class Leakage(Strict):
    """What goes straight from transmitter to receiver, the same for every pair of antennas."""

    level_db: Sourced[Annotated[Finite, Field(ge=-300, le=0)]]
    """Received over sent power, at the ports."""
    delay_s: Sourced[Annotated[NonNegative, Field(le=1.0)]]
    """From transmitter to receiver; less than the unambiguous delay."""


class Oscillator(Strict):
    """Phase noise of the carrier: single sideband over offset."""

    offset_hz: Sourced[Annotated[tuple[Positive, ...], Field(min_length=1)]]
    """Offsets from the carrier, ascending."""
    phase_noise_dbc_per_hz: Sourced[tuple[Annotated[Finite, Field(ge=-400, le=0)], ...]]
    """Single-sideband noise at each offset; straight between points where both are logarithms,
    constant beyond the first and the last.
    """
    shared: Sourced[bool]
    """One oscillator mixes up and down: what has not changed within an echo's delay cancels.
    Otherwise each way has its own, of the same kind.
    """

    @model_validator(mode="after")
    def _is_a_curve(self) -> "Oscillator":
        offsets, levels = self.offset_hz.value, self.phase_noise_dbc_per_hz.value
        if len(offsets) != len(levels):
            raise InputError(
                f"offset_hz has {len(offsets)} points, phase_noise_dbc_per_hz {len(levels)}"
            )
        if any(a >= b for a, b in pairwise(offsets)):
            raise InputError("offset_hz does not ascend")
        return self

    def level(self, offset_hz: np.ndarray) -> np.ndarray:
        """Single-sideband noise at offsets, 1/Hz (not dB)."""
        offsets, decibel = self.offset_hz.value, self.phase_noise_dbc_per_hz.value
        return np.asarray(10 ** (np.interp(np.log(offset_hz), np.log(offsets), decibel) / 10))
