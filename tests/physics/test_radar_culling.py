"""Bodies found, and what is left out of large scenes by bounds of its share of the power."""

import gc
from weakref import ref

import numpy as np
import pytest
import trimesh

from tests.physics.large_worlds import block, counted, scattered_blocks, staged
from tests.physics.radar_worlds import (
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    wave,
    world,
)
from twin.geometry.near_boxes import near_pairs
from twin.radar.propagation import prepared_scene
from twin.radar.propagation.meshes import grouping
from twin.radar.propagation.scene import culling
from twin.radar.propagation.scene.culling import (
    Beam,
    beam_of,
    image_antennas_of,
    shares,
    worth_tracing,
)
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.mesh_scene import Flats
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace

# Bodies.


@pytest.mark.parametrize("seed", range(4))
def test_bodies_are_those_of_all_pairs(seed: int) -> None:
    """Objects closer than 2 % of the larger one's size that move alike, whatever their sizes."""
    items = scattered_blocks(np.random.default_rng(seed), 150)
    parent = list(range(len(items)))
    for i, a in enumerate(items):
        for j, b in enumerate(items[:i]):
            ends = [(o.vertices_m.min(axis=0), o.vertices_m.max(axis=0)) for o in (a, b)]
            gap = np.maximum(ends[0][0] - ends[1][1], ends[1][0] - ends[0][1]).max()
            size = max((high - low).max() for low, high in ends)
            if gap <= 0.02 * size and a.velocity_m_per_s == b.velocity_m_per_s:
                old, new = parent[i], parent[j]
                parent = [new if p == old else p for p in parent]
    assert len(set(parent)) < len(items) - 10
    body = grouping.bodies_of(items)
    expected = [sorted(set(parent), key=parent.index).index(p) for p in parent]
    assert body.tolist() == expected


def test_pairs_compared_grow_with_the_objects_not_with_their_square() -> None:
    """Four times the objects at one density: four times the pairs, not sixteen times."""
    rng = np.random.default_rng(0)
    compared = []
    for count in (500, 2000, 8000):
        low = rng.uniform(0, 10 * count**0.5, (count, 3)) * (1, 1, 0)
        boxes = np.stack([low, low + 10 ** rng.uniform(-1, 1, (count, 3))], axis=1)
        boxes[0] = [[0, 0, -1], [10 * count**0.5, 10 * count**0.5, 0]]  # the ground under all
        compared.append(near_pairs(boxes)[1] / count)
    assert compared[2] < 1.5 * compared[0]
    assert compared[2] < 50


def test_one_object_that_moves_is_all_that_is_looked_at_anew(monkeypatch) -> None:
    """More objects than any fixed cache would hold: none is measured twice, and with the scene all
    that was known of it goes.
    """
    measured = counted(monkeypatch)
    items = [block(f"b{i}", (2.0 * i, 0, 0), (1, 1, 1)) for i in range(1500)]
    for step in range(3):
        moved = items[7].moved([step, step, step])
        scene = world(*items[:7], moved, *items[8:])
        assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
        grouping.bodies_of(scene.objects)
    assert len(measured) == len(set(measured)) == 1500
    known = [ref(item.geometry.shape) for item in items]
    del items, moved, scene
    gc.collect()
    assert all(shape() is None for shape in known)


# Shares of the sent power.


def images_of(flats: Flats, axis: np.ndarray) -> list[Image]:
    """The radar at the origin, and its image in every patch."""
    here = np.zeros(3)
    places = [
        np.stack([here, 2 * (p @ n) * n]) for p, n in zip(flats.point, flats.normal, strict=True)
    ]
    return [Image((), here[None]), *(Image((i,), p) for i, p in enumerate(places))]


