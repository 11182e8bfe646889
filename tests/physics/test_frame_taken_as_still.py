"""A moving frame that is taken as still: its scores hold what motion does, and warnings say it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hardware.reconstruction import reconstruct
from tests.physics.moving_worlds import (
    SIDE,
    anew,
    exposed,
    going,
    plate,
    small,
    world,
)
from twin.camera import capture
from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.camera.intervals import ScoreIntervals, score_intervals
from twin.fidelity import DEFAULT, Fidelity
from twin.motion.trajectory import through
from twin.scene import Pose, Rig, Scene
from twin.system import System

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def system() -> System:
    """16 x 16 cells, 512 exposures in 51.2 ms."""
    return small()


def frozen(scene: Scene, system: System) -> list[str]:
    told = capture(scene, system, seed=2, fidelity=Fidelity(64, 1, motion_tolerance=None)).warnings
    return [str(text) for text in told if "taken as still" in text]


def test_scores_of_a_frame_taken_as_still_hold_what_motion_does(system: System) -> None:
    """A plate before a wall that crosses 8 cells of 0.36 m at 5 m: scores where it is followed are
    within those where it is not, whose intervals hold the motion; without it they were 8 widths
    too narrow. At rest they are as narrow as before.
    """
    width = 2 * 5.0 * np.tan(np.radians(system.emitter.field_of_view_deg.value / 2)) / SIDE
    speed = 8 * width / Exposures.of(system).duration_s
    wall = plate("wall", (-9, 9), (-9, 9), 6.0)
    knobs, still = DEFAULT, replace(DEFAULT, motion_tolerance=None)

    def scores(speed: float, fidelity: Fidelity) -> ScoreIntervals:
        scene = world(wall, going(plate("plate", (-0.4, 0.1), (-0.3, 0.3)), 0.0, speed, 0.0))
        found = capture(scene, system, seed=2, fidelity=fidelity)
        return score_intervals(found, reconstruct(found.record, "lmmse"))

    true, told, at_rest = scores(speed, knobs), scores(speed, still), scores(0.0, still)
    assert abs(told.psnr_db.value - true.psnr_db.value) > 3 * at_rest.psnr_db.half_width
    assert told.psnr_db.holds(true.psnr_db.value)
    assert told.ssim.holds(true.ssim.value)
    assert told.ssim.half_width < 3


@pytest.mark.thorough
def test_a_frame_taken_as_still_says_how_far_things_move_and_what_that_does(system: System) -> None:
    """A plate that crosses 4 cells of 0.36 m; what counts are off by is that of exposures at their
    own time, and no more than the warning says, which takes all cells passed as changed at once.
    """
    width = 2 * 5.0 * np.tan(np.radians(system.emitter.field_of_view_deg.value / 2)) / SIDE
    speed = 4 * width / Exposures.of(system).duration_s
    scene = world(going(plate("plate", (-0.4, 0.1), (-0.3, 0.3)), 0.0, speed, 0.0))
    (told,) = frozen(scene, system)
    said = re.search(r"up to ([\d.]+) cells .* some ([\d.e+]+) times", told)
    assert said is not None
    cells, over = map(float, said.groups())
    assert cells == pytest.approx(4.0, rel=0.03)
    frame, noise = exposed(scene, system)
    chain = Chain.of(system, scene.sun)
    (power,) = anew(scene, system, np.array([0.0]))
    off_by = (frame.signal_w - chain.mean_signal(power)) / noise
    true = float(np.sqrt(np.mean(off_by**2)))
    assert over / 8 < true < over


def test_a_frame_whose_noise_hides_the_motion_says_nothing(system: System) -> None:
    wall, slow = plate("wall", (-9, 9), (-9, 9), 6.0), plate("plate", (0.0, 1.0), (-1, 1))
    assert frozen(world(wall, slow), system) == []
    assert frozen(world(wall, going(slow, 0.0, 1e-6, 0.0)), system) == []


def test_a_frame_taken_as_still_may_outlast_its_trajectory(system: System) -> None:
    way = through([0.0, 0.02], [[0, 0, 0], [0.0, 1.0, 0]], Rotation.identity(2))
    rig = Rig(Pose((0.0,) * 3)).following(way)
    items = plate("wall", (-9, 9), (-9, 9), 6.0), plate("plate", (0.0, 1.0), (-1, 1))
    assert len(frozen(world(*items, rig=rig), system)) == 1
