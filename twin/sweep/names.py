"""Names of what a study may measure, with unit and meaning."""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from twin.errors import InputError


@dataclass(frozen=True)
class Named:
    """A number's unit and what it is; ``better``: more of it, or less, which each says itself;
    ``of_radar``: the radar must run for it, ``of_image``: an image must be reconstructed;
    ``why_void``: it says why a record is void, and is listed of void points too.
    """

    unit: str
    meaning: str
    better: Literal["more", "less"]
    of_radar: bool = False
    of_image: bool = False
    why_void: bool = False


#: Said with what is solved for: at the time or distance found, either may be another.
_NOISE_ALONE = "of noise alone: neither lag nor clipping is counted"
_ALL_LIT = f"of one exposure with all cells lit, {_NOISE_ALONE}"
RENDERED = {
    "snr_median": Named(
        "1",
        "signal over noise per pixel, median of those that are lit, of noise alone: what patterns "
        "that are not shown would add is not counted",
        "more",
    ),
    "snr_above_1": Named("1", "share of lit pixels above their noise", "more"),
    "signal_e": Named("e", "signal of one average exposure", "more"),
    "background_e": Named("e", "sun in one exposure", "less"),
    "noise_e": Named("e", "noise of one exposure", "less"),
    "saturated": Named("1", "share of exposures marked saturated", "less", why_void=True),
    "in_band": Named("1", "share of the emitter's line inside the filter", "more"),
    "psnr_db": Named("dB", "peak signal-to-noise ratio of the image", "more", of_image=True),
    "ssim": Named("1", "structural similarity of the image", "more", of_image=True),
    "minimum_time_s": Named(
        "s", f"integration for SNR 1 in the median lit pixel, {_NOISE_ALONE}", "less"
    ),
    "maximum_distance_m": Named(
        "m", f"distance for SNR 1 in the median lit pixel, {_NOISE_ALONE}", "more"
    ),
    "frame_rate_hz": Named("Hz", "frames per second, acquisition alone", "more"),
    "range_error_m": Named("m", "largest range error of a detected target", "less", of_radar=True),
    "detections": Named("1", "true targets that are detected", "more", of_radar=True),
}
CLOSED_FORM = {
    "signal_e_per_s": Named("e/s", "photo-electrons of the emitter, all cells lit", "more"),
    "background_e_per_s": Named("e/s", "photo-electrons of the sun, and dark current", "less"),
    "snr": Named("1", f"signal over noise {_ALL_LIT}", "more"),
    "minimum_time_s": Named("s", f"integration for SNR 1 {_ALL_LIT}", "less"),
    "maximum_distance_m": Named("m", f"distance for SNR 1 {_ALL_LIT}", "more"),
}


#: Of a rendered metric, columns of what the model may be off by, with their meaning.
MODEL_ERRORS = {
    "standard_error": "standard error of the model",
    "systematic": "bound of the model's systematic error",
}
#: The same, and what the metric scatters by.
ERRORS = {**MODEL_ERRORS, "noise": "standard deviation over draws of the sensor's noise"}


def columns_of(metrics: Iterable[str], model: str) -> list[str]:
    """Columns of numbers: each metric, and those of its errors; a closed form has none."""
    kinds = ERRORS if model == "rendered" else ()
    return [column for name in metrics for column in (name, *(f"{name}.{kind}" for kind in kinds))]


def error_of(column: str) -> tuple[str, str] | None:
    """Metric and kind of a column of errors; None for a metric's own."""
    metric, _, kind = column.rpartition(".")
    return (metric, kind) if metric and kind in ERRORS else None


#: Entry points by which installed packages offer metrics.
GROUP = "twin.metric"


def is_own(metric: str) -> bool:
    """Whether a metric is a user's own function: none of the bundled ones."""
    return metric not in RENDERED and metric not in CLOSED_FORM


def _may_be_found(metric: str) -> bool:
    """Whether a user's own metric says where it is, or an installed package offers it."""
    from importlib.metadata import entry_points

    return ":" in metric or metric in entry_points(group=GROUP).names


def needs_radar(metrics: Iterable[str]) -> bool:
    """Whether a metric looks at the radar; a user's own may."""
    return any((name in RENDERED and RENDERED[name].of_radar) or is_own(name) for name in metrics)


def needs_image(metrics: Iterable[str]) -> bool:
    """Whether a metric looks at a reconstruction; a user's own may."""
    return any((name in RENDERED and RENDERED[name].of_image) or is_own(name) for name in metrics)


def check_metrics(metrics: tuple[str, ...], model: str) -> None:
    """Raise InputError, with the nearest name, for a metric that a model does not have."""
    known = RENDERED if model == "rendered" else CLOSED_FORM
    for name in metrics:
        if name in known or (is_own(name) and model == "rendered" and _may_be_found(name)):
            continue
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}? There are" if near else "expected"
        if not is_own(name):
            other = "closed-form" if model == "rendered" else "rendered"
            hint = f'it belongs to model = "{other}"; there are'
        raise InputError(f"metrics: {name!r} is unknown; {hint} {', '.join(known)}")
    if len(set(metrics)) != len(metrics):
        raise InputError("metrics: a name stands twice")


def check_front(front: tuple[str, str] | None, metrics: tuple[str, ...]) -> None:
    """Raise InputError for a front that is not of two of the metrics."""
    if front is None:
        return
    for name in front:
        if name not in metrics:
            raise InputError(f"front: {name!r} is none of the metrics {', '.join(metrics)}")
    check_two(*front)


def check_two(first: str, second: str) -> None:
    """Raise InputError for a front of one metric."""
    if first == second:
        raise InputError(f"front: {first!r} stands twice, expected two metrics")
