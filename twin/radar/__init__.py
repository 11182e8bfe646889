"""The radar twin: what an OFDM radar would receive from the scene's own triangles."""

from twin.radar.acquisition import RadarCapture, radar_capture
from twin.radar.design import RadarDesign, load_radar

__all__ = ["RadarCapture", "RadarDesign", "load_radar", "radar_capture"]
