"""Light of bounces that fixed knobs cut off, where it comes by surfaces that are not seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.physics.moving_worlds import plate, small, world
from twin.camera import capture
from twin.camera.intervals import background_interval, noise_interval, sun_power_interval
from twin.camera.left_out import bounces_share, typical_reflectance
from twin.camera.light import render
from twin.camera.reflectance_rescaling import render_unit_reflectance
from twin.fidelity import PRESETS, Fidelity
from twin.geometry import Geometry
from twin.scene import Pose, Rig, SceneObject, Sun, load_scene
from twin.scene.texture import Texture
from twin.system import load_system


def wall(name: str, y: float, inward: int) -> SceneObject:
    """An upright wall of 8 x 4 m along the view, beside it, as bright as snow."""
    corners = np.array([[0, y, -2], [8, y, -2], [8, y, 2], [0, y, 2]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)[:, ::inward]
    return SceneObject(name, Geometry(corners, faces), "m", 0.88)


def test_the_reflectance_of_bounces_is_the_brighter_of_what_is_seen_and_of_all() -> None:
    """By areas: 32 m^2 of .9 and 4 m^2 of a texture of .1 and .3 beside what is seen, of .5."""
    bright = replace(wall("bright", 2.0, 1), reflectance=0.9)
    dark = replace(plate("dark", (-1, 1), (-1, 1)), reflectance=Texture(np.float32([[0.1, 0.3]])))
    of_all = (32 * 0.9 + 4 * 0.2) / 36
    assert typical_reflectance([bright, dark], np.array([[0.5, 0.0]])) == pytest.approx(of_all)
    assert typical_reflectance([dark], np.array([[0.5, 0.0]])) == 0.5
    assert typical_reflectance([], np.zeros((1, 1))) == 0
    assert bounces_share(0.5, 3, None) == pytest.approx(1 / 7)
    assert bounces_share(0.0, 3, None) == 0


def test_sunlight_by_two_bright_walls_beside_the_field_is_within_what_is_stated() -> None:
    """The camera sees a dark end alone; the sun comes to it by the walls, many times. The stated
    error followed from the end's reflectance, and the sun was off by 3 times as much.
    """
    end = replace(plate("end", (-1.5, 1.5), (-2, 2), 8.0), reflectance=0.1)
    sun = Sun(azimuth_deg=80.0, elevation_deg=35.0, illuminance_lx=20_000.0)
    scene = replace(world(end, wall("left", 1.5, 1), wall("right", -1.5, -1)), sun=sun)
    cut, whole = (
        background_interval(
            capture(
                replace(scene, path=Path(f"depth{depth}")),
                small(),
                seed=1,
                fidelity=PRESETS["standard"].with_(max_depth=depth, samples=256),
            )
        )
        for depth in (4, 40)
    )
    off = abs(cut.value - whole.value)
    assert off > 0.02 * whole.value
    assert off < cut.of_model.half_width + whole.of_model.half_width


def test_sun_that_no_path_met_is_not_none_at_all() -> None:
    """From behind the patches only light off the ground behind the rig reaches them: four paths of
    a part miss it, and the interval says what they may miss.
    """
    scene = load_scene("table1")
    behind = scene.with_({"sun.azimuth_deg": scene.sun.azimuth_deg + 180})
    small = {"emitter.rows": 16, "emitter.columns": 16, "acquisition.n_patterns": 256}
    system = load_system("workable").with_({**small, "sky": None})
    finest = Fidelity(samples=4096, max_depth=12)
    truth_w = capture(behind, system, seed=2, fidelity=finest).background_w
    assert truth_w > 0
    draft = capture(behind, system, seed=1, fidelity=PRESETS["draft"])
    assert draft.background_w == 0
    sun, noise = sun_power_interval(draft), noise_interval(draft)
    assert sun.systematic > truth_w
    assert noise.holds(capture(behind, system, seed=1, fidelity=finest).noise.total_noise_e)
    missed_e = background_interval(draft).systematic
    by_missed_e = np.sqrt(noise.value**2 + missed_e) - noise.value
    assert noise.systematic >= 0.9 * by_missed_e > 0.1 * noise.value
    swept = render_unit_reflectance(
        behind, system, fidelity=PRESETS["draft"], seed=np.random.SeedSequence(1)
    ).rescaled(behind)
    rendered = render(behind, system, fidelity=PRESETS["draft"], seed=np.random.SeedSequence(1))
    assert not swept.sun.any()
    np.testing.assert_allclose(rendered.sun_left_out, swept.sun_left_out)


@pytest.mark.quick(1)
@pytest.mark.parametrize("dark", [{"sky.illuminance_lx": 0.0}, {"sky.sun_elevation_deg": -5.0}])
def test_of_no_sun_in_fog_nothing_is_left_out(dark: dict[str, float]) -> None:
    """What is left out of a sun's light in fog has no bound here, per irradiance of the sun; of 0
    W/m^2 it is 0 W. The product had been no number, and the capture was refused.
    """
    here, beside = Pose((0.0, 0.0, 0.0)), Pose((0.0, -0.3, 0.0))
    scene = world(plate("wall", (-2, 2), (-2, 2)), rig=Rig(here, beside, here))
    few = {"emitter.rows": 4, "emitter.columns": 4, "acquisition.n_patterns": 16}
    system = load_system("workable").with_({**few, **dark, "weather.part": "fog-200m"})
    night = capture(scene, system, seed=1)
    assert (night.background_w, night.noise.background_e) == (0.0, 0.0)
    for interval in (sun_power_interval(night), background_interval(night)):
        assert (interval.value, interval.half_width) == (0.0, 0.0)
