"""A line sensor behind rows of LEDs: counts by column, and the image they make."""

from pathlib import Path

import numpy as np
import pytest
from scipy import constants

from hardware import reconstruct
from tests.still import still_yard
from twin.camera import capture
from twin.camera.equal_paths import emitter_light, sun_light
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.devices import Device
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.radiometry import collection, mean_cos_power, wall_power_w
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

LINE = load_system("line-256x16")


@pytest.fixture
def at_dusk(tmp_path: Path) -> System:
    """The same sensor where it works: source inside the filter, dusk, small capacitor."""
    (tmp_path / "dusk.toml").write_text(
        'base = "line-256x16"\n[emitter]\nline_fwhm_m = 2e-9\n[sky]\npart = "dusk"\n'
        '[readout]\npart = "ctia-high-gain"\n'
    )
    return load_system(tmp_path / "dusk.toml")


def wall(distance_m: float) -> Scene:
    corners = np.array([[0, -50, -50], [0, 50, -50], [0, 50, 50], [0, -50, 50.0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    item = SceneObject("wall", Geometry(corners + [distance_m, 0, 0], faces), "white", 0.5)
    rig = Rig(Pose((0.0, 0.0, 0.0)), detector=Pose((0.0, 0.0, 0.0)))
    return Scene("wall", Path(), "", (item,), rig, Sun(180.0, 0.0, 1e5))


def test_all_columns_together_are_the_closed_form() -> None:
    """Watts of all columns from a wall at 5 m: rho I tau A / ((4 N^2 + 1) z^2) <cos^7>, A of all
    1024 pixels; and each column has the same share but for the cosines.
    """
    lens = collection(LINE)
    scene = wall(5.0)
    here = Device(np.zeros(3), np.eye(3), lens.tan_half_field)
    problem = LightProblem(mitsuba_scene(scene), here, here)
    light = emitter_light(problem, (16, 1), 256, quality=TracingQuality(64, 1), seed=1)
    intensity = LINE.emitter.radiant_intensity_w_per_sr.value
    watts = intensity * lens.transmission * lens.pupil_area_m2 * light.cells.sum()
    assert watts == pytest.approx(wall_power_w(LINE, 0.5, 5.0), rel=3e-3)
    assert lens.pupil_area_m2 * lens.field_area == pytest.approx(np.pi * 2.56e-6 / 5, rel=1e-9)
    columns = light.cells.sum(axis=1)
    assert columns.min() > 0.8 * columns.max()
    assert np.argmax(columns) in range(100, 156)


def test_the_sun_falls_on_every_column() -> None:
    lens = collection(LINE)
    here = Device(np.zeros(3), np.eye(3), lens.tan_half_field)
    problem = LightProblem(mitsuba_scene(wall(5.0)), here, here, np.array([-1.0, 0, 0]))
    parts = sun_light(problem, (32, 256), quality=TracingQuality(16, 1), seed=1).total
    expected = 0.5 / np.pi * mean_cos_power(4, lens.tan_half_field, "square") * lens.field_area
    assert parts.sum() == pytest.approx(expected, rel=1e-3)
    assert parts.shape == (32, 256)
    columns = parts.sum(axis=0)
    assert columns.min() > 0.9 * columns.max()


def test_the_picture_is_the_scene(at_dusk: System) -> None:
    """16 differential pairs of 256 counts make 256 x 16 pixels that agree with the noise-free ones;
    turned over or mirrored they do not.
    """
    taken = capture(still_yard(), at_dusk, seed=2, fidelity=Fidelity(16, 2))
    assert taken.record.counts.shape == (32, 256)
    assert taken.cells_e.shape == taken.truth.albedo.shape == (16, 256)
    picture = reconstruct(taken.record, "zero-fill").picture

    def likeness(other: np.ndarray) -> float:
        return float(np.corrcoef(picture.ravel(), other.ravel())[0, 1])

    assert likeness(taken.cells_e) > 0.99
    assert likeness(taken.cells_e[::-1]) < 0.9
    assert likeness(taken.cells_e[:, ::-1]) < 0.9


def test_truth_lies_under_the_picture(at_dusk: System) -> None:
    """Where the noise-free image is brightest the truth has the chart, 5 m ahead on the left."""
    taken = capture(still_yard(), at_dusk, fidelity=Fidelity(16, 1))
    row, column = np.unravel_index(np.argmax(taken.cells_e), taken.cells_e.shape)
    assert taken.truth.depth_m[row, column] == pytest.approx(5.0, abs=0.01)
    assert column < 128


def test_noise_of_a_column_is_that_of_its_own_light(at_dusk: System) -> None:
    """Errors over predicted noise have rms 1: 4096 pixels, each noise from 16 pairs: 5 sigma."""
    taken = capture(still_yard(), at_dusk, seed=5, fidelity=Fidelity(64, 2))
    picture = reconstruct(taken.record, "zero-fill").picture
    lit = taken.cells_e > 0
    noise = taken.cells_e[lit] / taken.snr[lit]
    scaled = (picture - taken.cells_e)[lit] / noise
    assert np.sqrt(np.mean(scaled**2)) == pytest.approx(
        1.0, abs=5 / np.sqrt(2 * len(scaled)) + 0.02
    )


def test_binning_adds_charge_and_dark_current() -> None:
    from twin.detector import FrontEnd

    front_end = FrontEnd.of(LINE)
    assert LINE.pixels_per_detector == 4
    assert front_end.dark_e == pytest.approx(4 * 3e-12 * 450e-6 / constants.e, rel=1e-9)
    assert front_end.full_well_e == pytest.approx(4 * 120e6)


@pytest.mark.parametrize("columns", [64, 128, 256])
def test_every_width_of_the_paper_works(tmp_path: Path, columns: int) -> None:
    (tmp_path / "s.toml").write_text(f'base = "line-256x16"\n[acquisition]\ncolumns = {columns}\n')
    taken = capture(load_scene("table1"), load_system(tmp_path / "s.toml"), fidelity=Fidelity(4, 1))
    assert taken.cells_e.shape == (16, columns)
    assert np.isfinite(reconstruct(taken.record).picture).all()


@pytest.mark.thorough
def test_a_picture_of_one_row_has_its_report(tmp_path: Path) -> None:
    from twin.job import run

    (tmp_path / "row.toml").write_text(
        'base = "line-256x16"\n[emitter]\nrows = 1\nline_fwhm_m = 2e-9\n'
        '[acquisition]\nn_patterns = 1\ncolumns = 32\n[sky]\npart = "dusk"\n'
    )
    fidelity = Fidelity(4, 1)
    system = tmp_path / "row.toml"
    result = run("yard", system, compare=None, radar=None, fidelity=fidelity, out=tmp_path / "out")
    assert result.evaluations[0].capture.snr.shape == (1, 32)
