"""What the radar's solver takes or leaves out by bounds: the error stays within what it tells."""

import re

import numpy as np
import pytest
import trimesh

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    GAIN,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    thing,
    trihedral,
    world,
)
from twin.fidelity import DEFAULT, PRESETS, Fidelity, Tolerance
from twin.radar import radar_capture
from twin.radar.evaluation import evaluate_radar
from twin.radar.intervals import body_level
from twin.radar.propagation.facets import body_scattering, echo_search
from twin.radar.propagation.facets.convergence import band_of, summed_by
from twin.radar.propagation.facets.error_budget import Budget
from twin.radar.propagation.physical_optics import (
    at_antenna,
    diffracted,
    edge_bounds,
    loss_of,
)
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.scene import Scene, SceneObject

FREQUENCIES = band_of(RADAR.ofdm)
BY_BOUNDS = Fidelity(radar_bounces=None, radar_images=None)
EDGES_BY_BOUNDS = Fidelity(radar_edges=None)
#: What the bounds decide on, all of it, and finely.
EVERYTHING = Fidelity(radar_bounces=12, radar_images=3, radar_tolerance=0.03)


def errors(found: Propagation, truth: Propagation) -> dict[str, float]:
    """Of every body over the band, relative as its estimate is, over that estimate."""
    echoes = []
    for propagation in (found, truth):
        number = {name: i for i, name in enumerate(propagation.objects)}
        owner = np.full(len(propagation.objects), -1)
        for row, body in enumerate(found.bodies):
            owner[[number[name] for name in body.objects]] = row
        surfaces = propagation.surfaces
        echoes.append(
            summed_by(owner[surfaces.object], len(found.bodies), surfaces, CARRIER_HZ, FREQUENCIES)
        )
    off, level = (
        np.sqrt(np.mean(np.abs(e) ** 2, axis=1)) for e in (echoes[0] - echoes[1], echoes[0])
    )
    least = np.maximum(level, 0.01 * level.max())
    return {
        body.objects[0]: float(off[k] / least[k]) / body.estimated_error
        for k, body in enumerate(found.bodies)
    }


def decided(found: Propagation, what: str, name: str) -> tuple[int, float]:
    """Most reflections of a kind that are computed of a body, and the bound of what is not."""
    (left_out,) = (
        d for d in found.decisions if d.effect.startswith(what) and name in d.effect and not d.taken
    )
    return int(left_out.effect.removeprefix(what).split()[1].rstrip(",")), left_out.bound


def test_named_knobs_decide_by_themselves() -> None:
    """And nothing bounds what they leave out, which the figures say."""
    found = trace(world(ball("ball", (8, 0, 0), level=3)), RADAR, fidelity=Fidelity())
    assert found.decisions == ()
    (body,) = found.bodies
    assert (body.systematic, body.is_bounded) == (0.0, False)
    assert body_level(body).systematic == np.inf
    (decided,) = trace(world(ball("ball", (8, 0, 0), level=3)), RADAR, fidelity=DEFAULT).bodies
    assert decided.is_bounded
    assert body_level(decided).half_width < 1


def test_what_is_decided_by_default_is_a_fifth_of_the_noise() -> None:
    assert Tolerance(0.2).knobs() == DEFAULT
    assert None is DEFAULT.radar_bounces is DEFAULT.radar_images is DEFAULT.radar_edges
    assert DEFAULT.radar_shadowed is None


def test_detections_under_fixed_knobs_are_not_bounded() -> None:
    """The statistical part stays."""
    scene = world(trihedral("corner", (12, 0, 0)))
    for fidelity, is_bounded in ((Fidelity(), False), (DEFAULT, True)):
        taken = radar_capture(scene, RADAR, fidelity=fidelity)
        level = evaluate_radar(RADAR, taken).intervals[0].level_dbm
        assert 0 < level.standard_error < 1
        assert np.isfinite(level.systematic) == is_bounded


def test_nothing_faces_a_ball_alone() -> None:
    """So a second reflection adds nothing, and no mirror shows it: the echo is that of one."""
    scene = world(ball("ball", (8, 0, 0), level=4))
    found = trace(scene, RADAR, fidelity=BY_BOUNDS)
    assert decided(found, "reflections at bodies", "ball") == (1, 0.0)
    assert decided(found, "reflections at large surfaces", "ball") == (0, 0.0)
    once = trace(scene, RADAR, fidelity=Fidelity(radar_bounces=1, radar_images=0))
    assert errors(found, once)["ball"] < 0.1
    assert found.bodies[0].systematic == 0


