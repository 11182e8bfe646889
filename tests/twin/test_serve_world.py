"""Camera and radar behind their protocols, in one world: one instant for both."""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hardware.drivers.radio import acquire
from hardware.drivers.radio.interface import RadioError
from hardware.records import SpiRecord
from tests.twin.test_serve_radio import QUICK, SEED, small
from twin.motion.trajectory import through
from twin.radar import radar_capture
from twin.scene import Scene, load_scene
from twin.serve import serving
from twin.serve.clock import DeviceClock
from twin.serve.radio import VirtualRadio
from twin.serve.sweeps import RadarSweep, RadarSweeps, SweepsOfWorld
from twin.serve.world import SharedWorld
from twin.system import System, load_system


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("yard")


def radio_in(scene: Scene, world: SharedWorld | None, pace="fast") -> VirtualRadio:
    design = small()

    def later(begins_s: float) -> Callable[[int], RadarSweep]:
        return partial(sweeps, begins_s=begins_s, period_s=virtual.schedule.sweep_s)

    sweeps = SweepsOfWorld(RadarSweeps(scene, design, SEED, QUICK))
    virtual = VirtualRadio(design, sweeps, clock=DeviceClock(pace), world=world, later=later)
    return virtual


def test_a_radio_that_begins_later_shows_what_the_world_is_like_by_then(scene: Scene) -> None:
    """The camera has come to 0.8 s: sweep k is, bit for bit, that of 0.8 s and k sweeps
    and half a burst later.
    """
    world = SharedWorld("fast")
    assert world.begin() == 0.0
    world.reached(0.8)
    radio = radio_in(scene, world)
    record = acquire(radio, radio.schedule, radio.front_end, bursts=3)
    design, lasts_s = small(), radio.schedule.sweep_s
    for sweep in range(3):
        then = scene.after(0.8).after(sweep * lasts_s + design.middle_s)
        expected = radar_capture(then, design, seed=SEED + sweep, fidelity=QUICK).record
        np.testing.assert_array_equal(record.iq[sweep], expected.iq[0])
    assert world.now_s() == pytest.approx(0.8 + 2 * lasts_s)
    early = acquire(radio_in(scene, None), radio.schedule, radio.front_end, bursts=1)
    assert not np.array_equal(early.iq[0], record.iq[0])


def test_a_camera_that_begins_later_does_so_too(scene: Scene, monkeypatch, caplog) -> None:
    """What the camera's server is given for a run begins where the radar has come to. At a fast
    pace too its frames are computed ahead, elsewhere: a camera that computes hears nothing. A run
    that goes on with what the one before waited for says how old that is.
    """
    given = {}

    class Camera:
        url, run, stop, listen = "tcp://127.0.0.1:1", None, None, None

        def __init__(self, camera, line, **_: object) -> None:
            given["camera"] = camera

    def virtual_camera(system: System, sun, records, **_: object) -> Iterator[SpiRecord]:
        return records(system)

    class Ahead:
        def __init__(self, now: Scene, *_: object) -> None:
            self.scene, self.begins_s = now, None

        def wait(self) -> None:
            """They are there."""

        def __call__(self, asked: System, begins_s: float) -> "Ahead":
            self.begins_s = self.begins_s or begins_s  # none has come yet
            return self

    world = SharedWorld("fast")
    world.begin()
    world.reached(1.25)
    monkeypatch.setattr(serving, "FramesOfRuns", Ahead)
    monkeypatch.setattr(serving, "CameraServer", Camera)
    monkeypatch.setattr(serving, "VirtualCamera", virtual_camera)
    system = load_system("workable").with_(
        {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 8}
    )
    monkeypatch.setattr(serving, "Terminal", lambda: Camera(None, None))
    monkeypatch.setattr(serving.MovingFrames, "__call__", lambda self, number: None)
    serving.serve_camera(scene, system, None, pace="fast", world=world)
    run = given["camera"](None, None)
    assert (run.scene, run.begins_s) == (scene, 1.25)
    assert not caplog.messages
    world.reached(11.25)
    given["camera"](None, None)
    assert "they show the world of 10 s ago" in caplog.text


def test_a_radio_behind_the_world_says_by_how_much(scene: Scene, caplog) -> None:
    """The world goes on with the host's clock; a sweep of 0.3 s is behind, and it is said once."""
    world = SharedWorld("real")
    radio = radio_in(scene, world, pace="real")
    computed = radio._later
    assert computed is not None

    def slowly(begins_s: float):
        sweeps = computed(begins_s)

        def slow(number: int):
            time.sleep(0.3)
            return sweeps(number)

        return slow

    radio._later = slowly
    schedule = replace(radio.schedule, lead_s=0.2)
    acquire(radio, schedule, radio.front_end, bursts=4)
    (told,) = [line for line in caplog.messages if "shows the world of" in line]
    assert "s ago" in told
    assert world.now_s() > 0.9


def test_a_world_begins_with_its_first_device_and_goes_on() -> None:
    real = SharedWorld("real")
    assert real.now_s() == 0.0
    assert real.begin() == 0.0
    time.sleep(0.02)
    later = [real.begin(), real.now_s(), real.begin()]
    assert later[0] >= 0.02
    assert all(one <= other for one, other in itertools.pairwise(later))
    assert real.reached(0.0) == pytest.approx(real.now_s(), abs=0.05)
    assert real.reached(1e3) == 0.0


def test_a_world_whose_trajectories_have_ended_is_one_line(scene: Scene) -> None:
    """Told when the radio is tuned, not a trace."""
    item = scene.objects[0]
    ends = through(
        np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [0.1, 0, 0]]), Rotation.identity(2), "error"
    )
    short = replace(scene, objects=(item.following(ends), *scene.objects[1:]))
    world = SharedWorld("fast")
    world.begin()
    world.reached(5.0)
    radio = radio_in(short, world)
    with pytest.raises(RadioError, match="trajectories"):
        radio.tune(radio.carriers_hz[0])
