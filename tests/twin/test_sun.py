"""The sun through the day: against NREL's algorithm, clear skies, and walls that it lights."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.camera import capture, still_world
from twin.camera.acquisition import measure
from twin.camera.assumptions import SKY_STAYS_ASSUMPTION, SUN_MOVES_ASSUMPTION
from twin.camera.chain import Chain
from twin.camera.exposure_noise import exposure_noise_w
from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.camera.still_world import StillWorld
from twin.camera.stream import MovingFrames
from twin.errors import InputError
from twin.fidelity import DEFAULT, Fidelity
from twin.optics.solar_irradiance import sun_in_band
from twin.scene import Scene, Sun, load_scene
from twin.system import Sky, System, load_system
from twin.toml import Sourced

Array = NDArray[np.float64]

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
    assert changed.after(3600.0) == Sun(changed.azimuth_deg, 20.0, 1e4, 50.0, 286.0).after(3600.0)
    stopped = scene.with_({"sun.latitude_deg": None, "sun.north_azimuth_deg": None}).sun
    assert stopped == Sun(scene.sun.azimuth_deg, scene.sun.elevation_deg, scene.sun.illuminance_lx)
    place = {"sun.latitude_deg": "-34 deg", "sun.north_azimuth_deg": 0}
    begun = replace(scene, sun=stopped).with_(place).sun
    assert (begun.latitude_deg, begun.north_azimuth_deg) == (-34.0, 0)
    with pytest.raises(InputError, match="needs both"):
        replace(scene, sun=stopped).with_({"sun.latitude_deg": 10})


def test_a_sun_that_has_set_is_changed_as_far_as_that_says_something(tmp_path: Path) -> None:
    night = wall_in_the_sun(tmp_path / "wall", moving_sun().after(14 * 3600.0))
    turned = night.with_({"sun.azimuth_deg": 10.0}).sun
    assert turned.after(43200.0).illuminance_lx > 0
    with pytest.raises(InputError, match=r"sun has set.*expected sun.illuminance_lx beside it"):
        night.with_({"sun.elevation_deg": 10.0})
    risen = night.with_({"sun.elevation_deg": 10.0, "sun.illuminance_lx": 1e4}).sun
    assert risen.after(60.0).illuminance_lx > 1e4 * 0.9


@pytest.mark.parametrize("when", [float("nan"), float("inf"), 1e300, "1 h", None])
def test_what_is_no_time_is_told(when: Any) -> None:
    for sun in (moving_sun(), Sun(160.0, 38.0, 1e5)):
        with pytest.raises(InputError, match=r"sun.after = .*expected"):
            sun.after(when)


def test_a_sun_below_the_horizon_that_lights_is_warned_of(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    with (scene.path.parent / "scene.toml").open("a") as file:
        file.write("[sun]\nazimuth_deg = 160\nelevation_deg = -3\nilluminance_lx = 5e4\n")
    assert any("3 deg below the horizon" in told for told in load_scene(scene.path.parent).warnings)


def test_a_frame_in_which_the_sun_does_not_stand_still_says_so(tmp_path: Path) -> None:
    """All its exposures have the light of its middle."""
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun(1.0, illuminance_lx=500.0))
    period = {"acquisition.integration_time_s": 0.4, "acquisition.pattern_period_s": 0.5}
    slow = CAMERA.with_({"sky": None, **period})
    taken = capture(scene, slow, seed=1, fidelity=FAST)
    assert taken.illuminance_lx == pytest.approx(scene.sun.after(32.0).illuminance_lx)
    assert any("the sun turns by 0.27 deg in a frame" in told for told in taken.warnings)
    dark = slow.with_({"sky.illuminance_lx": 0.0})
    for other in (CAMERA.with_({"sky": None}), dark):
        quick = capture(scene, other, seed=1, fidelity=FAST)
        assert not any("the sun turns" in told for told in quick.warnings)


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
        ({"clear_sky_share": -1.0}, "clear_sky_share = -1.0: expected"),
        ({"clear_sky_share": float("nan")}, "clear_sky_share = nan: expected"),
        ({"clear_sky_share": 0.3}, "clear_sky_share = 0.3 makes it"),
        ({"elevation_deg": -10.0, "clear_sky_share": 0.3}, "= 50000: clear_sky_share = 0.3 makes"),
        (
            {"latitude_deg": None, "north_azimuth_deg": None, "clear_sky_share": 0.3},
            "belongs to a sun that moves",
        ),
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
    assert str(loaded.sun).endswith("moves as at latitude 50 deg, north at azimuth 286 deg")


def backgrounds_w(world: StillWorld, system: System, begins_s: Sequence[float]) -> Array:
    """The sun's power in frames that begin at some times."""
    found = []
    for begin_s in begins_s:
        seen, light = world.at(begin_s)
        rng = np.random.default_rng(1)
        found.append(measure(seen, system, light, rng=rng, noise="none").background_w)
    return np.array(found)


