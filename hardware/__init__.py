"""The vehicle's own software: what sensors send goes in, images and detections come out.

It never knows who sent the data: the digital twin and the device deliver the same records.
"""

from hardware.patterns import PatternSet
from hardware.reconstruction import Reconstruction, reconstruct
from hardware.records import SpiRecord, read_record, write_record

__all__ = [
    "PatternSet",
    "Reconstruction",
    "SpiRecord",
    "read_record",
    "reconstruct",
    "write_record",
]
