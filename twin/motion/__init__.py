"""Motion of rigid bodies: pose, velocity and acceleration as functions of time, in float64.

A `Motion` gives the pose of a moving frame and its first two derivatives in closed form of what
interpolates it. Motions are combined by `Product`: a frame within a frame.
"""

from twin.motion.kinematics import Kinematics
from twin.motion.motion import Later, Motion, Parent, Product, Still, Straight
from twin.motion.rolling import Rolling
from twin.motion.trajectory import Outside, Trajectory
from twin.motion.turning import Swinging, Turning

__all__ = [
    "Kinematics",
    "Later",
    "Motion",
    "Outside",
    "Parent",
    "Product",
    "Rolling",
    "Still",
    "Straight",
    "Swinging",
    "Trajectory",
    "Turning",
]
