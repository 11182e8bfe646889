"""Detections: constant false-alarm rate on the map, then each peak refined on the channel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.radar.cfar import Cfar, cfar_threshold, possible
from hardware.radar.demodulation import Complex
from hardware.radar.range_doppler import RangeDopplerMap, check_channel
from hardware.radar.refinement import Blocks, amplitudes, blocks_about, highest
from hardware.radar.windows import frequency_variance, taper
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Detection:
    """One target: where, how fast (positive: receding), how strong.

    ``power_w`` is what one antenna received. Standard errors follow from the SNR and the window:
    with a rectangular one they are the Cramer-Rao bounds. Azimuth (positive: left), elevation and
    cross-section are NaN where array or antenna do not tell them.
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
        See `Cfar`; for other methods than the mean use `detected`.
    window
        The one of ``image``.
    at_most
        Detections returned.
    """
    cfar = Cfar(false_alarm, "ca", guard, training)
    return [found for found, _ in detected(channel, waveform, image, cfar, window, at_most)]


def detected(
    channel: Complex,
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    cfar: Cfar,
    window: str = "blackmanharris",
    at_most: int = 64,
) -> list[tuple[Detection, NDArray[np.complex128]]]:
    """Find targets, strongest first, each with its amplitude on every channel, (n_channels,)."""
    check_channel(channel, waveform)
    cells = tuple(s * image.oversampling for s in channel.shape[-2:])
    if image.power_w.shape != cells:
        raise ValueError(f"image: shape {image.power_w.shape}, expected the channel's {cells}")
    rows, columns = peaks_above(image, cfar, window)
    strongest = np.argsort(-image.power_w[rows, columns], kind="stable")[:at_most]
    if not len(strongest):
        return []
    rows, columns = rows[strongest], columns[strongest]
    found = [
        _measured(blocks, waveform, image.noise_w, window)
        for blocks in blocks_about(
            channel, waveform, window, image.range_m[rows], image.range_rate_m_per_s[columns]
        )
    ]
    return distinct(found, waveform)


def peaks_above(
    image: RangeDopplerMap, cfar: Cfar, window: str
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the cells above their threshold and above the cells around them."""
    power = image.power_w
    if all(size <= 2 * g + 1 for size, g in zip(power.shape, cfar.guard, strict=True)):
        none = np.zeros(0, dtype=np.intp)
        return none, none  # nothing but guard cells: nothing to tell the noise from
    made: dict[str, Any] = {
        "window": window,
        "n_channels": image.n_channels,
        "oversampling": image.oversampling,
    }
    rows, columns = possible(power, cfar, **made)
    peak = _are_peaks(power, rows, columns)
    rows, columns = rows[peak], columns[peak]
    above = power[rows, columns] > cfar_threshold(power, cfar, at=(rows, columns), **made)
    return rows[above], columns[above]


def _are_peaks(
    power: NDArray[np.floating[Any]], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether cells are the highest of the 5 x 5 around them; the map wraps around."""
    from scipy.ndimage import maximum_filter

    sizes = [min(5, size) for size in power.shape]
    if len(rows) > power.size // 25:
        top = maximum_filter(power, sizes, mode="wrap")[rows, columns]
    else:
        reach = [np.arange(size) - size // 2 for size in sizes]
        around = power[
            (rows[:, None, None] + reach[0][:, None]) % power.shape[0],
            (columns[:, None, None] + reach[1]) % power.shape[1],
        ]
        top = around.max(axis=(1, 2))
    return np.asarray((power[rows, columns] >= top) & (top > 0))


def _measured(
    blocks: Blocks, waveform: OfdmWaveform, noise_w: float, window: str
) -> tuple[Detection, NDArray[np.complex128]]:
    step = highest(blocks)
    return measurement(blocks, step, amplitudes(blocks, step), waveform, noise_w, window)


def measurement(
    blocks: Blocks,
    step: Array,
    amplitude: NDArray[np.complex128],
    waveform: OfdmWaveform,
    noise_w: float,
    window: str,
) -> tuple[Detection, NDArray[np.complex128]]:
    """A detection at cells from the middle of blocks."""
    power = float(np.mean(np.abs(amplitude) ** 2))
    snr = power / noise_w if noise_w else np.inf
    range_error, rate_error = standard_errors(waveform, window, snr * len(amplitude))
    delay = blocks.delay_s + step[0] * blocks.cell[0]
    found = Detection(
        range_m=float(C_M_PER_S / 2 * delay) % waveform.max_range_m,
        range_rate_m_per_s=float(C_M_PER_S / 2 * (blocks.delay_rate + step[1] * blocks.cell[1])),
        power_w=power,
        snr_db=float(10 * np.log10(snr)) if snr else -np.inf,
        range_error_m=range_error,
        range_rate_error_m_per_s=rate_error,
    )
    return found, amplitude


def distinct(
    found: Sequence[tuple[Detection, NDArray[np.complex128]]], waveform: OfdmWaveform
) -> list[tuple[Detection, NDArray[np.complex128]]]:
    """Strongest first, without those that climbed the same peak: nearer than 0.3 cells."""
    kept: list[tuple[Detection, NDArray[np.complex128]]] = []
    for candidate in sorted(found, key=lambda pair: -pair[0].power_w):
        if all(_apart(candidate[0], other[0], waveform) > 0.3 for other in kept):
            kept.append(candidate)
    return kept


def _apart(a: Detection, b: Detection, waveform: OfdmWaveform) -> float:
    by_range = abs(a.range_m - b.range_m) / waveform.range_cell_m
    by_rate = abs(a.range_rate_m_per_s - b.range_rate_m_per_s) / waveform.velocity_cell_m_per_s
    return max(by_range, by_rate)


def standard_errors(waveform: OfdmWaveform, window: str, snr: float) -> tuple[float, float]:
    """Standard errors of range and range rate at an image SNR (after all processing)."""
    if not snr:
        return float("inf"), float("inf")
    spread = [
        np.sqrt(frequency_variance(taper(window, n)) / snr)
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

    What averaging over a slot takes from a moving target's echo is put back.
    """
    gain = 10 ** (antenna_gain_dbi / 10)
    loss = 10 ** (losses_db / 10)
    doppler = 2 * found.range_rate_m_per_s / waveform.wavelength_m
    kept = float(waveform.slot_gain(np.array(doppler))) ** 2
    spread = (4 * np.pi) ** 3 * found.range_m**4 * loss
    sent = transmit_power_w * gain**2 * waveform.wavelength_m**2 * kept
    return replace(found, rcs_m2=float(found.power_w * spread / sent) if sent else float("nan"))
