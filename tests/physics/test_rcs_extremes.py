"""`twin rcs`: what must not matter, extremes, and what it says where it is out of its depth."""

import math
import subprocess
import sys
from typing import Any

import drjit as dr
import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light

from benchmarks.cross_section_references import image_integral
from tests.physics.rcs_targets import (
    CARRIER,
    WAVELENGTH,
    K,
    as_target,
    dbsm,
    dihedral,
    polygons,
    rectangle,
)
from twin.engine import sionna
from twin.geometry import Geometry
from twin.radar.cross_section import Aspects, Quality, facets, physical_optics, sweep
from twin.radar.cross_section.rays import Density, later_bounces
from twin.radar.cross_section.subject import bare, subject_of
from twin.radar.propagation.facets import adaptive_subdivision
from twin.radar.propagation.facets.currents import echoes_of
from twin.radar.scattering import (
    EdgeQuality,
    Layer,
    LayeredSurface,
    MeshTarget,
    Radar,
    edge_diffraction,
    sharp_edges,
)

# Invariance


@pytest.fixture(scope="module")
def ball() -> MeshTarget:
    return as_target(trimesh.creation.icosphere(6, radius=0.15))


@pytest.mark.parametrize("tolerance", [1.0, 0.001])
def test_flat_facets_far_away_have_no_error(tolerance: float) -> None:
    """Side lobes of a plate at 40 to 50 deg, 60 dB down: what is left is rounding, 3e-8 of the main
    lobe.
    """
    target = as_target(polygons(rectangle(0.2, 0.1)))
    angles = np.linspace(40, 50, 10)
    sine = np.sin(np.radians(angles))
    expected = 0.02 / WAVELENGTH * np.cos(np.radians(angles))
    expected = expected * np.sinc(2 * 0.2 / WAVELENGTH * sine)
    found = sweep(target, CARRIER, angles, quality=Quality(tolerance)).amplitude_m
    np.testing.assert_allclose(1j * found, expected, rtol=0, atol=5e-5 * np.abs(expected).max())


@pytest.mark.parametrize("carrier_hz", [10.2e9, 79e9])
@pytest.mark.parametrize("tolerance", [0.1, 0.005, 0.001])
def test_flat_facets_far_away_are_not_divided(
    monkeypatch: pytest.MonkeyPatch, carrier_hz: float, tolerance: float
) -> None:
    """A plate is two triangles at each aspect, in side lobes and where it sends nothing back, as
    well: neither rounding of long paths nor errors over a band that nobody asks for divide it. They
    once did, into 3 800 000 triangles at 81 aspects.
    """
    triangles = []

    def counted(context: Any, scatterers: Any, lit: Any) -> Any:
        triangles.append(len(lit))
        return echoes_of(context, scatterers, lit)

    for module in (facets, adaptive_subdivision):
        monkeypatch.setattr(module, "echoes_of", counted)
    target = as_target(polygons(rectangle(0.2, 0.2)))
    angles = np.linspace(1, 86, 40)
    sweep(target, carrier_hz, angles, 30.0, quality=Quality(tolerance))
    assert sum(triangles) == 2 * len(angles)


@pytest.mark.parametrize("tolerance", [0.1, 0.01, 0.001])
@pytest.mark.parametrize(
    "radar", [Radar.at(2.0, 1.0, 1.0), Radar.at(10.0, 5.0, 1.0), Radar.at(1.0, 0.0, 0.4)]
)
def test_errors_near_by_stay_within_the_tolerance(radar: Radar, tolerance: float) -> None:
    """A plate of 0.2 m whose phase is bent, straight ahead and in a side lobe."""
    face = rectangle(0.2, 0.2)
    expected = image_integral([face], radar, WAVELENGTH, 0)
    found = physical_optics(as_target(polygons(face)), radar, CARRIER, "V", Quality(tolerance))
    assert abs(found.amplitude[0] / expected - 1) < tolerance


