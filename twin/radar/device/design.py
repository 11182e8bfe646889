"""The radar under study, as data: its sections, and what must fit between them."""

import math
from pathlib import Path

import numpy as np
from pydantic import model_validator
from scipy import constants

from hardware.records import RadarFrontEnd
from hardware.waveform import C_M_PER_S, OfdmWaveform
from twin.files import InputError, catalog_folder
from twin.radar.device.antenna import Antenna, Elements
from twin.radar.device.burst import Burst
from twin.radar.device.design_warnings import (
    antenna_warnings,
    band_warnings,
    range_warnings,
    rate_warnings,
    step_warnings,
)
from twin.radar.device.electronics import FrontEndDesign, Leakage, Oscillator
from twin.radar.device.waveform import Band, Steps, Waveform
from twin.toml import Entry, bundled, load_entry
from twin.warned import CaptureWarning

_MOST_CELLS = 2**25  # of one burst: half a gigabyte in complex numbers
_MOST_SYMBOLS = 2**24  # of one step, over which the oscillator wanders
_STEP_OFF = 1e-6  # of a step's bandwidth, by which the next may begin elsewhere than at its end
_REFERENCE_K = 290.0  # of noise figures, by definition


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
        if steps > 1:
            self._check_spacing()
        if self.leakage and not self.leakage.delay_s.value < wave.max_delay_s:
            raise InputError(
                f"leakage.delay_s = {self.leakage.delay_s.value:g}: expected less than the "
                f"unambiguous delay, 1 / subcarrier_spacing_hz = {wave.max_delay_s:.4g} s"
            )
        symbols = wave.n_slots * wave.slot_period_s / wave.symbol_s
        if self.oscillator and symbols > _MOST_SYMBOLS:
            raise InputError(
                f"oscillator: {symbols:.3g} symbols in a step, expected at most {_MOST_SYMBOLS}"
            )
        return self

    def _check_spacing(self) -> None:
        """Raise InputError unless the bands of the steps touch: only then they make one band."""
        assert self.steps is not None
        spacing_hz, bandwidth_hz = self.steps.spacing_hz.value, self.ofdm.bandwidth_hz
        if abs(spacing_hz / bandwidth_hz - 1) > _STEP_OFF:
            raise InputError(
                f"steps.spacing_hz = {spacing_hz:.9g}: expected the bandwidth of one step, "
                f"n_subcarriers x subcarrier_spacing_hz = {bandwidth_hz:.9g}"
            )

    @property
    def ofdm(self) -> OfdmWaveform:
        """The waveform that is sent; the first step's."""
        return self.waveform.ofdm

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
            gain=self.antenna.gain,
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
    def middle_s(self) -> float:
        """From the first slot of a burst to its middle, when the scene is as it is given."""
        return self.ofdm.n_slots * self.ofdm.slot_period_s / 2 - float(self.burst.step_times_s[0])

    @property
    def total_bandwidth_hz(self) -> float:
        """From the lowest subcarrier of all steps to the highest."""
        carriers = self.burst.carriers_hz
        return float(carriers[-1] - carriers[0] + self.ofdm.bandwidth_hz)

    @property
    def range_cell_m(self) -> float:
        """Range resolution of all steps together."""
        return C_M_PER_S / (2 * self.total_bandwidth_hz)

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
            *band_warnings(self.ofdm, self.burst.carriers_hz, self.band),
            *range_warnings(self.ofdm, farthest_m),
            *rate_warnings(self.ofdm, self.channel_waveform, fastest_m_per_s),
            *step_warnings(self.burst, self.range_cell_m, fastest_m_per_s),
            *antenna_warnings(self.antenna),
        ]


def load_radar(name: "str | Path | RadarDesign") -> RadarDesign:
    """A bundled radar by name, or a user's own TOML file; a design is returned as it is.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(RadarDesign, name, "radar", catalog_folder() / "radars")


def radar_names() -> list[str]:
    """Names of the bundled radars."""
    return bundled(catalog_folder() / "radars")
