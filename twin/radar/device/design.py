"""The radar under study, as data, and what contradicts itself in it."""

import math
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator
from scipy import constants

from hardware.records import RadarFrontEnd
from hardware.symbols import OwnSymbols, own_symbols
from hardware.waveform import C_M_PER_S, OfdmWaveform, Symbols
from twin.files import InputError, catalog_folder
from twin.own_parts import OwnCode, own_part
from twin.radar.device.antenna import Antenna
from twin.radar.device.burst import Burst
from twin.toml import (
    Count,
    Entry,
    Finite,
    NonNegative,
    Positive,
    Sourced,
    Strict,
    bundled,
    load_entry,
)
from twin.warned import CaptureWarning

_SYMBOLS = ("symbols", "symbols_file", "function")  # fields of which one says what is sent
_MOST_CELLS = 2**25  # of one burst: half a gigabyte in complex numbers
_MOST_SYMBOLS = 2**24  # of one step, over which the oscillator wanders
_REFERENCE_K = 290.0  # of noise figures, by definition
_SMEARED_DB = 10.0  # that an echo loses by moving through range cells, from which it is told
_MOST_FED = 1.05  # gain of a pattern over the sphere, integrated, from which it is warned of

Place = tuple[Finite, Finite, Finite]
Places = Annotated[tuple[Place, ...], Field(min_length=1, max_length=256)]


class Waveform(Strict):
    """See `OfdmWaveform`. Of a radar that steps its carrier, this is the first step's.

    In place of ``symbols``, a user's own: ``symbols_file`` or ``function``.

    >>> def random_phases(waveform):
    ...     rng = np.random.default_rng(0)
    ...     return np.exp(2j * np.pi * rng.random(waveform.n_subcarriers.value))
    >>> radar = load_radar("hybrid-79").with_({"waveform.function": random_phases})
    >>> radar.ofdm.symbols, radar.ofdm.sent().shape
    ('own', (4096,))
    """

    alternatives: ClassVar = (("symbols",), ("symbols_file",), ("function",))

    carrier_hz: Sourced[Annotated[Positive, Field(le=1e13)]]
    """Middle of the band; of a radar that steps its carrier, in the first step."""
    n_subcarriers: Sourced[Count]
    """N: subcarrier n lies at carrier + (n - N // 2) spacing."""
    subcarrier_spacing_hz: Sourced[Positive]
    """df: range resolution c / (2 N df), unambiguous range c / (2 df)."""
    n_slots: Sourced[Count]
    """M: slots that are processed together."""
    slot_period_s: Sourced[Annotated[Positive, Field(ge=1e-9, le=1e3)]]
    """T: velocity resolution lambda / (2 M T), unambiguous to +/- lambda / (4 T)."""
    repeats: Sourced[Count]
    """Symbols per slot that the receiver averages coherently."""
    prefix_s: Sourced[NonNegative]
    """Cyclic prefix before the first of them; echoes from beyond c prefix / 2 fall out of step."""
    symbols: Sourced[Symbols] | None = None
    """`zadoff-chu`: constant modulus, flat envelope; `flat`: all ones, an impulse in time."""
    symbols_file: Sourced[str] | None = None
    """File of a user's own symbols, an array (n_subcarriers,) of complex numbers of modulus 1 as
    `.npy`.
    """
    function: Sourced[OwnCode] | None = None
    """What gives such an array for this section: `file.py:function`, the name of an entry point of
    the group `twin.waveform`, or in Python itself.
    """

    @model_validator(mode="after")
    def _says_its_symbols(self) -> "Waveform":
        if [self.symbols, self.symbols_file, self.function].count(None) != 2:
            raise InputError("needs one of symbols, symbols_file and function")
        return self

    @cached_property
    def sent(self) -> Symbols | OwnSymbols:
        """Name of the symbols, or a user's own. Raises InputError."""
        if self.symbols_file is not None:
            try:
                return own_symbols(self.symbols_file.value)
            except (InputError, FileNotFoundError) as error:
                raise InputError(f"waveform.symbols_file: {error}") from error
        if self.function is None:
            assert self.symbols is not None
            return self.symbols.value
        own = own_part("waveform.function", self.function.value, "waveform")
        try:
            return own_symbols(own(self))
        except InputError as error:
            raise InputError(f"waveform.function: {own.name}: {error}") from error


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
    """From transmitter to receiver."""


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


