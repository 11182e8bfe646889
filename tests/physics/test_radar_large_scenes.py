"""Images, bounds, portions and cities: what grows with the number of objects."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
import trimesh

from benchmarks.large_scenes import many_boxes
from tests.physics.large_worlds import counted, staged, street, town
from tests.physics.radar_worlds import (
    OPTICS,
    RADAR,
    ball,
    ground,
    plate,
    quad,
    thing,
    trihedral,
    wave,
    world,
)
from twin.errors import InputError
from twin.fidelity import DEFAULT, Fidelity
from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation import followed_images, physical_optics_solver, prepared_scene
from twin.radar.propagation.diffraction import fringes
from twin.radar.propagation.facets import (
    adaptive_subdivision,
    body_scattering,
    echo_search,
    front_facets,
)
from twin.radar.propagation.facets.convergence import band_of, unconverged
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene import image_search
from twin.radar.propagation.scene.culling import (
    Beam,
)
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.single_paths import mirror_echoes
from twin.radar.propagation.solvers import trace
from twin.scene import Scene, SceneObject, load_scene
from twin.scene.boxes import boxes_of
from twin.trade.bodies import echoes_by_body

EVERYWHERE = Beam(np.ones(721))


# Images.


def test_no_image_is_lost_to_what_is_known_of_patches(monkeypatch) -> None:
    """Two reflections: the same images as when rays are sent to every patch from every image."""
    scene = street(np.random.default_rng(3), 3)
    monkeypatch.setattr(prepared_scene, "beam_of", lambda antenna: EVERYWHERE)
    monkeypatch.setattr(prepared_scene, "_limit", lambda radar: 0.0)
    found = {image.patches for image in staged(scene, 2).all_images}
    monkeypatch.setattr(
        image_search, "shares", lambda ways, boxes, *_: np.ones((len(ways.place), len(boxes)))
    )
    assert {image.patches for image in staged(scene, 2).all_images} == found
    assert len(found) > 30


def test_the_radar_sees_itself_over_the_same_mirrors_as_over_all_images(monkeypatch) -> None:
    """Sequences of one image and another one reversed: every echo of the search over all images."""
    monkeypatch.setattr(prepared_scene, "_limit", lambda radar: 0.0)
    scene = street(np.random.default_rng(4), 3)
    once, twice = staged(scene, 1).seen_by_itself(), staged(scene, 2)
    whole = twice.with_images(twice.all_images)
    assert len(once.images) < len(whole.images)
    found = []
    for one in (once, whole):
        rays, _ = mirror_echoes(one)
        heard = np.flatnonzero(np.abs(rays.amplitude))
        found.append(
            sorted((one.via(int(rays.source[k])), rays.delay_s[k]) for k in heard.tolist())
        )
    assert [via for via, _ in found[0]] == [via for via, _ in found[1]]
    np.testing.assert_allclose([x for _, x in found[0]], [x for _, x in found[1]], rtol=1e-12)
    assert len(found[0]) >= 2


def test_launches_do_not_grow_with_the_patches() -> None:
    """Four times the walls: as many kernels, where each wall had two of its own."""
    launches = []
    for houses in (5, 20):
        scene = street(np.random.default_rng(5), houses)
        staged(scene)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            set_up = staged(scene)
            launches.append(len(dr.kernel_history()))
        assert len(set_up.flats) >= 2 * houses
    assert launches[1] <= launches[0] + 8


# What bounds cost.


def work_of(scene: Scene, fidelity: Fidelity, monkeypatch) -> tuple[Propagation, dict[str, int]]:
    """Rays that look for images, triangles that rays are sent to, and pieces of edges, one for each
    image that a path leads there from.
    """
    work = dict.fromkeys(("rays", "triangles", "pieces"), 0)
    with monkeypatch.context() as patched:

        def count(module, name: str, what: str, size) -> None:
            compute = getattr(module, name)

            def counting(*given):
                work[what] += size(given)
                return compute(*given)

            patched.setattr(module, name, counting)

        count(image_search, "_first_hits", "rays", lambda given: dr.width(given[3]))
        count(adaptive_subdivision, "visible_samples", "triangles", lambda given: len(given[1]))
        count(echo_search, "visible_samples", "triangles", lambda given: len(given[1]))
        count(fringes, "paths_to_points", "pieces", lambda given: len(given[2]))
        return trace(scene, RADAR, fidelity=fidelity), work


@pytest.mark.whole
def test_bounds_do_not_cost_a_town_more_than_fixed_knobs(monkeypatch) -> None:
    """Boxes among walls, with too many echoes by two reflections to follow them: what is not
    followed is told with its bound, and what is looked at stays of the order of what fixed knobs
    look at.
    """
    scene = town(60)
    monkeypatch.setattr(followed_images, "MOST_ECHO_PATHS", 10_000)
    _, fixed = work_of(scene, Fidelity(), monkeypatch)
    found, by_bounds = work_of(scene, DEFAULT, monkeypatch)
    assert by_bounds["rays"] <= fixed["rays"]
    assert by_bounds["triangles"] < 2.5 * fixed["triangles"]
    assert 0 < by_bounds["pieces"] < 2 * fixed["triangles"]
    assert any("none of more than one reflection is looked for" in a for a in found.assumptions)
    beyond = [d for d in found.decisions if "large surfaces beyond 1" in d.effect and not d.taken]
    assert any(decision.bound > decision.permitted for decision in beyond)
    once, twice = (len(staged(scene, order).all_images) for order in (1, 2))
    assert once > image_search.MANY_IMAGES
    assert twice > 2 * once


@pytest.mark.thorough
def test_too_many_images_by_hand_are_refused(monkeypatch) -> None:
    """Before a ray is sent to any facet, and with the number of paths and what to set. Nothing else
    changes: one reflection, or as many as are few enough, are followed as ever.
    """

    def never(*given, **named):
        raise AssertionError("echoes were looked for")

    scene, twice = town(60), Fidelity(radar_images=2)
    paths = followed_images.echo_paths(staged(scene, 2))
    with monkeypatch.context() as patched:
        patched.setattr(physical_optics_solver, "scattered", never)
        with pytest.raises(
            InputError, match=r"radar_images = 2: .* 2\d\.?\d* million paths"
        ) as told:
            trace(town(3000), RADAR, fidelity=twice)
        assert "set fidelity.radar_images = 1, or leave it to a tolerance" in str(told.value)
        patched.setattr(followed_images, "MOST_PATHS_BY_HAND", paths - 1)
        for most in (2, 9):  # nor are images of nine reflections looked for
            with pytest.raises(InputError, match=f"{len(staged(scene, 2).all_images) - 1} images"):
                trace(scene, RADAR, fidelity=twice.with_(radar_images=most))
        with pytest.raises(AssertionError, match="echoes were looked for"):
            trace(scene, RADAR, fidelity=Fidelity(radar_images=1))
        # What else bounds decide on takes longer, over the same paths.
        patched.setattr(followed_images, "MOST_PATHS_BY_HAND", paths)
        patched.setattr(followed_images, "MOST_ECHO_PATHS", paths - 1)
        with pytest.raises(InputError, match="radar_images = 2"):
            trace(scene, RADAR, fidelity=DEFAULT.with_(radar_images=2))
        with pytest.raises(AssertionError, match="echoes were looked for"):
            trace(scene, RADAR, fidelity=twice)


@pytest.mark.whole
def test_a_town_is_seen_over_two_walls() -> None:
    """Images of two reflections are followed where so few facets echo over them, though there are
    many: without them most boxes' echoes are off by a third.
    """
    scene = town(12)
    assert len(staged(scene, 1).all_images) > image_search.MANY_IMAGES
    found = trace(scene, RADAR, fidelity=DEFAULT)
    assert not any("more than one reflection" in line for line in found.assumptions)
    one, two, bounds = (
        band_echoes(trace(scene, RADAR, fidelity=knobs.with_(radar_edges=0)), found)
        for knobs in (
            DEFAULT.with_(radar_images=1),
            DEFAULT.with_(radar_images=2, radar_tolerance=0.03),
            DEFAULT,
        )
    )
    level = np.sqrt(np.mean(np.abs(two) ** 2, axis=1))
    left_out, off = (
        np.sqrt(np.mean(np.abs(echo - two) ** 2, axis=1)) / level for echo in (one, bounds)
    )
    assert np.median(left_out) > 0.2
    told = np.array([body.estimated_error for body in found.bodies])
    assert np.median(off) < 0.1
    assert np.all(off < told)


def band_echoes(propagation: Propagation, named: Propagation) -> np.ndarray:
    """Echoes of bodies over the band, in the order of another propagation's."""
    names = tuple(body.objects for body in named.bodies)
    return echoes_by_body(propagation, names, RADAR, band_of(RADAR.ofdm))


