"""From a record to an image: one interface, one function per method."""

from hardware.reconstruction.imaging import Reconstruction, fits_in_memory, reconstruct
from hardware.reconstruction.measurements import Measurements, measurements
from hardware.reconstruction.own_method import method_of
from hardware.reconstruction.ranging import RangeImage, range_image
from hardware.reconstruction.registry import METHODS, Method, discover, load_plugins, method
from hardware.reconstruction.sensing import Mixing, Sensing

__all__ = [
    "METHODS",
    "Measurements",
    "Method",
    "Mixing",
    "RangeImage",
    "Reconstruction",
    "Sensing",
    "fits_in_memory",
    "load_plugins",
    "measurements",
    "method",
    "method_of",
    "range_image",
    "reconstruct",
]

discover()
