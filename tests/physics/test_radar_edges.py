"""Sharp edges in the scene: against `twin rcs`, mirrored worlds, the slab; what must not matter.

`tests/physics/test_rcs_edges.py` holds `twin rcs` against Sommerfeld's wedge and the Austin plates.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform, Rotation

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    reshaped,
    thing,
    trihedral,
    wave,
    world,
)
from tests.physics.test_radar_walls import box, permittivity, slab
from twin.fidelity import PRESETS
from twin.geometry import Geometry
from twin.radar.cross_section import Quality, sweep
from twin.radar.propagation.physical_optics import diffracted, scattered
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.radar.scattering import MeshTarget, Radar, edge_diffraction, sharp_edges
from twin.radar.synthesis import Contributions
from twin.scene import Pose, Rig, Scene, SceneObject

K = 2 * np.pi / WAVELENGTH_M
EDGES = OPTICS.with_(radar_edges=1_000_000)

# A few wavelengths large: there edges matter.
SHAPES = {
    "plate": trimesh.Trimesh(
        np.array([[0, -75, -90], [0, 75, -90], [0, 75, 90], [0, -75, 90]]) * 1e-4,
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    ),
    "box": trimesh.creation.box((0.012, 0.015, 0.010)),
    "wedge": trimesh.convex.convex_hull(
        [[x, y, z] for x, y in ((0, 0), (0.018, 0.004), (0.002, 0.016)) for z in (0, 0.014)]
    ),
}
ASPECTS = [(3.0, 1.0), (24.0, 7.0), (61.0, -12.0), (140.0, 30.0)]


def turned(mesh: trimesh.Trimesh, radar: Radar, distance_m: float) -> SceneObject:
    """The mesh as that radar sees it, its origin straight ahead of one at the scene's origin."""
    up = radar.polarizations[0]
    axes = np.stack([-radar.direction, np.cross(up, -radar.direction), up])
    at = np.array(mesh.vertices) @ axes.T + [distance_m, 0, 0]
    return thing("t", at, mesh.faces, radar="optics")


def rays_of(scene: Scene, **knobs) -> Contributions:
    """Of surfaces and edges, without the antenna's gain."""
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    prepared, fidelity = prepare_scene(scene, RADAR, roles, 1), EDGES.with_(**knobs)
    surfaces = scattered(prepared, RADAR, fidelity).contributions
    return Contributions.concatenate([surfaces, diffracted(prepared, fidelity)[0]])


def lengths_m(found: Contributions) -> np.ndarray:
    return 299792458.0 * found.delay_s


def edges_of(scene: Scene) -> Contributions:
    """Those of sharp edges alone."""
    roles = assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    return diffracted(prepare_scene(scene, RADAR, roles, 1), EDGES)[0]


def total(rays: Contributions) -> complex:
    return complex(np.sum(rays.amplitude * np.exp(-1j * K * lengths_m(rays))))


def amplitude_m(rays: Contributions, distance_m: float) -> complex:
    """S at the target's origin."""
    return total(rays) * np.exp(2j * K * distance_m) * 4 * np.pi * distance_m**2 / WAVELENGTH_M


