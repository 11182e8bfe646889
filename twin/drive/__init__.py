"""A drive: both sensors along the trajectories of a scene, with the truth beside them."""

from twin.drive.clocks import DeviceClock
from twin.drive.plan import Drive
from twin.drive.run import Driven, drive

__all__ = ["DeviceClock", "Drive", "Driven", "drive"]