# Portions.


def hills(side: int) -> SceneObject:
    """A mesh of two triangles for each of side^2 quadrangles, open, before and below the radar."""
    along = np.linspace(0, 12, side + 1)
    x, y = np.meshgrid(along + 3, along - 6, indexing="ij")
    z = -1.5 + 0.2 * np.sin(2 * x) * np.cos(1.5 * y)
    n = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return thing("hills", np.stack([x, y, z], axis=-1).reshape(-1, 3), faces, radar="optics")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "bounces", "off"),
    [(["hills"], 1, 1e-9), (["corner", "balls"], 3, 1e-9), (["all"], 3, 0.01)],
    ids=["hills", "corner and balls", "all before a mirror"],
)
def test_portions_change_nothing(names: list[str], bounces: int, off: float, monkeypatch) -> None:
    """Hills that shade each other; a corner and balls; in portions of 300: as many contributions,
    and every body's echo over the band, to rounding. Of all of them before a mirror tubes between
    bodies are divided elsewhere: the sum is off by 1 % at most, where 30 are permitted. Fails where
    a portion's rows are taken for another's.
    """
    parts_of = {
        "hills": [hills(30)],
        "corner": [trihedral("corner", (9, 1, -0.3))],
        "balls": [ball(f"b{i}", (6 + i, 1.5 - i, 0), 0.1, 3) for i in range(3)],
    }
    mirror = plate("mirror", (14, 0, 0), 6.0, radar="surface")
    parts_of["all"] = [*(item for some in parts_of.values() for item in some), mirror]
    scene = world(*(item for name in names for item in parts_of[name]))
    fidelity = OPTICS.with_(radar_tolerance=0.3, radar_bounces=bounces)
    whole = trace(scene, RADAR, fidelity=fidelity)
    monkeypatch.setattr(front_facets, "AT_ONCE", 300)
    parts = trace(scene, RADAR, fidelity=fidelity)
    assert len(whole.echoes.delay_s) > 3000
    assert len(parts.echoes.delay_s) == pytest.approx(len(whole.echoes.delay_s), rel=off)
    level = {body.name: body.level_db for body in whole.bodies}
    assert level.keys() == {body.name for body in parts.bodies}
    for body in parts.bodies:
        assert body.level_db == pytest.approx(level[body.name], abs=max(5 * off, 1e-5))
    for frequency in (77.2e9, 79e9, 80.8e9):
        one, other = (wave(p.echoes, frequency) for p in (whole, parts))
        assert abs(one - other) < off * abs(one)


