"""What a study may measure of a point: metrics by name."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np

from hardware.own_functions import OwnFunction, OwnFunctionError
from hardware.read_only import cached_read_only
from hardware.reconstruction import Reconstruction, reconstruct
from twin.accuracy import Interval, propagated
from twin.camera.acquisition import Capture
from twin.camera.intervals import (
    background_interval,
    noise_interval,
    psnr_interval,
    signal_interval,
    ssim_interval,
)
from twin.camera.score import Score, score_of
from twin.camera.snr_intervals import snr_interval
from twin.detector.flicker import FLICKER
from twin.errors import InputError
from twin.radar.detection_count import targets_detected
from twin.radar.evaluation import RadarEvaluation
from twin.sweep.inputs import Inputs
from twin.sweep.setup import Setup

T = TypeVar("T")


def _computed(function: Callable[["Outcome"], T]) -> cached_property[T]:
    """A result of a point, computed once and read-only, with NumPy's floating-point errors handled
    as before any metric: one that asks may have set them to be raised, where the twin underflows.
    """

    @wraps(function)
    def made(outcome: "Outcome") -> T:
        with np.errstate(**outcome._numpy_errors):
            return function(outcome)

    return cached_read_only(made)


@dataclass(frozen=True, eq=False)
class Outcome:
    """One point's results, each computed when a metric first asks for it. Metrics share them with
    each other and with other points: they cannot be assigned, and all arrays that they hold are
    read-only.
    """

    setup: Setup
    _capture: Callable[[], Capture]
    _radar: Callable[[], RadarEvaluation]
    _numpy_errors: Any = field(default_factory=np.geterr, init=False)

    @_computed
    def capture(self) -> Capture:
        """The camera's record, with what the twin knows about it."""
        return self._capture()

    @_computed
    def reconstruction(self) -> Reconstruction:
        """The image, by the point's method."""
        return reconstruct(self.capture.record, self.setup.method)

    @_computed
    def score(self) -> Score:
        """The image, less backscatter, against the light of the scene."""
        return score_of(self.capture, self.reconstruction.picture)

    @_computed
    def radar(self) -> RadarEvaluation:
        """Detections and what they should have been."""
        return self._radar()


def _pixel_terms(
    outcome: Outcome, times_signal: float, times_sun: float
) -> tuple[float, float, float, float]:
    """Of the median lit pixel: signal and all that is collected, e/s; constant noise and noise that
    grows with time, both as what is left in a pixel: k^2 (collected T + constant^2 + (rate T)^2).
    Signal and sun are taken as many times.
    """
    taken, system = outcome.capture, outcome.setup.system
    time = system.acquisition.integration_time_s.value
    noise = taken.noise.noise_e
    shot = ("shot noise of the signal", "shot noise of the sun", "shot noise of the dark current")
    if system.detector.function is not None:
        raise InputError(
            "metrics: minimum_time_s and maximum_distance_m know how the noise of the bundled "
            "photodiode grows with time, and not that of a detector.function"
        )
    if system.is_raster:
        raise InputError(
            "metrics: minimum_time_s and maximum_distance_m know pattern sets, whose pixels share "
            "the noise of all exposures, and not acquisition.order raster"
        )
    factor = taken.noise.pixel_noise_e(system.patterns) / taken.noise.total_noise_e
    has_tia = system.readout.transimpedance_ohm is not None
    growing = [noise["fluctuation of the emitter"]]
    constant = [noise["read noise"]]
    # A transimpedance amplifier averages: its converter's step grows with time.
    (growing if has_tia else constant).append(noise["quantisation"])
    times = (times_signal, times_sun, 1.0)
    linear = [noise[name] * math.sqrt(x) for name, x in zip(shot, times, strict=True)]
    # 1/f noise grows as white noise of the amplifier does, and with the root of time besides.
    johnson, read, slow = (
        noise["Johnson noise of the amplifier"],
        noise["read noise"],
        noise[FLICKER],
    )
    white = math.hypot(johnson, read) or 1.0
    linear += [johnson, slow * read / white]
    growing.append(slow * johnson / white)
    lit = taken.scene_e[taken.lit]
    signal = times_signal * float(np.median(lit)) / factor / time if lit.size else 0.0
    return (
        signal,
        sum(x**2 for x in linear) / time,
        math.hypot(*constant),
        math.hypot(*growing) / time,
    )


def minimum_time_s(outcome: Outcome, times_signal: float = 1.0, times_sun: float = 1.0) -> float:
    """Integration time at which the median lit pixel equals its noise; infinite where none does.

    (s T)^2 = c T + r^2 + (g T)^2, with the patterns, sun and readout of the point. What exposures
    leave in the next ones and what rails cut off change with the time, and are not counted.
    """
    s, c, r, g = _pixel_terms(outcome, times_signal, times_sun)
    a = s * s - g * g
    if s <= 0 or a <= 0:
        return math.inf
    return (c + math.sqrt(c * c + 4 * a * r * r)) / (2 * a)


