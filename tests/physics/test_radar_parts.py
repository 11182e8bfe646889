"""What stands in one mesh with a large surface answers as an object of its own would."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay
from scipy.spatial.transform import RigidTransform

from tests.physics.radar_worlds import RADAR, quad, thing, world
from twin.fidelity import DEFAULT, Fidelity
from twin.geometry import Geometry
from twin.radar import radar_capture
from twin.radar.propagation.diffraction.open_edges import open_edges
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.parts import parted
from twin.radar.propagation.scene.scattering_models import (
    ScatteringModel,
    assign_scattering_models,
)
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

GROUND = [[-5, -40, -1], [75, -40, -1], [75, 40, -1], [-5, 40, -1]]


def ground() -> SceneObject:
    return quad("ground", GROUND)


def box(name: str, place: tuple[float, float, float]) -> SceneObject:
    mesh = trimesh.creation.box((0.5, 0.6, 1.0)).apply_translation(place)
    return thing(name, mesh.vertices, mesh.faces)


def joined(name: str, *items: SceneObject) -> SceneObject:
    mesh = Geometry.concatenate([item.geometry for item in items])
    return thing(name, mesh.vertices_m, mesh.faces)


#: On the ground, and not.
BOXES = box("near", (10.0, 1.0, -0.5)), box("far", (30.0, -4.0, 0.3))


def channel(found: Propagation) -> complex:
    c = found.contributions
    return complex(np.sum(c.amplitude * np.exp(-2j * np.pi * (79e9 * c.delay_s % 1))))


def test_what_was_joined_answers_as_before() -> None:
    """All of it was silent, without a word."""
    site = joined("site", ground(), *BOXES)
    apart = trace(world(ground(), *BOXES), RADAR)
    found = trace(world(site), RADAR)
    assert found.objects == ("site", "site (other part 1)", "site (other part 2)")
    assert found.bodies[0].objects == ("site (other part 1)",)
    levels, alone = ([body.level_amplitude for body in each.bodies] for each in (found, apart))
    assert levels == pytest.approx(alone, rel=1e-3)
    assert abs(channel(found) - channel(apart)) < 2e-3 * alone[0]


@pytest.mark.thorough
def test_a_capture_has_the_same_record() -> None:
    """Motion too: the site passes by, and its parts keep its velocity."""
    knobs = DEFAULT.with_(radar_images=1, radar_edges=0, radar_shadowed=0)
    velocity = (-3.0, 0.0, 0.0)
    site = replace(joined("site", ground(), *BOXES), velocity_m_per_s=velocity)
    parts = [replace(p, velocity_m_per_s=velocity) for p in (ground(), *BOXES)]
    one, two = (
        radar_capture(world(*items), RADAR, fidelity=knobs).record for items in ((site,), parts)
    )
    np.testing.assert_allclose(one.iq, two.iq, atol=1)


def test_only_what_hangs_together_without_a_large_side_is_taken_apart() -> None:
    slabs = [
        quad(f"{x} {y}", [[x, y, -1], [x + 1, y, -1], [x + 1, y + 1, -1], [x, y + 1, -1]])
        for x in range(5, 40, 2)
        for y in range(-20, 20, 2)
    ]
    wall = quad("wall", [[30, -9, -1], [30, 9, -1], [30, 9, 4], [30, -9, 4]])
    whole = joined("site", ground(), wall, *slabs)
    assert parted(world(whole), RADAR).objects == (whole,)
    tiny = thing("tiny", np.array([[9, 0, 0], [9.005, 0, 0], [9, 0.005, 0]]), [[0, 1, 2]])
    for item in (
        whole,
        joined("site", ground(), tiny),
        replace(joined("site", ground(), *BOXES), radar="surface"),
        BOXES[0],
    ):
        scene = world(item)
        assert parted(scene, RADAR) is scene


def test_parts_go_with_what_they_were_part_of() -> None:
    site = joined("site", ground(), *BOXES)
    moved = replace(site, pose=RigidTransform.from_translation([0.0, 3.0, -0.2]))
    scene = parted(world(moved), RADAR)
    for part, alone in zip(scene.objects[1:], BOXES, strict=True):
        np.testing.assert_allclose(part.box_m, alone.moved([0.0, 3.0, -0.2]).box_m)
    assert parted(scene, RADAR) is scene  # once is enough
    again = parted(world(moved), RADAR)
    assert again.objects[1].geometry is scene.objects[1].geometry


@pytest.mark.thorough
def test_what_has_corners_or_edges_in_common_with_a_surface_is_a_part() -> None:
    """A box of the size of a cell of the ground, its bottom a face of it; one that touches a corner
    of the grid alone; and the same with its faces twice.
    """
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0.0, 60.0, 0.5), np.arange(-10.0, 10.0, 0.6)))
    grid = Delaunay(np.stack([x, y], axis=1))
    terrain = thing("terrain", np.stack([x, y, np.full(len(x), -1.0)], axis=1), grid.simplices)
    on_cell, on_corner = box("cell", (10.25, 0.5, -0.5)), box("corner", (20.25, -1.5, -0.5))
    assert (on_cell.vertices_m[:, :2] % [0.5, 0.6]).max() < 0.7
    for item in (on_cell, on_corner):
        alone = trace(world(terrain, item), RADAR).bodies[0]
        for whole in (joined("site", terrain, item), joined("site", terrain, item, item)):
            (found,) = trace(world(whole), RADAR).bodies
            assert found.name == "site (other parts)"
            # By its bottom, which is a part of the ground here.
            assert found.level_amplitude == pytest.approx(alone.level_amplitude, rel=0.03)


@pytest.mark.thorough
def test_waves_go_round_one_part_to_another() -> None:
    """What stands before another part is an obstacle to it: both were one body."""
    before = box("before", (8.0, 0.5, 0.0))
    behind = box("behind", (14.0, 0.9, 0.0))
    apart = trace(world(ground(), before, behind), RADAR)
    found = trace(world(joined("site", ground(), before, behind)), RADAR)
    assert abs(channel(found) - channel(apart)) < 1e-3 * apart.bodies[-1].level_amplitude


def test_parts_of_a_body_in_line_are_warned_of() -> None:
    """What goes round one part of a mesh to the next is left out, and no stated error holds it."""
    before, behind = box("before", (8.0, 0.5, 0.0)), box("behind", (14.0, 0.9, 0.0))
    beside = box("beside", (8.1, -1.0, 0.0))
    touching = box("touching", (8.5, 0.5, 0.0))

    def is_told(*items: SceneObject, **knobs: int) -> bool:
        found = trace(world(joined("site", *items)), RADAR, fidelity=DEFAULT.with_(**knobs))
        return any("site: parts that do not touch" in text for text in found.warnings)

    assert is_told(before, behind)
    assert is_told(behind, before)
    assert not is_told(before, behind, radar_shadowed=0)
    assert not is_told(before, beside)
    assert not is_told(before, touching)


def test_parts_of_a_declared_surface_are_warned_of() -> None:
    site = joined("site", ground(), *BOXES)
    found = trace(world(replace(site, radar="surface")), RADAR)
    assert any(text.startswith("site: declared to be a surface") for text in found.warnings)
    alone = trace(world(replace(ground(), radar="surface")), RADAR)
    assert not any("declared to be a surface" in text for text in alone.warnings)
    # No table has a surface's place where meshes scatter by physical optics.
    assert len(parted(world(replace(site, radar="table")), RADAR).objects) == 3


def test_parts_have_names_of_their_own() -> None:
    taken = [replace(BOXES[0], name=f"site (other part 2){more}") for more in ("", " (2)")]
    scene = parted(world(joined("site", ground(), *BOXES), *taken), RADAR)
    names = [item.name for item in scene.objects]
    assert names[1:3] == ["site (other part 1) (3)", "site (other part 2) (3)"]


def test_an_object_without_an_area_has_no_parts() -> None:
    line = thing("line", [[8, 0, 0], [8, 0.5, 0], [8, 1, 0]], [[0, 1, 2]])
    found = trace(world(ground(), line, BOXES[1]), RADAR)
    alone = trace(world(ground(), BOXES[1]), RADAR)
    assert found.bodies[-1].level_amplitude == pytest.approx(alone.bodies[-1].level_amplitude)


def test_many_parts_are_one_object() -> None:
    """It scatters, though some are near enough for a side of those far away to be large there."""
    many = [box(f"{n}", (1.2 * (n % 30) - 8.0, 1.5 * (n // 30) - 8.0, 0.3)) for n in range(300)]
    scene = parted(world(joined("site", ground(), *many)), RADAR)
    assert [item.name for item in scene.objects] == ["site", "site (other parts)"]
    role = assign_scattering_models(scene, RADAR.ofdm.wavelength_m, with_optics=True)[1].role
    assert role is ScatteringModel.OPTICS


def test_on_a_terrain_of_many_large_sides_parts_are_found() -> None:
    """In a mesh of more than 64 planes there were none, without a word."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-5, 75, 21), np.linspace(-40, 40, 21)))
    heights = -1 + 0.02 * np.random.default_rng(3).uniform(-1, 1, len(x))
    faces = Delaunay(np.stack([x, y], axis=1)).simplices
    terrain = thing("terrain", np.stack([x, y, heights], axis=1), faces)
    scene = parted(world(joined("site", terrain, BOXES[1])), RADAR)
    assert [item.name for item in scene.objects] == ["site", "site (other parts)"]
    assert parted(world(terrain), RADAR).objects == (terrain,)


