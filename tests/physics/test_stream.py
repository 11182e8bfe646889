"""A moving rig: the same light as a still one, the same bits again, no growing memory."""

import resource
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from hardware import reconstruct
from twin.camera import capture
from twin.camera.stream import frames
from twin.fidelity import Fidelity
from twin.scene import Pose, load_scene
from twin.system import System, load_system


@pytest.fixture
def small(tmp_path: Path) -> System:
    (tmp_path / "s.toml").write_text(
        'base = "workable"\n[emitter]\nrows = 16\ncolumns = 16\n[acquisition]\nn_patterns = 256\n'
    )
    return load_system(tmp_path / "s.toml")


def drive(step_m: float = 0.05):
    i = 0
    while True:
        yield Pose((step_m * i, 0.02 * i, 0.5), yaw_deg=0.5 * i, pitch_deg=0.1 * i)
        i += 1


@pytest.mark.whole
def test_a_frame_on_the_way_is_the_frame_of_a_capture_there(small: System) -> None:
    """Expected electrons of every cell agree within noise and tracing: the rig moves, or the world
    is rebuilt around it.
    """
    scene = load_scene("yard")
    poses = [scene.rig.pose, Pose((0.7, -0.2, 0.9), yaw_deg=3.0, pitch_deg=2.0, roll_deg=1.0)]
    for pose, record in zip(
        poses, frames(scene, small, poses, fidelity=Fidelity(64**2, 1)), strict=True
    ):
        still = capture(scene.at(pose), small, fidelity=Fidelity(64**2, 1))
        found = reconstruct(record, "zero-fill").picture
        noise = still.cells_e.max() / still.snr.max()
        scaled = (found - still.cells_e) / noise
        assert np.sqrt(np.mean(scaled**2)) == pytest.approx(1, abs=0.35)
        assert np.abs(record.pose.position_m - pose.position_m).max() == 0


def test_frames_are_drawn_from_their_number_alone(small: System) -> None:
    scene = load_scene("yard")
    one = [r.counts for r in islice(frames(scene, small, drive(), seed=5), 3)]
    two = [r.counts for r in islice(frames(scene, small, drive(), seed=5), 3)]
    other = next(iter(frames(scene, small, drive(), seed=6))).counts
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0], one[1])
    assert not np.array_equal(one[0], other)


def test_memory_stays_flat_and_nothing_recompiles(small: System) -> None:
    """200 frames after 20: less than 4 MB more at the peak (a leak of one frame's rays is 20)."""
    import drjit as dr

    stream = frames(load_scene("yard"), small, drive(0.01))
    for _ in islice(stream, 20):
        pass
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in islice(stream, 200):
        pass
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 4096
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for _ in islice(stream, 10):
            pass
        kernels = [k for k in dr.kernel_history() if not k.get("cache_hit", True)]
    assert not kernels
