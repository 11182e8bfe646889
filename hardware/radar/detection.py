"""Detections: constant false-alarm rate on the map, then each peak refined on the channel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.cfar_rule import Cfar
from hardware.radar.demodulation import Complex
from hardware.radar.peaks import Peaks, peaks_above
from hardware.radar.range_doppler import RangeDopplerMap, check_channel
from hardware.radar.refinement import Blocks, amplitudes, blocks_about, highest, left_over
from hardware.radar.sensitivity import side_lobe, weak_echoes
from hardware.radar.windows import frequency_variance, taper
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_OVER_LOBES = 20.0  # of an echo's power over the side lobes of others that may stand there
_WITHIN = 1  # cells of a tapered echo that a neighbour must reach to move it
_ON_TAPERED = 0.2  # of the false alarms, at least; the rest are of the map without a window


@dataclass(frozen=True)
class Detection:
    """One target: where, how fast (positive: receding), how strong.

    ``power_w`` is what one antenna received. Standard errors follow from the SNR and the window:
    without one they are the Cramer-Rao bounds. What is not measured is NaN: the rate of a single
    slot, the range of a single subcarrier; azimuth (positive: left), elevation and cross-section
    where array or antenna do not tell them.
    ``range_rate_alternatives_m_per_s``: other range rates that the record cannot exclude, likeliest
    first; the error of the range rate, and the direction, hold if it is none of them.
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
Measured = tuple[Detection, NDArray[np.complex128]]


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
        As `range_doppler` took and gave them.
    false_alarm, guard, training
        See `Cfar`; for other methods than its own use `detected`.
    window
        The one of ``image``.
    at_most
        Detections returned.
    """
    cfar = Cfar(false_alarm, guard=guard, training=training)
    return [found for found, _ in detected(channel, waveform, image, cfar, window, at_most)]


def detected(
    channel: Complex,
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    cfar: Cfar,
    window: str = "blackmanharris",
    at_most: int = 64,
) -> list[Measured]:
    """Find targets, strongest first, each with its amplitude on every channel, (n_channels,).

    A map with a window shows what is strong, and the weak beside it; what is weak and alone is
    found without one, see `weak_echoes`. The two share the false alarms; what side lobes keep from
    the latter is the former's as well.
    """
    check_channel(channel, waveform)
    cells = tuple(s * image.oversampling for s in channel.shape[-2:])
    if image.power_w.shape != cells:
        raise InputError(f"image: shape {image.power_w.shape}, expected the channel's {cells}")
    if all(size <= 2 * g + 1 for size, g in zip(cells, cfar.guard, strict=True)):
        return []  # nothing but guard cells: nothing to tell the noise from
    if window == "boxcar" or cfar.shape != float("inf"):  # what is between cells is known of noise
        peaks = peaks_above(image, cfar, window).strongest(at_most)
        return distinct(_measured_at(channel, waveform, window, peaks, image.noise_w), waveform)
    untapered = replace(cfar, false_alarm=(1 - _ON_TAPERED) * cfar.false_alarm)
    weak, noise_w, share = weak_echoes(channel, waveform, image, untapered, window)
    weak = weak.strongest(at_most)
    tapered = replace(cfar, false_alarm=cfar.false_alarm - share * untapered.false_alarm)
    strong = peaks_above(image, tapered, window).strongest(at_most)
    range_m, rate_m_per_s = (
        np.concatenate(place) for place in zip(strong.places, weak.places, strict=True)
    )
    blocks = blocks_about(channel, waveform, "boxcar", range_m, rate_m_per_s)
    found, crowded = _isolated(blocks[: len(strong)], waveform, window, strong, noise_w)
    found += _measured_at(channel, waveform, window, crowded, image.noise_w)
    found += _weak(blocks[len(strong) :], waveform, noise_w, found)
    return distinct(found, waveform)[:at_most]


def _isolated(
    blocks: Sequence[Blocks], waveform: OfdmWaveform, window: str, peaks: Peaks, noise_w: float
) -> tuple[list[Measured], Peaks]:
    """Peaks of a tapered map that are measured better without the window, and the others.

    Without one, noise does least and errors reach their bound, but the side lobes of other echoes
    come in. What is left around an echo once it is taken away tells by how much.
    """
    size = max(waveform.n_subcarriers, waveform.n_slots)
    worse = frequency_variance(taper(window, size)) / frequency_variance(np.ones(size))
    found, crowded = [], []
    for i, (about, step) in enumerate(zip(blocks, highest(blocks), strict=True)):
        around_w = left_over(about, step)
        if around_w < worse * peaks.noise_w[i]:
            found.append(_measured(about, step, waveform, noise_w, "boxcar", around_w))
        else:
            crowded.append(i)
    return found, peaks[np.array(crowded, dtype=np.intp)]


def _measured_at(
    channel: Complex, waveform: OfdmWaveform, window: str, peaks: Peaks, noise_w: float
) -> list[Measured]:
    """Peaks as the window of their map shows them.

    Another echo that the window does not separate stands in no training cell, but in what is left.
    """
    range_m, rate_m_per_s = peaks.places
    blocks = blocks_about(channel, waveform, window, range_m, rate_m_per_s)
    found = []
    for about, step, cfar_w in zip(blocks, highest(blocks), peaks.noise_w, strict=True):
        around_w = max(float(cfar_w), left_over(about, step, _WITHIN))
        found.append(_measured(about, step, waveform, noise_w, window, around_w))
    return found


def _weak(
    blocks: Sequence[Blocks], waveform: OfdmWaveform, noise_w: float, strong: Sequence[Measured]
) -> list[Measured]:
    """Weak echoes, strongest first, less those that may be side lobes of stronger ones."""
    cells = np.array([waveform.n_subcarriers, waveform.n_slots])
    kept: list[Measured] = []
    for about, step in zip(blocks, highest(blocks), strict=True):
        weak = _measured(about, step, waveform, noise_w, "boxcar", left_over(about, step))
        others = [other for other, _ in (*strong, *kept)]
        lobes = np.prod(side_lobe(_cells_apart([weak[0]], others, waveform)[0], cells), axis=-1)
        lobes_w = float(lobes @ [other.power_w for other in others])
        if weak[0].power_w > _OVER_LOBES * lobes_w:
            kept.append(weak)
    return kept


def _measured(
    blocks: Blocks,
    step: Array,
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    around_w: float,
) -> Measured:
    return measurement(blocks, step, amplitudes(blocks, step), waveform, noise_w, window, around_w)


def measurement(
    blocks: Blocks,
    step: Array,
    amplitude: NDArray[np.complex128],
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
    around_w: float = 0.0,
) -> Measured:
    """A detection at cells from the middle of blocks.

    ``noise_w``: of the map, for the SNR; ``around_w``: what is around the echo, counted as noise
    in its errors if it is more. Along an axis of one sample nothing is measured: NaN.
    """
    power = float(np.mean(np.abs(amplitude) ** 2))
    snr = power / noise_w if noise_w else np.inf
    disturbed = power / max(noise_w, around_w) if noise_w else np.inf
    range_error, rate_error = standard_errors(waveform, window, disturbed * len(amplitude))
    delay = blocks.delay_s + step[0] * blocks.grid.cell[0]
    rate = C_M_PER_S / 2 * (blocks.delay_rate + step[1] * blocks.grid.cell[1])
    found = Detection(
        range_m=float(C_M_PER_S / 2 * delay) % waveform.max_range_m
        if waveform.n_subcarriers > 1
        else float("nan"),
        range_rate_m_per_s=float(rate) if waveform.n_slots > 1 else float("nan"),
        power_w=power,
        snr_db=float(10 * np.log10(snr)) if snr else -np.inf,
        range_error_m=range_error,
        range_rate_error_m_per_s=rate_error,
    )
    return found, amplitude


def distinct(
    found: Sequence[Measured], waveform: OfdmWaveform, *, folded: bool = True
) -> list[Measured]:
    """Strongest first, without those that climbed the same peak: nearer than 0.3 cells.

    ``folded``: rates a whole span of the Doppler ambiguity apart are one.
    """
    falling = sorted(found, key=lambda pair: -pair[0].power_w)
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
        np.sqrt(frequency_variance(taper(window, n)) / snr) if n > 1 else np.nan
        for n in (waveform.n_subcarriers, waveform.n_slots)
    ]
    return (
        float(C_M_PER_S / (4 * np.pi * waveform.subcarrier_spacing_hz) * spread[0]),
        float(waveform.wavelength_m / (4 * np.pi * waveform.slot_period_s) * spread[1]),
    )


def with_cross_section(
    found: Detection,
    waveform: OfdmWaveform,
    transmit_power_w: float,
    antenna_gain_dbi: float,
    losses_db: float,
) -> Detection:
    """A detection with its cross-section by the radar equation in free space, at the boresight.

    What averaging over a slot takes from a moving target's echo is put back, where its rate is
    measured. NaN without a range.
    """
    gain = 10 ** (antenna_gain_dbi / 10)
    loss = 10 ** (losses_db / 10)
    doppler = 2 * np.nan_to_num(found.range_rate_m_per_s) / waveform.wavelength_m
    kept = float(waveform.slot_gain(np.array(doppler))) ** 2
    spread = (4 * np.pi) ** 3 * found.range_m**4 * loss
    sent = transmit_power_w * gain**2 * waveform.wavelength_m**2 * kept
    return replace(found, rcs_m2=float(found.power_w * spread / sent) if sent else float("nan"))
