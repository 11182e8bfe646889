"""The system under study, as data: emitter, filter, optics, detector, readout, acquisition, sky,
weather.

A system is a TOML file. Every value is a table ``{ value = ..., source = "..." }`` or
``{ value = ..., assumed = "..." }``; a bare number counts as assumed. ``base = "paper"`` takes
everything that the file leaves out from another system.
"""

from twin.system.acquisition import Acquisition, TimeOfFlight
from twin.system.detector import Photodetector, Readout
from twin.system.emitter import Emitter
from twin.system.environment import Sky, Weather
from twin.system.optics import Filter, Optics
from twin.system.part import Part, load_part, part_names
from twin.system.system import System, load_system, system_names

__all__ = [
    "Acquisition",
    "Emitter",
    "Filter",
    "Optics",
    "Part",
    "Photodetector",
    "Readout",
    "Sky",
    "System",
    "TimeOfFlight",
    "Weather",
    "load_part",
    "load_system",
    "part_names",
    "system_names",
]
