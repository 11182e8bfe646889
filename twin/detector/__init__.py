"""The photodiode and its electronics: photons to electrons to volts to counts."""

from twin.detector.front_end import FrontEnd, expose
from twin.detector.interface import Detector
from twin.detector.noise import NoiseBudget, noise_budget

__all__ = ["Detector", "FrontEnd", "NoiseBudget", "expose", "noise_budget"]
