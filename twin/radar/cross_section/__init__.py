"""Radar cross-section of meshes: physical optics of their facets, and diffracting edges.

What Sionna RT has no place for: the echo of a finite or curved target.
"""

from twin.radar.cross_section.optics import Echo, Quality, physical_optics, scattered
from twin.radar.cross_section.sweep import Sweep, sweep
from twin.radar.cross_section.ways import Ways

__all__ = ["Echo", "Quality", "Sweep", "Ways", "physical_optics", "scattered", "sweep"]
