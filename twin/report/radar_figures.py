"""Figures of the radar report."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.radar.evaluation import RadarEvaluation
from twin.radar.picture import TrackPicture
from twin.report.extent import folded, mover_row, shown_ranges, shown_rates, top_range_m
from twin.report.radar_charts import micro_doppler_rates, micro_doppler_title, part_places
from twin.report.style import BLUE, GREY, ORANGE, new_figure, wrapped

_DEPTH_DB = 20.0  # shown of a track's image
_LINE = 0.045  # height of a line of text over that of the map


def radar_map(evaluation: RadarEvaluation) -> Figure:
    """Received power by range and range rate, with detections on true targets."""
    image, shown = evaluation.image, shown_ranges(evaluation)
    decibel = _dbm(image.power_w[shown]) - float(_dbm(np.array(image.noise_w)))
    figure = new_figure((7.4, 5.2))
    axis = figure.subplots()
    drawn = axis.pcolormesh(
        image.range_rate_m_per_s,
        image.range_m[shown],
        decibel,
        cmap="cividis",
        vmin=-3.0,
        vmax=max(float(decibel.max()), 0.0),
        shading="nearest",
        rasterized=True,
    )
    figure.colorbar(drawn, ax=axis, label="power over the noise (dB per cell)")
    axis.set_xlim(*shown_rates(evaluation))
    axis.set_ylim(0, top_range_m(evaluation))
    _mark(axis, evaluation)
    axis.set_title(f"{evaluation.radar.name}: {evaluation.tally}")
    axis.set_xlabel("range rate (m/s), receding is positive")
    axis.set_ylabel("range (m)")
    return figure


def radar_cuts(evaluation: RadarEvaluation) -> Figure:
    """Range cut (strongest rate of each range) and rate cut through the strongest mover."""
    image, shown = evaluation.image, shown_ranges(evaluation)
    figure = new_figure((10.2, 3.3))
    left, right = figure.subplots(1, 2)
    left.plot(image.range_m[shown], _dbm(image.power_w[shown].max(axis=1)), color=BLUE, lw=0.8)
    for target in evaluation.capture.truth:
        level = _dbm(np.array(target.received_w))
        left.plot(target.wrapped_range_m, level, "+", color=ORANGE, ms=9)
    left.set_xlabel("range (m)")
    left.set_title("range cut; crosses: radar equation at the true targets")
    row = mover_row(evaluation)
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


def micro_doppler(evaluation: RadarEvaluation) -> Figure:
    """Spectrogram of each body of which parts turn or swing, with the true rates of its parts."""
    bodies = evaluation.micro_doppler
    figure = new_figure((5.6 * len(bodies), 4.6))
    for axis, body in zip(figure.subplots(1, len(bodies), squeeze=False)[0], bodies, strict=True):
        seen = body.seen
        shown = slice(*np.searchsorted(seen.range_rate_m_per_s, micro_doppler_rates(body)))
        level = _dbm(seen.power_w[shown])
        drawn = axis.pcolormesh(
            1e3 * seen.time_s,
            seen.range_rate_m_per_s[shown],
            level - level.max(),
            cmap="cividis",
            vmin=-40.0,
            vmax=0.0,
            shading="nearest",
            rasterized=True,
        )
        figure.colorbar(drawn, ax=axis, label="dB below the strongest")
        places = part_places(body, *(1e3 * seen.time_s[[0, -1]]))
        for place, part in zip(places, body.parts, strict=True):
            axis.vlines(place, part.least_m_per_s, part.greatest_m_per_s, color=ORANGE, lw=1.6)
            axis.text(
                place,
                part.greatest_m_per_s,
                f" {part.name}",
                rotation=90,
                ha="center",
                va="bottom",
                color="white",
                fontsize=6.5,
                clip_on=True,
            )
        axis.set_title(wrapped(micro_doppler_title(evaluation, body), 62))
        axis.set_xlabel("time within the interval (ms); lines: true rates of parts, side by side")
        axis.set_ylabel("range rate (m/s)")
    return figure


def _mark(axis: Any, evaluation: RadarEvaluation) -> None:
    plot = axis.plot
    ranges = np.nan_to_num([d.range_m for d in evaluation.detections])  # not measured: the only row
    rates = folded(evaluation, [d.range_rate_m_per_s for d in evaluation.detections])
    plot(rates, ranges, "o", mfc="none", mec="white", ms=10, label="detection", ls="none")
    truth = evaluation.capture.truth
    true_rates = folded(evaluation, [t.range_rate_m_per_s for t in truth])
    true_ranges = [t.wrapped_range_m for t in truth]
    plot(true_rates, true_ranges, "+", color=ORANGE, label="true target")
    _name(axis, [target.name for target in truth], true_rates, true_ranges)
    axis.legend(loc="upper left", facecolor="#00204d", labelcolor="white")


def _name(axis: Any, names: list[str], rates: Any, ranges: list[float]) -> None:
    """Names in a column at the right, as far apart as lines of text, each with a line to its mark.

    Those that lie too high for the column stand at its top.
    """
    left, right = axis.get_xlim()
    low, high = axis.get_ylim()
    height, place = _LINE * (high - low), -np.inf
    column = right - 0.02 * (right - left)
    for i in np.argsort(ranges):
        place = max(ranges[i], place + height, low + height)
        axis.annotate(
            names[i],
            (rates[i], ranges[i]),
            xytext=(column, place),
            ha="right",
            va="center",
            color="white",
            fontsize=8,
            arrowprops={"arrowstyle": "-", "color": "white", "lw": 0.5, "shrinkB": 5},
        )


def _dbm(power_w: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(power_w, 1e-30) * 1e3)