@pytest.mark.quick(3)
@pytest.mark.parametrize("tolerance", [0.1, 0.01, 0.001])
@pytest.mark.parametrize("tilt_deg", [0.0, 10.0])
def test_errors_of_shadows_stay_within_the_tolerance(tilt_deg: float, tolerance: float) -> None:
    """A screen far before a plate hides what lies beyond its straight or slanted edge."""
    face, slope = rectangle(0.2, 0.2), math.tan(math.radians(tilt_deg))
    screen = [[0.5, 0.01, -0.2], [0.5, 0.3, -0.2], [0.5, 0.3, 0.2], [0.5, 0.01 + 0.4 * slope, 0.2]]
    found = physical_optics(
        as_target(polygons(face, screen)), Radar.at(0), CARRIER, "V", Quality(tolerance)
    ).amplitude[0]
    # What the plate shows lies left of the edge, in phase all over; the screen is 0.5 m nearer.
    shown = 0.2 * (0.1 + 0.01 + 0.2 * slope)
    area = 0.4 * (0.29 + 0.29 - 0.4 * slope) / 2
    expected = -1j / WAVELENGTH * (shown + area * np.exp(2j * K * 0.5))
    assert abs(found - expected) < tolerance * abs(expected)


def test_a_body_without_edges_has_no_edge_diffraction(ball: MeshTarget) -> None:
    edges = sharp_edges(ball, 25)
    assert not edge_diffraction(ball, edges, Radar.at(0), CARRIER).any()


def with_edges(target: MeshTarget, radar: Radar, carrier_hz: float = 20e9) -> np.ndarray:
    edges, dense = sharp_edges(target, 25), Quality(tolerance=0.002)
    return physical_optics(target, radar, carrier_hz, "V", dense).amplitude + edge_diffraction(
        target, edges, radar, carrier_hz
    )


def test_refining_moving_reordering_and_doubling_change_nothing() -> None:
    """A box and a plate beside it: same echo from the same geometry, however it is written."""
    plate = polygons(rectangle(0.1, 0.15))
    plate.apply_translation([0.1, 0.4, 0.02])
    box = trimesh.creation.box((0.2, 0.3, 0.1))
    both, turned = (trimesh.util.concatenate(pair) for pair in ([box, plate], [plate, box]))
    radar = Radar.at(33.0, 12.0)
    reference = with_edges(as_target(both), radar)
    refined = both.subdivide().subdivide()
    rng = np.random.default_rng(0)
    faces = rng.permutation(np.array(both.faces), axis=0)
    flipped = np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1])
    doubled = np.vstack([flipped, np.roll(faces[::3], 1, axis=1)])
    vertices = np.array(both.vertices)
    for target in (
        as_target(turned),
        as_target(refined),
        MeshTarget(Geometry(vertices, flipped)),
        MeshTarget(Geometry(vertices, doubled)),
        MeshTarget(
            Geometry(vertices[flipped].reshape(-1, 3), np.arange(flipped.size).reshape(-1, 3))
        ),
    ):
        np.testing.assert_allclose(with_edges(target, radar), reference, rtol=2e-3, atol=1e-4)
    shift = np.array([40.0, -25.0, 13.0])
    moved = with_edges(MeshTarget(Geometry(vertices + shift, faces)), radar)
    phase = np.exp(4j * np.pi * 20e9 / speed_of_light * (radar.direction @ shift))
    np.testing.assert_allclose(moved, reference * phase, rtol=2e-3, atol=1e-4)


def test_many_aspects_at_once_are_each_by_itself() -> None:
    """What a box and a plate beside it shade and light of each other, all around."""
    plate = polygons(rectangle(0.1, 0.15))
    plate.apply_translation([0.1, 0.4, 0.02])
    target = as_target(trimesh.util.concatenate([trimesh.creation.box((0.2, 0.3, 0.1)), plate]))
    azimuths = np.arange(0, 360, 45.0)
    together = sweep(target, 20e9, azimuths, 12.0).amplitude_m
    alone = [physical_optics(target, Radar.at(a, 12.0), 20e9).amplitude[0] for a in azimuths]
    np.testing.assert_allclose(together, alone, rtol=1e-9)


