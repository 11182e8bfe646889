"""What stands in one mesh with a large surface answers as an object of its own would."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform

from tests.physics.radar_worlds import RADAR, quad, thing, world
from twin.fidelity import DEFAULT, Fidelity
from twin.geometry import Geometry
from twin.radar import radar_capture
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.parts import parted
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
    apart = trace(world(ground(), joined("boxes", *BOXES)), RADAR)
    found = trace(world(site), RADAR)
    assert found.objects == ("site", "site (other parts)")
    assert found.bodies[0].objects == ("site (other parts)",)
    level, alone = (each.bodies[0].level_amplitude for each in (found, apart))
    assert level == pytest.approx(alone, rel=1e-3)
    assert abs(channel(found) - channel(apart)) < 1e-3 * alone


def test_a_capture_has_the_same_record() -> None:
    """Motion too: the site passes by, and its parts keep its velocity."""
    knobs = DEFAULT.with_(radar_images=1, radar_edges=0, radar_shadowed=0)
    velocity = (-3.0, 0.0, 0.0)
    site = replace(joined("site", ground(), *BOXES), velocity_m_per_s=velocity)
    parts = [replace(p, velocity_m_per_s=velocity) for p in (ground(), joined("boxes", *BOXES))]
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
    boxes = joined("boxes", *BOXES).moved([0.0, 3.0, -0.2])
    np.testing.assert_allclose(scene.objects[1].box_m, boxes.box_m)
    assert parted(scene, RADAR) is scene  # once is enough
    again = parted(world(moved), RADAR)
    assert again.objects[1].geometry is scene.objects[1].geometry


def test_other_models_see_the_scene_as_it_is() -> None:
    found = trace(world(joined("site", ground(), *BOXES)), RADAR, fidelity=Fidelity(radar="paths"))
    assert "site (other parts)" not in found.objects
