"""What contradicts itself in a radar's design, or in what a scene asks of it, each with figures."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hardware.radar.stitching import range_per_rate_s
from hardware.waveform import C_M_PER_S, OfdmWaveform
from twin.radar.device.antenna import Antenna
from twin.radar.device.burst import Burst
from twin.radar.device.waveform import Band
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

_MIGRATION_DB = 10.0  # that an echo loses by moving through range cells, from which it is told
_LEAKAGE_DB = -25.0  # of an echo, to other subcarriers by Doppler, from which it is told
_SHIFT = 0.1  # of a range cell, by which steps may shift a moving echo
_MAX_EFFICIENCY = 1.05  # gain of a pattern, averaged over the sphere, from which it is warned of


def band_warnings(wave: OfdmWaveform, carriers_hz: Array, band: Band) -> Iterator[CaptureWarning]:
    """Of a waveform, the carriers (n_steps,) that it steps through, and the band allowed."""
    low, high = carriers_hz[0] - wave.bandwidth_hz / 2, carriers_hz[-1] + wave.bandwidth_hz / 2
    if low < band.low_hz.value or high > band.high_hz.value:
        yield CaptureWarning(
            "design",
            f"band: {low / 1e9:.2f}-{high / 1e9:.2f} GHz leaves "
            f"{band.low_hz.value / 1e9:g}-{band.high_hz.value / 1e9:g} GHz",
        )


def range_warnings(wave: OfdmWaveform, farthest_m: float) -> Iterator[CaptureWarning]:
    """Of the farthest target's range; 0: unknown."""
    if farthest_m > wave.max_range_m:
        yield CaptureWarning(
            "ambiguous",
            f"range: {farthest_m:.1f} m is beyond the unambiguous {wave.max_range_m:.1f} m "
            f"and appears at {farthest_m % wave.max_range_m:.1f} m",
        )
    protected_m = C_M_PER_S * wave.prefix_s / 2
    needed_m = min(farthest_m, wave.max_range_m) if farthest_m else wave.max_range_m
    if protected_m < needed_m * (1 - 1e-9) - wave.range_cell_m:
        yield CaptureWarning(
            "design",
            f"prefix: {wave.prefix_s * 1e6:.3g} us protects {protected_m:.1f} m of "
            f"{needed_m:.1f} m",
        )


def rate_warnings(
    wave: OfdmWaveform, channel: OfdmWaveform, fastest_m_per_s: float
) -> Iterator[CaptureWarning]:
    """Of the fastest target's range rate.

    ``wave``: what is sent; ``channel``: what one transmitter sends, whose slots are further apart
    where several take turns.
    """
    if fastest_m_per_s > channel.max_velocity_m_per_s:
        yield CaptureWarning(
            "ambiguous",
            f"velocity: {fastest_m_per_s:.2f} m/s is beyond the unambiguous "
            f"+/- {channel.max_velocity_m_per_s:.2f} m/s",
        )
    doppler_hz = 2 * fastest_m_per_s / wave.wavelength_m
    loss_db = _slot_loss_db(wave, doppler_hz)
    if loss_db > 1:
        yield CaptureWarning(
            "design",
            f"slot: averaging {wave.repeats} repeats loses {loss_db:.1f} dB at "
            f"{fastest_m_per_s:.1f} m/s ({_slot_loss_db(wave, 0.5 / wave.slot_period_s):.1f} dB "
            "at the edge)",
        )
    # Root mean square of the turn over a symbol, in the first order of the Doppler shift.
    turn = np.pi / math.sqrt(3) * doppler_hz * wave.symbol_s
    if (leakage_db := 20 * math.log10(max(turn, 1e-15))) > _LEAKAGE_DB:
        yield CaptureWarning(
            "design",
            f"subcarriers: at {fastest_m_per_s:.1f} m/s {min(leakage_db, 0):.0f} dB of an echo "
            "leak from each to others by Doppler within a symbol: noise, or a shift in range",
        )
    migration_db = -20 * np.log10(channel.migration_gain(fastest_m_per_s))
    if migration_db > _MIGRATION_DB:
        yield CaptureWarning(
            "design",
            f"migration: at {fastest_m_per_s:.2f} m/s an echo crosses range cells within a "
            f"burst; it is {migration_db:.0f} dB weaker where detection looks for it",
        )


def step_warnings(
    burst: Burst, range_cell_m: float, fastest_m_per_s: float
) -> Iterator[CaptureWarning]:
    """Of the fastest target's range rate, which shifts its range where the carrier is stepped;
    ``range_cell_m``: of all steps together.
    """
    shift_m = abs(range_per_rate_s(burst.carriers_hz, burst.step_times_s)) * fastest_m_per_s
    if shift_m > _SHIFT * range_cell_m:
        yield CaptureWarning(
            "ambiguous",
            f"steps: at {fastest_m_per_s:.2f} m/s carrier steps one after the other shift an "
            f"echo's range by {shift_m:.2g} m, unless the processing is told the rate "
            "(range_rate_m_per_s)",
        )


def antenna_warnings(antenna: Antenna) -> Iterator[CaptureWarning]:
    """Of the gain of a pattern file."""
    pattern = antenna.pattern
    if pattern is not None and pattern.efficiency > _MAX_EFFICIENCY:
        yield CaptureWarning(
            "design",
            f"antenna: the pattern radiates {100 * pattern.efficiency:.0f} % of what it is fed",
        )


def _slot_loss_db(wave: OfdmWaveform, doppler_hz: float) -> float:
    """What an echo loses by the averaging of a slot's repeats."""
    gain = abs(float(wave.slot_gain(np.array(doppler_hz))))
    return -20 * math.log10(max(gain, 1e-15))
