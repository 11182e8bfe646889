"""From IQ samples to detections: OFDM demodulation, range-Doppler map, CFAR."""

from hardware.radar.detection import Detection, detect
from hardware.radar.range_doppler import RangeDopplerMap, channel, range_doppler
from hardware.radar.waveform import OfdmWaveform

__all__ = [
    "Detection",
    "OfdmWaveform",
    "RangeDopplerMap",
    "channel",
    "detect",
    "range_doppler",
]