def maximum_distance_m(
    outcome: Outcome, times_signal: float = 1.0, times_sun: float = 1.0
) -> float:
    """Distance at which the median lit pixel would equal its noise.

    Its signal falls with 1 / z^2, the sun's part stays. Nothing in the field: not a number. Counts
    noise as `minimum_time_s` does.
    """
    s, c, r, g = _pixel_terms(outcome, times_signal, times_sun)
    taken = outcome.capture
    depth = taken.truth.depth_m[np.isfinite(taken.truth.depth_m) & taken.lit]
    if not depth.size or s <= 0:
        return math.nan
    time = outcome.setup.system.acquisition.integration_time_s.value
    own = times_signal * taken.noise.noise_e["shot noise of the signal"] ** 2
    other = c * time - own + r * r
    # (s x T)^2 = own x + other + (g x T)^2 with x = (z0 / z)^2
    a = (s * time) ** 2 - (g * time) ** 2
    if a <= 0:
        return 0.0
    x = (own + math.sqrt(own * own + 4 * a * other)) / (2 * a)
    return float(np.median(depth)) / math.sqrt(x)


def _range_error(outcome: Outcome) -> Interval:
    """The largest, with the model's error of that detection."""
    radar = outcome.radar
    errors = [
        (abs(found.range_m - true.wrapped_range_m), model.range_m)
        for found, model, true in zip(radar.detections, radar.intervals, radar.matches, strict=True)
        if true
    ]
    if not errors:
        return Interval(math.nan)
    largest, model = max(errors, key=lambda pair: pair[0])
    return replace(model, value=largest)


def _of_pixel_terms(solve: Callable[..., float], outcome: Outcome) -> Interval:
    """A time or distance with what errors of the signal and of the sun make of it."""
    return propagated(
        lambda signal, sun: solve(outcome, max(signal, 0.0), max(sun, 0.0)),
        *(
            propagated(lambda value, here=each.value: value / here, each)
            if each.value > 0
            else Interval(1.0)
            for each in (_median_signal(outcome), background_interval(outcome.capture))
        ),
    )


def _median_signal(outcome: Outcome) -> Interval:
    """SNR of the median lit pixel, whose relative error is about that of its signal."""
    return snr_interval(outcome.capture, "median")


def _exact(value: Callable[[Outcome], float]) -> Callable[[Outcome], Interval]:
    return lambda outcome: Interval(value(outcome))


_MEASURES: dict[str, Callable[[Outcome], Interval]] = {
    "snr_median": lambda o: snr_interval(o.capture, "median"),
    "snr_above_1": lambda o: snr_interval(o.capture, "above 1"),
    "signal_e": lambda o: signal_interval(o.capture),
    "background_e": lambda o: background_interval(o.capture),
    "noise_e": lambda o: noise_interval(o.capture),
    "saturated": _exact(lambda o: float(np.mean(o.capture.record.flags != 0))),
    "in_band": _exact(lambda o: o.capture.in_band_fraction),
    "psnr_db": lambda o: psnr_interval(o.capture, o.reconstruction),
    "ssim": lambda o: ssim_interval(o.capture, o.reconstruction),
    "minimum_time_s": lambda o: _of_pixel_terms(minimum_time_s, o),
    "maximum_distance_m": lambda o: _of_pixel_terms(maximum_distance_m, o),
    "frame_rate_hz": _exact(lambda o: 1 / o.setup.system.frame_time_s),
    "range_error_m": _range_error,
    "detections": lambda o: targets_detected(o.radar),
}


def metric(name: str, inputs: Inputs) -> Callable[[Outcome], Interval]:
    """A metric by name, or a user's own function of an `Outcome`: ``file.py:function``, a name of
    the entry-point group ``twin.metric``, or an object in a study in Python. Of one that gives a
    number and no `Interval` the errors and the noise are not known, NaN.

    Raises InputError for one that can't be found; the metric itself OwnFunctionError, with its
    name, for what it raises, and for a result that is no number.
    """
    if name in _MEASURES:
        return _MEASURES[name]
    own = OwnFunction(inputs.get("metric", name), name, inputs.digests[f"metric {name}"])

    def measured(outcome: Outcome) -> Interval:
        value = own(outcome)
        if isinstance(value, Interval):
            return value
        try:
            number = float(value)
        except (TypeError, ValueError) as error:
            raise OwnFunctionError(
                f"{name}: returned a {type(value).__name__}, expected a number or an Interval"
            ) from error
        return Interval(number, math.nan, math.nan, math.nan)

    return measured
