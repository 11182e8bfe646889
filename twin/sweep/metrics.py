"""What a study may measure of a point: metrics by name."""

import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from hardware.reconstruction import Reconstruction, reconstruct
from twin.camera.acquisition import Capture
from twin.camera.evaluation import Score, score_of
from twin.camera.verdict import lit_cells
from twin.errors import InputError
from twin.radar.evaluation import RadarEvaluation
from twin.sweep.inputs import Inputs
from twin.sweep.setup import Setup

T = TypeVar("T")


class Outcome:
    """One point's results, each computed when a metric first asks for it; arrays are read-only."""

    def __init__(
        self,
        setup: Setup,
        capture: Callable[[], Capture],
        radar: Callable[[], RadarEvaluation],
    ) -> None:
        self.setup = setup
        self._capture, self._radar = capture, radar

    @cached_property
    def capture(self) -> Capture:
        """The camera's record, with what the twin knows about it."""
        return _read_only(self._capture())

    @cached_property
    def reconstruction(self) -> Reconstruction:
        """The image, by the point's method."""
        return _read_only(reconstruct(self.capture.record, self.setup.method))

    @cached_property
    def score(self) -> Score:
        """The image, less backscatter, against the light of the scene."""
        return score_of(self.capture, self.reconstruction.picture)

    @cached_property
    def radar(self) -> RadarEvaluation:
        """Detections and what they should have been."""
        return _read_only(self._radar())


def _read_only(value: T) -> T:
    """The same; arrays in it, and in what it holds, can no longer be written to: metrics share them
    with each other and with other points.
    """
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif is_dataclass(value):
        for field in fields(value):
            _read_only(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for item in value:
            _read_only(item)
    return value


def _pixel_terms(outcome: Outcome) -> tuple[float, float, float, float]:
    """Of the median lit pixel: signal and all that is collected, e/s; constant noise and noise that
    grows with time, both as what is left in a pixel: k^2 (collected T + constant^2 + (rate T)^2).
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
    factor = taken.noise.pixel_noise_e(system.patterns) / taken.noise.total_noise_e
    has_tia = system.readout.transimpedance_ohm is not None
    growing = [noise["fluctuation of the emitter"]]
    constant = [noise["read noise"], noise["1/f noise of the amplifier"]]
    # A transimpedance amplifier averages: its converter's step grows with time.
    (growing if has_tia else constant).append(noise["quantisation"])
    linear = [noise[name] for name in shot] + [noise["Johnson noise of the amplifier"]]
    lit = taken.scene_e[lit_cells(taken.scene_e)]
    signal = float(np.median(lit)) / factor / time if lit.size else 0.0
    return (
        signal,
        sum(x**2 for x in linear) / time,
        math.hypot(*constant),
        math.hypot(*growing) / time,
    )


def minimum_time_s(outcome: Outcome) -> float:
    """Integration time at which the median lit pixel equals its noise; infinite where none does.

    (s T)^2 = c T + r^2 + (g T)^2, with the patterns, sun and readout of the point. What exposures
    leave in the next ones and what rails cut off change with the time, and are not counted.
    """
    s, c, r, g = _pixel_terms(outcome)
    a = s * s - g * g
    if s <= 0 or a <= 0:
        return math.inf
    return (c + math.sqrt(c * c + 4 * a * r * r)) / (2 * a)


def maximum_distance_m(outcome: Outcome) -> float:
    """Distance at which the median lit pixel would equal its noise.

    Its signal falls with 1 / z^2, the sun's part stays. Nothing in the field: not a number. Counts
    noise as `minimum_time_s` does.
    """
    s, c, r, g = _pixel_terms(outcome)
    taken = outcome.capture
    depth = taken.truth.depth_m[np.isfinite(taken.truth.depth_m) & lit_cells(taken.scene_e)]
    if not depth.size or s <= 0:
        return math.nan
    time = outcome.setup.system.acquisition.integration_time_s.value
    own = taken.noise.noise_e["shot noise of the signal"] ** 2
    other = c * time - own + r * r
    # (s x T)^2 = own x + other + (g x T)^2 with x = (z0 / z)^2
    a = (s * time) ** 2 - (g * time) ** 2
    if a <= 0:
        return 0.0
    x = (own + math.sqrt(own * own + 4 * a * other)) / (2 * a)
    return float(np.median(depth)) / math.sqrt(x)


def _range_error(outcome: Outcome) -> float:
    pairs = zip(outcome.radar.detections, outcome.radar.matches, strict=True)
    errors = [abs(found.range_m - true.wrapped_range_m) for found, true in pairs if true]
    return max(errors, default=math.nan)


def _detected(outcome: Outcome) -> float:
    return float(len({true.name for true in outcome.radar.matches if true is not None}))


_MEASURES: dict[str, Callable[[Outcome], float]] = {
    "snr_median": lambda o: o.capture.verdict.snr_median,
    "snr_above_1": lambda o: o.capture.verdict.above_noise_share,
    "signal_e": lambda o: o.capture.noise.signal_e,
    "background_e": lambda o: o.capture.noise.background_e,
    "noise_e": lambda o: o.capture.noise.total_noise_e,
    "saturated": lambda o: float(np.mean(o.capture.record.flags != 0)),
    "in_band": lambda o: o.capture.in_band_fraction,
    "psnr_db": lambda o: o.score.psnr_db,
    "ssim": lambda o: o.score.ssim,
    "minimum_time_s": minimum_time_s,
    "maximum_distance_m": maximum_distance_m,
    "frame_rate_hz": lambda o: 1 / o.setup.system.frame_time_s,
    "range_error_m": _range_error,
    "detections": _detected,
}


def metric(name: str, inputs: Inputs) -> Callable[[Outcome], float]:
    """A metric by name, or a user's own function of an `Outcome`: ``file.py:function``, a name of
    the entry-point group ``twin.metric``, or an object in a study in Python.

    Raises InputError for one that can't be found.
    """
    if name in _MEASURES:
        return _MEASURES[name]
    own: Callable[[Outcome], float] = inputs.get("metric", name)
    return own
