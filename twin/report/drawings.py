"""Figures of a run as PNG files, for slides and papers; the page draws charts of its own.

Loading Matplotlib and laying out the figures takes longer than all the rest of a report, so they
are drawn where they are asked for.
"""

import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.camera.evaluation import Evaluation
from twin.camera.view import View
from twin.radar.evaluation import RadarEvaluation
from twin.report import figures, radar_figures


def write_figures(
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
    folder: Path,
) -> None:
    """Write a PNG file for each figure of the sensors that there are."""
    drawn: dict[str, Figure] = {}
    if view:
        drawn |= _drawn_by_light(view, evaluations)
    if radar:
        drawn |= _drawn_by_radar(radar)
    for name, figure in drawn.items():
        (folder / f"{name}.png").write_bytes(_png(figure))


def _drawn_by_light(view: View, evaluations: Sequence[Evaluation]) -> dict[str, Figure]:
    first = evaluations[0]
    return {
        "headline": figures.headline(view, evaluations),
        "scene": figures.scene_view(view),
        "truth": figures.truth(first),
        "reconstruction": figures.reconstructions(first),
        "snr": figures.snr_maps(evaluations),
        "signal": figures.signal(first),
    }


def _drawn_by_radar(radar: RadarEvaluation) -> dict[str, Figure]:
    drawn = {
        "range_doppler": radar_figures.radar_map(radar),
        "radar_cuts": radar_figures.radar_cuts(radar),
    }
    if radar.micro_doppler:
        drawn["micro_doppler"] = radar_figures.micro_doppler(radar)
    if radar.picture:
        drawn["radar_image"] = radar_figures.track_image(radar.picture)
    return drawn


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    # What `savefig` writes, without its rehearsal of every figure.
    canvas = FigureCanvasAgg(figure)
    canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 3})
    return buffer.getvalue()
