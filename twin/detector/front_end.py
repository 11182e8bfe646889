"""Power on the detector to ADC counts: shot, dark, Johnson and read noise, then the converter."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from hardware.records import Flag
from twin.detector.flicker import FLICKER, ONE_AFTER_THE_OTHER, ExposureTimes, drawn
from twin.detector.gamma import gamma
from twin.detector.noise import NoiseBudget
from twin.detector.poisson import poisson
from twin.errors import InputError
from twin.system import System

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrontEnd:
    """Constants of one photodiode with its amplifier and converter.

    A transimpedance amplifier R averages the current over the integration time T, so that n
    electrons give n q R / T volts; its Johnson noise 4 k Theta / R in the bandwidth 1 / (2 T) of
    that average is a charge variance of 2 k Theta T / R. A capacitive one gives n q / C volts and
    fills up at its well. ``flicker_cycles``: the time T times the corner frequency below which the
    amplifier's noise density grows as 1/f; 0 is white noise. ``times``: of the exposures whose 1/f
    noise hangs together.

    All electrons are those at the detector's terminals, behind an avalanche's ``gain`` M, whose
    ``excess_noise`` F makes their shot noise M F times their mean (McIntyre 1966).

    Where a digitiser takes all gates of the same pulses, T is the time that a gate is open in all;
    ``electrons_per_watt`` still is of the power averaged over the whole exposure.
    """

    electrons_per_watt: float
    dark_e: float
    johnson_e: float
    read_e: float
    electrons_per_count: float
    offset_counts: float
    adc_bits: int
    full_well_e: float = np.inf
    flicker_cycles: float = 0.0
    times: ExposureTimes = ONE_AFTER_THE_OTHER
    gain: float = 1.0
    excess_noise: float = 1.0

    @classmethod
    def of(cls, system: System, responsivity_a_per_w: float | None = None) -> "FrontEnd":
        """Front end of a system, its responsivity by default the plain number it gives."""
        q, exposure_s = constants.e, system.acquisition.integration_time_s.value
        tof = system.time_of_flight
        t = exposure_s * (tof.open_share if tof and tof.at_once else 1.0)
        readout, detector = system.readout, system.detector
        responsivity = responsivity_a_per_w or detector.responsivity_a_per_w.value
        volts_per_count = readout.adc_full_scale_v.value / 2**readout.adc_bits.value
        johnson_c2 = 0.0
        if readout.transimpedance_ohm is not None:
            resistance = readout.transimpedance_ohm.value
            johnson_c2 = 2 * constants.k * readout.temperature_k.value * t / resistance
            volts_per_e = q * resistance / t
        else:
            assert readout.feedback_capacitance_f is not None  # a Readout has one of the two
            volts_per_e = q / readout.feedback_capacitance_f.value
        return cls(
            electrons_per_watt=responsivity * exposure_s / q,
            dark_e=detector.dark_current_a.value * system.pixels_per_detector * t / q,
            johnson_e=np.sqrt(johnson_c2) / q,
            read_e=readout.read_noise_e.value,
            electrons_per_count=volts_per_count / volts_per_e,
            offset_counts=readout.adc_offset_v.value / volts_per_count,
            adc_bits=readout.adc_bits.value,
            full_well_e=readout.full_well_e.value * system.pixels_per_detector
            if readout.full_well_e
            else np.inf,
            flicker_cycles=readout.flicker_corner_hz.value * t
            if readout.flicker_corner_hz
            else 0.0,
            times=ExposureTimes(
                period=system.acquisition.pattern_period_s.value / exposure_s,
                n_shutters=tof.n_shutters if tof else 1,
                at_once=system.gates_at_once,
            ),
            gain=detector.multiplication,
            excess_noise=detector.excess_noise,
        )

    @property
    def shot_variance(self) -> float:
        """Variance over mean of the collected electrons, M F."""
        return self.gain * self.excess_noise

    def expose(
        self,
        power_w: Array,
        *,
        rng: np.random.Generator,
        noise: Literal["none", "gaussian", "full"] = "full",
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Counts and flags, see `expose`."""
        return expose(power_w, self, rng=rng, noise=noise)

    def mean_e(self, power_w: Array) -> Array:
        """Mean electrons, as read from the counts, at a power, W: up to the rail and the well."""
        top = (2**self.adc_bits - 1 - self.offset_counts) * self.electrons_per_count
        linear = power_w * self.electrons_per_watt + self.dark_e
        return np.minimum(linear, min(top, self.full_well_e))

    def noise_budget(
        self, signal_w: Array, background_w: float | Array, emitter_noise: float = 0.0
    ) -> NoiseBudget:
        """Budget at the mean of exposures, see `noise_budget`."""
        return noise_budget(signal_w, background_w, self, emitter_noise)

    @property
    def amplifier_e(self) -> float:
        """White noise of the amplifier, rms of one exposure."""
        return float(np.hypot(self.johnson_e, self.read_e))

    @property
    def flicker_e(self) -> float:
        """Root of S0 fc T^2, the unit of `twin.detector.flicker`."""
        return self.amplifier_e * float(np.sqrt(self.flicker_cycles))