@pytest.mark.parametrize("seed", range(4))
def test_no_box_gets_more_power_than_its_bound(seed: int) -> None:
    """Rays of an antenna of 10 dBi, straight and over a wall, against boxes around it: the share of
    the power that meets each, within five standard deviations (one false alarm in 1e6 per box), and
    none where there is no way.
    """
    rng = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    middle = turn @ [6.0, 0, 0]
    across = turn @ np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]).T * [[3], [3], [3]]
    wall = quad("wall", (middle[:, None] + across).T, radar="surface")
    set_up = staged(world(wall))
    flats = set_up.flats
    assert len(flats) == 1
    gain = 10.0
    axis = np.array([1.0, 0, 0])
    beam = Beam(gain * np.maximum(np.cos(np.radians(np.arange(721) * 0.25)), 0) ** (gain / 2 - 1))
    middles = rng.normal(size=(60, 3)) * 5
    middles = middles[np.linalg.norm(middles, axis=1) > 2]
    sizes = rng.uniform(0.3, 1.5, (len(middles), 3))
    boxes = np.stack([middles - sizes / 2, middles + sizes / 2], axis=1)
    bound = shares(image_antennas_of(images_of(flats, axis), flats, axis, beam), boxes, flats, beam)

    count = 20_000
    ray = rng.normal(size=(count, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    weight = gain * np.maximum(ray[:, 0], 0) ** (gain / 2 - 1)
    n, p = flats.normal[0], flats.point[0]
    t = (p @ n) / (ray @ n)
    there = t[:, None] * ray
    on_wall = (t > 0) & (np.abs(turn.T[1:] @ (there.T - middle[:, None])) < 3).all(axis=0)
    away = ray - 2 * (ray @ n)[:, None] * n
    for row, (start, along, active) in enumerate(
        ((np.zeros((1, 3)), ray, np.ones(count, bool)), (there, away, on_wall))
    ):
        for k, (low, high) in enumerate(boxes):
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.stack([(low - start) / along, (high - start) / along])
            hit = active & (ends.min(axis=0).max(axis=1) <= ends.max(axis=0).min(axis=1))
            hit &= ends.max(axis=0).min(axis=1) > 0
            share = weight * hit
            error = 5 * share.std() / count**0.5
            assert share.mean() - error <= bound[row, k] * (1 + 1e-9)
            if bound[row, k] == 0:
                assert not share.any()
    # Behind the wall, beside its window: known without a ray.
    assert np.count_nonzero(bound[1] == 0) > len(boxes) / 6


def test_the_beam_bounds_the_gain_off_axis_and_beyond() -> None:
    rng = np.random.default_rng(1)
    beam = beam_of(RADAR.antenna)
    way = rng.normal(size=(20_000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    off = np.arccos(way[:, 0])
    gain = RADAR.antenna.gain(way)
    assert (gain <= beam.most(off) * (1 + 1e-12)).all()
    assert (gain <= beam.most(0.9 * off) * (1 + 1e-12)).all()
    assert beam.most(np.array([0.0]))[0] == pytest.approx(100.0)
    assert beam.most(np.array([np.radians(91)]))[0] == 0


def test_what_is_left_out_stays_below_the_limit_and_is_the_most_that_does() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        share = 10 ** rng.uniform(-20, -1, (5, 40)) * (rng.random((5, 40)) < 0.7)
        limit = 10 ** rng.uniform(-9, -2)
        worth = worth_tracing(share, limit)
        lost = share[~worth.is_traced].sum()
        whole = min(1.0, share.sum())
        assert not worth.is_traced[share == 0].any()
        assert worth.left_out == pytest.approx(2 * np.sqrt(whole * lost), rel=1e-9)
        assert worth.left_out <= limit
        if worth.is_traced.any():
            assert 2 * np.sqrt(whole * (lost + share[worth.is_traced].min())) > limit


@pytest.mark.parametrize("seed", range(2))
def test_culling_loses_no_more_than_its_bound(seed: int, monkeypatch) -> None:
    """Small bodies all around, over ground and wall: the sum of all echoes with a limit that bites
    against that of every way.
    """
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-1.2, 1.2, 5)
    balls = [
        ball(f"b{i}", (4 * np.cos(a), 4 * np.sin(a), rng.uniform(-0.5, 0.5)), 0.02, 3)
        for i, a in enumerate(angle)
    ]
    scene = world(*balls, ground(-1.0), plate("wall", (9.0, 0, 0), 8.0, radar="surface"))
    fidelity = OPTICS.with_(radar_tolerance=0.01)
    limit = 10.0 ** rng.uniform(-6, -4)
    found = []
    for allowed in (limit, 0.0):
        monkeypatch.setattr(prepared_scene, "_limit", lambda radar, allowed=allowed: allowed)
        echoes = trace(scene, RADAR, fidelity=fidelity)
        found.append((staged(scene).worth.sum(), wave(echoes.echoes, CARRIER_HZ)))
    (fewer, culled), (more, whole) = found
    assert fewer < more
    loss = 10 ** (-RADAR.front_end.losses_db.value / 20)
    assert abs(culled - whole) <= limit * loss
    assert abs(whole) > 0


def test_what_was_left_out_is_told_in_one_line() -> None:
    """A ball 55 degrees off axis beside one ahead: its power, and that it is below the noise."""
    off = np.radians(62.0)
    scene = world(
        ball("b", (5, 0, 0), level=3), ball("off", (5e2 * np.cos(off), 5e2 * np.sin(off), 0))
    )
    (line,) = [a for a in staged(scene).assumptions if "too faint" in a]
    assert "1 of 2 paths to objects" in line
    assert int(line.split("at most ")[1].split(" dB")[0]) <= 20 * np.log10(culling.OF_NOISE)
