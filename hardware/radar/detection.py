"""Detection: CFAR on the range-Doppler map, then refinement of each peak on the channel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_count, check_kind
from hardware.radar.cfar_rule import Cfar, has_training_cells
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.demodulation import Complex
from hardware.radar.measurement import (
    EchoMeasurement,
    cells_apart,
    echo_measurement,
    with_noise,
    without_duplicates,
)
from hardware.radar.peaks import Peaks, peaks_above
from hardware.radar.range_doppler import RangeDopplerMap, check_channel
from hardware.radar.refinement import (
    Blocks,
    blocks_about,
    echo_amplitudes,
    peak_offsets,
)
from hardware.radar.residue import residual_cells, residual_power
from hardware.radar.sensitivity import side_lobe, weak_echoes
from hardware.radar.windows import check_window, frequency_variance, normalised_window
from hardware.radar.within_symbols import leakage_of, without_doppler_within_symbols
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_OVER_LOBES = 20.0  # least power of an echo over the side lobes of others in its cell
_ALIKE = 1.5  # ratio of an echo's power without the window and with it, at most
_BESIDE = 1.0  # cells, within which echoes are one to all that is measured here
_WITHIN = 1  # cells of a tapered echo within which a neighbour affects its position
_ON_TAPERED = 0.2  # share of the false alarms of the windowed map, at least


@dataclass(frozen=True)
class Detection:
    """One target. What was not measured is NaN.

    Standard errors follow from the noise around the echo, which channels may share, and from the
    window; in white noise, without a window, they are the Cramer-Rao bounds.

    Parameters
    ----------
    range_m
        From the middle of the antennas' phase centres, that is half the sum of the mean transmitter
        and the mean receiver: the antenna's origin where they lie around it. NaN from a single
        subcarrier.
    range_rate_m_per_s
        Positive: receding; NaN from a single slot.
    power_w
        Received by one antenna, after the mean over a slot's repeats, whose loss at a target's rate
        `rcs_m2` does not hold.
    snr_db
        Power of the peak over the noise of the map that it is measured on: with the window where
        another echo is near, else without, 6 dB less noise with the default window.
    range_error_m
        Standard error of the range.
    range_rate_error_m_per_s
        Standard error of the range rate.
    azimuth_rad
        In the antenna's frame, positive to the left; NaN where the array does not determine it.
    azimuth_error_rad
        Standard error of the azimuth.
    elevation_rad
        In the antenna's frame, positive upwards; NaN where the array does not determine it.
    elevation_error_rad
        Standard error of the elevation.
    rcs_m2
        Radar cross-section of a target on the boresight: off it the antenna's gain, out and back,
        makes it too low. NaN where gain or losses are unknown.
    range_rate_alternatives_m_per_s
        Other range rates that the record cannot exclude, likeliest first; direction and error of
        the range rate are valid if none of them is the true one.
    azimuth_alternatives_rad
        Azimuths of other directions that the record cannot exclude, likeliest first: noise may have
        raised another lobe of the array above that of the target. The direction and its errors are
        valid if none of them is the true one.
    elevation_alternatives_rad
        Elevations of those directions.
    power_error_w
        Standard error of the power; NaN where a detection of one's own does not tell it.
    rcs_error_m2
        Standard error of the cross-section by power and range, and by the calibration where there
        is one; gain and losses that a record declares count as exact, and the direction as that of
        the boresight. NaN where one of these is unknown.
    """

    range_m: float
    range_rate_m_per_s: float
    power_w: float
    snr_db: float
    range_error_m: float
    range_rate_error_m_per_s: float
    azimuth_rad: float = float("nan")
    azimuth_error_rad: float = float("nan")
    elevation_rad: float = float("nan")
    elevation_error_rad: float = float("nan")
    rcs_m2: float = float("nan")
    range_rate_alternatives_m_per_s: tuple[float, ...] = ()
    azimuth_alternatives_rad: tuple[float, ...] = ()
    elevation_alternatives_rad: tuple[float, ...] = ()
    power_error_w: float = float("nan")
    rcs_error_m2: float = float("nan")

    @classmethod
    def of(cls, echo: EchoMeasurement) -> "Detection":
        """The detection of an echo: its delay and delay rate times c / 2."""
        half_c = C_M_PER_S / 2
        return cls(
            range_m=half_c * echo.delay_s,
            range_rate_m_per_s=half_c * echo.delay_rate,
            power_w=echo.power_w,
            snr_db=echo.snr_db,
            power_error_w=echo.power_error_w,
            range_error_m=half_c * echo.delay_error_s,
            range_rate_error_m_per_s=half_c * echo.delay_rate_error,
            range_rate_alternatives_m_per_s=tuple(
                half_c * rate for rate in echo.delay_rate_alternatives
            ),
        )


def detect(
    channel: Complex,
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    *,
    false_alarm: float = 1e-8,
    window: str = "blackmanharris",
    guard: tuple[int, int] = (6, 6),
    training: tuple[int, int] = (16, 12),
    at_most: int = 64,
) -> list[Detection]:
    """Find targets, strongest first.

    Parameters
    ----------
    channel, waveform, image
        Input and result of `range_doppler`.
    false_alarm, guard, training
        See `Cfar`; for its other methods use `detect_echoes`.
    window
        Window of ``image``.
    at_most
        Largest number of detections.
    """
    cfar = Cfar(false_alarm, guard=guard, training=training)
    echoes = detect_echoes(channel, waveform, image, cfar, window, at_most)
    return [Detection.of(without_doppler_within_symbols(echo, waveform)) for echo in echoes]


def detect_echoes(
    channel: Complex,
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    cfar: Cfar,
    window: str = "blackmanharris",
    at_most: int = 64,
) -> list[EchoMeasurement]:
    """Find echoes, strongest first, each with its amplitude on every channel.

    The map with a window shows strong echoes and weak ones beside them; isolated weak echoes are
    detected on the map without a window, see `weak_echoes`. The two share the probability of false
    alarm; what side lobes suppress on the second map is added to the first.
    """
    check_channel(channel, waveform)
    check_kind("image", image, RangeDopplerMap, "hardware.range_doppler")
    check_window(window)
    check_count("at_most", at_most)
    cells = tuple(s * image.oversampling for s in channel.shape[-2:])
    if image.power_w.shape != cells:
        raise InputError(f"image: shape {image.power_w.shape}, expected the channel's {cells}")
    if not has_training_cells(cells, cfar):
        return []
    # The rate of false alarms between cells is known for noise only, not for clutter.
    if window == "boxcar" or cfar.shape != float("inf"):
        peaks = peaks_above(image, cfar, window).strongest(at_most)
        return without_duplicates(
            _measurements_at(channel, waveform, window, peaks, image.noise_w), waveform
        )
    untapered = replace(cfar, false_alarm=(1 - _ON_TAPERED) * cfar.false_alarm)
    weak, noise_w, share = weak_echoes(channel, waveform, image, untapered, window)
    weak = weak.strongest(at_most)
    tapered = replace(cfar, false_alarm=cfar.false_alarm - share * untapered.false_alarm)
    strong = peaks_above(image, tapered, window).strongest(at_most)
    delay_s = np.concatenate([strong.delay_s, weak.delay_s])
    delay_rate = np.concatenate([strong.delay_rate, weak.delay_rate])
    blocks = blocks_about(channel, waveform, "boxcar", delay_s, delay_rate)
    echoes = _strong_measurements(
        blocks[: len(strong)], channel, waveform, window, strong, (noise_w, image.noise_w)
    )
    echoes += _weak_measurements(blocks[len(strong) :], waveform, noise_w, echoes)
    return without_duplicates(echoes, waveform)[:at_most]


def _strong_measurements(
    blocks: Sequence[Blocks],
    channel: Complex,
    waveform: OfdmWaveform,
    window: str,
    peaks: Peaks,
    noise_w: tuple[float, float],
) -> list[EchoMeasurement]:
    """Peaks of a windowed map, measured without the window or with it, whichever is better.

    Without a window the error due to noise is least and reaches its bound, but side lobes of other
    echoes interfere. The power around an echo after its subtraction shows by how much; it may also
    be the echo's own phase noise, against which no window helps. ``noise_w``: mean noise of a cell
    without the window and with it.
    """
    size = max(waveform.n_subcarriers, waveform.n_slots)
    worse = frequency_variance(normalised_window(window, size)) / frequency_variance(np.ones(size))
    echoes, around_w = [], []
    for about, step in zip(blocks, peak_offsets(blocks), strict=True):
        leakage = leakage_of(about, step, waveform, noise_w[0])
        around = residual_cells(about, step, leakage=leakage)
        noise = ChannelNoise.of_cells(around, noise_w[0])
        echoes.append(_measurement(about, step, waveform, noise_w[0], "boxcar", noise))
        around_w.append(residual_power(around))
    lobes_w = _moved_by_others(echoes, peaks, waveform)
    echoes = [
        with_noise(echo, echo.noise.and_white(float(lobe_w)))
        for echo, lobe_w in zip(echoes, lobes_w, strict=True)
    ]
    crowded = np.flatnonzero(np.array(around_w) + lobes_w >= worse * peaks.noise_w).tolist()
    some = peaks[np.array(crowded, dtype=np.intp)]
    with_window = _measurements_at(channel, waveform, window, some, noise_w[1])
    for i, echo in zip(crowded, with_window, strict=True):
        ratio = echoes[i].power_w / echo.power_w if echo.power_w else 1.0
        is_another = not 1 / _ALIKE < ratio < _ALIKE  # a side lobe of a stronger one
        if is_another or not echoes[i].delay_or_rate_error < echo.delay_or_rate_error:
            echoes[i] = echo
    return echoes


def _moved_by_others(
    echoes: Sequence[EchoMeasurement], peaks: Peaks, waveform: OfdmWaveform
) -> Array:
    """Power of white noise (n,) that would move echoes as far as the side lobes of the others do,
    with any phase, where these are steepest.

    A side lobe of amplitude A / (pi d) in d cells moves an echo of amplitude 1 by 3 A / (pi^2 d)
    cells at most; noise of power P moves it by the root of 3 P / (2 pi^2). Powers are those of the
    map, where the lobes of stronger ones are not taken for an echo.
    """
    apart = cells_apart(echoes, echoes, waveform)
    level = 1 / np.maximum(1.0, np.pi * apart) ** 2
    slope = 1 / np.maximum(1.0, apart) ** 2 / np.pi**2
    steepest = np.maximum(slope[..., 0] * level[..., 1], level[..., 0] * slope[..., 1])
    steepest[apart.max(axis=-1) < _BESIDE] = 0.0
    return np.asarray(3 * steepest @ peaks.power_w)


def _measurements_at(
    channel: Complex, waveform: OfdmWaveform, window: str, peaks: Peaks, noise_w: float
) -> list[EchoMeasurement]:
    """Peaks measured with the window of their map.

    An echo that the window does not separate is in no training cell, but in the residual power.
    """
    blocks = blocks_about(channel, waveform, window, peaks.delay_s, peaks.delay_rate)
    echoes = []
    for about, step, cfar_w in zip(blocks, peak_offsets(blocks), peaks.noise_w, strict=True):
        around = residual_cells(about, step, _WITHIN, follow=False)
        noise = ChannelNoise.of_cells(around, max(float(cfar_w), noise_w) if noise_w else 0.0)
        echoes.append(_measurement(about, step, waveform, noise_w, window, noise))
    return echoes


def _weak_measurements(
    blocks: Sequence[Blocks],
    waveform: OfdmWaveform,
    noise_w: float,
    strong: Sequence[EchoMeasurement],
) -> list[EchoMeasurement]:
    """Weak echoes, strongest first, less those that may be side lobes of stronger ones."""
    cells = np.array([waveform.n_subcarriers, waveform.n_slots])
    echoes: list[EchoMeasurement] = []
    for about, step in zip(blocks, peak_offsets(blocks), strict=True):
        noise = ChannelNoise.of_cells(residual_cells(about, step), noise_w)
        weak = _measurement(about, step, waveform, noise_w, "boxcar", noise)
        others = [*strong, *echoes]
        lobes = np.prod(side_lobe(cells_apart([weak], others, waveform)[0], cells), axis=-1)
        lobes_w = float(lobes @ [other.power_w for other in others])
        if weak.power_w > _OVER_LOBES * lobes_w:
            echoes.append(weak)
    return echoes


def _measurement(
    blocks: Blocks,
    step: Array,
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    noise: ChannelNoise,
) -> EchoMeasurement:
    return echo_measurement(
        blocks, step, echo_amplitudes(blocks, step), waveform, noise_w, window, noise
    )


def with_cross_section(
    detection: Detection,
    waveform: OfdmWaveform,
    transmit_power_w: float,
    antenna_gain_dbi: float,
    losses_db: float,
) -> Detection:
    """A detection with its cross-section by the radar equation in free space, at the boresight.

    The loss of a moving target's echo by averaging over a slot is compensated, where its rate is
    measured. NaN without a range.
    """
    gain = 10 ** (antenna_gain_dbi / 10)
    loss = 10 ** (losses_db / 10)
    doppler = 2 * np.nan_to_num(detection.range_rate_m_per_s) / waveform.wavelength_m
    slot_gain = float(waveform.slot_gain(np.array(doppler))) ** 2
    spread = (4 * np.pi) ** 3 * detection.range_m**4 * loss
    sent = transmit_power_w * gain**2 * waveform.wavelength_m**2 * slot_gain
    if not sent:
        return replace(detection, rcs_m2=float("nan"), rcs_error_m2=float("nan"))
    rcs_m2 = float(detection.power_w * spread / sent)
    relative = float("nan")
    if rcs_m2:
        by_power = detection.power_error_w / detection.power_w
        relative = float(np.hypot(by_power, 4 * detection.range_error_m / detection.range_m))
    return replace(detection, rcs_m2=rcs_m2, rcs_error_m2=rcs_m2 * relative)
