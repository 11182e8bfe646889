"""A user's own detection in place of CFAR and refinement: a function, or a file's function."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from hardware.own_functions import OwnFunction, OwnFunctionError, own_function
from hardware.radar.demodulation import Complex
from hardware.radar.detection import Detection
from hardware.radar.range_doppler import RangeDopplerMap
from hardware.waveform import OfdmWaveform

#: A function of the channel (n_channels, n_subcarriers, n_slots), root watts, and its map.
Detect: TypeAlias = Callable[[Complex, OfdmWaveform, RangeDopplerMap], Sequence[Detection]]

_ARGUMENTS = ("channel", "waveform", "image")
#: Of fields that cannot be negative.
_LEAST = {
    name: 0.0
    for name in Detection.__dataclass_fields__
    if name in ("range_m", "power_w", "rcs_m2") or "_error_" in name
}
#: Entry points by which installed packages offer a detection.
GROUP = "ugv.detection"


@dataclass(frozen=True)
class OwnDetection:
    """A user's detection; ``name`` is the function's with a digest of its source."""

    name: str
    own: OwnFunction

    def __call__(
        self, channel: Complex, waveform: OfdmWaveform, image: RangeDopplerMap
    ) -> tuple[Detection, ...]:
        """Detections, strongest first. Raises OwnFunctionError for invalid ones."""
        detections = self.own(channel, waveform, image)
        if isinstance(detections, str | bytes) or not isinstance(detections, Sequence):
            raise OwnFunctionError(
                f"{self.own.name}: returned a {type(detections).__name__}, expected a sequence of "
                "hardware.Detection"
            )
        for i, detection in enumerate(detections):
            if not isinstance(detection, Detection):
                raise OwnFunctionError(
                    f"{self.own.name}: item {i} is a {type(detection).__name__}, expected a "
                    "hardware.Detection"
                )
            if wrong := _wrong(detection, waveform):
                raise OwnFunctionError(f"{self.own.name}: item {i}: {wrong}")
            if np.isnan(detection.range_m) and np.isnan(detection.range_rate_m_per_s):
                raise OwnFunctionError(
                    f"{self.own.name}: item {i} has neither range nor range rate"
                )
        return tuple(sorted(detections, key=lambda detection: -detection.power_w))


def _wrong(detection: Detection, waveform: OfdmWaveform) -> str:
    """What is no value of its field; NaN, not measured, is one of all but power and SNR."""
    for name, value in vars(detection).items():
        if "_alternatives_" in name:
            continue
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            return f"{name} = {value!r:.60}: expected a number"
        if name in ("power_w", "snr_db") and np.isnan(value):
            return "power_w or snr_db is not finite"
        least = _LEAST.get(name, -np.inf)
        least -= (
            waveform.range_cell_m if name == "range_m" else 0
        )  # an echo at no distance, refined
        if np.isinf(value) or value < least:
            return f"{name} = {value}: expected a finite number" + (
                f" from {least:.3g} up" if np.isfinite(least) else ""
            )
    return ""


def detection_of(
    given: "str | OwnDetection | Detect", *, folder: Path | None = None
) -> OwnDetection:
    """A user's own detection.

    Parameters
    ----------
    given
        A function of (channel, waveform, image), as `hardware.detect` takes them: the channel
        (n_channels, n_subcarriers, n_slots) in root watts, the `OfdmWaveform`, the
        `RangeDopplerMap`; it returns a sequence of `Detection`. Or ``file.py:function``, or a name
        in the entry-point group ``ugv.detection``.
    folder
        What a relative path starts from; default the working directory.

    Raises OwnFunctionError, an InputError, for a function that does not exist or takes other
    arguments; the result raises it, when called, for invalid detections.

    >>> from hardware import Detection
    >>> def strongest_cell(channel, waveform, image):
    ...     "The highest cell of the map, as it is."
    ...     i, k = np.unravel_index(image.power_w.argmax(), image.power_w.shape)
    ...     power_w = image.power_w[i, k]
    ...     snr_db = 10 * np.log10(power_w / image.noise_w)
    ...     cell_m, cell_m_per_s = waveform.range_cell_m, waveform.velocity_cell_m_per_s
    ...     place = image.range_m[i], image.range_rate_m_per_s[k]
    ...     return [Detection(*place, power_w, snr_db, cell_m, cell_m_per_s)]
    >>> detection_of(strongest_cell).name[:15]
    'strongest_cell-'
    """
    if isinstance(given, OwnDetection):
        return given
    own = own_function(given, _ARGUMENTS, group=GROUP, folder=folder)
    return OwnDetection(own.label, own)
