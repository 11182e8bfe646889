"""The vehicle's own software: what sensors send goes in, images and detections come out.

It never knows who sent the data: the digital twin and the device deliver the same records.
``__init__.pyi`` says what can be had from here.
"""

from hardware.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
