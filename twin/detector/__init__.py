"""The photodiode and its electronics: photons to electrons to volts to counts.

`front_end` holds noise and the converter; `interface` the protocol that another detector fulfils,
in place of the bundled one (``twin.capture(..., detector=...)``, ``[detector] function``).
"""

from twin.detector.front_end import FrontEnd, expose, noise_budget
from twin.detector.interface import Detector
from twin.detector.noise import NoiseBudget

__all__ = ["Detector", "FrontEnd", "NoiseBudget", "expose", "noise_budget"]