def test_other_models_see_the_scene_as_it_is() -> None:
    found = trace(world(joined("site", ground(), *BOXES)), RADAR, fidelity=Fidelity(radar="paths"))
    assert "site (other parts)" not in found.objects


def block(name: str, low: tuple[float, float, float], high: tuple[float, float, float]):
    mesh = trimesh.creation.box(bounds=[low, high])
    return thing(name, mesh.vertices, mesh.faces)


def by_two(*items: SceneObject) -> list[float]:
    """Amplitudes of the radar's own echoes by two mirrors."""
    return sorted(abs(p.amplitude) for p in trace(world(*items), RADAR).paths if len(p.via) == 2)


@pytest.mark.parametrize(
    ("surface", "body"),
    [
        (ground(), block("house", (12, -3, -1), (15, 3, 3))),
        (ground(), block("house", (12, -3, -1 + 1e-6), (15, 3, 3))),
        (
            quad("ground", [[-5, -40, -1], [75, -40, -1], [75, 1, -1], [-5, 1, -1]]),
            block("over the border", (12, -3, -1), (15, 3, 3)),
        ),
        (
            quad("wall", [[12, -8, -1], [12, 8, -1], [12, 8, 5], [12, -8, 5]]),
            block("annex", (6, 2, -1), (12, 6, 5)),
        ),
    ],
)
def test_a_side_within_a_larger_one_is_no_border(surface: SceneObject, body: SceneObject) -> None:
    """The floor of a closed house is in the ground's plane, and the back of an annex in its wall's.
    In one mesh with these its edges had hidden the echo by both mirrors, without a warning.
    """
    apart = by_two(surface, body)
    assert len(apart) == 2
    assert by_two(joined("site", surface, body)) == pytest.approx(apart, rel=1e-6)


