"""Detection: CFAR on the range-Doppler map, then refinement of each peak on the channel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.cfar_rule import Cfar
from hardware.radar.demodulation import Complex
from hardware.radar.peaks import Peaks, peaks_above
from hardware.radar.range_doppler import RangeDopplerMap, check_channel
from hardware.radar.refinement import (
    Blocks,
    blocks_about,
    echo_amplitudes,
    peak_offsets,
    residual_power,
)
from hardware.radar.sensitivity import side_lobe, weak_echoes
from hardware.radar.windows import frequency_variance, normalised_window
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_OVER_LOBES = 20.0  # least power of an echo over the side lobes of others in its cell
_WITHIN = 1  # cells of a tapered echo within which a neighbour affects its position
_ON_TAPERED = 0.2  # share of the false alarms of the windowed map, at least


@dataclass(frozen=True)
class Detection:
    """One target: range, range rate (positive: receding) and power.

    ``power_w``: received by one antenna. Standard errors follow from the SNR and the window;
    without a window they are the Cramer-Rao bounds. Values not measured are NaN: the rate from a
    single slot, the range from a single subcarrier; azimuth (positive: left), elevation and
    cross-section where array or antenna do not determine them.
    ``range_rate_alternatives_m_per_s``: other range rates that the record cannot exclude, likeliest
    first; direction and error of the range rate are valid if none of them is the true one.
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


#: A detection, and its amplitude on every channel, (n_channels,), in root watts.
EchoMeasurement = tuple[Detection, NDArray[np.complex128]]


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
    return [
        detection for detection, _ in detect_echoes(channel, waveform, image, cfar, window, at_most)
    ]


def detect_echoes(
    channel: Complex,
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    cfar: Cfar,
    window: str = "blackmanharris",
    at_most: int = 64,
) -> list[EchoMeasurement]:
    """Find targets, strongest first, each with its amplitude on every channel, (n_channels,).

    The map with a window shows strong echoes and weak ones beside them; isolated weak echoes are
    detected on the map without a window, see `weak_echoes`. The two share the probability of false
    alarm; what side lobes suppress on the second map is added to the first.
    """
    check_channel(channel, waveform)
    cells = tuple(s * image.oversampling for s in channel.shape[-2:])
    if image.power_w.shape != cells:
        raise InputError(f"image: shape {image.power_w.shape}, expected the channel's {cells}")
    if all(size <= 2 * g + 1 for size, g in zip(cells, cfar.guard, strict=True)):
        return []  # guard cells only: no training cells
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
    range_m, rate_m_per_s = (
        np.concatenate(place) for place in zip(strong.places, weak.places, strict=True)
    )
    blocks = blocks_about(channel, waveform, "boxcar", range_m, rate_m_per_s)
    echoes, crowded = _isolated(blocks[: len(strong)], waveform, window, strong, noise_w)
    echoes += _measurements_at(channel, waveform, window, crowded, image.noise_w)
    echoes += _weak_measurements(blocks[len(strong) :], waveform, noise_w, echoes)
    return without_duplicates(echoes, waveform)[:at_most]


def _isolated(
    blocks: Sequence[Blocks], waveform: OfdmWaveform, window: str, peaks: Peaks, noise_w: float
) -> tuple[list[EchoMeasurement], Peaks]:
    """Peaks of a windowed map that are measured better without the window, and the others.

    Without a window the error due to noise is least and reaches its bound, but side lobes of other
    echoes interfere. The power around an echo after its subtraction shows by how much.
    """
    size = max(waveform.n_subcarriers, waveform.n_slots)
    worse = frequency_variance(normalised_window(window, size)) / frequency_variance(np.ones(size))
    isolated, crowded = [], []
    for i, (about, step) in enumerate(zip(blocks, peak_offsets(blocks), strict=True)):
        around_w = residual_power(about, step)
        if around_w < worse * peaks.noise_w[i]:
            isolated.append(_measurement(about, step, waveform, noise_w, "boxcar", around_w))
        else:
            crowded.append(i)
    return isolated, peaks[np.array(crowded, dtype=np.intp)]


def _measurements_at(
    channel: Complex, waveform: OfdmWaveform, window: str, peaks: Peaks, noise_w: float
) -> list[EchoMeasurement]:
    """Peaks measured with the window of their map.

    An echo that the window does not separate is in no training cell, but in the residual power.
    """
    range_m, rate_m_per_s = peaks.places
    blocks = blocks_about(channel, waveform, window, range_m, rate_m_per_s)
    echoes = []
    for about, step, cfar_w in zip(blocks, peak_offsets(blocks), peaks.noise_w, strict=True):
        around_w = max(float(cfar_w), residual_power(about, step, _WITHIN))
        echoes.append(_measurement(about, step, waveform, noise_w, window, around_w))
    return echoes