def test_only_what_bends_nowhere_inwards_is_convex() -> None:
    """Whichever way faces wind; a dent, a hole, a second body and an open shell are not."""
    ball = trimesh.creation.icosphere(3, radius=0.15)
    dent = ball.copy()
    dent.vertices[7] *= 0.9
    far = ball.copy()
    far.apply_translation([1.0, 0, 0])
    shell = trimesh.Trimesh(ball.vertices, ball.faces[5:], process=False)
    turned = trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1], process=False)
    box = trimesh.creation.box((0.2, 0.3, 0.1)).subdivide()
    found = [
        subject_of(as_target(mesh)).shape.is_convex
        for mesh in (ball, turned, box, dent, shell, trimesh.util.concatenate([ball, far]))
    ]
    assert found == [True, True, True, False, False, False]


def test_facets_are_bare_where_no_other_one_stands_before_them() -> None:
    """A small plate before one triangle of a large one, as seen from ahead and from the left; past
    it from the right; hidden behind it; and from a place among them, which has no projection.
    """
    large, small = rectangle(1.0, 1.0), (np.array(rectangle(0.1, 0.1)) + [0.5, 0.2, 0.1]).tolist()
    places = np.array([[10, 0, 0], [6, 8, 0], [6, -8, 0], [-10, 0, 0], [0.05, 0, 0]])
    found = bare(subject_of(as_target(polygons(large, small))), places)
    np.testing.assert_array_equal(
        found,
        np.array(
            [
                [False, True, True, True],
                [True, False, True, True],
                [True, True, True, True],
                [True, True, False, False],
                [False, False, False, False],
            ]
        ),
    )


def test_near_field_tends_to_the_far_field() -> None:
    target = as_target(trimesh.creation.box((0.2, 0.3, 0.1)))
    far = with_edges(target, Radar.at(33.0, 12.0))
    near = with_edges(target, Radar.at(33.0, 12.0, 5e4))
    np.testing.assert_allclose(near, far, rtol=1e-3, atol=3e-5)


def test_the_choice_of_the_origin_only_scales() -> None:
    """Radar and box stay, the origin moves along the line of sight: (R'/R)^2 and a phase.

    At 2 m from a box of 0.3 m this holds only if spreading and phase are those of the near field.
    """
    box = trimesh.creation.box((0.2, 0.3, 0.1))
    away = Radar.at(33.0, 12.0, 2.0)
    closer = Radar(away.direction, 1.4)
    here = with_edges(as_target(box), away)
    box.apply_translation(-0.6 * away.direction)
    there = with_edges(as_target(box), closer)
    phase = np.exp(4j * np.pi * 20e9 / speed_of_light * -0.6)
    np.testing.assert_allclose(there, here * (1.4 / 2) ** 2 * phase, rtol=2e-3, atol=1e-4)
    far = with_edges(as_target(box), Radar(away.direction))
    assert np.abs(np.abs(far[0]) - np.abs(here[0])) > 0.1 * np.abs(here[0])


def test_what_is_hidden_sends_nothing_back() -> None:
    """A plate behind a larger one, 3 cm away, adds neither surface nor edges."""
    screen, behind = np.array(rectangle(0.3, 0.3)), np.array(rectangle(0.1, 0.1)) - [0.03, 0, 0]
    radar = Radar.at(17.0, 5.0)
    alone = with_edges(as_target(polygons(screen)), radar)
    both = with_edges(as_target(polygons(screen, behind)), radar)
    np.testing.assert_allclose(both, alone, rtol=1e-3, atol=1e-5)
    reversed_ = with_edges(as_target(polygons(screen, behind)), Radar.at(180 - 17.0, 5.0))
    assert np.abs(reversed_[0] - alone[0]) > 0.1 * np.abs(alone[0])


def test_a_new_pose_compiles_nothing() -> None:
    """Pose, distance, carrier, polarisation, density and material are data for the kernel."""
    target = as_target(polygons(*dihedral(0.2)))
    physical_optics(target, Radar.at(0, 0, 12.0), CARRIER)
    other = as_target(polygons(*dihedral(0.1)), LayeredSurface(backing=5 - 1j))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        physical_optics(target, Radar.at(4.7, 1.0, 31.0), 2.5e9, "H", Quality(0.02, 3))
        physical_optics(other, Radar.at(14.7), 10e9)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert len(history) > 3
    assert all(kernel["cache_hit"] for kernel in history)


