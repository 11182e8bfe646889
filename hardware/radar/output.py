"""Maps and images as grey PNG files in decibels, and detections as CSV."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.files import whole_file
from hardware.formatting import number, with_error
from hardware.png import write_grey
from hardware.radar.detection import Detection
from hardware.radar.imaging import RadarImage
from hardware.radar.spectrogram import Spectrogram


def write_png(path: Path, power: NDArray[np.floating[Any]], span_db: float = 50.0) -> None:
    """Grey image, white at the peak, black ``span_db`` below it; row 0 on top.

    Raises InputError where Pillow (the extra ``png``) is not installed.
    """
    peak = float(power.max(initial=0.0)) or 1.0
    with np.errstate(divide="ignore"):
        write_grey(path, 1 + 10 * np.log10(power / peak) / span_db)


def write_detections(path: Path, detections: Iterable[tuple[int, Detection]]) -> None:
    """One row per detection, after the number of its burst; unknown values are empty."""
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["burst", *(f.name for f in fields(Detection))])
        writer.writerows([burst, *map(cell, astuple(detection))] for burst, detection in detections)


def cell(value: float | tuple[float, ...]) -> float | str:
    """Table cell of a number: empty for NaN; several are separated by semicolons."""
    if isinstance(value, tuple):
        return ";".join(f"{each:.6g}" for each in value)
    return "" if np.isnan(value) else value


def write_image(path: Path, image: RadarImage) -> None:
    """Power in dB over its peak: cross-range along the first row, down-range first in each."""
    power = np.abs(image.value) ** 2
    with np.errstate(divide="ignore"):
        level = 10 * np.log10(power / (power.max() or 1.0))
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["down_range_m", *map("{:.6g}".format, image.cross_range_m)])
        for down, row in zip(image.down_range_m, level, strict=True):
            writer.writerow([f"{down:.6g}", *map("{:.2f}".format, row)])


def write_spectrogram(path: Path, seen: Spectrogram) -> None:
    """Power in dBm: times along the first row, the range rate first in each."""
    with np.errstate(divide="ignore"):
        level = 10 * np.log10(1e3 * seen.power_w)
    with whole_file(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["range_rate_m_per_s", *map("{:.9g}".format, seen.time_s)])
        for rate, row in zip(seen.range_rate_m_per_s, level, strict=True):
            writer.writerow([f"{rate:.6g}", *map("{:.2f}".format, row)])


_HEAD = ("range", "range rate", "azimuth", "elevation", "SNR", "cross-section", "")


def table_rows(detections: Sequence[Detection], most: int = 20) -> Iterable[str]:
    """Detections as a table for a terminal, each value with its standard error; elevations where
    any of them has one.
    """
    shown = detections[:most]
    rows = [_HEAD, *(_cells(detection) for detection in shown)]
    if all(np.isnan(detection.elevation_rad) for detection in shown):
        rows = [tuple(row[:3] + row[4:]) for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        aligned = (f"{text:>{width}}" for text, width in zip(row, widths, strict=True))
        yield f"  {'  '.join(aligned)}".rstrip()
    if len(detections) > most:
        yield f"  ... and {len(detections) - most} more"


def _cells(d: Detection) -> tuple[str, ...]:
    """Texts under the head; a dash for what is not measured."""
    return (
        _known(d.range_m, with_error(d.range_m, d.range_error_m, "m")),
        _known(
            d.range_rate_m_per_s,
            with_error(d.range_rate_m_per_s, d.range_rate_error_m_per_s, "m/s"),
        ),
        _angle(d.azimuth_rad, d.azimuth_error_rad),
        _angle(d.elevation_rad, d.elevation_error_rad),
        f"{d.snr_db:.1f} dB",
        _known(d.rcs_m2, _cross_section(d)),
        _alternatives(d),
    )


def _angle(angle_rad: float, error_rad: float) -> str:
    return _known(angle_rad, with_error(np.degrees(angle_rad), np.degrees(error_rad), "deg"))


def _cross_section(d: Detection) -> str:
    error_m2 = d.rcs_error_m2
    if np.isnan(error_m2):  # of a detection of one's own
        return f"{number(d.rcs_m2)} m^2"
    return with_error(d.rcs_m2, error_m2, "m^2")


def _known(value: float, text: str) -> str:
    return "-" if np.isnan(value) else text


def _alternatives(detection: Detection) -> str:
    rates = ", ".join(f"{rate:+.3f}" for rate in detection.range_rate_alternatives_m_per_s)
    by_name = {
        "azimuth": detection.azimuth_alternatives_rad,
        "elevation": detection.elevation_alternatives_rad,
    }
    told = {
        name: np.degrees(each)
        for name, each in by_name.items()
        if each and not np.isnan(each).any()
    }
    name = "/".join(told)
    angles = ", ".join(
        "/".join(f"{angle:+.1f}" for angle in both) for both in zip(*told.values(), strict=False)
    )
    return "; ".join(
        [f"rate ambiguous, or {rates} m/s"] * bool(rates)
        + [f"{name} ambiguous, or {angles} deg"] * bool(angles)
    )
