"""What a failed test shows: results side by side, and every seed's figure before and after."""

import base64
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from twin.regression.metrics import RadarResult
from twin.regression.runs import SeedResults
from twin.regression.statistics import Verdict
from twin.report.style import BLUE, GREY, ORANGE, new_figure

_LARGEST_SIDE = 64


def image_example(outcome: SeedResults) -> dict[str, Any]:
    """The first seed's image as a small PNG: the square root of its share of the brightest cell."""
    from PIL import Image

    top = float(np.nanmax(outcome.truth)) or 1.0
    grey = np.rint(255 * _grey(np.nan_to_num(outcome.results[0]) / top)).astype(np.uint8)
    picture = Image.fromarray(grey)
    picture.thumbnail((_LARGEST_SIDE, _LARGEST_SIDE), Image.Resampling.BOX)
    buffer = io.BytesIO()
    picture.save(buffer, format="png")
    return {"png": base64.b64encode(buffer.getvalue()).decode()}


def echo_example(outcome: SeedResults) -> dict[str, Any]:
    """The first seed's detections: range in m, rate in m/s."""
    found: RadarResult = outcome.results[0]
    return {
        "detections": [
            [round(d.range_m, 4), round(d.range_rate_m_per_s, 4)] for d in found.detections
        ]
    }


def draw_images(
    outcome: SeedResults,
    example: dict[str, Any],
    before: dict[str, Any],
    verdicts: Sequence[Verdict],
) -> Figure:
    """Truth, image before and now, what is wrong now, and the figures."""
    figure, axes = _figure(4, verdicts)
    truth, image = outcome.truth, outcome.results[0]
    top = float(np.nanmax(truth)) or 1.0
    aspect = truth.shape[1] / truth.shape[0]
    shown = (_grey(truth / top), _decoded(example), _grey(image / top))
    for axis, picture, title in zip(
        axes, shown, ("truth", "before, seed 0", "now, seed 0"), strict=False
    ):
        side = picture.shape[1] / picture.shape[0]
        axis.imshow(picture, cmap="gray", vmin=0, vmax=1, interpolation="nearest", aspect=side)
        axis.set_title(title)
    error = (np.mean(outcome.results[::2], axis=0) - truth) / top  # the others are mirrored
    reach = float(np.nanpercentile(np.abs(error), 99)) or 1.0
    drawn = axes[3].imshow(error, cmap="PuOr", vmin=-reach, vmax=reach, aspect=aspect)
    axes[3].set_title("now less truth, mean of even seeds")
    figure.colorbar(drawn, ax=axes[3], shrink=0.8, label="share of the brightest true cell")
    for axis in axes[:4]:
        axis.set_axis_off()
    _draw_figures(axes[4:], outcome, before, verdicts)
    return figure


def draw_echoes(
    outcome: SeedResults,
    example: dict[str, Any],
    before: dict[str, Any],
    verdicts: Sequence[Verdict],
) -> Figure:
    """Detections before and now among the true targets, and the figures."""
    figure, axes = _figure(2, verdicts)
    earlier = np.array(example["detections"]).reshape(-1, 2)
    found: RadarResult = outcome.results[0]
    now = np.array([(d.range_m, d.range_rate_m_per_s) for d in found.detections]).reshape(-1, 2)
    places = [(t.wrapped_range_m, t.range_rate_m_per_s) for t in outcome.truth]
    true = np.array(places).reshape(-1, 2)
    for axis, points, title in zip(axes, (earlier, now), ("before", "now"), strict=False):
        axis.plot(*true.T, "o", ms=11, mfc="none", color=GREY, label="visible target")
        axis.plot(*points.T, "x", color=ORANGE, label="detection")
        axis.set_xlabel("range (m)")
        axis.set_ylabel("range rate (m/s)")
        axis.set_title(f"{title}, seed 0: {len(points)} detections")
        axis.legend(frameon=False)
    _draw_figures(axes[2:], outcome, before, verdicts)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a PNG, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")


def _figure(n_pictures: int, verdicts: Sequence[Verdict]) -> tuple[Figure, list[Any]]:
    n = n_pictures + len(verdicts)
    figure = new_figure((3.2 * n, 3.4))
    return figure, figure.subplots(1, n, squeeze=False).ravel().tolist()


def _draw_figures(
    axes: Sequence[Any], outcome: SeedResults, before: dict[str, Any], verdicts: Sequence[Verdict]
) -> None:
    for axis, verdict in zip(axes, verdicts, strict=True):
        metric = verdict.metric
        seeds = np.arange(len(before[metric.name]))
        axis.plot(seeds, before[metric.name], ".", color=BLUE, label="before")
        axis.plot(seeds, outcome.figures[metric.name], ".", color=ORANGE, label="now")
        axis.set_xlabel("noise seed")
        axis.set_ylabel(f"{metric.name}{f' ({metric.unit})' if metric.unit else ''}")
        word = "worse" if verdict.worse else "better" if verdict.better else "same"
        axis.set_title(f"{metric.name}: {word}")
        axis.legend(frameon=False)


def _grey(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """How bright a share of the brightest cell is shown: dark detail would be lost in black."""
    return np.sqrt(np.clip(share, 0, 1))


def _decoded(example: dict[str, Any]) -> NDArray[np.float64]:
    from PIL import Image

    with Image.open(io.BytesIO(base64.b64decode(example["png"]))) as picture:
        return np.asarray(picture, np.float64) / 255


@dataclass(frozen=True)
class Pictures:
    """How results of one sensor are shown.

    example
        What a baseline keeps of the first seed's result.
    draw
        Figure of a failure from results, example and figures before, verdicts.
    """

    example: Callable[[SeedResults], dict[str, Any]]
    draw: Callable[[SeedResults, dict[str, Any], dict[str, Any], Sequence[Verdict]], Figure]


IMAGES = Pictures(image_example, draw_images)
ECHOES = Pictures(echo_example, draw_echoes)
