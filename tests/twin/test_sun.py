"""The sun through the day: against NREL's algorithm, clear skies, and walls that it lights."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.camera import capture
from twin.camera.acquisition import measure
from twin.camera.assumptions import SKY_STAYS_ASSUMPTION, SUN_MOVES_ASSUMPTION
from twin.camera.still_world import StillWorld
from twin.camera.stream import MovingFrames
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.optics.solar_irradiance import sun_in_band
from twin.scene import Scene, Sun, load_scene
from twin.system import Sky, load_system
from twin.toml import Sourced

CAMERA = load_system("workable").with_(
    {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
)
FAST = Fidelity(samples=4, max_depth=1, noise="none")

#: Latitude, and hours from the first: azimuth from north clockwise and elevation without
#: refraction, in degrees, by NREL's SPA as pvlib 0.16.1 has it (`get_solarposition`,
#: `nrel_numpy`): longitude 8, 151, 18, 0 and -120, from 2026-03-20 07:30, 11-26 21:00, 06-21
#: 20:00, 12-21 10:00 and 09-01 22:00 UTC on.
SPA = [
    (50.0, {0: (112.7658, 17.838), 0.5: (119.2812, 22.1765), 6: (215.4824, 34.3194)}),
    (-34.0, {0: (98.1803, 27.046), 1: (90.3795, 39.4374), 4: (39.402, 73.9169)}),
    (69.0, {0: (321.3376, 7.3979), 2: (348.5522, 2.8799), 6: (43.178, 8.58)}),
    (0.0, {0: (131.3536, 52.9862), 1: (149.972, 62.6506), 3: (211.6178, 62.1545)}),
    (35.0, {0: (232.7019, 51.4636), 1: (247.6978, 40.7714), 3: (268.0215, 16.791)}),
]


def moving_sun(elevation_deg: float = 38.0, **others: float) -> Sun:
    return Sun(
        **{  # type: ignore[arg-type]
            "azimuth_deg": 160.0,
            "elevation_deg": elevation_deg,
            "illuminance_lx": 5e4,
            "latitude_deg": 50.0,
            "north_azimuth_deg": 286.0,
        }
        | others
    )


def wall_in_the_sun(folder: Path, sun: Sun) -> Scene:
    """A wall across the field, 5 m before the rig, which looks along x; no floor."""
    folder.mkdir(exist_ok=True)
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="rectangle" id="wall"><transform name="to_world">'
        '<scale value="20"/><rotate y="1" angle="-90"/><translate x="5" z="1"/></transform>'
        '<bsdf type="diffuse" id="concrete"/></shape></scene>'
    )
    (folder / "scene.toml").write_text("[rig]\nposition_m = [0.0, 0.0, 1.0]\n")
    return replace(load_scene(folder), sun=sun)


@pytest.mark.parametrize(("latitude_deg", "places"), SPA)
@pytest.mark.parametrize("north_azimuth_deg", [90.0, -200.0])
def test_the_sun_is_where_nrels_algorithm_has_it(
    latitude_deg: float, places: dict[float, tuple[float, float]], north_azimuth_deg: float
) -> None:
    """To 0.02 degrees an hour, the course of the year."""
    suns = {
        hours: Sun(north_azimuth_deg - azimuth, elevation, 5e4, latitude_deg, north_azimuth_deg)
        for hours, (azimuth, elevation) in places.items()
    }
    for hours, expected in suns.items():
        found = suns[0].after(3600 * hours).direction
        off_deg = np.degrees(np.arccos(np.clip(found @ expected.direction, -1, 1)))
        assert off_deg <= 0.02 * hours + 1e-4


def test_the_sun_of_a_later_time_goes_on_as_the_first_does() -> None:
    """Through a night too; and a day later it is where it was."""
    first = moving_sun()
    for between in (600.0, 12 * 3600.0):
        later, at_once = first.after(between).after(2e4), first.after(between + 2e4)
        np.testing.assert_allclose(later.direction, at_once.direction, atol=1e-12)
        assert later.illuminance_lx == pytest.approx(at_once.illuminance_lx, rel=1e-9, abs=1e-9)
    day = first.after(86400.0)
    np.testing.assert_allclose(day.direction, first.direction, atol=1e-12)
    assert day.illuminance_lx == pytest.approx(first.illuminance_lx, rel=1e-9)


def test_its_illuminance_is_that_of_a_clear_sky_and_zero_at_night() -> None:
    band, first = load_system("workable").filter, moving_sun()

    def clear_lx(elevation_deg: float) -> float:
        sky = Sky(sun_elevation_deg=Sourced(value=elevation_deg, assumed="for this test"))
        return sun_in_band(sky, band).illuminance_lx

    noon = first.after(3 * 3600.0)
    assert noon.elevation_deg > first.elevation_deg + 5
    share = first.illuminance_lx / clear_lx(first.elevation_deg)
    assert noon.illuminance_lx == pytest.approx(share * clear_lx(noon.elevation_deg), rel=1e-6)
    night = first.after(14 * 3600.0)
    assert night.elevation_deg < 0
    assert night.has_set
    assert night.illuminance_lx == 0


def test_a_changed_sun_moves_on_from_where_it_was_put(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun().after(3600.0))
    changed = scene.with_({"sun.illuminance_lx": 1e4, "sun.elevation_deg": 20.0}).sun
    assert changed == replace(changed, clear_sky_share=None)
    later = changed.after(3600.0)
    fresh = Sun(changed.azimuth_deg, 20.0, 1e4, 50.0, 286.0).after(3600.0)
    assert later == fresh


def test_a_sun_without_a_latitude_stands_still() -> None:
    sun = Sun(160.0, 38.0, 1e5)
    assert not sun.moves
    assert sun.after(1e6) is sun


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"north_azimuth_deg": None}, "needs both `latitude_deg` and `north_azimuth_deg`"),
        ({"latitude_deg": None}, "needs both `latitude_deg` and `north_azimuth_deg`"),
        ({"latitude_deg": 91.0}, "latitude_deg = 91.0: expected -90 to 90"),
        ({"north_azimuth_deg": float("nan")}, "north_azimuth_deg = nan: expected a finite"),
        ({"elevation_deg": -1.0}, "elevation_deg = -1: expected a number above 0 for a sun that"),
        ({"elevation_deg": 0.2, "illuminance_lx": 1e5}, "lx in the zenith, expected at most 1e"),
    ],
)
def test_suns_that_cannot_be_are_refused(changes: dict[str, float], told: str) -> None:
    with pytest.raises(InputError, match=told):
        moving_sun(**changes)


def test_a_file_says_that_it_moves(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    given = (
        "[sun]\nazimuth_deg = 160\nelevation_deg = 38\nilluminance_lx = 5e4\nlatitude_deg = 50\n"
    )
    with (scene.path.parent / "scene.toml").open("a") as file:
        file.write(given)
    with pytest.raises(InputError, match="north_azimuth_deg"):
        load_scene(scene.path.parent)
    with (scene.path.parent / "scene.toml").open("a") as file:
        file.write("north_azimuth_deg = 286.0\n")
    loaded = load_scene(scene.path.parent)
    assert loaded.sun == moving_sun()
    assert loaded.after(600.0).sun == moving_sun().after(600.0)
    assert str(loaded.sun).endswith("moves as at latitude 50 deg")


@pytest.mark.parametrize("elevation_deg", [38.0, 3.0])
def test_a_walls_sunlight_follows_the_suns_course(tmp_path: Path, elevation_deg: float) -> None:
    """By cosine and illuminance; from behind the wall, and after sunset, there is none."""
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun(elevation_deg))
    system = CAMERA.with_({"sky": None})
    world, normal = StillWorld(scene, system, FAST, np.random.SeedSequence(5)), [-1.0, 0.0, 0.0]

    def background_w(seconds: float) -> float:
        seen, light = world.at(seconds)
        rng = np.random.default_rng(1)
        return measure(seen, system, light, rng=rng, noise="none").background_w

    def expected(seconds: float) -> float:
        sun = scene.sun.after(seconds)
        return max(float(sun.direction @ normal), 0.0) * sun.illuminance_lx

    first_w = background_w(0.0)
    for seconds in (48.0, 2400.0, 24 * 600.0, 24 * 2000.0):
        ratio = expected(seconds) / expected(0.0)
        assert background_w(seconds) / first_w == pytest.approx(ratio, rel=1e-4, abs=1e-9)
    # In between its direction is that of the nearest step, its illuminance its own.
    error = np.radians(0.05) / np.sqrt(1 - (scene.sun.direction @ normal) ** 2)
    assert background_w(11.0) / first_w == pytest.approx(expected(11.0) / expected(0.0), rel=error)


def test_light_is_rendered_once_a_step_and_comes_back_to_the_same_bits(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    world = StillWorld(scene, CAMERA, FAST, np.random.SeedSequence(5))
    first = world.at(0.0)[1]
    assert world.at(11.9)[1] is first
    second = world.at(12.1)[1]
    assert second is not first
    assert (second.sun != first.sun).any()
    np.testing.assert_array_equal(world.at(0.0)[1].sun, first.sun)
    fixed = StillWorld(replace(scene, sun=Sun(160, 38, 5e4)), CAMERA, FAST, world._seed)
    assert fixed.at(1e6)[1] is fixed.at(0.0)[1]


def test_frames_under_a_sun_that_moves_begin_with_that_of_a_capture(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun(illuminance_lx=500.0))
    system = CAMERA.with_({"sky": None})
    frames = MovingFrames(scene, system, 3, replace(FAST, noise="full"))
    alone = capture(scene, system, seed=3, fidelity=replace(FAST, noise="full"))
    np.testing.assert_array_equal(frames(0).counts, alone.record.counts)
    assert SUN_MOVES_ASSUMPTION in alone.assumptions
    assert SKY_STAYS_ASSUMPTION not in alone.assumptions
    a_while = round(600.0 / system.frame_time_s)
    counts = frames(a_while).counts
    np.testing.assert_array_equal(
        MovingFrames(scene, system, 3, replace(FAST, noise="full"))(a_while).counts, counts
    )
    assert abs(counts.mean() - alone.record.counts.mean()) > 1


def test_a_systems_own_sky_shines_until_the_sun_sets(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    shown = [capture(s, CAMERA, seed=1, fidelity=FAST) for s in (scene, scene.after(14 * 3600.0))]
    assert [x.illuminance_lx for x in shown] == [400.0, 0.0]
    assert SKY_STAYS_ASSUMPTION in shown[0].assumptions
