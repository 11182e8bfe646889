"""Intervals of what a radar detects: what the propagation model may be off by, and its noise.

The solver tells where in range and rate the errors are that it accepts of a body's echo, and where
the echo is itself (`BodyEcho.profile`). What of both lies in a detection's cell is the error of its
amplitude (`errors_in_cell`).

At an echo of amplitude a an error of amplitude r a changes the level by -20 lg(1 - r) dB downward
and 20 lg(1 + r) dB upward at most; where r is 1 or more, the echo may be any weaker, and
its level has an upper bound alone. Delay, rate and direction change by at most as much as noise of
a signal-to-noise ratio of 1 / (2 r^2) does by one standard deviation (Cauchy-Schwarz inequality; of
noise, half the power turns the phase).

What another draw of the noise changes is what the detection tells of its own errors: they follow
from the power around the echo, in which clutter counts as noise does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hardware.radar import Detection, RangeDopplerMap
from hardware.radar.measurement import standard_errors
from hardware.waveform import C_M_PER_S, OfdmWaveform
from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.radar.acquisition import RadarCapture
from twin.radar.errors_in_cell import errors_in_cell, measured_with
from twin.radar.propagation.facets.convergence import BodyEcho


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
    if not body.amplitude:
        return Interval(body.level_db)
    over = body.level_amplitude / body.amplitude
    statistical = body.accepted_error * over
    more = body.estimated_error * over - statistical if body.is_bounded else np.inf
    return level_interval(body.level_db, statistical, more)


def level_interval(
    level_db: float, statistical: float, systematic: float, noise_db: float = 0.0
) -> Interval:
    """A level whose amplitude may be off by shares of it: by one that 95 of 100 keep, and by a
    bound, in one phase.

    >>> print(level_interval(-80.0, 0.1, 0.2), "/", level_interval(-80.0, 0.5, 0.7))
    -80.0 ± 3.1 / -80.0, at most -73.2
    """
    both = statistical + systematic
    if both < 1:
        down = -20 * np.log10(1 - np.array([statistical, both]))
        statistical_db = float(down[0])
        return Interval(
            level_db, statistical_db / TWO_SIDED_95, float(down[1]) - statistical_db, noise_db
        )
    up = 20 * np.log10(1 + np.array([statistical, both]))
    above = float(up[1] - up[0]) if both < np.inf else None
    return Interval(level_db, float(up[0]) / TWO_SIDED_95, np.inf, noise_db, above)


def detection_intervals(
    detections: Sequence[Detection],
    capture: RadarCapture,
    image: RangeDopplerMap,
    waveform: OfdmWaveform,
    window: str,
    transmit_power_w: float,
) -> tuple[DetectionIntervals, ...]:
    """Intervals of detections of the first burst, on its map ``image``; ``waveform``, ``window``:
    those of the map.
    """
    record, sent = capture.record, np.sqrt(transmit_power_w)
    n_channels = max(len(record.front_end.transmitters_m), 1) * record.iq.shape[3]
    found = []
    for detection in detections:
        windows = measured_with(detection, window, image.noise_w)
        shares = _shares(detection, capture, waveform, windows, sent)
        found.append(_intervals(detection, shares, waveform, window, n_channels))
    return tuple(found)


def _shares(
    detection: Detection,
    capture: RadarCapture,
    waveform: OfdmWaveform,
    windows: tuple[str, ...],
    sent: float,
) -> tuple[float, float]:
    """Errors of a detection's amplitude, relative to it: the statistical one, and how much more it
    is with the bound of what was left out, of paths with phases of their own.
    """
    amplitude, bodies = np.sqrt(detection.power_w), capture.propagation.bodies
    if not capture.is_bounded or not amplitude > 0:
        return 0.0, np.inf
    found = errors_in_cell(bodies, detection, waveform, windows)
    is_bounded = all(body.is_bounded for body in bodies)
    both = float(np.hypot(found.statistical, found.systematic)) if is_bounded else np.inf
    scale = sent / amplitude
    return float(scale * found.statistical), float(scale * (both - found.statistical))


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
    return DetectionIntervals(
        level_dbm=_level(detection, shares),
        range_m=of(d.range_m, d.range_error_m, *(half_c * delay_s for delay_s, _ in errors_s)),
        range_rate_m_per_s=of(
            d.range_rate_m_per_s,
            d.range_rate_error_m_per_s,
            *(half_c * rate for _, rate in errors_s),
        ),
        azimuth_rad=of(d.azimuth_rad, d.azimuth_error_rad, *turned(d.azimuth_error_rad)),
        elevation_rad=of(d.elevation_rad, d.elevation_error_rad, *turned(d.elevation_error_rad)),
    )


def _level(detection: Detection, shares: tuple[float, float]) -> Interval:
    """As received by one antenna, dBm."""
    power_w = detection.power_w
    if not power_w > 0:
        return Interval(float("nan"))
    noise_db = float(10 / np.log(10) * detection.power_error_w / power_w)
    return level_interval(
        float(10 * np.log10(power_w * 1e3)), *shares, np.inf if np.isnan(noise_db) else noise_db
    )