@pytest.mark.slow
def test_no_more_triangles_are_looked_at_together_than_a_portion_holds(monkeypatch) -> None:
    """A mesh of 20 000 facets in portions of 1000, at two images of the radar: what is computed of
    facets, of what tubes light, and of contributions. Tubes go on from a portion's quarter in up
    to eight parts each.
    """
    most: dict[str, int] = {}

    def counted(module, name: str, which: int):
        compute = getattr(module, name)

        def counting(*given):
            triangles = getattr(given[which], "triangles", given[which])
            most[name] = max(most.get(name, 0), len(triangles))
            return compute(*given)

        monkeypatch.setattr(module, name, counting)

    monkeypatch.setattr(front_facets, "AT_ONCE", 1000)
    counted(front_facets, "echoes_of", 2)
    counted(adaptive_subdivision, "echoes_of", 2)
    counted(echo_search, "echoes_of", 2)
    counted(adaptive_subdivision, "visible_samples", 1)
    counted(adaptive_subdivision, "split_in_four", 1)
    counted(echo_search, "reflected_on", 2)
    counted(body_scattering, "contributions_of", 2)
    scene = world(hills(100), trihedral("corner", (9, 1, 0)), ground(-2.0))
    found = trace(scene, RADAR, fidelity=OPTICS.with_(radar_tolerance=0.3))
    assert len(found.surfaces.delay_s) > 1000
    assert set(most) == {
        "echoes_of",
        "visible_samples",
        "split_in_four",
        "reflected_on",
        "contributions_of",
    }
    assert max(most["echoes_of"], most["contributions_of"]) == 1000
    assert max(most.values()) <= 2 * 1000


