"""Physical optics in scenes at the edge: empty, touching, near, far, broken meshes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.physics.radar_worlds import (
    OPTICS,
    RADAR,
    ball,
    cross_section_db,
    ground,
    plate,
    quad,
    reshaped,
    thing,
    trihedral,
    wave,
    world,
)
from twin.fidelity import Fidelity
from twin.radar import radar_capture
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, Scene


def echo(scene: Scene, **knobs) -> complex:
    return wave(trace(scene, RADAR, fidelity=OPTICS.with_(**knobs)).echoes)


@pytest.mark.parametrize("rung", ["optics", "rough"])
def test_an_empty_scene_is_silent(rung: str) -> None:
    found = trace(world(), RADAR, fidelity=Fidelity(radar=rung))
    assert found.paths == ()
    assert len(found.echoes.delay_s) == 0
    taken = radar_capture(world(), RADAR, fidelity=Fidelity(radar=rung))
    assert any("no echo at all" in w for w in taken.warnings)


def test_what_stands_behind_the_radar_is_silent() -> None:
    assert abs(echo(world(ball("b", (-5, 0, 0), level=3)))) == 0.0


def test_a_target_at_a_tenth_of_a_metre() -> None:
    """A ball of 2 cm: geometrical optics of the near field, pi a^2 (R / (R - a))^2, to its nearest
    point; 5 wavelengths small, so within 1 dB.
    """
    found = cross_section_db(echo(world(ball("b", (0.1, 0, 0), 0.02, 5))), 0.1)
    assert found == pytest.approx(10 * np.log10(np.pi * 0.02**2 * (0.1 / 0.08) ** 2), abs=1.0)


def test_a_target_at_a_kilometre() -> None:
    """1000 m^2, six times the noise of a cell; the tolerance of 3 % is 0.26 dB."""
    scene = world(trihedral("t", (1000.0, 0, 0), 1000.0))
    found = cross_section_db(echo(scene, radar_tolerance=0.03), 1000.0)
    assert found == pytest.approx(30.0, abs=0.3)


@pytest.mark.thorough
def test_a_radar_that_touches_a_mesh_hears_finite_numbers() -> None:
    """On a plate, in its plane, on a vertex of a ball, and inside one; with edges."""
    on_edge = quad("e", [[0, 0, 0], [3, 0, 0], [3, 0, 2], [0, 0, 2]])
    for scene in (
        world(plate("p", (0.0, 0, 0), 2.0)),
        world(on_edge),
        world(quad("e", [[1e-5, 0, -1], [1e-5, 0, 1], [2, 0, 1], [2, 0, -1]], radar="optics")),
        world(replace(on_edge, radar="surface")),
        world(ball("b", (0.15, 0, 0), level=3)),
        world(ball("b", (0, 0, 0), level=3)),
        world(ground(0.0)),
    ):
        knobs = OPTICS.with_(radar_edges=20_000)
        found = trace(scene, RADAR, fidelity=knobs)
        for values in (found.echoes.amplitude, found.echoes.delay_s, found.echoes.delay_rate):
            assert np.isfinite(values).all()
        assert np.abs(found.echoes.amplitude).max(initial=0.0) < 10.0
        assert all(np.isfinite(p.amplitude) and p.delay_s > 0 for p in found.paths)


def test_degenerate_and_duplicate_faces_change_nothing() -> None:
    """Faces twice, in the other order, and faces without area."""
    clean = ball("b", (10, 0, 0), level=5)
    faces = clean.geometry.faces
    dirty = reshaped(clean, faces=np.vstack([faces, faces[::3, ::-1], np.tile(faces[:5, :1], 3)]))
    one, other = echo(world(clean)), echo(world(dirty))
    assert abs(one - other) < 2e-3 * abs(one)


@pytest.mark.thorough
def test_an_open_mesh_answers_from_either_side() -> None:
    """Half a ball: its bulge as the whole one, its hollow by what it focuses, finite."""
    whole = ball("b", (10, 0, 0), level=5)
    corners = whole.vertices_m[whole.geometry.faces].mean(axis=1)
    bulge = reshaped(whole, faces=whole.geometry.faces[corners[:, 0] < 10])
    hollow = reshaped(whole, faces=whole.geometry.faces[corners[:, 0] >= 10])
    full = echo(world(whole))
    assert abs(echo(world(bulge)) - full) < 0.05 * abs(full)
    assert np.isfinite(abs(echo(world(hollow))))


def test_tilted_facets_do_not_depend_on_the_heading() -> None:
    """Scene and radar turned together: the same echo."""
    things = (ball("b", (10, 0.3, 0), level=5), trihedral("t", (12.0, -1.0, 0.2)))
    turn = np.radians(37.0)
    matrix = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    turned = (reshaped(o, o.vertices_m @ matrix.T) for o in things)
    rig = Rig(Pose((0.0, 0.0, 0.0), 37.0), radar=Pose((0.0, 0.0, 0.0)))
    one, other = echo(world(*things)), echo(world(*turned, rig=rig))
    assert abs(one - other) < 0.02 * abs(one)


def test_a_crumb_is_no_scatterer() -> None:
    """Smaller than three wavelengths: silent, and said so by its role."""
    crumb = thing("c", np.array([[5, 0, 0], [5, 1e-3, 0], [5, 0, 1e-3]]), [[0, 1, 2]])
    found = trace(world(crumb), RADAR, fidelity=OPTICS)
    assert "shadow" in found.roles[0].role
    assert len(found.echoes.delay_s) == 0
