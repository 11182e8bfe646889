"""A scanning LIDAR beside patterns over equal time: `benchmarks.lidar`."""

import numpy as np
import pytest

from benchmarks.lidar import beside
from tests.physics.moving_worlds import going, plate, small, world
from twin.camera import capture
from twin.fidelity import Fidelity
from twin.scene import Scene
from twin.system import System, load_system

QUICK = Fidelity(samples=64, max_depth=1, motion_tolerance=0.5)
FROZEN = Fidelity(samples=64, max_depth=1, motion_tolerance=None)
SPEED = 17.0


@pytest.fixture(scope="module")
def systems() -> tuple[System, System]:
    """8 x 8 cells: 128 exposures in 12.8 ms, a scan in 25.6 ms."""
    side = {"value": 8, "assumed": "test"}
    patterns = small(
        emitter__rows=side,
        emitter__columns=side,
        acquisition__n_patterns={"value": 64, "assumed": "test"},
    )
    scan = load_system("lidar-scan").with_(
        {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
    )
    return patterns, scan


def crossing(speed: float) -> Scene:
    """A plate that goes a cell and a half a scan at 17 m/s, before a wall."""
    passing = plate("plate", (-0.6, 0.1), (-0.5, 0.5), 4.0)
    moving = going(passing, 0.0, speed, 0.0) if speed else passing
    return world(plate("wall", (-9, 9), (-9, 9), 6.0), moving)


def test_both_have_equal_mean_power() -> None:
    powers = [load_system(name).mean_power_w for name in ("workable", "lidar-scan")]
    assert powers[1] == pytest.approx(powers[0], rel=0.01)


def test_at_rest_two_frames_gain_what_their_noise_falls_by(systems: tuple[System, System]) -> None:
    patterns, scan = beside(crossing(0.0), systems, seed=1, fidelity=QUICK)
    assert (patterns.n_frames, scan.n_frames) == (2, 1)
    single = np.mean([one.psnr_db for one in patterns.of_single])
    assert patterns.score.psnr_db > single
    assert scan.score == scan.of_single[0]


def test_in_motion_both_are_compared_with_the_middle_of_the_same_time(
    systems: tuple[System, System],
) -> None:
    """The truth of both is the plate where it is after 12.8 ms; frames of patterns, a quarter of
    the time before and after, agree with it less than each with its own middle.
    """
    scene = crossing(SPEED)
    both = beside(scene, systems, seed=1, fidelity=QUICK)
    for one, system in zip(both, systems, strict=True):
        middle = capture(scene.after(0.0128), system, seed=5, fidelity=FROZEN).scene_e
        start = capture(scene, system, seed=5, fidelity=FROZEN).scene_e
        off = np.sqrt(np.mean((one.truth - middle) ** 2)) / middle.max()
        assert off < 0.03
        assert np.sqrt(np.mean((start - middle) ** 2)) / middle.max() > 0.1
        assert one.image.shape == (8, 8)
    patterns, _ = both
    assert patterns.score.psnr_db < min(one.psnr_db for one in patterns.of_single)
