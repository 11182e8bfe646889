"""The photodiode and its electronics: photons to electrons to volts to counts."""

from twin.detector.front_end import FrontEnd, expose
from twin.detector.noise import NoiseBudget, noise_budget

__all__ = ["FrontEnd", "NoiseBudget", "expose", "noise_budget"]
