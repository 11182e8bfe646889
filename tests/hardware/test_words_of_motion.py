"""The line of a frame says what was there, what was tried, and by how much it was believed."""

import numpy as np
import pytest

from hardware import Layers, MovingBox, PlaneMotion
from hardware.reconstruction.motion.evidence import REST
from hardware.reconstruction.motion.sightings import SupportedMotion
from hardware.records import QuaternionPose
from hardware.rig_poses import RigState
from hardware.words_of_motion import Proposal, told

FIELD = (0.35, 0.35)
AT_REST = RigState(QuaternionPose(), np.zeros(3), np.zeros(3))
DRIVES = RigState(QuaternionPose(), np.array([5.0, 0, 0]), np.array([0, 0, np.radians(3.0)]))
#: A board 7 m away that crosses at 1.2 m/s over the ground, seen from a camera at 5 m/s.
BOARD = MovingBox(2, 3, 9, 8, PlaneMotion(7.0, (-5.0, 1.2, 0.0), FIELD))
WALL = PlaneMotion(14.0, (-5.0, 0.0, 0.0), FIELD)


def line(found: SupportedMotion, proposal: Proposal) -> str:
    words = told(found, proposal, proposal.rig.velocity_m_per_s)
    assert words.startswith("motion: ")
    return words.removeprefix("motion: ")


def test_what_is_compensated_is_told_with_speeds_and_distances() -> None:
    found = SupportedMotion(Layers(WALL, (BOARD,)), 92.7, 1, asked=35.0)
    assert line(found, Proposal(DRIVES, 4, 2)) == (
        "compensated: the rig's 5 m/s and 3 deg/s before a plane 14 m away and 1 of 2 objects of 4 "
        "tracks (1.2 m/s at 7 m): log-likelihood +93 over rest (+35 needed)"
    )


def test_a_rig_at_rest_is_not_said_to_move() -> None:
    crossing = MovingBox(2, 3, 9, 8, PlaneMotion(7.0, (0.0, -1.2, 0.0), FIELD))
    words = line(SupportedMotion(Layers(REST, (crossing,)), 50.0, 1), Proposal(AT_REST, 1, 1))
    assert "rig" not in words
    assert "1 of 1 object of 1 track (1.2 m/s at 7 m)" in words


def test_a_rig_that_turns_on_the_spot_is_said_to_turn_alone() -> None:
    turns = RigState(QuaternionPose(), np.zeros(3), np.array([0, 0, np.radians(3.0)]))
    words = line(SupportedMotion(WALL, 50.0, 0), Proposal(turns, 0, 0))
    assert words.startswith("compensated: the rig's 3 deg/s before a plane 14 m away: log")


@pytest.mark.parametrize(
    ("found", "proposal", "expected"),
    [
        (
            SupportedMotion(None, 29.0, 0, asked=35.0),
            Proposal(AT_REST, 2, 1),
            "not compensated: 1 object of 2 tracks, tried: log-likelihood +29 over rest (+35 "
            "needed)",
        ),
        (
            SupportedMotion(None, -3.0, 0),
            Proposal(DRIVES, 0, 0, "no tracks in the frame's time"),
            "not compensated: the rig's 5 m/s and 3 deg/s, tried: log-likelihood -3 over rest (+30 "
            "needed); no tracks in the frame's time",
        ),
        (
            SupportedMotion(None, 0.0, 0, tried=False),
            Proposal(AT_REST, 4, 0),
            "not compensated: the rig is at rest, and of 4 tracks none moves in the image",
        ),
        (
            SupportedMotion(None, 0.0, 0, ("from coarse to fine",), tried=False),
            Proposal(DRIVES, 4, 2),
            "not compensated: this record can hardly show any",
        ),
    ],
)
def test_what_was_not_tried_is_not_said_to_be_unlikely(
    found: SupportedMotion, proposal: Proposal, expected: str
) -> None:
    assert line(found, proposal) == expected
