"""Intervals of what a radar detects: what the propagation model may be off by, and its noise.

The error of a body's echo is estimated as a share of its amplitude, root mean square over the band,
that 95 of 100 bodies keep (`Propagation.bodies`). A detection is a part of one or several bodies at
its range and rate. Of each it has the same relative error, and an equal part of the power of the
error of the whole, which is spread over the ranges of the body.

At an echo of amplitude a an error of amplitude r a changes the level by up to -20 lg(1 - r) dB; and
delay, rate and direction by at most as much as noise of a signal-to-noise ratio of 1 / (2 r^2) does
by one standard deviation (Cauchy-Schwarz inequality; of noise, half the power turns the phase).

What another draw of the noise changes is what the detection tells of its own errors: they follow
from the power around the echo, in which clutter counts as noise does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hardware.radar import Detection
from hardware.radar.measurement import standard_errors
from hardware.waveform import C_M_PER_S, OfdmWaveform
from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.radar.acquisition import RadarCapture
from twin.radar.propagation.facets.convergence import BodyEcho

#: Cells beside a body's ranges and rates in which its error counts.
_CELLS = 2.0


@dataclass(frozen=True)
class DetectionIntervals:
    """A detection with what the model may be off by and its noise; ``level_dbm`` as received by one
    antenna.
    """

    level_dbm: Interval
    range_m: Interval
    range_rate_m_per_s: Interval
    azimuth_rad: Interval
    elevation_rad: Interval


def body_level(body: BodyEcho) -> Interval:
    """Level of a body over that of the strongest one, dB."""
    statistical, systematic = _errors(body)
    if not body.amplitude:
        return Interval(body.level_db)
    return Interval(
        body.level_db,
        _in_db(statistical / body.amplitude) / TWO_SIDED_95,
        _in_db(systematic / body.amplitude) if body.is_bounded else np.inf,
    )


def _errors(body: BodyEcho) -> tuple[float, float]:
    """Amplitudes of a body's error, that 95 of 100 bodies keep, and of the bound of what was left
    out of it.
    """
    statistical = body.estimated_error - body.systematic
    return statistical * body.level_amplitude, body.systematic * body.level_amplitude


def detection_intervals(
    detections: Sequence[Detection],
    capture: RadarCapture,
    waveform: OfdmWaveform,
    window: str,
    transmit_power_w: float,
) -> tuple[DetectionIntervals, ...]:
    """Intervals of detections of the first burst; ``waveform``, ``window``: those of the map."""
    shares = [
        _shares(detection, capture, waveform, np.sqrt(transmit_power_w)) for detection in detections
    ]
    record = capture.record
    n_channels = max(len(record.front_end.transmitters_m), 1) * record.iq.shape[3]
    return tuple(
        _intervals(detection, share, waveform, window, n_channels)
        for detection, share in zip(detections, shares, strict=True)
    )


def _shares(
    detection: Detection, capture: RadarCapture, waveform: OfdmWaveform, sent: float
) -> tuple[float, float]:
    """Errors of a detection's amplitude, relative to it: statistical and systematic."""
    amplitude = np.sqrt(detection.power_w)
    if not capture.is_bounded or not amplitude > 0:
        return 0.0, np.inf
    near = [b for b in capture.propagation.bodies if _is_near(b, detection, waveform)]
    found = []
    for each in zip(*map(_errors, near), strict=True):
        # No more than its whole error, however strong the detection: a faint body's is not the
        # others'.
        own = [
            min(error / body.amplitude, sent * error / amplitude)
            for body, error in zip(near, each, strict=True)
        ]
        spread = [
            sent * error / np.sqrt(_cells(body, waveform)) / amplitude
            for body, error in zip(near, each, strict=True)
        ]
        found.append(float(np.linalg.norm([max(own), *spread])))
    statistical, systematic = found or (0.0, 0.0)
    return statistical, systematic if all(b.is_bounded for b in near) else np.inf


def _cells(body: BodyEcho, waveform: OfdmWaveform) -> float:
    """Range cells over which a body is spread."""
    nearest, farthest = body.ranges_m
    return max((farthest - nearest) / waveform.range_cell_m, 1.0) if farthest < np.inf else 1.0


def _is_near(body: BodyEcho, detection: Detection, waveform: OfdmWaveform) -> bool:
    """Whether range and rate, as they wrap, are among a body's."""
    pairs = (
        (detection.range_m, body.ranges_m, waveform.range_cell_m, waveform.max_range_m),
        (
            detection.range_rate_m_per_s,
            body.range_rates_m_per_s,
            waveform.velocity_cell_m_per_s,
            2 * waveform.max_velocity_m_per_s,
        ),
    )
    for value, (least, most), cell, period in pairs:
        if np.isfinite(value) and most < np.inf:
            beyond = (value - least + _CELLS * cell) % period
            if beyond > most - least + 2 * _CELLS * cell:
                return False
    return True


def _intervals(
    detection: Detection,
    shares: tuple[float, float],
    waveform: OfdmWaveform,
    window: str,
    n_channels: int,
) -> DetectionIntervals:
    errors_s = [
        standard_errors(waveform, window, 1 / (2 * r**2)) if 0 < r < np.inf else (r, r)
        for r in shares
    ]

    def of(value: float, noise: float, statistical: float, systematic: float) -> Interval:
        if np.isnan(value):
            return Interval(float("nan"))
        return Interval(
            float(value),
            float(statistical) / TWO_SIDED_95,
            float(systematic),
            float("inf") if np.isnan(noise) else float(noise),
        )

    def turned(by_noise: float) -> list[float]:
        """Errors of an angle, from what noise does to it; without noise nothing tells them."""
        snr = 10 ** (detection.snr_db / 10) * n_channels
        if not 0 < snr < np.inf:
            return [np.inf if r else 0.0 for r in shares]
        by_share = by_noise * float(np.sqrt(2 * snr))
        return [by_share * r if 0 < r < np.inf else r for r in shares]

    d, half_c = detection, C_M_PER_S / 2
    level_dbm = 10 * np.log10(d.power_w * 1e3) if d.power_w > 0 else np.nan
    level_noise_db = 10 / np.log(10) * d.power_error_w / d.power_w if d.power_w > 0 else np.nan
    return DetectionIntervals(
        level_dbm=of(level_dbm, level_noise_db, *map(_in_db, shares)),
        range_m=of(d.range_m, d.range_error_m, *(half_c * delay_s for delay_s, _ in errors_s)),
        range_rate_m_per_s=of(
            d.range_rate_m_per_s,
            d.range_rate_error_m_per_s,
            *(half_c * rate for _, rate in errors_s),
        ),
        azimuth_rad=of(d.azimuth_rad, d.azimuth_error_rad, *turned(d.azimuth_error_rad)),
        elevation_rad=of(d.elevation_rad, d.elevation_error_rad, *turned(d.elevation_error_rad)),
    )


def _in_db(share: float) -> float:
    """Change of a level by a share of its amplitude, the larger of both directions."""
    if not share:
        return 0.0
    return float(-20 * np.log10(1 - share)) if share < 1 else np.inf
