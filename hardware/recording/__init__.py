"""The vehicle's log: records, images, detections and poses in one file that ROS tools open."""

from hardware.recording.log import Log
from hardware.recording.reading import Received, read_messages, read_records
from hardware.recording.recovery import recover

__all__ = ["Log", "Received", "read_messages", "read_records", "recover"]
