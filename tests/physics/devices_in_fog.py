"""An emitter and detectors beside it in fog."""

import math

import numpy as np

from twin.optics.devices import Device
from twin.optics.weather import Air

TAN = math.tan(math.radians(10))
AHEAD = np.eye(3)
EMITTER = Device(np.zeros(3), AHEAD, TAN)
FOG = Air(0.02, 0.0198, 0.85, 0.0142)


def beside(*baseline_m: float, outline: str = "square") -> Device:
    return Device(np.array(baseline_m), AHEAD, TAN, outline)  # type: ignore[arg-type]
