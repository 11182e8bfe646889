"""Radar cross-section of meshes: physical optics of their facets, and diffracting edges.

What Sionna RT has no place for: the echo of a finite or curved target.
"""

from twin.radar.cross_section.aspects import Aspects
from twin.radar.cross_section.optics import (
    Quality,
    ScatteringAmplitudes,
    physical_optics,
    scattered,
)
from twin.radar.cross_section.sweep import Sweep, sweep

__all__ = [
    "Aspects",
    "Quality",
    "ScatteringAmplitudes",
    "Sweep",
    "physical_optics",
    "scattered",
    "sweep",
]
