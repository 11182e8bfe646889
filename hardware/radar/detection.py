"""Detections: constant false-alarm rate on the map, then each peak refined on the channel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar.range_doppler import RangeDopplerMap, taper
from hardware.radar.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Detection:
    """One target: where, how fast (positive: receding), how strong.

    The standard errors are the Cramer-Rao bounds at its SNR for a rectangular window; tapered by
    ``hann`` an estimate scatters 1.5 times as much, by ``blackmanharris`` 2.2 times.
    """

    range_m: float
    range_rate_m_per_s: float
    power_w: float
    snr_db: float
    range_error_m: float
    range_rate_error_m_per_s: float


def detect(
    channel: NDArray[np.complex128],
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
    false_alarm
        Probability per cell that noise alone is called a target.
    window
        The one of ``image``.
    guard, training
        Cells on each side along range and rate that are left out, and that tell the noise.
    at_most
        Detections returned.
    """
    power = image.power_w
    if all(size <= 2 * g + 1 for size, g in zip(power.shape, guard, strict=True)):
        return []  # nothing but guard cells: nothing to tell the noise from
    above = power > cfar_threshold(power, false_alarm, guard, training)
    found = np.argwhere(above & _peaks(power))
    order = np.argsort(-image.power_w[tuple(found.T)])[:at_most]
    tapered = channel * taper(window, channel.shape[0])[:, None] * taper(window, channel.shape[1])
    return [_refined(tapered, waveform, image, *found[i]) for i in order]


def cfar_factor(false_alarm: float, cells: int) -> float:
    """Threshold over the mean of ``cells`` exponential cells: n (Pfa^(-1/n) - 1)."""
    return float(cells * (false_alarm ** (-1 / cells) - 1))


def cfar_threshold(
    power: Array, false_alarm: float, guard: tuple[int, int], training: tuple[int, int]
) -> Array:
    """Cell-averaging threshold of every cell; the map wraps around.

    Raises ValueError when the map leaves no cells to tell the noise from.
    """
    from scipy.ndimage import uniform_filter

    inner = tuple(min(2 * g + 1, size) for g, size in zip(guard, power.shape, strict=True))
    outer = tuple(
        min(2 * (g + t) + 1, size) for g, t, size in zip(guard, training, power.shape, strict=True)
    )
    n_inner, n_outer = inner[0] * inner[1], outer[0] * outer[1]
    cells = n_outer - n_inner
    if cells < 1:
        raise ValueError(f"training: no cells left of a map of {power.shape} to tell the noise")
    around = n_outer * uniform_filter(power, outer, mode="wrap")
    around -= n_inner * uniform_filter(power, inner, mode="wrap")
    # A running mean loses digits next to a peak 1e10 times higher: never below zero.
    level = np.maximum(around / cells, 0)
    return np.asarray(cfar_factor(false_alarm, cells) * level, dtype=np.float64)


def _peaks(power: Array) -> NDArray[np.bool_]:
    """Cells that are the highest of the 5 x 5 around them."""
    from scipy.ndimage import maximum_filter

    highest = maximum_filter(power, tuple(min(5, size) for size in power.shape), mode="wrap")
    return np.asarray((power == highest) & (power > 0))