def test_a_trihedral_takes_three() -> None:
    """And not a fourth: its open side lets everything out."""
    found = trace(world(trihedral("corner", (12, 0, 0))), RADAR, fidelity=BY_BOUNDS)
    most, bound = decided(found, "reflections at bodies", "corner")
    assert most == 3
    assert bound < 0.01
    (last,) = (d for d in found.decisions if "beyond 2" in d.effect)
    assert last.taken
    assert last.bound > 0.9


def facing_plates() -> Scene:
    """Two mirrors at an acute angle, open towards the radar: a ray is thrown to and fro."""
    wedge = [
        quad(name, [[10, y, -0.1], [10.4, 0.02 * y, -0.1], [10.4, 0.02 * y, 0.1], [10, y, 0.1]])
        for name, y in (("left", 0.1), ("right", -0.1))
    ]
    return world(*wedge)


def beside_a_mirror() -> Scene:
    """A ball between a metal floor and a metal wall: echoes over both, in either order."""
    wall = quad("wall", [[0, 3, -2], [30, 3, -2], [30, 3, 10], [0, 3, 10]])
    return world(ball("ball", (9, 1, 0), level=4), ground(-1.0), wall)


def between_walls() -> Scene:
    """A ball in a corridor, whose walls show it ever again."""
    walls = [
        quad(f"wall {y}", [[0, y, -3], [40, y, -3], [40, y, 3], [0, y, 3]]) for y in (-0.7, 0.9)
    ]
    return world(ball("ball", (9, 0.3, 0), level=4), *walls)


def test_images_beyond_the_last_are_bounded_where_there_are_any() -> None:
    """Between two walls there are, in a right corner there are none, since two reflections there
    send everything back: the third of three mirrors has nothing to show.
    """
    corner, corridor = (
        trace(make(), RADAR, fidelity=BY_BOUNDS) for make in (beside_a_mirror, between_walls)
    )
    assert decided(corner, "reflections at large surfaces", "ball") == (2, 0.0)
    most, bound = decided(corridor, "reflections at large surfaces", "ball")
    assert most == 3
    assert 0.01 < bound < 2


def round_a_corner() -> Scene:
    """A ball in the second leg of a corridor, which the radar in the first one sees by walls."""
    legs = {
        "right": [[-0.75, -0.73], [4.68, -0.73]],
        "end": [[4.68, -0.73], [4.68, 3.93]],
        "left": [[2.89, 0.99], [-0.75, 0.99]],
        "beyond": [[2.89, 3.93], [2.89, 1.0]],
    }
    walls = [
        quad(name, [[*a, -1.5], [*b, -1.5], [*b, 1.5], [*a, 1.5]]) for name, (a, b) in legs.items()
    ]
    return world(ball("ball", (3.274, 2.633, 0), radius=0.04, level=4), *walls)


def test_of_what_only_the_last_images_show_no_bound_is_known() -> None:
    """Round the corner of a corridor one and no reflections show nothing, two little; of those
    beyond, which show most of it, two do not tell.
    """
    scene = round_a_corner()
    found = trace(scene, RADAR, fidelity=BY_BOUNDS)
    assert decided(found, "reflections at large surfaces", "ball") == (2, np.inf)
    (body,) = found.bodies
    assert body.estimated_error == np.inf
    four = trace(scene, RADAR, fidelity=Fidelity(radar_bounces=1, radar_images=4))
    assert four.bodies[0].level_amplitude > 50 * body.level_amplitude


def test_what_is_not_followed_is_warned_of() -> None:
    """A fourth reflection at the walls of a corridor may add more than is permitted."""
    taken = radar_capture(between_walls(), RADAR, fidelity=BY_BOUNDS)
    (warning,) = (w for w in taken.warnings if w.kind == "tolerance")
    assert warning.startswith(
        "reflections at large surfaces beyond 3, ball: not computed; at most "
    )
    alone = radar_capture(world(ball("ball", (8, 0, 0), level=4)), RADAR, fidelity=BY_BOUNDS)
    assert [w for w in alone.warnings if w.kind == "tolerance"] == []


def strong_beside_weak() -> Scene:
    """Behind a large trihedral a small ball on a floor: its errors count 40 dB below."""
    return world(
        trihedral("corner", (10, 1, 0), rcs_m2=100.0),
        ball("ball", (10, -1.5, 0), radius=0.03, level=3),
        ground(-0.7, "concrete"),
    )