def test_errors_of_what_there_is_no_room_to_divide_are_told(monkeypatch) -> None:
    """Two plates that face each other at an angle, a ball between them: of 16 roots of tubes and
    of 64 triangles only the most uncertain ones are divided. Estimates of the errors grow, and a
    remark names a body.
    """
    corners = np.array([[0, 0, -0.2], [0.4, 0, -0.2], [0.4, 0, 0.2], [0, 0, 0.2]])
    turned = trimesh.transformations.rotation_matrix(np.radians(80), [0, 0, 1])[:3, :3]
    walls = [quad(f"w{i}", way + [4, 0, 0]) for i, way in enumerate((corners, corners @ turned.T))]
    scene = world(*walls, ball("b", (3.9, 0.2, 0), 0.05, 3))
    whole = trace(scene, RADAR, fidelity=OPTICS)
    monkeypatch.setattr(echo_search, "MOST_ROOTS", 16)
    monkeypatch.setattr(adaptive_subdivision, "MOST_TRIANGLES", 64)
    some = trace(scene, RADAR, fidelity=OPTICS)
    assert len(some.echoes.delay_s) < len(whole.echoes.delay_s) / 2
    known = {body.name: body.estimated_error for body in whole.bodies}
    assert max(body.estimated_error / known[body.name] for body in some.bodies) > 3
    assert unconverged(some.bodies)


# Whole cities.


def sionna_scene(name: str) -> Path:
    spec = importlib.util.find_spec("sionna")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0]) / "rt" / "scenes" / name / f"{name}.xml"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["munich", "etoile", "florence", "san_francisco"])
def test_cities_are_set_up_in_work_that_their_objects_bound(name: str, monkeypatch) -> None:
    """Sionna's: every mesh measured once, few pairs compared, ways within the beam alone; and a
    frame in which one object moved measures none.
    """
    scene = load_scene(sionna_scene(name))
    measured = counted(monkeypatch)
    set_up = staged(scene)
    count = len(measured)
    assert len(set(measured)) == count > 0.9 * len(scene.objects)
    scatterers = sum(role is ScatteringModel.OPTICS for role in set_up.roles)
    assert set_up.worth.sum() < 0.2 * scatterers * len(set_up.all_images)
    boxes = boxes_of(scene.objects)
    assert near_pairs(boxes)[1] < 100 * len(boxes)
    item = scene.objects[int(np.argmin((boxes[:, 1] - boxes[:, 0]).max(axis=1)))]
    moved = item.moved([0.3, 0.3, 0.3])
    again = replace(scene, objects=tuple(moved if o is item else o for o in scene.objects))
    staged(again)
    assert len(measured) == count
    assert trace(again, RADAR, fidelity=OPTICS).roles


@pytest.mark.slow
@pytest.mark.parametrize("name", ["munich", "etoile", "florence", "san_francisco", "boxes"])
def test_large_scenes_are_traced_by_default(name: str) -> None:
    """As a user traces them, to the end: cities, and ten thousand boxes. Of walls and ground
    there are images; where bodies are too large for waves round obstacles, no error is stated.
    """
    scene = many_boxes(10_000) if name == "boxes" else load_scene(sionna_scene(name))
    found = trace(scene, RADAR)
    assert len(found.contributions) > 10_000
    assert found.contributions.source.max() > 0
    told = np.array([(b.level_db, b.level_amplitude, b.estimated_error) for b in found.bodies])
    assert len(told) > 2
    assert np.isfinite(told[:, 1]).all()
    assert (told[:, 2] > 0).all()
