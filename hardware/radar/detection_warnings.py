"""What the detections of a burst may be other than they say, in words."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hardware.formatting import counted
from hardware.radar.array_plane import FLAT, extents, virtual_array
from hardware.radar.burst import DemodulatedBurst
from hardware.radar.cfar_rule import has_training_cells, one_echo_fills
from hardware.radar.detection import Detection
from hardware.radar.k_distribution import ClutterFit
from hardware.radar.range_doppler import RangeDopplerMap
from hardware.radar.rate_evidence import fastest_resolved
from hardware.radar.receivers import LEAST_NOISE, branch_scatter, noise_in_counts
from hardware.radar.settings import Processing
from hardware.waveform import C_M_PER_S, OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

_LOWERS = 0.1  # rad^2, which lowers levels by 0.4 dB
_FEW_COUNTS = 4.0  # rms of a branch: echoes of 5 counts are within 0.1 dB


def untested_rates(waveform: OfdmWaveform, how: Processing) -> list[str]:
    """A warning of range rates that cannot be told from slower ones."""
    fastest = 2 / C_M_PER_S * how.fastest_m_per_s
    resolved = fastest_resolved(waveform, fastest)
    if resolved == fastest or waveform.max_velocity_m_per_s > how.fastest_m_per_s:
        return []
    return [
        f"range rate: beyond {C_M_PER_S / 2 * resolved:.3g} m/s none is told from slower ones, "
        f"of the {how.fastest_m_per_s:g} m/s asked for (fastest_m_per_s): "
        f"{waveform.n_slots} slots every {waveform.slot_period_s:g} s are too slow"
    ]


def targets_of_two_slots(waveform: OfdmWaveform, how: Processing) -> list[str]:
    """A warning that targets of one range are not split by their rates."""
    if not how.resolve or waveform.n_slots != 2:
        return []
    return [
        "range rate: 2 slots of a transmitter tell one in each range cell; where targets of "
        "several are in it (resolve), it is that of none, which its error does not hold, and "
        "detections beside it may be false"
    ]


def lost_at_rest(count: int) -> list[str]:
    """A warning of so many peaks at rest that are no single echo."""
    if not count:
        return []
    return [
        f"range rate: {counted(count, 'peak')} at rest, of several echoes that move at one range, "
        "whose rates are not told (moving_only)"
    ]


def coupled_ranges(interval: DemodulatedBurst, how: Processing) -> list[str]:
    """A warning of ranges that hold at one rate alone: others shift or smear them by a cell."""
    if not (why := _coupling(interval, how)):
        return []
    return [
        f"range: holds at a range rate of {how.range_rate_m_per_s:g} m/s (range_rate_m_per_s): "
        f"{why}, which its error does not hold"
    ]


def ranges_of_a_spectrogram(interval: DemodulatedBurst) -> list[str]:
    """As `coupled_ranges`, of a spectrogram, which looks at one range for all rates."""
    if not (why := _coupling(interval, Processing())):
        return []
    cell = f"{interval.waveform.velocity_cell_m_per_s:.3g} m/s"
    return [
        f"range: that of what does not move; {why}: what moves is seen at less power, if at all "
        f"(--span holds more of it), and rates are told to {cell} at best"
    ]


def _coupling(interval: DemodulatedBurst, how: Processing) -> str:
    """What carrier steps do to the range of an echo that moves; empty: less than a cell."""
    if abs(interval.range_per_rate_s) * how.fastest_m_per_s >= interval.waveform.range_cell_m:
        return (
            f"carrier steps one after the other shift it by {interval.range_per_rate_s:.2g} m for "
            "each m/s more"
        )
    if interval.scatter_per_rate * how.fastest_m_per_s >= 1:
        return (
            "carrier steps in this order smear over ranges what moves by "
            f"{1 / interval.scatter_per_rate:.2g} m/s more"
        )
    return ""


def shifted_ranges(
    points: Sequence[Detection], waveform: OfdmWaveform, how: Processing
) -> list[str]:
    """A warning of ranges of a single slot, which tells no rate to correct them by."""
    if waveform.n_slots > 1 or waveform.symbols != "zadoff-chu":
        return []
    turns = 2 * how.fastest_m_per_s / waveform.wavelength_m * waveform.symbol_s
    shift_m = turns * waveform.range_cell_m
    if not any(point.range_error_m < shift_m for point in points):
        return []
    return [
        f"range: one slot tells no range rate; up to {how.fastest_m_per_s:g} m/s (fastest_m_per_s) "
        f"Doppler within the symbol shifts ranges by up to {shift_m:.2g} m, which no error holds"
    ]


def beside_the_reference(points: Sequence[Detection], interval: DemodulatedBurst) -> list[str]:
    """A warning of detections that the reference of carrier steps hides a part of."""
    reference_m = C_M_PER_S / 2 * interval.joined_by_s
    cell_m = interval.waveform.range_cell_m
    count = sum(abs(point.range_m - reference_m) < cell_m for point in points)
    if not count:
        return []
    return [
        f"range: {count} of {len(points)} detections within a cell ({cell_m:.2g} m) of the leakage "
        f"at {reference_m:.2g} m: they may be what is left of it, and nearer echoes appear there, "
        "too weak"
    ]


def moving_side_lobes(
    points: Sequence[Detection], interval: DemodulatedBurst, how: Processing
) -> list[str]:
    """A warning of detections that may be side lobes of moving echoes, of carrier steps."""
    rate = np.array([point.range_rate_m_per_s for point in points]) - how.range_rate_m_per_s
    error = np.array([point.range_rate_error_m_per_s for point in points])
    most = np.abs(rate) + np.fmin(2 * error, how.fastest_m_per_s)
    most = np.where(np.isnan(most), how.fastest_m_per_s, most)
    power_w = np.array([point.power_w for point in points])
    lobe_w = np.minimum(interval.scatter_per_rate * most, 1) ** 2 * power_w
    count = int(np.count_nonzero(power_w < lobe_w.max(initial=0.0)))
    if not count:
        return []
    return [
        f"range: {count} of {len(points)} detections may be side lobes of stronger ones that move "
        f"at other rates than {how.range_rate_m_per_s:g} m/s (range_rate_m_per_s) from step to step"
    ]


def ambiguous(points: list[Detection]) -> list[str]:
    """Warnings of ambiguous range rates and directions."""
    counts = {
        "range rate": sum(bool(point.range_rate_alternatives_m_per_s) for point in points),
        "direction": sum(bool(point.azimuth_alternatives_rad) for point in points),
    }
    return [
        f"{name}: ambiguous for {count} of {len(points)} detections, alternatives listed"
        for name, count in counts.items()
        if count
    ]


def without_directions(interval: DemodulatedBurst) -> list[str]:
    """A warning of an array whose places tell directions, but which `ArrayPlane` does not take."""
    extent_m = extents(virtual_array(interval))
    if extent_m.max() <= FLAT * interval.waveform.wavelength_m:
        return []
    return [
        "direction: none is told, since the antennas are in no plane that faces ahead within 60 "
        f"degrees: {', '.join(f'{1e3 * size:.3g}' for size in extent_m)} mm ahead, left and up"
    ]


def mixed_directions(fits: Sequence[bool], how: Processing) -> list[str]:
    """A warning of cells whose directions leave more than noise."""
    count = fits.count(False)
    if not count:
        return []
    if how.per_cell == 1:
        several, beside = "one direction", " (per_cell resolves targets on an evenly spaced line)"
    else:
        several, beside = f"up to {how.per_cell} directions (per_cell)", ""
    return [
        f"direction: {count} of {len(fits)} echoes do not fit {several}, which their errors do not "
        f"hold: several targets in a cell, or bodies that are no points{beside}"
    ]


def scattered_phases(burst: int, variance: float, n_left_out: int) -> list[str]:
    """A warning of what phases of slots, of this variance in rad^2, do to strong echoes: levels
    fall by exp(-variance), and peaks appear beside them.
    """
    if not n_left_out and variance < _LOWERS:
        return []
    left_out = (
        f"; {n_left_out} peaks at the delays of stronger echoes, whose spread over the rates they "
        "may be, are left out"
    )
    return [
        f"burst {burst}: phases differ from slot to slot by {variance**0.5:.2g} rad: levels are "
        f"some {10 * math.log10(math.e) * variance:.2g} dB too low, and no errors hold it"
        f"{left_out if n_left_out else ''}"
    ]


def left_to_rounding(
    record: "RadarRecord", burst: int, interval: DemodulatedBurst, noise_w: float
) -> list[str]:
    """A warning of samples of a few counts with hardly any noise, whose rounding follows the
    echoes. ``noise_w``: of a cell without a window.
    """
    n_samples = interval.channel.shape[-2] * interval.channel.shape[-1]
    noise = noise_in_counts(noise_w / record.front_end.root_watt_per_count**2, n_samples)
    if not (0 < noise < LEAST_NOISE and branch_scatter(record.iq[burst]).min() < _FEW_COUNTS):
        return []
    return [
        f"burst {burst}: noise of {noise:.2g} counts in samples of a few: levels are left to "
        "rounding, which no stated error holds"
    ]


def of_the_map(
    burst: int, image: RangeDopplerMap, how: Processing, clutter: ClutterFit
) -> list[str]:
    """Warnings of a map without training cells, or so few that an echo fills them, and of clutter
    in it.
    """
    cells = image.power_w.shape
    warnings = []
    if not has_training_cells(cells, how.cfar):
        warnings.append(
            f"burst {burst}: nothing can be detected on a map of {cells[0]} x {cells[1]} cells, "
            f"which the guard cells of CFAR cover, {how.cfar.guard[0]} and {how.cfar.guard[1]} to "
            "each side (a Cfar with a smaller guard leaves training cells)"
        )
    elif one_echo_fills(cells, how.cfar, how.window, image.oversampling):
        warnings.append(
            f"burst {burst}: on a map of {cells[0]} x {cells[1]} cells the main lobe of one echo "
            f"({how.window}) fills the training cells of CFAR: weaker echoes beside it, and some "
            "that are alone, may not be detected"
        )
    if not clutter.is_noise and how.cfar.shape == float("inf"):
        warnings.append(
            f"burst {burst}: the map contains clutter: {clutter.exceedance:.2g} times as many "
            "cells as in noise are far above their median, as in K-distributed clutter of shape "
            f"{clutter.shape:.2g}; the rate of false alarms is "
            f"{clutter.false_alarms(how.cfar.false_alarm, image.n_channels):.2g} times the one set "
            "(a CFAR with fitted shape keeps it)"
        )
    return warnings


def too_many(burst: int, n_detections: int, how: Processing) -> list[str]:
    """A warning of more detections than are kept."""
    if n_detections <= how.at_most:
        return []
    return [
        f"burst {burst}: more than {how.at_most} detections; the strongest {how.at_most} are "
        "kept (at_most)"
    ]