def between_posts() -> Scene:
    """A plate seen between posts that light it and each other."""
    posts = [ball(f"post {k}", (7, 0.25 * k - 0.6, 0), radius=0.05, level=3) for k in range(6)]
    return world(plate("plate", (8, 0.1, 0), side=0.3), *posts)


def grazing_floor() -> Scene:
    """A low box far out on a floor that the radar sees at 2 degrees."""
    box: SceneObject = plate("box", (20, 0, -0.6), side=0.15)
    return world(box, ground(-0.7, "concrete"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "make",
    [
        facing_plates,
        beside_a_mirror,
        between_walls,
        strong_beside_weak,
        between_posts,
        grazing_floor,
    ],
)
def test_errors_are_within_what_is_told(make) -> None:
    """Of every body, against three times as fine with all reflections. What is told is three
    standard errors, and the bound of what is left out: the tests' few bodies stay within it.
    """
    scene = make()
    found = trace(scene, RADAR, fidelity=BY_BOUNDS)
    truth = trace(scene, RADAR, fidelity=EVERYTHING)
    for name, over_estimate in errors(found, truth).items():
        assert over_estimate < 1, name
    for decision in found.decisions:
        assert decision.sensor == "radar"
        assert decision.permitted == pytest.approx(0.01)
        if decision.taken:
            assert decision.bound > decision.permitted or "large surfaces" in decision.effect


def test_a_wedge_of_mirrors_takes_more_than_three() -> None:
    """Rays are thrown to and fro until they leave: three, the default, are too few."""
    found = trace(facing_plates(), RADAR, fidelity=BY_BOUNDS)
    assert decided(found, "reflections at bodies", "left")[0] > 3


def behind_bars() -> Scene:
    """A plate behind bars that throw rays to and fro between each other and the plate."""
    bars = [
        quad(f"bar {k}", [[7, y, -0.6], [7.2, y, -0.6], [7.2, y + 0.05, 0.6], [7, y + 0.05, 0.6]])
        for k, y in enumerate(np.arange(-0.6, 0.6, 0.15))
    ]
    return world(plate("plate", (7.6, 0, 0), side=0.8), *bars)


def test_deep_tubes_without_room_are_told(monkeypatch) -> None:
    """Where the tubes of few roots alone may be followed beyond the third reflection, what coarse
    ones leave uncertain is a decision, warned of where it may be more than is permitted; errors
    against twelve reflections of a finer trace are within what is told.
    """
    scene, effect = between_posts(), "finer ray tubes for more than 3 reflections at bodies, "
    finely = BY_BOUNDS.with_(radar_tolerance=0.03)
    whole = trace(scene, RADAR, fidelity=finely)
    assert not any(d.effect.startswith(effect) for d in whole.decisions)
    monkeypatch.setattr(echo_search, "MOST_DEEP_ROOTS", 4)
    taken = radar_capture(scene, RADAR, fidelity=finely)
    rows = [d for d in taken.propagation.decisions if d.effect.startswith(effect)]
    assert rows
    for decision in rows:
        assert decision.bound > 0
        assert not decision.taken
        warned = any(
            w.kind == "tolerance"
            and w.startswith(effect)
            and decision.body in w.partition(":")[0].removeprefix(effect).split(", ")
            for w in taken.warnings
        )
        assert warned == (decision.bound > decision.permitted)
    truth = trace(scene, RADAR, fidelity=EVERYTHING.with_(radar_tolerance=0.01))
    for name, over_estimate in errors(taken.propagation, truth).items():
        assert over_estimate < 1, name
    known = {body.name: body.estimated_error for body in whole.bodies}
    assert any(b.estimated_error > known[b.name] for b in taken.propagation.bodies)


def test_a_pass_is_repeated_for_bodies_that_need_it(monkeypatch) -> None:
    """The coarse pass takes bars for stronger than they are: one of nine bodies is done again, all
    others keep what the first pass found; all are as right as they say.
    """
    scene, again_of, repeated = behind_bars(), Budget.again_of, []

    def spied(budget: Budget, bodies: np.ndarray) -> Budget:
        again = again_of(budget, bodies)
        np.testing.assert_array_equal(again.accepted[~bodies], budget.accepted[~bodies])
        assert not again.accepted[bodies].any()
        repeated.append(bodies)
        return again

    monkeypatch.setattr(Budget, "again_of", spied)
    found = trace(scene, RADAR, fidelity=BY_BOUNDS)
    assert repeated
    assert all(0 < bodies.sum() < len(bodies) / 2 for bodies in repeated)
    monkeypatch.setattr(body_scattering, "_MOST_PASSES", 0)
    once = trace(scene, RADAR, fidelity=BY_BOUNDS)
    truth = trace(scene, RADAR, fidelity=EVERYTHING)
    assert max(errors(found, truth).values()) < 1
    of_once = {body.name: body.level_db for body in once.bodies}
    assert any(of_once.get(body.name) != body.level_db for body in found.bodies)


@pytest.mark.whole
def test_the_reference_follows_as_many_as_it_takes() -> None:
    """Three reflections return a ninth of the echo of mirrors that throw rays to and fro."""
    scene, finest = facing_plates(), EVERYTHING.with_(radar_tolerance=0.01)
    truth = trace(scene, RADAR, fidelity=finest)
    smooth = PRESETS["reference"].with_(radar="optics", radar_edges=0, radar_shadowed=0)
    found = trace(scene, RADAR, fidelity=smooth)
    three = trace(scene, RADAR, fidelity=smooth.with_(radar_bounces=3, radar_images=1))
    for body, over_estimate in errors(found, truth).items():
        assert over_estimate < 1, body
    assert max(errors(three, truth).values()) > 10


def test_a_later_frame_tells_what_the_first_one_left_out() -> None:
    """Reused echoes keep the bounds of what was not computed beside them."""
    scene = strong_beside_weak()
    first = trace(scene, RADAR, fidelity=BY_BOUNDS, keep=True)
    later = trace(scene, RADAR, fidelity=BY_BOUNDS, earlier=first)
    before = {body.objects: body.systematic for body in first.bodies}
    for body in later.bodies:
        assert body.systematic >= 0.99 * before[body.objects]


def tilted_box() -> SceneObject:
    """No face of it is seen at right angles."""
    mesh = trimesh.creation.box((0.3, 0.2, 0.4))
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.4, 0.5))
    return thing("box", mesh.vertices + (9.0, 0.5, 0.2), mesh.faces)