def test_sionnas_variant_in_between_does_no_harm() -> None:
    target = as_target(polygons(*dihedral(0.1)))
    before = physical_optics(target, Radar.at(1.0), CARRIER).amplitude
    sionna()
    after = physical_optics(target, Radar.at(1.0), CARRIER).amplitude
    np.testing.assert_allclose(after, before, rtol=1e-12)


def test_the_wavefront_that_rays_hit_is_the_silhouette(ball: MeshTarget) -> None:
    """Far from a sphere pi a^2, all directions inside a box, and no direction twice."""

    def lit_m2(target: MeshTarget, radar: Radar, carrier_hz: float, density: float) -> float:
        aspects, close = Aspects.monostatic([radar], "V"), Density(density, 2**15, 2**24)
        wavelength = speed_of_light / carrier_hz
        return later_bounces(target, aspects, wavelength, carrier_hz, 2, close).lit_m2[0]

    found = lit_m2(ball, Radar.at(20, 30), CARRIER, 4.0)
    assert found == pytest.approx(math.pi * 0.15**2, rel=2e-3)
    box = as_target(trimesh.creation.box((2, 3, 4)))
    for density in (8.0, 11.3):
        found = lit_m2(box, Radar.at(20, 10, 0.4), 1e9, density)
        assert found == pytest.approx(4 * math.pi * 0.4**2, rel=2e-3)


def test_few_rays_do_for_corners() -> None:
    """Phase stands still where a corner sends back what came: 1000 rays do for 5 %."""
    target = as_target(polygons(*dihedral(0.2)))
    fine, coarse = (
        physical_optics(target, Radar.at(24.0), CARRIER, "V", Quality(tolerance)).amplitude[0]
        for tolerance in (0.001, 0.05)
    )
    assert dbsm(coarse) == pytest.approx(dbsm(fine), abs=0.2)


def test_phase_is_kept_across_half_a_kilometre() -> None:
    """A plate 500 m behind a smaller one beside it: float32 distances would be 30 um off."""
    plates = (
        (np.array(rectangle(0.05, 0.05)), np.array([-250.0, 0.0, 0.0])),
        (np.array(rectangle(0.02, 0.02)), np.array([250.0, 0.08, 0.0])),
    )
    both = as_target(polygons(*(face + place for face, place in plates)))
    for azimuth in (0.0, 1e-3):
        radar = Radar.at(azimuth)
        found = physical_optics(both, radar, CARRIER).amplitude[0]
        expected = sum(
            physical_optics(as_target(polygons(face)), radar, CARRIER).amplitude[0]
            * np.exp(2j * K * (radar.direction @ place))
            for face, place in plates
        )
        assert found == pytest.approx(expected, rel=0.01)


# Extremes


@pytest.mark.parametrize("distance_m", [0.1, 1000.0])
def test_ten_centimetres_and_a_kilometre(distance_m: float) -> None:
    """A plate of 5 cm against the surface integral, within 0.1 dB."""
    face, radar = rectangle(0.05, 0.05), Radar.at(0.4, 0.3, distance_m)
    found = physical_optics(as_target(polygons(face)), radar, CARRIER).amplitude[0]
    assert dbsm(found) == pytest.approx(dbsm(image_integral([face], radar, WAVELENGTH, 0)), abs=0.1)


def test_edges_that_are_all_hidden_send_nothing_back() -> None:
    """Those of a closed box, from within it."""
    walls = as_target(trimesh.creation.box((2.0, 3.0, 4.0)))
    found = edge_diffraction(walls, sharp_edges(walls, 25), Radar.at(10.0, 5.0, 0.1), 2.5e9)
    assert not found.any()


def test_a_radar_in_a_closed_box_and_one_that_touches_a_mesh_get_numbers() -> None:
    box = as_target(trimesh.creation.box((2, 2, 2)))
    inside = sweep(box, 2.5e9, [10.0], distance_m=0.3)
    assert np.isfinite(inside.cross_section_dbsm).all()
    assert any("may stand within the target" in w for w in inside.warnings)
    assert any("of the rays go on after 8 bounces" in w for w in inside.warnings)
    for distance in (1.0, 1.0 + 1e-9):
        touching = sweep(box, 2.5e9, [0.0], distance_m=distance, edges=True)
        assert np.isfinite(touching.amplitude_m).all()