def test_a_seam_without_common_corners_is_no_border() -> None:
    """As between strips of ground, of which one has more points along the seam."""
    x, house = 11.95, block("house", (12, -3, -1), (15, 3, 3))
    near = quad("near", [[-5, -40, -1], [x, -40, -1], [x, 40, -1], [-5, 40, -1]])
    far = [
        quad("far", [[x, low, -1], [75, low, -1], [75, high, -1], [x, high, -1]])
        for low, high in ((-40, 7), (7, 40))
    ]
    whole = by_two(ground(), house)
    assert len(whole) == 2
    assert by_two(joined("strips", near, *far), house) == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize(
    ("low", "high", "expected_m"),
    [
        ((1.0, 1.0), (2.0, 2.0), 16.0),  # within
        ((3.0, 1.0), (6.0, 2.0), 20.0),  # over a side
        ((4.0, 0.0), (6.0, 3.0), 20.0),  # beside
        ((0.0, 0.0), (4.0, 4.0), 16.0),  # the same
        ((5.0, 0.0), (6.0, 1.0), 20.0),  # apart
    ],
)
def test_open_edges_are_those_of_what_two_squares_cover(low, high, expected_m: float) -> None:
    """By their length, to the distance beyond edges at which it is tried."""
    square = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], dtype=np.float64)
    other = [*low, 0] + square / 4 * [*np.subtract(high, low), 0]
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
    points, number = np.unique(np.concatenate([square, other]), axis=0, return_inverse=True)
    found = open_edges(points, number.reshape(-1)[faces], np.array([0.0, 0.0, 1.0]))
    length_m = np.linalg.norm(found.ends[:, 1] - found.ends[:, 0], axis=1).sum()
    assert length_m == pytest.approx(expected_m, abs=1e-3)
