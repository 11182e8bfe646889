"""Charts of a radar: its range-Doppler map and cuts through it, in dB over the map's noise."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from twin.accuracy.interval import TWO_SIDED_95
from twin.radar.evaluation import RadarEvaluation
from twin.radar.micro_doppler import DEEPEST_DB, MicroDoppler
from twin.radar.picture import TrackPicture
from twin.report import charts
from twin.report.extent import folded, mover_row, shown_ranges, shown_rates, top_range_m

Array = NDArray[np.float64]

_MOST_CELLS = 400_000  # of the map on the page; of a larger one the strongest of neighbours
_BELOW_DB = -3.0  # below the noise, from which the colours begin
_TRACK_DB = 20.0  # below the peak of a track's image, from which they begin


def map_chart(evaluation: RadarEvaluation) -> charts.Chart:
    """Power by range and range rate, with detections on true targets."""
    image, shown = evaluation.image, shown_ranges(evaluation)
    levels = _over_noise(evaluation, image.power_w[shown])
    rates = image.range_rate_m_per_s
    pooled = _pooled(levels)
    cells = _borders(image.range_m[shown]), _borders(rates)
    rate_low, rate_high = shown_rates(evaluation)
    truth, found = evaluation.capture.truth, evaluation.detections
    names = [target.name for target in truth]
    labels = [match.name if match else "" for match in evaluation.matches]
    return {
        "title": f"{evaluation.radar.name}: {evaluation.tally}",
        "equal": False,
        "axes": True,
        "x": charts.axis("range rate (m/s), receding is positive", rate_low, rate_high),
        "y": charts.axis("range (m)", 0.0, top_range_m(evaluation)),
        "image": charts.raster(
            pooled, cells[1], cells[0], _BELOW_DB, float(levels.max()), "dB over the noise"
        ),
        "layers": [
            charts.layer(
                "true target",
                folded(evaluation, [t.range_rate_m_per_s for t in truth]),
                [t.wrapped_range_m for t in truth],
                mark="plus",
                colour="orange",
                labels=names,
                texts=[f"{t.name}: {number(t.range_m, 5)} m" for t in truth],
            ),
            charts.layer(
                "detection",
                folded(evaluation, [d.range_rate_m_per_s for d in found]),
                np.nan_to_num([d.range_m for d in found]),
                mark="ring",
                colour="white",
                texts=[
                    f"{label or 'detection'}: {number(d.range_m, 5)} m, "
                    f"{number(d.range_rate_m_per_s, 4)} m/s, SNR {number(d.snr_db)} dB"
                    for label, d in zip(labels, found, strict=True)
                ],
                errors=(
                    [TWO_SIDED_95 * d.range_rate_error_m_per_s for d in found],
                    [TWO_SIDED_95 * d.range_error_m for d in found],
                ),
            ),
        ],
    }


def track_chart(track: TrackPicture) -> charts.Chart:
    """Back-projection over a track from above, with true outlines and what is taken for targets."""
    image = track.image
    with np.errstate(divide="ignore"):
        levels = 20 * np.log10(np.abs(image.value))
    down, cross = _borders(image.down_range_m), _borders(image.cross_range_m)
    down_cm, cross_cm = 100 * image.down_resolution_m, 100 * image.cross_resolution_m
    layers = [
        charts.layer(
            "true outline",
            *np.vstack([outline, outline[:1], [[np.nan, np.nan]]]).T,
            colour="orange",
            texts=[name] * (len(outline) + 2),
        )
        for name, outline in track.outlines.items()
    ]
    seen = charts.layer(
        "taken for a true target",
        [s.down_range_m for s in track.seen],
        [s.cross_range_m for s in track.seen],
        mark="ring",
        colour="white",
        texts=[s.name for s in track.seen],
    )
    return {
        "title": f"over the track: resolution {down_cm:.0f} cm ahead, {cross_cm:.1f} cm across",
        "equal": True,
        "axes": True,
        "x": charts.axis("down-range (m)", *down),
        "y": charts.axis("cross-range (m), positive to the left", *cross),
        "image": charts.raster(
            (levels - levels.max()).T, down, cross, -_TRACK_DB, 0.0, "dB over the peak"
        ),
        "layers": [*layers, seen],
    }


def cut_charts(evaluation: RadarEvaluation) -> list[charts.Chart]:
    """Strongest cell of each range; and rates at the range of the strongest mover."""
    image, shown = evaluation.image, shown_ranges(evaluation)
    levels = _over_noise(evaluation, image.power_w[shown])
    truth = evaluation.capture.truth
    names = [t.name for t in truth]
    top = float(levels.max()) + 6
    expected = _over_noise(evaluation, np.array([t.received_w for t in truth]))
    profile: charts.Chart = {
        "title": "range cut: the strongest rate of each range",
        "equal": False,
        "axes": True,
        "x": charts.axis("range (m)", 0, top_range_m(evaluation)),
        "y": charts.axis("dB over the noise per cell", -6, top),
        "layers": [
            charts.layer("measured", image.range_m[shown], levels.max(axis=1)),
            charts.layer(
                "radar equation at the true target",
                [t.wrapped_range_m for t in truth],
                expected,
                mark="plus",
                colour="orange",
                labels=names,
                texts=names,
            ),
            _noise(0, float(image.range_m[shown][-1])),
        ],
    }
    row, rates = mover_row(evaluation), image.range_rate_m_per_s
    rate_low, rate_high = shown_rates(evaluation)
    spectrum = _over_noise(evaluation, image.power_w[row])
    return [
        profile,
        {
            "title": f"rate cut at {image.range_m[row]:.2f} m",
            "equal": False,
            "axes": True,
            "x": charts.axis("range rate (m/s)", rate_low, rate_high),
            "y": charts.axis("dB over the noise per cell", -6, float(spectrum.max()) + 6),
            "layers": [
                charts.layer("measured", rates, spectrum),
                _noise(float(rates[0]), float(rates[-1])),
            ],
        },
    ]


def micro_doppler_charts(evaluation: RadarEvaluation) -> list[charts.Chart]:
    """Of each body of which parts turn or swing: power by time and range rate, and true rates."""
    return [_micro_doppler(evaluation, body) for body in evaluation.micro_doppler]


def _micro_doppler(evaluation: RadarEvaluation, body: MicroDoppler) -> charts.Chart:
    seen, parts = body.seen, body.parts
    shown = slice(*np.searchsorted(seen.range_rate_m_per_s, micro_doppler_rates(body)))
    levels = 10 * np.log10(np.maximum(seen.power_w[shown], 1e-30))
    top, times_ms = float(levels.max()), 1e3 * seen.time_s
    rates = seen.range_rate_m_per_s[shown]
    left, right = _borders(times_ms)
    low, high = _borders(rates)
    middles = [(part.least_m_per_s + part.greatest_m_per_s) / 2 for part in parts]
    halves = [(part.greatest_m_per_s - part.least_m_per_s) / 2 for part in parts]
    return {
        "title": micro_doppler_title(evaluation, body),
        "equal": False,
        "axes": True,
        "x": charts.axis("time within the interval (ms)", left, right),
        "y": charts.axis("range rate (m/s), receding is positive", low, high),
        "image": charts.raster(
            levels - top, (left, right), (low, high), -40.0, 0.0, "dB below the strongest"
        ),
        "layers": [
            charts.layer(
                "true rates of its parts, side by side",
                part_places(body, left, right),
                middles,
                mark="plus",
                colour="orange",
                labels=[part.name for part in parts],
                texts=[
                    f"{part.name}: {number(part.least_m_per_s, 3)} to "
                    f"{number(part.greatest_m_per_s, 3)} m/s"
                    for part in parts
                ],
                errors=([0.0] * len(parts), halves),
            )
        ],
    }


def micro_doppler_title(evaluation: RadarEvaluation, body: MicroDoppler) -> str:
    """What the spectrogram of a body shows, in words."""
    low, high = body.heard_m_per_s
    heard = f"rates from {low:.2f} to {high:.2f} m/s heard within {body.depth_db:.0f} dB"
    if np.isnan(low):
        heard = "no echo above the noise"
    elif body.depth_db < DEEPEST_DB:
        heard += ", down to the noise"
    return (
        f"micro-Doppler of {body.name} at {number(body.seen.range_m, 3)} m: {heard}, "
        f"its parts have {body.least_m_per_s:.2f} to {body.greatest_m_per_s:.2f} m/s"
    )


def micro_doppler_rates(body: MicroDoppler) -> tuple[float, float]:
    """Range rates that are shown: a third beyond those of the parts, within what is unambiguous."""
    rates, cell = body.seen.range_rate_m_per_s, np.diff(body.seen.range_rate_m_per_s[:2])[0]
    margin = max((body.greatest_m_per_s - body.least_m_per_s) / 3, 8 * float(cell))
    low, high = body.least_m_per_s - margin, body.greatest_m_per_s + margin
    if low < rates[0] or high > rates[-1]:  # folded: all of them
        return float(rates[0]), np.inf
    return low, high


def part_places(body: MicroDoppler, left: float, right: float) -> Array:
    """Where the rates of parts stand along the axis of time, side by side."""
    n = len(body.parts)
    return left + (right - left) * (np.arange(n, dtype=np.float64) + 0.5) / n


def _noise(low: float, high: float) -> dict[str, Any]:
    return charts.layer("noise", [low, high], [0, 0], colour="soft", dashed=True)


def _over_noise(evaluation: RadarEvaluation, power_w: NDArray[np.floating[Any]]) -> Array:
    noise_w = max(evaluation.image.noise_w, 1e-300)
    return np.asarray(10 * np.log10(np.maximum(power_w, 1e-30 * noise_w) / noise_w))


def _borders(middles: Sequence[float] | Array) -> tuple[float, float]:
    """Outer borders of cells with these middles."""
    half = (middles[1] - middles[0]) / 2 if len(middles) > 1 else 0.5
    return float(middles[0] - half), float(middles[-1] + half)


def _pooled(levels: Array) -> Array:
    """The strongest of neighbouring ranges, where the map has too many cells for the page."""
    step = -(-levels.size // _MOST_CELLS)
    if step == 1:
        return levels
    padding = -len(levels) % step
    padded = np.pad(levels, ((0, padding), (0, 0)), constant_values=-np.inf)
    return np.asarray(padded.reshape(-1, step, levels.shape[1]).max(axis=1))