class Steps(Strict):
    """A carrier that steps upwards from the waveform's."""

    count: Sourced[Annotated[int, Field(strict=True, ge=1, le=4096)]]
    """Carriers, one after another."""
    spacing_hz: Sourced[Positive]
    """From one carrier to the next."""
    settling_s: Sourced[Annotated[NonNegative, Field(le=1e3)]]
    """From the end of one step's slots to the next one's."""
    random_phase: Sourced[bool]
    """Whether the carrier comes back from each retune with a phase of its own."""
    timing_rms_s: Sourced[Annotated[NonNegative, Field(le=1.0)]]
    """Of the delay between sending and sampling, drawn anew at each step."""


class Elements(Strict):
    """Phase centres of the antennas: x ahead, y left, z up; transmitters take turns by slot."""

    transmitters_m: Sourced[Places]
    """Phase centres x, y, z of the transmitters, which take turns by slot."""
    receivers_m: Sourced[Places]
    """Phase centres x, y, z of the receivers."""


class Band(Strict):
    """Where the radar may transmit."""

    low_hz: Sourced[Positive]
    """Lowest frequency that may be sent; below it there is a warning."""
    high_hz: Sourced[Positive]
    """Highest frequency that may be sent; above it there is a warning."""

    @model_validator(mode="after")
    def _ascends(self) -> "Band":
        if self.low_hz.value >= self.high_hz.value:
            raise InputError("low_hz is not below high_hz")
        return self