def _weak_measurements(
    blocks: Sequence[Blocks],
    waveform: OfdmWaveform,
    noise_w: float,
    strong: Sequence[EchoMeasurement],
) -> list[EchoMeasurement]:
    """Weak echoes, strongest first, less those that may be side lobes of stronger ones."""
    cells = np.array([waveform.n_subcarriers, waveform.n_slots])
    kept: list[EchoMeasurement] = []
    for about, step in zip(blocks, peak_offsets(blocks), strict=True):
        weak = _measurement(about, step, waveform, noise_w, "boxcar", residual_power(about, step))
        others = [other for other, _ in (*strong, *kept)]
        lobes = np.prod(side_lobe(_cells_apart([weak[0]], others, waveform)[0], cells), axis=-1)
        lobes_w = float(lobes @ [other.power_w for other in others])
        if weak[0].power_w > _OVER_LOBES * lobes_w:
            kept.append(weak)
    return kept


def _measurement(
    blocks: Blocks,
    step: Array,
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    around_w: float,
) -> EchoMeasurement:
    return echo_measurement(
        blocks, step, echo_amplitudes(blocks, step), waveform, noise_w, window, around_w
    )


def echo_measurement(
    blocks: Blocks,
    step: Array,
    amplitude: NDArray[np.complex128],
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    around_w: float = 0.0,
) -> EchoMeasurement:
    """A detection ``step`` cells from the middle of blocks.

    ``noise_w``: of the map, for the SNR; ``around_w``: power around the echo, used in its errors
    if it exceeds the noise. Along an axis of one sample nothing is measured: NaN.
    """
    power = float(np.mean(np.abs(amplitude) ** 2))
    snr = power / noise_w if noise_w else np.inf
    disturbed = power / max(noise_w, around_w) if noise_w else np.inf
    range_error, rate_error = standard_errors(waveform, window, disturbed * len(amplitude))
    delay = blocks.delay_s + step[0] * blocks.grid.cell[0]
    rate = C_M_PER_S / 2 * (blocks.delay_rate + step[1] * blocks.grid.cell[1])
    detection = Detection(
        range_m=float(C_M_PER_S / 2 * delay) % waveform.max_range_m
        if waveform.n_subcarriers > 1
        else float("nan"),
        range_rate_m_per_s=float(rate) if waveform.n_slots > 1 else float("nan"),
        power_w=power,
        snr_db=float(10 * np.log10(snr)) if snr else -np.inf,
        range_error_m=range_error,
        range_rate_error_m_per_s=rate_error,
    )
    return detection, amplitude


def without_duplicates(
    echoes: Sequence[EchoMeasurement], waveform: OfdmWaveform, *, folded: bool = True
) -> list[EchoMeasurement]:
    """Strongest first, without duplicates of the same peak, nearer than 0.3 cells.

    ``folded``: rates that differ by whole spans of the Doppler ambiguity count as equal.
    """
    falling = sorted(echoes, key=lambda pair: -pair[0].power_w)
    targets = [one for one, _ in falling]
    near = _cells_apart(targets, targets, waveform).max(axis=-1) <= 0.3
    if not folded:
        rates = np.array([one.range_rate_m_per_s for one in targets])
        near &= ~(np.abs(rates[:, None] - rates) > waveform.max_velocity_m_per_s)
    kept: list[int] = []
    for i in range(len(falling)):
        if not near[i, kept].any():
            kept.append(i)
    return [falling[i] for i in kept]


def _cells_apart(some: Sequence[Detection], others: Sequence[Detection], w: OfdmWaveform) -> Array:
    """Cells between detections along range and rate (n_some, n_others, 2); 0 along what is not
    measured.
    """
    here, there = (
        np.array([(one.range_m, one.range_rate_m_per_s) for one in all_]).reshape(-1, 2)
        for all_ in (some, others)
    )
    cell = np.array([w.range_cell_m, w.velocity_cell_m_per_s])
    sizes = np.array([w.n_subcarriers, w.n_slots])
    cells = np.abs(np.nan_to_num((here[:, None] - there) / cell)) % sizes
    return np.minimum(cells, np.abs(sizes - cells))  # the map wraps around


def standard_errors(waveform: OfdmWaveform, window: str, snr: float) -> tuple[float, float]:
    """Standard errors of range and range rate at an image SNR (after all processing).

    NaN along an axis of one sample.
    """
    if not snr:
        return float("inf"), float("inf")
    spread = [
        np.sqrt(frequency_variance(normalised_window(window, n)) / snr) if n > 1 else np.nan
        for n in (waveform.n_subcarriers, waveform.n_slots)
    ]
    return (
        float(C_M_PER_S / (4 * np.pi * waveform.subcarrier_spacing_hz) * spread[0]),
        float(waveform.wavelength_m / (4 * np.pi * waveform.slot_period_s) * spread[1]),
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
    return replace(
        detection, rcs_m2=float(detection.power_w * spread / sent) if sent else float("nan")
    )
