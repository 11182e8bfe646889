"""From IQ samples to detections: OFDM demodulation, range-Doppler map, CFAR."""

from hardware.radar.cfar import cfar_threshold
from hardware.radar.cfar_rule import Cfar, MapNoise, cfar_factor
from hardware.radar.demodulation import channel
from hardware.radar.detection import Detection, detect
from hardware.radar.range_doppler import RangeDopplerMap, range_doppler
from hardware.radar.spectrogram import Spectrogram, spectrogram, spectrogram_of_intervals
from hardware.radar.stitching import stitch
from hardware.waveform import OfdmWaveform

__all__ = [
    "Cfar",
    "Detection",
    "MapNoise",
    "OfdmWaveform",
    "RangeDopplerMap",
    "Spectrogram",
    "cfar_factor",
    "cfar_threshold",
    "channel",
    "detect",
    "range_doppler",
    "spectrogram",
    "spectrogram_of_intervals",
    "stitch",
]