@pytest.mark.parametrize(
    "objects",
    [
        (plate("plate", (8, 0, 0)),),
        (tilted_box(),),
        (trihedral("corner", (9, 0, 0)), ground(-1.0)),
        (plate("plate", (3, 0.1, 0), side=0.6), ground(-0.5)),
    ],
)
def test_edges_add_no_more_than_their_bound(objects: tuple[SceneObject, ...]) -> None:
    """Summed over the band. The bound ignores shadows and takes mirrors as perfect."""
    scene = world(*objects)
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    prepared = prepare_scene(scene, RADAR, roles, 1)
    echoes = at_antenna(diffracted(prepared, EDGES_BY_BOUNDS)[0], prepared, RADAR)
    (of_edges,) = edge_bounds(prepared, RADAR).values()
    bound = of_edges.sum * loss_of(RADAR)
    owner = np.zeros(len(echoes), dtype=int)
    band = summed_by(owner, 1, echoes, CARRIER_HZ, FREQUENCIES)
    assert 0 < np.abs(band).max() < bound


def test_what_answers_by_its_edges_alone_is_a_body() -> None:
    """A plate in a plane with the radar shows no face: only its edges answer, and the body is told
    with their level and place.
    """
    edge_on = quad("plate", [[8, 0, -0.3], [8.6, 0, -0.3], [8.6, 0, 0.3], [8, 0, 0.3]])
    found = trace(world(edge_on), RADAR, fidelity=DEFAULT)
    assert len(found.surfaces) == 0
    (body,) = found.bodies
    assert body.name == "plate"
    edges = found.echoes
    sum_of_edges = summed_by(np.zeros(len(edges), int), 1, edges, CARRIER_HZ, FREQUENCIES)[0]
    assert body.amplitude == pytest.approx(np.sqrt(np.mean(np.abs(sum_of_edges) ** 2)), rel=1e-6)
    assert 7.9 < body.ranges_m[0] < 8.1
    assert body.ranges_m[1] < 8.7
    assert trace(world(edge_on), RADAR, fidelity=Fidelity()).bodies == ()


