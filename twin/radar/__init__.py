"""The radar twin: what an OFDM radar would receive from the scene's own triangles."""

from twin.radar.acquisition import RadarCapture, RadarEcho, radar_capture, radar_echo
from twin.radar.device.design import RadarDesign, load_radar, radar_names

__all__ = [
    "RadarCapture",
    "RadarDesign",
    "RadarEcho",
    "load_radar",
    "radar_capture",
    "radar_echo",
    "radar_names",
]