def test_the_cube_of_directions_and_the_frustum_agree() -> None:
    """Close to a plate rays start from the six faces of a cube; the integral is the same."""
    face = rectangle(0.1, 0.1)
    for distance in (0.1, 0.12):  # the first within 1.5 radii
        radar = Radar.at(5.0, 3.0, distance)
        found = physical_optics(as_target(polygons(face)), radar, CARRIER).amplitude[0]
        assert dbsm(found) == pytest.approx(
            dbsm(image_integral([face], radar, WAVELENGTH, 0)), abs=0.1
        )


MILLION = """
import resource
import numpy as np
import trimesh
from tests.physics.rcs_targets import as_target
from twin.radar.cross_section import sweep
ball = trimesh.creation.icosphere(8, radius=0.15)
start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
target = as_target(ball)
found = sweep(target, 79e9, [0.0, 90.0], edges=True)
print(len(ball.faces), start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print(*found.cross_section_m2 / (np.pi * 0.15**2))
"""


@pytest.mark.slow
def test_a_million_triangles_in_bounded_memory() -> None:
    """1.3 million: at most 1.6 GB beyond what the mesh took to make, half of it while the shape is
    measured, and the right answer.
    """
    asked = subprocess.run(
        [sys.executable, "-c", MILLION], check=True, capture_output=True, text=True
    )
    size, ratios = asked.stdout.splitlines()
    faces, before, after = (int(part) for part in size.split())
    assert faces == 1310720
    assert (after - before) * 1024 < 1.6e9
    for ratio in ratios.split():
        assert 10 * math.log10(float(ratio)) == pytest.approx(0, abs=0.1)


def test_nothing_comes_back_from_a_plate_edge_on() -> None:
    result = sweep(as_target(polygons(rectangle(0.2, 0.2))), CARRIER, [90.0])
    assert result.cross_section_dbsm[0] == -np.inf


def test_zero_area_faces_never_get_to_the_rays() -> None:
    vertices = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 2, 0]], dtype=float)
    with pytest.raises(ValueError, match="1 faces have no area"):
        MeshTarget(Geometry(vertices, np.array([[0, 1, 2], [0, 1, 3]])))


# Warnings


def test_what_physical_optics_cannot_do_is_said() -> None:
    """Each warning on its target, and none on one that is large, fine and seen well."""

    def warned(target: MeshTarget, carrier_hz: float = CARRIER, **options) -> str:
        return " | ".join(sweep(target, carrier_hz, [0.0], **options).warnings)

    ball = trimesh.creation.icosphere(5, radius=0.02)
    assert warned(as_target(ball)) == ""
    assert "measures 1.3 wavelengths" in warned(as_target(ball), 10e9)
    coarse = trimesh.creation.icosphere(2, radius=0.15)
    assert "wavelengths off a smooth surface" in warned(as_target(coarse))
    cone = trimesh.creation.cone(0.02, 0.4, sections=360)
    cone.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    assert "within 15 deg of grazing" in warned(as_target(cone))
    wire = trimesh.creation.box((0.0005, 0.0005, 0.2))
    assert "wavelengths wide" in warned(as_target(wire))
    thin = Quality(max_rays=2**10)
    assert "wider apart than asked for" in warned(as_target(polygons(*dihedral(0.2))), quality=thin)


def test_bad_knobs_are_named() -> None:
    for build, name in (
        (lambda: Quality(tolerance=0), "tolerance"),
        (lambda: Quality(tolerance=math.nan), "tolerance"),
        (lambda: Quality(tolerance=1.5), "tolerance"),
        (lambda: Quality(max_bounces=0), "max_bounces"),
        (lambda: Quality(max_rays=0), "max_rays"),
        (lambda: EdgeQuality(sharp_angle_deg=0), "sharp_angle_deg"),
        (lambda: EdgeQuality(pieces_per_wavelength=0), "pieces_per_wavelength"),
        (lambda: Radar.at(0, 0, 0.0), "distance_m"),
        (lambda: LayeredSurface(backing=2 + 1j), "permittivity"),
        (lambda: Layer(2, 1) and LayeredSurface((Layer(2, 0),)), "thickness_m"),
    ):
        with pytest.raises(ValueError, match=name):
            build()