@pytest.mark.parametrize("elevation_deg", [38.0, 3.0])
@pytest.mark.parametrize("fidelity", [FAST, replace(DEFAULT, noise="none")])
def test_a_walls_sunlight_follows_the_suns_course(
    tmp_path: Path, elevation_deg: float, fidelity: Fidelity
) -> None:
    """By its cosine and the spectrum of a clear sky, in between two steps too; from behind the
    wall, and after sunset, there is none.
    """
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun(elevation_deg))
    # A filter that does not shift with the angle, so that its band is one for the whole field.
    system = CAMERA.with_({"sky": None, "filter.effective_index": None})
    world = StillWorld(scene, system, fidelity, np.random.SeedSequence(5))

    def expected(begin_s: float) -> float:
        sun = scene.sun.after(begin_s + system.frame_time_s / 2)
        sky = Sky(sun_elevation_deg=Sourced(value=sun.elevation_deg, assumed="for this test"))
        clear = sun_in_band(sky, system.filter).irradiance_w_per_m2
        return max(float(sun.direction @ [-1.0, 0.0, 0.0]), 0.0) * clear

    times_s = [0.0, 11.0, 23.0, 48.0, 2400.0, 2411.0, 24 * 600.0, 24 * 2000.0, 24 * 2000.0 + 7]
    found_w = backgrounds_w(world, system, times_s)
    shape = np.array([expected(begin_s) for begin_s in times_s])
    assert (shape[4:6] > 0).any()
    assert (shape[-2:] == 0).all()
    rounding = 1e-4 if fidelity is FAST else 1e-2
    np.testing.assert_allclose(found_w / found_w[0], shape / shape[0], rtol=rounding, atol=1e-9)


def test_light_is_smooth_between_steps_where_the_sun_grazes(tmp_path: Path) -> None:
    """On level ground 2 degrees below the sun, a step is 5 % of its light."""
    scene = ground(tmp_path / "ground", moving_sun(2.0))
    world = StillWorld(scene, CAMERA, FAST, np.random.SeedSequence(5))
    begins_s = 4.0 * np.arange(14)
    found_w = backgrounds_w(world, CAMERA, begins_s)
    suns = [scene.sun.after(t + CAMERA.frame_time_s / 2).direction[2] for t in begins_s]
    np.testing.assert_allclose(found_w / found_w[0], np.array(suns) / suns[0], rtol=1e-4)


@pytest.mark.parametrize("elevation_deg", [0.02, 0.05])
def test_light_bends_where_the_sun_rises_and_where_it_passes_a_plane_edge_on(
    tmp_path: Path, elevation_deg: float
) -> None:
    """Ground from the horizon on, to a tenth of an exposure's noise: frame by frame as the closed
    form, the light of the sky given by the system, so that its brightness does not hide it.
    """
    scene = ground(tmp_path / "ground", moving_sun(elevation_deg, illuminance_lx=300.0))
    system = CAMERA.with_({"sky.illuminance_lx": 2e4})
    world = StillWorld(scene, system, FAST, np.random.SeedSequence(5))
    begins_s = np.arange(-24.0, 24.0, 1.3)
    found_w = backgrounds_w(world, system, begins_s)
    heights = np.array(
        [scene.sun.after(t + system.frame_time_s / 2).direction[2] for t in begins_s]
    )
    assert (heights < 0).any()
    assert (found_w[heights <= 0] == 0).all()
    lit, noise_w = heights > 0, noise_of_an_exposure_w(scene, system)
    slope = found_w[-1] / heights[-1]
    assert np.abs(found_w - slope * np.maximum(heights, 0))[lit].max() < 0.1 * noise_w
    half_step = np.sin(np.radians(0.05)) * slope
    assert half_step / 4 > 0.4 * noise_w, "else a straight line over half a step would pass"


def noise_of_an_exposure_w(scene: Scene, system: System) -> float:
    chain = Chain.of(system, scene.sun)
    light = render(scene, system, fidelity=FAST, seed=np.random.SeedSequence(5))
    return exposure_noise_w(chain, light)


def ground(folder: Path, sun: Sun) -> Scene:
    """Level ground before a rig that looks down to it."""
    folder.mkdir()
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="rectangle" id="ground"><transform name="to_world">'
        '<scale value="50"/></transform><bsdf type="diffuse" id="concrete"/></shape></scene>'
    )
    (folder / "scene.toml").write_text("[rig]\nposition_m = [0.0, 0.0, 2.0]\npitch_deg = 45.0\n")
    return replace(load_scene(folder), sun=sun)


def test_light_is_rendered_at_steps_alone_and_comes_back_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    rendered = []

    def counted(*args: Any, **others: Any) -> RenderedLight:
        rendered.append(args[0].sun)
        return render(*args, **others)

    monkeypatch.setattr(still_world, "render", counted)

    def new() -> StillWorld:
        return StillWorld(scene, CAMERA, FAST, np.random.SeedSequence(5))

    world = new()
    first = world.at(0.0)[1]
    for begin_s in (3.0, 9.0, 15.0, 20.0, 24.0, 30.0, 40.0):
        world.at(begin_s)
    assert len(rendered) == 5  # both ends and the middle of two steps
    np.testing.assert_array_equal(world.at(0.0)[1].sun, first.sun)
    at_once = new().at(30.0)[1].sun
    np.testing.assert_array_equal(at_once, world.at(30.0)[1].sun)
    night = [world.at(14 * 3600.0 + 60 * k)[1] for k in range(3)]
    assert night[0] is night[1] is night[2]
    still = replace(scene, sun=Sun(160, 38, 5e4))
    fixed = StillWorld(still, CAMERA, FAST, np.random.SeedSequence(5))
    assert fixed.at(1e6)[1] is fixed.at(0.0)[1]


def test_a_sun_that_never_stands_there_is_warned_of(tmp_path: Path) -> None:
    scene = wall_in_the_sun(tmp_path / "wall", moving_sun())
    with (scene.path.parent / "scene.toml").open("a") as file:
        file.write("[sun]\nazimuth_deg = 286\nelevation_deg = 80\nilluminance_lx = 5e4\n")
        file.write("latitude_deg = 60\nnorth_azimuth_deg = 286.0\n")
    told = load_scene(scene.path.parent).warnings
    assert any("declination would be 70.0 deg" in text for text in told)
    assert not any("declination" in text for text in load_scene("crossing").warnings)


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
