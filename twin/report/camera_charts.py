"""Charts of a camera: pictures by source of light, truth, reconstructions, SNR, counts."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import OwnPatterns, RasterScan
from twin.camera.evaluation import Evaluation
from twin.camera.view import View
from twin.report import charts
from twin.report.measured import emitter_share, range_used
from twin.report.overview import grey

Array = NDArray[np.float64]

_FIELD = (-1.0, 1.0), (1.0, -1.0)
_MOST_POINTS = 8192  # of a series; of a longer one every n-th


def light_charts(view: View) -> Iterator[charts.Chart]:
    """The scene in the light of the sun and in that of the emitter."""
    share = emitter_share(view)
    yield _picture(f"sun: {1 - share:.1%} of the light in the band", grey(view.sun))
    yield _picture(f"emitter, all cells lit: {share:.1%} of the light", grey(view.emitter))


def truth_charts(evaluation: Evaluation) -> Iterator[charts.Chart]:
    """True reflectance and depth."""
    known = evaluation.capture.truth
    yield _picture("true reflectance at 1550 nm", known.albedo)
    depth = np.where(np.isfinite(known.depth_m), known.depth_m, np.nan)
    far = float(np.nanmax(depth)) if np.isfinite(depth).any() else 1.0
    near = float(np.nanmin(depth)) if np.isfinite(depth).any() else 0.0
    yield _picture("true depth along the boresight", depth, near, far, "m", colours="heat")


def reconstruction_charts(evaluation: Evaluation) -> Iterator[charts.Chart]:
    """What a noise-free camera would see, and every method on the same record."""
    name, verdict = evaluation.system.name, evaluation.verdict
    yield _picture(f"{name}: noise-free", grey(evaluation.capture.cells_e))
    pairs = zip(evaluation.reconstructions, evaluation.scores, strict=True)
    for image, score in pairs:
        said = verdict.short if verdict.void else str(score)
        yield _picture(f"{name}, {image.method}: {said}", grey(image.picture))


def snr_chart(evaluation: Evaluation) -> charts.Chart:
    """Signal per pixel over noise per pixel, on a logarithmic scale."""
    snr, verdict = evaluation.capture.snr, evaluation.verdict
    with np.errstate(divide="ignore"):
        level = np.log10(np.maximum(snr, 0.0))
    said = (
        verdict.short
        if verdict.void
        else f"{verdict.above_noise_share:.0%} of lit pixels above noise"
    )
    level = np.where(np.isfinite(level), level, -2.0)
    chart = _picture(f"{evaluation.system.name}: {said}", level, -2, 2, "SNR", colours="heat")
    chart["image"]["log"] = True
    return chart


def counts_chart(evaluation: Evaluation) -> charts.Chart:
    """Counts of the middle detector by exposure, in the order in which they were taken."""
    record = evaluation.capture.record
    counts = record.counts[:, record.counts.shape[1] // 2].astype(np.float64)
    patterns = record.patterns
    series: Sequence[tuple[str, str, Array]] = [("exposure", "blue", counts)]
    if patterns.mode == "differential":
        pattern, complement = counts[0::2], counts[1::2]
        series = [("pattern", "blue", pattern), ("complement", "orange", complement)]
    kind = "own" if isinstance(patterns, OwnPatterns) else "Hadamard"
    scanned = f"cell of the scan, {len(record.shutters)} shutters each"
    raster = isinstance(patterns, RasterScan)
    layers, longest = [], 1
    for name, colour, values in series:
        step = max(1, -(-len(values) // _MOST_POINTS))
        words = name if step == 1 else f"{name}, every {step}th"
        at = np.arange(0, len(values), step)
        layers.append(charts.layer(words, at, values[at], mark="dot", colour=colour))
        longest = max(longest, len(values))
    pad = max(0.05 * float(np.ptp(counts)), 1.0)
    used = f"patterns move {range_used(evaluation):.2%} of the converter's range"
    return {
        "title": f"{evaluation.system.name}: {used}",
        "equal": False,
        "axes": True,
        "x": charts.axis(
            scanned if raster else f"{kind} pattern ({patterns.order} order)", 0, longest
        ),
        "y": charts.axis("ADC counts", float(counts.min()) - pad, float(counts.max()) + pad),
        "layers": layers,
    }


def _picture(
    title: str,
    levels: Array,
    low: float = 0.0,
    high: float = 1.0,
    unit: str = "",
    colours: str = "grey",
) -> charts.Chart:
    return {
        "title": title,
        "equal": True,
        "axes": False,
        "x": charts.axis("", -1, 1),
        "y": charts.axis("", -1, 1),
        "image": charts.raster(levels, *_FIELD, low, high, unit, colours=colours),
        "layers": [],
    }
