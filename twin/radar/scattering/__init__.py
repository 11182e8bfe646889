"""Radar cross-section of meshes: physical optics along bouncing rays, and diffracting edges.

What Sionna RT has no place for: the echo of a finite or curved target.
"""

from twin.radar.scattering.cross_section import Sweep, sweep
from twin.radar.scattering.diffraction import EdgeQuality, edge_diffraction
from twin.radar.scattering.edges import Edges, sharp_edges
from twin.radar.scattering.rays import Echo, Quality, physical_optics
from twin.radar.scattering.surface import PEC, Layer, Surface
from twin.radar.scattering.target import Target
from twin.radar.scattering.wave import Polarization, Radar

__all__ = [
    "PEC",
    "Echo",
    "EdgeQuality",
    "Edges",
    "Layer",
    "Polarization",
    "Quality",
    "Radar",
    "Surface",
    "Sweep",
    "Target",
    "edge_diffraction",
    "physical_optics",
    "sharp_edges",
    "sweep",
]
