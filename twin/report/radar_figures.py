"""Figures of the radar report."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hardware.waveform import C_M_PER_S
from twin.radar.evaluation import RadarEvaluation
from twin.radar.picture import TrackPicture
from twin.report.style import BLUE, GREY, ORANGE, new_figure

_DEPTH_DB = 20.0  # shown of a track's image


def radar_map(evaluation: RadarEvaluation) -> Figure:
    """Received power by range and range rate, with detections on true targets."""
    image, shown = evaluation.image, _shown_ranges(evaluation)
    decibel = _dbm(image.power_w[shown])
    floor = _dbm(np.array(image.noise_w))
    figure = new_figure((7.4, 5.2))
    axis = figure.subplots()
    drawn = axis.pcolormesh(
        image.range_rate_m_per_s,
        image.range_m[shown],
        decibel,
        cmap="cividis",
        vmin=float(floor) - 3,
        vmax=float(decibel.max()),
        shading="nearest",
        rasterized=True,
    )
    figure.colorbar(drawn, ax=axis, label="received power (dBm per cell)")
    _mark(axis, evaluation)
    axis.set_ylim(0, image.range_m[shown][-1])
    hit = len(evaluation.capture.truth) - len(evaluation.missed)
    axis.set_title(
        f"{evaluation.radar.name}: {hit} of {len(evaluation.capture.truth)} targets detected"
    )
    axis.set_xlabel("range rate (m/s), receding is positive")
    axis.set_ylabel("range (m)")
    return figure


def radar_cuts(evaluation: RadarEvaluation) -> Figure:
    """Range cut (strongest rate of each range) and rate cut through the strongest mover."""
    image, shown = evaluation.image, _shown_ranges(evaluation)
    figure = new_figure((10.2, 3.3))
    left, right = figure.subplots(1, 2)
    left.plot(image.range_m[shown], _dbm(image.power_w[shown].max(axis=1)), color=BLUE, lw=0.8)
    for target in evaluation.capture.truth:
        level = _dbm(np.array(target.received_w))
        left.plot(target.wrapped_range_m, level, "+", color=ORANGE, ms=9)
    left.set_xlabel("range (m)")
    left.set_title("range cut; crosses: radar equation at the true targets")
    row = _mover_row(evaluation)
    right.plot(image.range_rate_m_per_s, _dbm(image.power_w[row]), color=BLUE, lw=0.8)
    right.set_xlabel("range rate (m/s)")
    right.set_title(f"rate cut at {image.range_m[row]:.2f} m")
    for axis in (left, right):
        axis.axhline(float(_dbm(np.array(image.noise_w))), color=GREY, lw=0.8, ls="--")
        axis.set_ylabel("received power (dBm per cell)")
        axis.margins(x=0)
    return figure


def track_image(track: TrackPicture) -> Figure:
    """Back-projection over the track from above, with true outlines and detected targets."""
    image = track.image
    with np.errstate(divide="ignore"):
        decibel = 20 * np.log10(np.abs(image.value))
    figure = new_figure((6.4, 5.4))
    axis = figure.subplots()
    drawn = axis.pcolormesh(
        image.cross_range_m,
        image.down_range_m,
        decibel - decibel.max(),
        cmap="cividis",
        vmin=-_DEPTH_DB,
        vmax=0,
        shading="nearest",
        rasterized=True,
    )
    figure.colorbar(drawn, ax=axis, label="power (dB over the peak)")
    for outline in track.outlines.values():
        axis.fill(outline[:, 1], outline[:, 0], fill=False, ec=ORANGE, lw=1.2)
    seen = track.seen
    places = [s.cross_range_m for s in seen], [s.down_range_m for s in seen]
    axis.plot(*places, "o", mfc="none", mec="white", ms=10)
    axis.invert_xaxis()  # left is left
    axis.set_aspect("equal")
    axis.set_xlabel("cross-range (m), positive to the left")
    axis.set_ylabel("down-range (m)")
    down, cross = 100 * image.down_resolution_m, 100 * image.cross_resolution_m
    axis.set_title(f"resolution {down:.0f} cm down-range, {cross:.1f} cm across")
    return figure


def _mark(axis: Any, evaluation: RadarEvaluation) -> None:
    plot = axis.plot
    ranges = np.nan_to_num([d.range_m for d in evaluation.detections])  # not measured: the only row
    rates = _on_map(evaluation, [d.range_rate_m_per_s for d in evaluation.detections])
    plot(rates, ranges, "o", mfc="none", mec="white", ms=10, label="detection", ls="none")
    truth = evaluation.capture.truth
    true_rates = _on_map(evaluation, [t.range_rate_m_per_s for t in truth])
    true_ranges = [t.wrapped_range_m for t in truth]
    plot(true_rates, true_ranges, "+", color=ORANGE, label="true target")
    for target, rate, range_m in zip(truth, true_rates, true_ranges, strict=True):
        axis.annotate(
            target.name,
            (rate, range_m),
            xytext=(8, -3),
            textcoords="offset points",
            color="white",
            fontsize=8,
        )
    axis.legend(loc="upper right", facecolor="#00204d", labelcolor="white")


def _on_map(evaluation: RadarEvaluation, rates_m_per_s: Sequence[float]) -> np.ndarray:
    """Folded range rates, as shown on the map; 0 where not measured."""
    fastest = evaluation.waveform.max_velocity_m_per_s
    return (np.nan_to_num(rates_m_per_s) + fastest) % (2 * fastest) - fastest


def _shown_ranges(evaluation: RadarEvaluation) -> slice:
    """From 0 to a third beyond the farthest target or echo."""
    propagation = evaluation.capture.propagation
    far = [t.wrapped_range_m for t in evaluation.capture.truth]
    far += [p.range_m for p in propagation.paths]
    far += (
        [float(propagation.echoes.delay_s.max()) * C_M_PER_S / 2]
        if propagation.echoes.delay_s.size
        else []
    )
    top = 1.33 * max(far, default=evaluation.image.range_m[-1])
    return slice(0, max(8, int(np.searchsorted(evaluation.image.range_m, top))))


def _mover_row(evaluation: RadarEvaluation) -> int:
    """Row of the strongest moving detection, else of the strongest cell."""
    cell = evaluation.waveform.velocity_cell_m_per_s
    movers = [d for d in evaluation.detections if abs(d.range_rate_m_per_s) > cell]
    if movers:
        return int(np.argmin(np.abs(evaluation.image.range_m - movers[0].range_m)))
    return int(np.argmax(evaluation.image.power_w.max(axis=1)))


def _dbm(power_w: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(power_w, 1e-30) * 1e3)
