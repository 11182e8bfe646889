"""Figures of a capture as they are printed, against the same figures of the true light.

Both captures draw the same noise of the sensor, so that only the model's part of an interval is
judged (`Interval.of_model`); shot noise is normal, so that a little more light does not change all
that is drawn after it. It does change which counts are rounded up: differences are the mean of some
draws of the noise. An error of the truth's figure is told by leaving out each of the groups of its
renders (the jackknife) and by the scatter of these differences.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.stated_errors.light_reference import GROUPS, LightReference
from hardware.reconstruction import METHODS, Reconstruction, reconstruct
from twin.accuracy import Interval
from twin.accuracy.interval import TWO_SIDED_95
from twin.camera.acquisition import Capture, measure
from twin.camera.intervals import background_interval, psnr_interval, ssim_interval
from twin.camera.rendered import RenderedLight
from twin.camera.score import psnr_db, similarity
from twin.camera.snr_intervals import snr_interval
from twin.trade.camera import CameraCase

Array = NDArray[np.float64]

_METHOD = "lmmse"  # the vehicle's default
_DRAWS = 8  # of the noise


@dataclass(frozen=True)
class PrintedFigure:
    """Fields of `Judged`."""

    figure: str
    unit: str
    stated: float
    systematic: float
    true: float
    truth_error: float
    truth: str


@dataclass(frozen=True, eq=False)
class _Measured:
    """A capture, and the image of it."""

    capture: Capture
    image: Reconstruction

    @classmethod
    def draws(cls, case: CameraCase, rendered: RenderedLight) -> "list[_Measured]":
        found = []
        for draw in range(_DRAWS):
            rng = np.random.default_rng([case.seed, 8, draw])
            taken = measure(case.scene, case.system, rendered, rng=rng, noise="gaussian")
            found.append(cls(taken, reconstruct(taken.record, METHODS[_METHOD])))
        return found


@dataclass(frozen=True)
class _Figure:
    """A figure: its value, and its interval."""

    name: str
    unit: str
    value: Callable[[_Measured], float]
    interval: Callable[[_Measured], Interval]


def printed_figures(
    case: CameraCase, rendered: RenderedLight, truth: LightReference
) -> Iterator[PrintedFigure]:
    """Of one case; those without a finite value, as of a saturated record, are left out."""
    own = _Measured.draws(case, rendered)
    true = _Measured.draws(case, truth.in_place_of(rendered))
    lit, truly_lit = (int(each[0].capture.lit.sum()) for each in (own, true))
    source = "stock Mitsuba"
    if lit != truly_lit:  # the median SNR is that of the lit cells
        source += f", in which {truly_lit} cells are lit, here {lit}"
    others = [_Measured.draws(case, each) for each in truth.without_each_group(rendered)]
    for figure in _FIGURES:
        if figure is _SUN and truth.sun_groups is None:
            continue
        here, there, *around = (
            np.array([figure.value(each) for each in draws]) for draws in (own, true, *others)
        )
        if not np.isfinite([here, there, *around]).all():
            continue
        interval = figure.interval(own[0]).of_model
        scale = abs(float(there.mean())) if figure.unit == "of it" else 1.0
        if not scale:
            continue
        error = np.hypot(
            np.sqrt(GROUPS - 1) * np.std(np.mean(around, axis=1)),
            np.std(here - there, ddof=1) / np.sqrt(_DRAWS),
        )
        yield PrintedFigure(
            figure=figure.name,
            unit=figure.unit,
            stated=interval.half_width / scale,
            systematic=interval.systematic / scale,
            true=abs(float(np.mean(here - there))) / scale,
            truth_error=TWO_SIDED_95 * float(error) / scale,
            truth=source,
        )


def _whole_light(measured: _Measured) -> float:
    return float(measured.capture.cells_e.sum())


def _whole_interval(measured: _Measured) -> Interval:
    capture = measured.capture
    error = float(np.linalg.norm(capture.cells_error_e))
    return Interval(_whole_light(measured), error, float(np.sum(capture.light_systematic_e)))


def _sun(measured: _Measured) -> float:
    return float(measured.capture.noise.background_e)


def _sun_interval(measured: _Measured) -> Interval:
    return background_interval(measured.capture)


def _median_snr(measured: _Measured) -> float:
    capture = measured.capture
    lit = capture.lit
    return float("nan") if capture.void or not lit.any() else float(np.median(capture.snr[lit]))


def _psnr_db(measured: _Measured) -> float:
    capture = measured.capture
    return (
        float("nan") if capture.void else psnr_db(capture.measured_scene_e, measured.image.picture)
    )


def _ssim(measured: _Measured) -> float:
    capture = measured.capture
    if capture.void:
        return float("nan")
    return similarity(capture.measured_scene_e, measured.image.picture)


_SUN = _Figure("sun", "of it", _sun, _sun_interval)
_FIGURES = (
    _Figure("whole light", "of it", _whole_light, _whole_interval),
    _SUN,
    _Figure("median SNR", "of it", _median_snr, lambda m: snr_interval(m.capture, "median")),
    _Figure("PSNR", "dB", _psnr_db, lambda m: psnr_interval(m.capture, m.image)),
    _Figure("SSIM", "", _ssim, lambda m: ssim_interval(m.capture, m.image)),
)