class RadarDesign(Entry):
    """One radar; without `elements` it has one transmitter and one receiver at the same place."""

    waveform: Waveform
    """The OFDM waveform."""
    front_end: FrontEndDesign
    """Power, noise, losses, converter."""
    antenna: Antenna
    """One pattern for transmitting and receiving."""
    band: Band
    """Where the radar may transmit."""
    elements: Elements | None = None
    """Places of the antennas. Default: one transmitter and one receiver at the same place."""
    steps: Steps | None = None
    """A carrier that steps upwards. Default: one carrier."""
    leakage: Leakage | None = None
    """What goes straight from transmitter to receiver. Default: nothing."""
    oscillator: Oscillator | None = None
    """Phase noise of the carrier. Default: none."""

    @model_validator(mode="after")
    def _waveform_is_possible(self) -> "RadarDesign":
        wave, burst = self.ofdm, self.burst
        steps, receivers = len(burst.carriers_hz), len(burst.receivers_m)
        cells = wave.n_subcarriers * wave.n_slots * steps * receivers
        if cells > _MOST_CELLS:
            raise InputError(
                "waveform: n_subcarriers x n_slots"
                + (f" x {steps} steps" if steps > 1 else "")
                + (f" x {receivers} receivers" if receivers > 1 else "")
                + f" = {cells}, expected at most {_MOST_CELLS}"
            )
        if len(burst.transmitters_m) > wave.n_slots:
            raise InputError(
                f"elements.transmitters_m: {len(burst.transmitters_m)} take turns in "
                f"{wave.n_slots} slots"
            )
        symbols = wave.n_slots * wave.slot_period_s / wave.symbol_s
        if self.oscillator and symbols > _MOST_SYMBOLS:
            raise InputError(
                f"oscillator: {symbols:.3g} symbols in a step, expected at most {_MOST_SYMBOLS}"
            )
        return self

    @property
    def ofdm(self) -> OfdmWaveform:
        """The waveform that is sent; the first step's."""
        names = [name for name in Waveform.model_fields if name not in _SYMBOLS]
        fields = {name: getattr(self.waveform, name).value for name in names}
        return OfdmWaveform(**fields, symbols=self.waveform.sent)

    @property
    def burst(self) -> Burst:
        """Steps, transmitters and receivers."""
        wave, count, spacing, pause = self.ofdm, 1, 0.0, 0.0
        if self.steps:
            count, spacing = self.steps.count.value, self.steps.spacing_hz.value
            pause = self.steps.settling_s.value
        number = np.arange(count, dtype=np.float64)
        period = wave.n_slots * wave.slot_period_s + pause
        one = ((0.0, 0.0, 0.0),)
        return Burst(
            waveform=wave,
            carriers_hz=wave.carrier_hz + spacing * number,
            step_times_s=period * (number - (count - 1) / 2),
            transmitters_m=np.array(self.elements.transmitters_m.value if self.elements else one),
            receivers_m=np.array(self.elements.receivers_m.value if self.elements else one),
        )

    def recorded_front_end(self, root_watt_per_count: float) -> RadarFrontEnd:
        """What a record says of the front end, its counts scaled so."""
        burst = self.burst
        return RadarFrontEnd(
            root_watt_per_count=root_watt_per_count,
            transmit_power_w=self.front_end.transmit_power_w.value,
            antenna_gain_dbi=self.antenna.ahead_dbi,
            losses_db=self.front_end.losses_db.value,
            leakage_delay_s=self.leakage.delay_s.value if self.leakage else math.nan,
            transmitters_m=burst.transmitters_m,
            receivers_m=burst.receivers_m,
        )

    @property
    def burst_s(self) -> float:
        """From the first slot of a burst to where the next burst may begin."""
        steps = self.burst.step_times_s
        pause = self.steps.settling_s.value if self.steps else 0.0
        duration = self.ofdm.n_slots * self.ofdm.slot_period_s + pause
        return float(steps[-1] - steps[0]) + duration

    @property
    def total_bandwidth_hz(self) -> float:
        """From the lowest subcarrier of all steps to the highest."""
        carriers = self.burst.carriers_hz
        return float(carriers[-1] - carriers[0] + self.ofdm.bandwidth_hz)

    @property
    def channel_waveform(self) -> OfdmWaveform:
        """What the first transmitter sends in the first step."""
        return self.burst.waveform_of(0, 0)

    @property
    def sample_noise_w(self) -> float:
        """Thermal noise of one averaged sample: k T0 F B / repeats."""
        factor = 10 ** (self.front_end.noise_figure_db.value / 10)
        power = constants.k * _REFERENCE_K * factor * self.ofdm.bandwidth_hz
        return float(power / self.ofdm.repeats)

    def received_power_w(
        self, range_m: float, rcs_m2: float, direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    ) -> float:
        """Radar equation in free space: Pt G^2 lambda^2 sigma / ((4 pi)^3 R^4) less the losses.

        ``direction``: unit vector in the antenna's frame.
        """
        gain = float(self.antenna.gain(np.array(direction)))
        loss = 10 ** (self.front_end.losses_db.value / 10)
        spread = (4 * math.pi) ** 3 * range_m**4 * loss
        power = self.front_end.transmit_power_w.value
        return power * gain**2 * self.ofdm.wavelength_m**2 * rcs_m2 / spread

    def image_snr(self, received_w: float) -> float:
        """SNR of a lone target after processing one step, transmitter and receiver, rectangular
        window.
        """
        cells = self.channel_waveform.n_subcarriers * self.channel_waveform.n_slots
        return received_w * cells / self.sample_noise_w

    def warnings(
        self, farthest_m: float = 0.0, fastest_m_per_s: float = 0.0
    ) -> list[CaptureWarning]:
        """Contradictions, each with its figures.

        Parameters
        ----------
        farthest_m, fastest_m_per_s
            What the scene holds.
        """
        return [
            *self._band_warnings(),
            *self._range_warnings(farthest_m),
            *self._rate_warnings(fastest_m_per_s),
            *self._antenna_warnings(),
        ]

    def _band_warnings(self) -> list[CaptureWarning]:
        wave, carriers, warnings = self.ofdm, self.burst.carriers_hz, []
        low, high = carriers[0] - wave.bandwidth_hz / 2, carriers[-1] + wave.bandwidth_hz / 2
        if low < self.band.low_hz.value or high > self.band.high_hz.value:
            warnings.append(
                CaptureWarning(
                    "design",
                    f"band: {low / 1e9:.2f}-{high / 1e9:.2f} GHz leaves "
                    f"{self.band.low_hz.value / 1e9:g}-{self.band.high_hz.value / 1e9:g} GHz",
                )
            )
        if self.steps and self.steps.spacing_hz.value > wave.bandwidth_hz * (1 + 1e-9):
            warnings.append(
                CaptureWarning(
                    "design",
                    f"steps: {self.steps.spacing_hz.value / 1e6:g} MHz apart leave gaps between "
                    f"bands of {wave.bandwidth_hz / 1e6:g} MHz",
                )
            )
        return warnings

    def _range_warnings(self, farthest_m: float) -> list[CaptureWarning]:
        wave, warnings = self.ofdm, []
        if farthest_m > wave.max_range_m:
            warnings.append(
                CaptureWarning(
                    "ambiguous",
                    f"range: {farthest_m:.1f} m is beyond the unambiguous {wave.max_range_m:.1f} m "
                    f"and appears at {farthest_m % wave.max_range_m:.1f} m",
                )
            )
        protected = C_M_PER_S * wave.prefix_s / 2
        reach = min(farthest_m, wave.max_range_m) if farthest_m else wave.max_range_m
        if protected < reach * (1 - 1e-9) - wave.range_cell_m:
            warnings.append(
                CaptureWarning(
                    "design",
                    f"prefix: {wave.prefix_s * 1e6:.3g} us protects {protected:.1f} m of "
                    f"{reach:.1f} m",
                )
            )
        return warnings

    def _rate_warnings(self, fastest_m_per_s: float) -> list[CaptureWarning]:
        wave, warnings = self.ofdm, []
        unambiguous = self.channel_waveform.max_velocity_m_per_s
        if fastest_m_per_s > unambiguous:
            warnings.append(
                CaptureWarning(
                    "ambiguous",
                    f"velocity: {fastest_m_per_s:.2f} m/s is beyond the unambiguous "
                    f"+/- {unambiguous:.2f} m/s",
                )
            )
        edge = 20 * math.log10(abs(float(wave.slot_gain(np.array(0.5 / wave.slot_period_s)))))
        doppler = 2 * fastest_m_per_s / wave.wavelength_m
        left = abs(float(wave.slot_gain(np.array(doppler))))
        loss = 20 * math.log10(max(left, 1e-15))
        if loss < -1:
            warnings.append(
                CaptureWarning(
                    "design",
                    f"slot: averaging {wave.repeats} repeats loses {-loss:.1f} dB at "
                    f"{fastest_m_per_s:.1f} m/s ({-edge:.1f} dB at the edge)",
                )
            )
        smeared_db = -20 * np.log10(self.channel_waveform.migration_gain(fastest_m_per_s))
        if smeared_db > _SMEARED_DB:
            warnings.append(
                CaptureWarning(
                    "design",
                    f"migration: at {fastest_m_per_s:.2f} m/s an echo crosses range cells within a "
                    f"burst; it is {smeared_db:.0f} dB weaker where detection looks for it",
                )
            )
        return warnings

    def _antenna_warnings(self) -> list[CaptureWarning]:
        pattern = self.antenna.pattern
        if pattern is None or pattern.efficiency <= _MOST_FED:
            return []
        text = f"antenna: the pattern radiates {100 * pattern.efficiency:.0f} % of what it is fed"
        return [CaptureWarning("design", text)]


def load_radar(name: "str | Path | RadarDesign") -> RadarDesign:
    """A bundled radar by name, or a user's own TOML file; a design is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(RadarDesign, name, "radar", catalog_folder() / "radars")


def radar_names() -> list[str]:
    """Names of the bundled radars."""
    return bundled(catalog_folder() / "radars")
