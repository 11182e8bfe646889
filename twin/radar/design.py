"""The radar under study, as data, and what contradicts itself in it."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator
from scipy import constants

from hardware.radar.waveform import C_M_PER_S, OfdmWaveform, Symbols
from twin.files import catalog_folder
from twin.toml import (
    Count,
    Entry,
    NonNegative,
    Positive,
    Sourced,
    Strict,
    bundled,
    load_entry,
)

_MOST_CELLS = 2**25  # of one interval: half a gigabyte in complex numbers
_REFERENCE_K = 290.0  # of noise figures, by definition


class Waveform(Strict):
    """See `OfdmWaveform`."""

    carrier_hz: Sourced[Annotated[Positive, Field(le=1e13)]]
    n_subcarriers: Sourced[Count]
    subcarrier_spacing_hz: Sourced[Positive]
    n_slots: Sourced[Count]
    slot_period_s: Sourced[Annotated[Positive, Field(ge=1e-9, le=1e3)]]
    repeats: Sourced[Count]
    prefix_s: Sourced[NonNegative]
    symbols: Sourced[Symbols]


class FrontEnd(Strict):
    """Power, noise figure, losses (two-way, all told), and the converter's gain.

    ``noise_counts``: root mean square of one averaged sample's noise, in counts of 16 bits.
    """

    transmit_power_w: Sourced[Positive]
    noise_figure_db: Sourced[Annotated[NonNegative, Field(le=100)]]
    losses_db: Sourced[Annotated[NonNegative, Field(le=300)]]
    noise_counts: Sourced[Positive]


class Antenna(Strict):
    """One pattern for transmitting and receiving: G0 cos^q, zero behind, G0 = 2 (q + 1)."""

    gain_dbi: Sourced[Annotated[Positive, Field(ge=3.0103, le=60)]]

    def gain(self, cos_boresight: np.ndarray) -> np.ndarray:
        """Power gain at the cosine of the angle to the boresight; integrates to 4 pi."""
        peak = 10 ** (self.gain_dbi.value / 10)
        return peak * np.maximum(cos_boresight, 0.0) ** (peak / 2 - 1)


class Band(Strict):
    """Where the radar may transmit."""

    low_hz: Sourced[Positive]
    high_hz: Sourced[Positive]

    @model_validator(mode="after")
    def _ascends(self) -> "Band":
        if self.low_hz.value >= self.high_hz.value:
            raise ValueError("low_hz is not below high_hz")
        return self


class RadarDesign(Entry):
    """One radar with one transmit and one receive antenna at the same place."""

    waveform: Waveform
    front_end: FrontEnd
    antenna: Antenna
    band: Band

    @model_validator(mode="after")
    def _waveform_is_possible(self) -> "RadarDesign":
        cells = self.ofdm.n_subcarriers * self.ofdm.n_slots
        if cells > _MOST_CELLS:
            raise ValueError(
                f"waveform: n_subcarriers x n_slots = {cells}, expected at most {_MOST_CELLS}"
            )
        return self

    @property
    def ofdm(self) -> OfdmWaveform:
        """The waveform that is sent."""
        fields = {name: getattr(self.waveform, name).value for name in Waveform.model_fields}
        return OfdmWaveform(**fields)

    @property
    def sample_noise_w(self) -> float:
        """Thermal noise of one averaged sample: k T0 F B / repeats."""
        factor = 10 ** (self.front_end.noise_figure_db.value / 10)
        power = constants.k * _REFERENCE_K * factor * self.ofdm.bandwidth_hz
        return float(power / self.ofdm.repeats)

    def received_power_w(self, range_m: float, rcs_m2: float, cos_boresight: float = 1.0) -> float:
        """Radar equation in free space: Pt G^2 lambda^2 sigma / ((4 pi)^3 R^4) less the losses."""
        gain = float(self.antenna.gain(np.array(cos_boresight)))
        loss = 10 ** (self.front_end.losses_db.value / 10)
        spread = (4 * math.pi) ** 3 * range_m**4 * loss
        power = self.front_end.transmit_power_w.value
        return power * gain**2 * self.ofdm.wavelength_m**2 * rcs_m2 / spread

    def image_snr(self, received_w: float) -> float:
        """SNR of a lone target after all processing, rectangular window."""
        cells = self.ofdm.n_subcarriers * self.ofdm.n_slots
        return received_w * cells / self.sample_noise_w

    def warnings(self, farthest_m: float = 0.0, fastest_m_per_s: float = 0.0) -> list[str]:
        """Contradictions, each with its figures.

        Parameters
        ----------
        farthest_m, fastest_m_per_s
            What the scene holds.
        """
        wave, found = self.ofdm, []
        low, high = (wave.carrier_hz + s * wave.bandwidth_hz / 2 for s in (-1, 1))
        if low < self.band.low_hz.value or high > self.band.high_hz.value:
            found.append(
                f"band: {low / 1e9:.2f}-{high / 1e9:.2f} GHz leaves "
                f"{self.band.low_hz.value / 1e9:g}-{self.band.high_hz.value / 1e9:g} GHz"
            )
        if farthest_m > wave.max_range_m:
            found.append(
                f"range: {farthest_m:.1f} m is beyond the unambiguous {wave.max_range_m:.1f} m "
                f"and appears at {farthest_m % wave.max_range_m:.1f} m"
            )
        protected = C_M_PER_S * wave.prefix_s / 2
        reach = min(farthest_m, wave.max_range_m) if farthest_m else wave.max_range_m
        if protected < reach * (1 - 1e-9) - wave.range_cell_m:
            found.append(
                f"prefix: {wave.prefix_s * 1e6:.3g} us protects {protected:.1f} m of {reach:.1f} m"
            )
        if fastest_m_per_s > wave.max_velocity_m_per_s:
            found.append(
                f"velocity: {fastest_m_per_s:.2f} m/s is beyond the unambiguous "
                f"+/- {wave.max_velocity_m_per_s:.2f} m/s"
            )
        edge = 20 * math.log10(abs(float(wave.slot_gain(np.array(0.5 / wave.slot_period_s)))))
        speed = min(fastest_m_per_s, wave.max_velocity_m_per_s)
        doppler = 2 * speed / wave.wavelength_m
        loss = 20 * math.log10(abs(float(wave.slot_gain(np.array(doppler)))))
        if loss < -1:
            found.append(
                f"slot: averaging {wave.repeats} repeats loses {-loss:.1f} dB at "
                f"{speed:.1f} m/s ({-edge:.1f} dB at the edge)"
            )
        return found


def load_radar(name: "str | Path | RadarDesign") -> RadarDesign:
    """A bundled radar by name, or a user's own TOML file; a design is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(RadarDesign, name, "radar", catalog_folder() / "radars")


def radar_names() -> list[str]:
    """Names of the bundled radars."""
    return bundled(catalog_folder() / "radars")
