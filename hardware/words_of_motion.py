"""Which motion a camera's frame was compensated for, or why for none, in one line."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import counted, number
from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.layers import Layers, MovingBox
from hardware.reconstruction.motion.model import Motion, Shift
from hardware.reconstruction.motion.sightings import SupportedMotion
from hardware.rig_poses import LEAST_M_PER_S, LEAST_RAD_PER_S, RigState

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proposal:
    """What poses and tracks proposed of a frame: how the rig drives, tracks with a place, objects
    made of them that are in the image and move in it, and why there are no tracks.
    """

    rig: RigState
    tracks: int
    objects: int
    untold: str = ""


def motion_in_words(motion: Motion | None) -> str:
    """A motion in a few words."""
    if motion is None:
        return "none"
    if isinstance(motion, Shift):
        down, right = motion.down_cells_per_s, motion.right_cells_per_s
        return f"{down:.4g} cells/s down, {right:.4g} cells/s to the right"
    if isinstance(motion, Layers):
        objects = counted(len(motion.objects), "object")
        return f"background {motion_in_words(motion.background)}; {objects} in front of it"
    return f"as given ({type(motion).__name__})"


def told(found: SupportedMotion, proposal: Proposal, camera_m_per_s: Array) -> str:
    """The line of a frame; ``camera_m_per_s`` (3,) is the camera's velocity in its own frame."""
    but = f"; {proposal.untold}" if proposal.untold else ""
    if found.warnings:
        return "motion: not compensated: this record can hardly show any"
    if not found.tried:
        return f"motion: not compensated: {proposal.untold or _resting(proposal)}"
    if found.motion is None:
        return f"motion: not compensated: {_proposed(proposal)}, tried: {_gain(found)}{but}"
    return f"motion: compensated: {_taken(found, proposal, camera_m_per_s)}: {_gain(found)}{but}"


def _gain(found: SupportedMotion) -> str:
    return f"log-likelihood {found.evidence:+.0f} over rest ({found.asked:+.0f} needed)"


def _resting(proposal: Proposal) -> str:
    """Where neither the rig nor a track moves."""
    return f"the rig is at rest, and of {counted(proposal.tracks, 'track')} none moves in the image"


def _proposed(proposal: Proposal) -> str:
    parts = [f"the rig's {_speed(proposal.rig)}"] if proposal.rig.moves else []
    if proposal.objects:
        parts.append(f"{counted(proposal.objects, 'object')} of {_tracks(proposal)}")
    return " and ".join(parts)


def _taken(found: SupportedMotion, proposal: Proposal, camera_m_per_s: Array) -> str:
    motion = found.motion
    behind = motion.background if isinstance(motion, Layers) else motion
    boxes = motion.objects if isinstance(motion, Layers) else ()
    parts = []
    if isinstance(behind, PlaneMotion):
        at = f"a plane {number(behind.depth_m)} m away"
        parts.append(f"the rig's {_speed(proposal.rig)} before {at}")
    share = f"{len(boxes)} of {counted(proposal.objects, 'object')} of {_tracks(proposal)}"
    if boxes:
        share += f" ({', '.join(_box(one, camera_m_per_s) for one in boxes)})"
    return " and ".join([*parts, share] if proposal.objects else parts)


def _tracks(proposal: Proposal) -> str:
    return counted(proposal.tracks, "track")


def _speed(rig: RigState) -> str:
    speed, turn = (float(np.linalg.norm(one)) for one in (rig.velocity_m_per_s, rig.turn_rad_per_s))
    parts = [f"{number(speed, 2)} m/s"] if speed > LEAST_M_PER_S else []
    if turn > LEAST_RAD_PER_S:
        parts.append(f"{number(np.degrees(turn), 2)} deg/s")
    return " and ".join(parts)


def _box(box: MovingBox, camera_m_per_s: Array) -> str:
    """Speed over the ground, and distance along the boresight."""
    plane = box.motion
    assert isinstance(plane, PlaneMotion)
    speed = float(np.linalg.norm(np.array(plane.velocity_m_per_s) + camera_m_per_s))
    return f"{number(speed, 2)} m/s at {number(plane.depth_m)} m"