def _refined(
    tapered: NDArray[np.complex128],
    waveform: OfdmWaveform,
    image: RangeDopplerMap,
    row: int,
    column: int,
) -> Detection:
    """Maximum-likelihood range and rate of a lone target near a cell, by Newton's method.

    The model is exact: exp(-j 2 pi (fc + f) (tau + rate t)), with the migration through range
    cells that a fast target makes within the interval. The channel is brought to the cell and
    summed in blocks first, which leaves a small, slowly turning array.
    """
    delay = 2 * image.range_m[row] / C_M_PER_S
    rate = 2 * image.range_rate_m_per_s[column] / C_M_PER_S
    f, t = waveform.frequency_offsets_hz, waveform.slot_times_s
    mixed = tapered * np.exp(2j * np.pi * f * delay)[:, None]
    mixed *= np.exp(2j * np.pi * waveform.carrier_hz * rate * t)
    blocks, f, t = _in_blocks(mixed, f, t)
    by_delay = 2 * np.pi * np.broadcast_to(f[:, None], blocks.shape)
    by_rate = 2 * np.pi * (waveform.carrier_hz + f[:, None]) * t
    blocks = blocks * np.exp(2j * np.pi * f[:, None] * t * rate)

    cell = np.array([1 / waveform.bandwidth_hz, 2 * waveform.velocity_cell_m_per_s / C_M_PER_S])
    # Migration smears the peak over as many cells as the target crosses.
    crossed = abs(rate) * waveform.n_slots * waveform.slot_period_s / cell[0]
    step = _highest(blocks, 2 * np.pi * f * cell[0], by_rate[len(f) // 2] * cell[1], 1 + crossed)
    for _ in range(12):
        gradient, hessian = _slope(blocks, by_delay * cell[0], by_rate * cell[1], step)
        change = -np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        step = step + np.clip(change, -0.25, 0.25)
        if np.abs(change).max() < 1e-9:
            break
    turned = blocks * np.exp(1j * (by_delay * cell[0] * step[0] + by_rate * cell[1] * step[1]))
    power = float(np.abs(turned.sum() / tapered.size) ** 2)
    snr = power / image.noise_w if image.noise_w else np.inf
    range_error, rate_error = _bounds(waveform, snr)
    return Detection(
        range_m=float(C_M_PER_S / 2 * (delay + step[0] * cell[0])) % waveform.max_range_m,
        range_rate_m_per_s=float(C_M_PER_S / 2 * (rate + step[1] * cell[1])),
        power_w=power,
        snr_db=float(10 * np.log10(snr)),
        range_error_m=range_error,
        range_rate_error_m_per_s=rate_error,
    )


def _in_blocks(
    mixed: NDArray[np.complex128], f: Array, t: Array, most: tuple[int, int] = (64, 64)
) -> tuple[NDArray[np.complex128], Array, Array]:
    """Sums over up to 64 x 64 blocks, with the blocks' mean frequencies and times."""
    starts = [
        np.unique(np.linspace(0, size, min(m, size), endpoint=False).astype(int))
        for size, m in zip(mixed.shape, most, strict=True)
    ]
    summed = np.add.reduceat(np.add.reduceat(mixed, starts[0], axis=0), starts[1], axis=1)
    means = [
        np.add.reduceat(axis, s) / np.diff(np.append(s, len(axis)))
        for axis, s in zip((f, t), starts, strict=True)
    ]
    return summed, means[0], means[1]


def _highest(
    blocks: NDArray[np.complex128], by_delay: Array, by_rate: Array, reach: float
) -> Array:
    """Best of a grid of quarter cells out to ``reach`` cells: a start from which Newton climbs."""
    steps = np.arange(-np.ceil(4 * reach), np.ceil(4 * reach) + 1) / 4
    sums = np.exp(1j * np.outer(steps, by_delay)) @ blocks @ np.exp(1j * np.outer(by_rate, steps))
    row, column = np.unravel_index(np.argmax(np.abs(sums)), sums.shape)
    return np.array([steps[row], steps[column]])


def _slope(blocks: NDArray[np.complex128], a: Array, b: Array, step: Array) -> tuple[Array, Array]:
    """Gradient and Hessian of log |sum blocks exp(j (a x + b y))|^2 at ``step``."""
    turned = blocks * np.exp(1j * (a * step[0] + b * step[1]))
    s = turned.sum()
    first = np.array([(1j * a * turned).sum(), (1j * b * turned).sum()])
    second = -np.array(
        [
            [(a * a * turned).sum(), (a * b * turned).sum()],
            [(a * b * turned).sum(), (b * b * turned).sum()],
        ]
    )
    gradient = 2 * np.real(first / s)
    hessian = 2 * np.real(second / s - first[:, None] * first / s**2)
    return gradient, hessian


def _bounds(waveform: OfdmWaveform, snr: float) -> tuple[float, float]:
    """Cramer-Rao bounds of range and range rate at an image SNR (after all processing).

    sigma_R = c / (4 pi df) sqrt(6 / (SNR (N^2 - 1))), and the same along slots.
    """
    n, m = waveform.n_subcarriers, waveform.n_slots
    along_range = np.sqrt(6 / (snr * max(n**2 - 1, 1)))
    along_slots = np.sqrt(6 / (snr * max(m**2 - 1, 1)))
    return (
        float(C_M_PER_S / (4 * np.pi * waveform.subcarrier_spacing_hz) * along_range),
        float(waveform.wavelength_m / (4 * np.pi * waveform.slot_period_s) * along_slots),
    )
