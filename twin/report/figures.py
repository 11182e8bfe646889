"""Figures of the optical report. Titles state the result; colour maps are colour-blind safe."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hardware.formatting import quantity_text
from hardware.patterns import OwnPatterns, RasterScan
from twin.camera.evaluation import Evaluation
from twin.camera.verdict import ImageVerdict
from twin.camera.view import View
from twin.report.style import BLUE, GREY, ORANGE, new_figure, wrapped

Array = NDArray[np.float64]


def headline(view: View, evaluations: Sequence[Evaluation]) -> Figure:
    """Scene, noise-free image, and reconstruction of each system."""
    first = evaluations[0]
    figure, axes = _panels(1, 2 + len(evaluations), 3.1)
    _image(axes[0], view.total, "scene at 1550 nm, sun and emitter")
    _image(axes[1], first.capture.cells_e, "what a noise-free camera would see")
    for axis, evaluation in zip(axes[2:], evaluations, strict=True):
        lux = evaluation.capture.illuminance_lx
        _image(
            axis,
            evaluation.reconstructions[0].picture,
            f"{evaluation.system.name}, {_lux(lux)}: {evaluation.verdict.short}",
        )
    return figure


def scene_view(view: View) -> Figure:
    """The scene in the light of the sun and in that of the emitter."""
    figure, axes = _panels(1, 2, 4.2)
    share = view.emitter.sum() / max(view.total.sum(), np.finfo(float).tiny)
    _image(axes[0], view.sun, f"sun: {1 - share:.1%} of the light in the band")
    _image(axes[1], view.emitter, f"emitter, all cells lit: {share:.1%} of the light")
    return figure


def truth(evaluation: Evaluation) -> Figure:
    """Albedo and depth beside the reconstruction."""
    known = evaluation.capture.truth
    figure, axes = _panels(1, 3, 3.4)
    drawn = axes[0].imshow(known.albedo, cmap="gray", vmin=0, vmax=1, aspect=_aspect(known.albedo))
    figure.colorbar(drawn, ax=axes[0], shrink=0.8, label="reflectance at 1550 nm")
    axes[0].set_title("true albedo")
    drawn = axes[1].imshow(
        np.where(np.isfinite(known.depth_m), known.depth_m, np.nan),
        cmap="viridis_r",
        aspect=_aspect(known.depth_m),
    )
    figure.colorbar(drawn, ax=axes[1], shrink=0.8, label="depth along the boresight (m)")
    axes[1].set_title("true depth")
    _image(axes[2], evaluation.reconstructions[0].picture, f"reconstructed ({evaluation.best})")
    return figure


def reconstructions(evaluation: Evaluation) -> Figure:
    """Every method on the same record, beside the noise-free image."""
    figure, axes = _panels(1, 1 + len(evaluation.reconstructions), 3.4)
    _image(axes[0], evaluation.capture.cells_e, "noise-free")
    verdict = evaluation.verdict
    pairs = zip(evaluation.reconstructions, evaluation.scores, strict=True)
    for axis, (image, score) in zip(axes[1:], pairs, strict=True):
        _image(axis, image.picture, f"{image.method}: {verdict.short if verdict.void else score}")
    return figure


def snr_maps(evaluations: Sequence[Evaluation]) -> Figure:
    """Signal per pixel over noise per pixel, one scale for all systems."""
    figure, axes = _panels(1, len(evaluations), 3.6)
    norm = LogNorm(1e-2, 1e2)
    for axis, evaluation in zip(axes, evaluations, strict=True):
        snr = evaluation.capture.snr
        axis.imshow(np.maximum(snr, 1e-3), cmap="cividis", norm=norm, aspect=_aspect(snr))
        if min(snr.shape) > 1 and snr.min() < 1 < snr.max():
            axis.contour(snr, levels=[1.0], colors="white", linewidths=0.7)
        axis.set_title(wrapped(f"{evaluation.system.name}: {_above(evaluation.verdict)}"))
    scale = ScalarMappable(norm, "cividis")
    figure.colorbar(scale, ax=axes, shrink=0.85, label="signal / noise per pixel (line: 1)")
    return figure


def signal(evaluation: Evaluation) -> Figure:
    """Measured counts by exposure, and the noise of one exposure by origin."""
    record, noise = evaluation.capture.record, evaluation.capture.noise
    figure = new_figure((10.2, 3.3))
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1))
    counts = record.counts[:, record.counts.shape[1] // 2]
    patterns = record.patterns
    own = isinstance(patterns, OwnPatterns)
    if patterns.mode == "differential":
        left.plot(counts[0::2], ".", ms=1.6, color=BLUE, label="pattern")
        left.plot(counts[1::2], ".", ms=1.6, color=ORANGE, label="complement")
        left.legend(markerscale=5, frameon=False, loc="upper right")
    else:
        left.plot(counts, ".", ms=1.6, color=BLUE)
    kind = "own" if own else "Hadamard"
    scanned = f"cell of the scan, {len(record.shutters)} shutters each"
    raster = isinstance(patterns, RasterScan)
    left.set_xlabel(scanned if raster else f"{kind} pattern ({patterns.order} order)")
    left.set_ylabel("ADC counts")
    used = np.ptp(counts) / 2**record.adc_bits
    left.set_title(f"the patterns move {used:.2%} of the converter's range")
    names = list(noise.noise_e)
    values = [noise.noise_e[name] for name in names]
    order = np.argsort(values)
    colors = [ORANGE if i == order[-1] else GREY for i in order]
    right.barh([names[i] for i in order], [values[i] for i in order], color=colors)
    for row, i in enumerate(order):
        right.text(values[i], row, f" {values[i]:,.0f}", va="center")
    right.set_xlabel("electrons rms, one exposure")
    right.margins(x=0.18)
    right.set_title(f"{names[order[-1]]} dominates")
    return figure


def _panels(rows: int, columns: int, side: float) -> tuple[Figure, list[Any]]:
    figure = new_figure((columns * side, rows * side + 0.25))
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes:
        axis.set_axis_off()
    return figure, axes


def _image(axis: Any, image: Array, title: str) -> None:
    """Grey image, square-root scale from 0 to its 99.5th percentile.

    Cells without a value are left blank.
    """
    top = float(np.nanpercentile(image, 99.5))
    shown = np.sqrt(np.clip(image / top, 0, 1)) if top > 0 else np.zeros_like(image)
    aspect = _aspect(image)
    axis.imshow(shown, cmap="gray", vmin=0, vmax=1, interpolation="nearest", aspect=aspect)
    axis.set_title(wrapped(title))


def _aspect(image: Array) -> float:
    """Height over width of a cell: the field is square, however many rows and columns it has."""
    return image.shape[1] / image.shape[0]


def _above(verdict: ImageVerdict) -> str:
    if verdict.void:
        return verdict.short
    return f"{verdict.above_noise_share:.0%} of lit pixels above noise"


def _lux(lux: float) -> str:
    return quantity_text(lux, "lx")
