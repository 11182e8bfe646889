"""What surfaces and edges of meshes scatter: materials, currents, integrals over flat triangles."""

from twin.radar.scattering.diffraction import EdgeQuality, edge_diffraction
from twin.radar.scattering.edges import Edges, sharp_edges
from twin.radar.scattering.surface import PEC, Layer, Surface
from twin.radar.scattering.target import Target
from twin.radar.scattering.wave import Polarization, Radar

__all__ = [
    "PEC",
    "EdgeQuality",
    "Edges",
    "Layer",
    "Polarization",
    "Radar",
    "Surface",
    "Target",
    "edge_diffraction",
    "sharp_edges",
]
