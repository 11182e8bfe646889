"""The contract between whoever measures and whoever processes: raw data with their settings.

A record holds what a device can send and nothing else: integers, settings, clocks, flags, the
pose. Truth travels apart. On disk a record is one HDF5 file whose first attributes are its format
and schema version.
"""

from hardware.records.container import Flag
from hardware.records.radar import RadarRecord, read_radar_record, write_radar_record
from hardware.records.spi import SpiRecord, read_record, write_record
from hardware.records.state import QuaternionPose, RadarFrontEnd, Shutter

__all__ = [
    "Flag",
    "QuaternionPose",
    "RadarFrontEnd",
    "RadarRecord",
    "Shutter",
    "SpiRecord",
    "read_radar_record",
    "read_record",
    "write_radar_record",
    "write_record",
]