def test_edges_of_a_faint_plate_are_left_out() -> None:
    """9 km away it is fainter than the noise, and its edges than a hundredth of that; nearer by
    they are taken. A ball has none.
    """
    for distance, is_taken in ((9000.0, False), (30.0, True)):
        far = world(plate("plate", (distance, 0, 0), side=0.5))
        found = trace(far, RADAR, fidelity=EDGES_BY_BOUNDS)
        decision, *of_two_edges = found.decisions
        assert decision.effect == "edges of plate"
        assert decision.taken == is_taken
        left_out = of_two_edges[0] if is_taken else decision
        assert found.bodies[0].systematic == pytest.approx(left_out.bound)
    assert (
        trace(world(ball("ball", (8, 0, 0), level=4)), RADAR, fidelity=EDGES_BY_BOUNDS).decisions
        == ()
    )


def left_out_of_meshes(scene: Scene, fidelity: Fidelity) -> str:
    """What a result says of it, after it has said that bodies answer by physical optics."""
    said = trace(scene, RADAR, fidelity=fidelity).assumptions
    assert any(text.startswith("meshes scatter by physical optics") for text in said)
    beginning = "left out of meshes' echoes: "
    told = [text.removeprefix(beginning) for text in said if text.startswith(beginning)]
    assert len(told) <= 1
    return "".join(told)


def test_assumptions_name_what_was_left_out_of_meshes() -> None:
    """Edges and waves round obstacles only where these were not counted, and nothing of meshes
    where there are none.
    """
    near, far = (world(plate("plate", (x, 0, 0), side=0.5)) for x in (30.0, 9000.0))
    assert left_out_of_meshes(near, DEFAULT) == ""
    one = "edges of 1 of 1 bodies, within the stated errors"
    assert left_out_of_meshes(far, DEFAULT) == one
    assert left_out_of_meshes(near, Fidelity()) == "diffraction by edges"
    assert left_out_of_meshes(near, PRESETS["reference"]) == ""
    hidden = world(*near.objects, quad("screen", [[8, 0, -2], [8, 2, -2], [8, 2, 2], [8, 0, 2]]))
    both = "diffraction by edges; waves round obstacles"
    assert left_out_of_meshes(hidden, Fidelity()) == both
    assert "waves" not in left_out_of_meshes(hidden, DEFAULT)
    assert left_out_of_meshes(hidden, Fidelity(radar_edges=1000, radar_shadowed=7)) == (
        "waves round obstacles to more than 7 parts of bodies"
    )
    said = trace(world(ground(-1.0)), RADAR, fidelity=DEFAULT).assumptions
    assert not any("meshes" in text for text in said)


def test_assumptions_count_what_decisions_left_out() -> None:
    """Edges and waves round obstacles, of posts that shade each other from near to far."""
    posts = [
        quad(f"post {k}", [[x, y, -1], [x, y + 0.1, -1], [x, y + 0.1, 1], [x, y, 1]])
        for k, (x, y) in enumerate([(3, 1.0), (9, -0.6), (20, 0.5), (2000, 9.0), (12_000, -30.0)])
    ]
    found = trace(world(*posts), RADAR, fidelity=DEFAULT)
    (said,) = (text for text in found.assumptions if text.startswith("left out of meshes"))
    told = dict(re.findall(r"(edges|waves)[a-z ]* (\d) of 5 bodies", said))
    edges = {d.effect: d.taken for d in found.decisions if d.effect.startswith("edges of")}
    waves = {d.effect: d for d in found.decisions if "waves diffracted round obstacles" in d.effect}
    without = [
        effect
        for effect, decision in waves.items()
        if not (decision.taken or effect.startswith("the weaker "))
    ]
    assert int(told["edges"]) == sum(not taken for taken in edges.values()) == 1
    assert int(told["waves"]) == len(without) == 1


def test_what_cannot_rise_above_the_noise_is_listed() -> None:
    """A small plate 20 km away is not looked at; its largest cross-section bounds its echo, by the
    radar equation 4 pi A^2 / lambda^2.
    """
    distance, side = 20_000.0, 0.1
    far = world(plate("far", (distance, 0, 0), side=side))
    found = trace(far, RADAR, fidelity=Fidelity())
    (decision,) = found.decisions
    assert (decision.effect, decision.taken) == ("echo of far", False)
    most = GAIN * side**2 / (4 * np.pi * distance**2) / noise_amplitude(RADAR)
    assert most < decision.bound < 3 * most
    assert decision.bound < decision.permitted == OF_NOISE
    assert found.bodies == ()