@pytest.mark.parametrize("distance", [0.1, 5.0, 150.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_edges_alone_are_those_of_rcs(shape: str, distance: float) -> None:
    """Amplitude and phase to 1e-6 of the fringe field of a radar at that distance."""
    mesh = SHAPES[shape]
    target = MeshTarget(Geometry(np.array(mesh.vertices), np.array(mesh.faces)))
    for aspect in ASPECTS:
        radar = Radar.at(*aspect, distance)
        expected = edge_diffraction(target, sharp_edges(target, 25), radar, CARRIER_HZ)[0]
        found = amplitude_m(edges_of(world(turned(mesh, radar, distance))), distance)
        assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_surfaces_and_edges_together_are_those_of_rcs(shape: str) -> None:
    """Within 0.1 dB at a tolerance of 1 %, 0.09 dB; edges change it by up to 11 dB."""
    distance, mesh = 0.5, SHAPES[shape]
    target = MeshTarget(Geometry(np.array(mesh.vertices), np.array(mesh.faces)))
    azimuths = np.array([2.0, 16.0, 30.0, 51.0])
    dense = Quality(tolerance=0.001)
    expected, alone = (
        sweep(target, CARRIER_HZ, azimuths, 4.0, distance_m=distance, edges=e, quality=dense)
        for e in (True, False)
    )
    found = []
    for azimuth in azimuths:
        scene = world(turned(mesh, Radar.at(azimuth, 4.0), distance))
        found.append(amplitude_m(rays_of(scene, radar_tolerance=0.01), distance))
    level = 10 * np.log10(4 * np.pi * np.abs(found) ** 2)
    np.testing.assert_allclose(level, expected.cross_section_dbsm, atol=0.1)
    assert np.abs(level - alone.cross_section_dbsm).max() > 2


# What must not matter.


def tilted(name: str = "p", side: float = 0.15) -> SceneObject:
    """A plate 35 deg off its mirror direction, 4 m ahead."""
    turn = np.radians(35.0)
    flat = plate(name, (0, 0, 0), side)
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return reshaped(flat, flat.vertices_m @ spin.T + [4.0, 0.1, -0.2])


def test_neither_refinement_nor_parts_nor_order_nor_place_matter() -> None:
    """Coplanar seams are no edges, within one mesh or between two that touch."""
    whole, other = tilted(), trihedral("t", (6, 1, 0))
    expected = total(edges_of(world(whole, other)))
    vertices, faces = trimesh.remesh.subdivide(*trimesh.remesh.subdivide(*mesh_of(whole)))
    finer = reshaped(whole, vertices, faces)
    a, b, c, d = whole.vertices_m
    halves = (
        quad("left", [a, (a + b) / 2, (c + d) / 2, d]),
        quad("right", [(a + b) / 2, b, c, (c + d) / 2]),
    )
    there = np.array([1e6, -1e6, 500.0])
    moved = [o.moved(there) for o in (whole, other)]
    away = Rig(Pose(tuple(there)), radar=Pose((0.0, 0.0, 0.0)))
    for scene in (
        world(other, whole),
        world(reshaped(whole, faces=whole.geometry.faces[:, ::-1]), other),
        world(finer, other),
        world(*halves, other),
        world(*moved, rig=away),
    ):
        assert total(edges_of(scene)) == pytest.approx(expected, rel=3e-3)


def mesh_of(item: SceneObject) -> tuple:
    return item.vertices_m, item.geometry.faces


def test_a_body_without_edges_adds_nothing() -> None:
    assert len(edges_of(world(ball("b", (5, 0, 0), level=5))).amplitude) == 0


# Between the radar and an edge.


def test_what_stands_before_an_edge_hides_it() -> None:
    """Whole plates behind a screen, and the half of one that a screen leaves."""
    screen = replace(plate("s", (2.0, 0.0, 0.0), 1.0), radar="obstacle")
    alone = edges_of(world(tilted()))
    assert len(edges_of(world(tilted(), screen)).amplitude) == 0
    half = screen.moved([0, 0.5 + 0.05, 0])
    seen = edges_of(world(tilted(), half))
    left = alone.departure[:, 1] < 0.05 / 2 * alone.departure[:, 0]
    assert 0.2 < left.mean() < 0.8
    assert len(seen.amplitude) == pytest.approx(left.sum(), abs=2)
    assert np.all(seen.departure[:, 1] < 0.0251 * seen.departure[:, 0])


def test_a_plate_almost_edge_on_does_not_hide_its_far_edges() -> None:
    """0.2 deg above its plane, turned every way: float32 loses no piece."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        item = turned(SHAPES["plate"], Radar.at(89.8, 2.0, 1.0), 1.0)
        spin = Rotation.from_euler("zyx", rng.uniform(-20, 20, 3), degrees=True)
        item = replace(item, pose=RigidTransform.from_rotation(spin))
        assert len(edges_of(world(item)).amplitude) == 140


def test_edges_through_a_wall() -> None:
    """12.5 mm of wood, upright: the slab's transmission squared, as for all else behind it."""
    square = plate("p", (6.0, 0, 0), 0.1)
    panel = box("panel", (3.0, -15, -15), (3.0125, 15, 15), "wood")
    through, alone = (total(edges_of(world(*o, square))) for o in ((panel,), ()))
    factor = slab(permittivity("wood"), 0.0125, 0.0, CARRIER_HZ)[0] ** 2
    nearer = 0.0125 * (1 - 1 / np.sqrt(permittivity("wood").real))
    assert abs(through / alone) == pytest.approx(abs(factor) * (6 / (6 - nearer)) ** 2, rel=0.01)


def test_edges_over_the_ground_are_those_of_a_mirrored_world() -> None:
    """Over metal: down by the image and back by it is the mirrored plate seen directly; out one way
    and home the other has that length, and counts twice.
    """
    down = -1.0
    over = edges_of(world(tilted(), ground(down)))
    direct, image = ((over.source == n) & (over.receiver == n) for n in (0, 1))
    assert total(over.take(direct)) == pytest.approx(total(edges_of(world(tilted()))), rel=1e-6)
    below = tilted()
    below = reshaped(below, below.vertices_m * [1, 1, -1] + [0, 0, 2 * down])
    assert total(over.take(image)) == pytest.approx(total(edges_of(world(below))), rel=1e-3)
    out, back = (over.take((over.source == n) & (over.receiver == 1 - n)) for n in (0, 1))
    assert total(out) == pytest.approx(total(back), rel=1e-9)
    assert len(out.amplitude) > 100
    np.testing.assert_array_equal(out.departure, back.arrival)


def test_an_edge_on_the_ground_is_none() -> None:
    """A plate that stands on it: its lower edge is silent directly and by the image, no other."""
    item = quad("p", [[4, -0.1, -1], [4.1, 0.1, -1], [4.1, 0.1, -0.8], [4, -0.1, -0.8]])
    free, over = edges_of(world(item)), edges_of(world(item, ground(-1.0)))
    low = np.abs(lengths_m(free) / 2 * free.departure[:, 2] + 1.0) < 1e-4
    assert low.sum() > 400
    for out, home in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert np.sum((over.source == out) & (over.receiver == home)) == np.sum(~low)


# Over the band, in motion, by the knob.


def test_delays_hold_over_the_band_and_rates_are_their_derivatives() -> None:
    """The sum at the band's edges is `twin rcs`'s there within 10 % (what the ends of faces cut off
    is the carrier's); lengths grow as rates say.
    """
    flat = SHAPES["box"].copy()
    flat.apply_scale(8.0)
    target = MeshTarget(Geometry(np.array(flat.vertices), np.array(flat.faces)))
    radar = Radar.at(33.0, 5.0, 5.0)
    rays = edges_of(world(turned(flat, radar, 5.0)))
    for frequency in (77e9, 81e9):
        k = 2 * np.pi * frequency / 299792458.0
        found = np.sum(rays.amplitude * np.exp(-1j * k * (lengths_m(rays) - 10.0)))
        found *= 4 * np.pi * 25.0 / WAVELENGTH_M
        expected = edge_diffraction(target, sharp_edges(target, 25), radar, frequency)[0]
        assert abs(found - expected) < 0.1 * abs(expected)
    velocity, step = (3.0, 1.0, 0.0), 1e-6
    moving = replace(tilted(), velocity_m_per_s=velocity)
    later = moving.moved(step * np.array(velocity))
    one, other = (edges_of(world(o)) for o in (moving, later))
    np.testing.assert_allclose(
        (lengths_m(other) - lengths_m(one)) / step,
        299792458.0 * one.delay_rate,
        rtol=1e-5,
        atol=1e-6,
    )


def test_fewer_pieces_than_edges_ask_for_are_said_so() -> None:
    scene = world(tilted())
    found = trace(scene, RADAR, fidelity=EDGES.with_(radar_edges=200))
    assert any("fidelity.radar_edges" in a for a in found.assumptions)
    every = edges_of(scene)
    fewer = rays_of(scene, radar_edges=200).take(
        slice(len(rays_of(scene, radar_edges=0).amplitude), None)
    )
    assert len(fewer.amplitude) < 220 < len(every.amplitude)
    assert 20 * np.log10(abs(total(fewer) / total(every))) == pytest.approx(0, abs=1.0)


def test_a_weak_reflector_has_weak_edges() -> None:
    """Glass against metal: by what it reflects at normal incidence, and a remark that says so."""
    glass, metal = (replace(tilted(), material=m) for m in ("glass", "metal"))
    ratio = total(edges_of(world(glass))) / total(edges_of(world(metal)))
    root = np.sqrt(permittivity("glass"))
    assert ratio == pytest.approx(-(1 - root) / (1 + root), rel=1e-6)
    for item, remarked in ((glass, True), (metal, False)):
        said = trace(world(item), RADAR, fidelity=EDGES).assumptions
        assert any("edges of glass" in a for a in said) == remarked


def test_only_the_reference_diffracts() -> None:
    assert {name for name, p in PRESETS.items() if p.radar_edges} == {"reference"}
    heard = [wave(trace(world(tilted()), RADAR, fidelity=f).echoes) for f in (OPTICS, EDGES)]
    assert abs(heard[1] - heard[0]) > 0.1 * abs(heard[0])
