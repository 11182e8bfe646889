"""What surfaces and edges of meshes scatter: materials, currents, integrals over flat triangles."""

from twin.radar.scattering.diffraction import EdgeQuality, edge_diffraction
from twin.radar.scattering.edges import Edges, sharp_edges
from twin.radar.scattering.surface import PEC, Layer, LayeredSurface
from twin.radar.scattering.target import MeshTarget
from twin.radar.scattering.wave import Polarization, Radar

__all__ = [
    "PEC",
    "EdgeQuality",
    "Edges",
    "Layer",
    "LayeredSurface",
    "MeshTarget",
    "Polarization",
    "Radar",
    "edge_diffraction",
    "sharp_edges",
]