def noise_budget(
    signal_w: Array,
    background_w: float | Array,
    front_end: FrontEnd,
    emitter_noise: float = 0.0,
) -> NoiseBudget:
    """Budget at the mean of the exposures ``signal_w``, W, and of the background.

    ``emitter_noise``: relative fluctuation of the emitter. 1/f noise is counted as it survives the
    difference of a pair, all shutters added up (`flicker.in_image`: as it survives other sets).
    """
    shot = front_end.shot_variance
    signal = float(np.mean(signal_w)) * front_end.electrons_per_watt
    background = float(np.mean(background_w)) * front_end.electrons_per_watt
    return NoiseBudget(
        signal_e=signal,
        background_e=background,
        dark_e=front_end.dark_e,
        noise_e={
            "shot noise of the signal": float(np.sqrt(shot * signal)),
            "shot noise of the sun": float(np.sqrt(shot * background)),
            "shot noise of the dark current": float(np.sqrt(shot * front_end.dark_e)),
            "Johnson noise of the amplifier": front_end.johnson_e,
            "read noise": front_end.read_e,
            FLICKER: front_end.flicker_e * float(np.sqrt(front_end.times.in_a_pair)),
            "fluctuation of the emitter": emitter_noise * signal,
            "quantisation": front_end.electrons_per_count / float(np.sqrt(12)),
        },
    )


def expose(
    power_w: Array,
    front_end: FrontEnd,
    *,
    rng: np.random.Generator,
    noise: Literal["none", "gaussian", "full"] = "full",
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Counts and flags of exposures to a constant power.

    Parameters
    ----------
    power_w : (n_exposures, n_detectors) array
        On the photosensitive area, after filter and lens, W.
    front_end
        Detector, amplifier and converter.
    rng
        Source of all noise.
    noise
        ``full``: Poisson; ``gaussian``: shot noise as a normal distribution; ``none``: the mean.

    Returns
    -------
    counts : (n_exposures, n_detectors) int32
        Rounded and clipped to the converter's range.
    flags : (n_exposures,) uint8
        `Flag.SATURATED` where any detector reached a rail or its full well.

    Raises InputError for a power that is negative, or no finite number of electrons.
    """
    mean_e = power_w * front_end.electrons_per_watt + front_end.dark_e
    if not ((mean_e >= 0) & (mean_e < np.inf)).all():
        raise InputError(
            f"power_w: {float(np.min(power_w)):g} to {float(np.max(power_w)):g} W give "
            f"{float(np.max(mean_e)):g} electrons, expected a finite number from 0 up"
        )
    collected = mean_e if noise == "none" else _collect(mean_e, front_end, rng, noise)
    full = collected >= front_end.full_well_e
    electrons = np.minimum(collected, front_end.full_well_e)
    if noise != "none":
        electrons += rng.normal(0.0, front_end.amplifier_e, mean_e.shape)
    if noise != "none" and front_end.flicker_cycles:
        electrons += front_end.flicker_e * drawn(mean_e.shape, front_end.times, rng)
    exact = electrons / front_end.electrons_per_count + front_end.offset_counts
    top = 2**front_end.adc_bits - 1
    counts = np.clip(np.rint(exact), 0, top).astype(np.int32)
    saturated = ((counts == 0) | (counts == top) | full).any(axis=1)
    return counts, np.where(saturated, np.uint8(Flag.SATURATED), np.uint8(0))


def _collect(
    mean_e: Array, front_end: FrontEnd, rng: np.random.Generator, noise: Literal["gaussian", "full"]
) -> Array:
    """Electrons at the terminals.

    Of an avalanche, n Poisson electrons with a multiplied charge of mean n M and variance
    n M^2 (F - 1), drawn from a gamma distribution: exact where one carrier alone ionises and M is
    large (each electron's multiplication is exponential then), else right in mean and variance.
    """
    if front_end.shot_variance == 1:
        return _shot(mean_e, rng, gaussian=noise == "gaussian")
    gain, excess = front_end.gain, front_end.excess_noise - 1
    if noise == "gaussian":
        return rng.normal(mean_e, np.sqrt(front_end.shot_variance * mean_e))
    photoelectrons = _shot(mean_e / gain, rng)
    if excess == 0:
        return gain * photoelectrons
    return gain * excess * gamma(photoelectrons / excess, rng)


def _shot(mean: Array, rng: np.random.Generator, *, gaussian: bool = False) -> Array:
    """Poisson numbers as float64 for any mean from 0 up; or normal ones of the same variance."""
    return rng.normal(mean, np.sqrt(mean)) if gaussian else poisson(mean, rng)
