"""Cross-sections of meshes against Mie's series, surface integrals, closed forms.

Where nothing else is said, 79 GHz. The references share no code with the ray tracer: the series and
integrals below are float64 NumPy.
"""

import math

import numpy as np
import pytest
import trimesh

from benchmarks import rcs
from benchmarks.cross_section_references import image_integral, mie_coefficients, mie_cross_section
from benchmarks.timing import Timing
from tests.physics.rcs_targets import (
    CARRIER,
    WAVELENGTH,
    K,
    as_target,
    dbsm,
    dihedral,
    polygons,
    rectangle,
    trihedral,
)
from twin.geometry import Geometry
from twin.radar.cross_section import physical_optics, sweep
from twin.radar.scattering import PEC, Layer, LayeredSurface, MeshTarget, Radar


def test_the_series_gives_the_published_efficiencies() -> None:
    """Wiscombe, NCAR/TN-140+STR (1979): conductors of x = 0.101 and 100, m = 1.5 of x = 10."""
    for x, index, published in (
        (0.101, None, 0.000348),
        (100.0, None, 2.008102),
        (10.0, 1.5, 2.881999),
    ):
        n, a, b = mie_coefficients(x, index)
        extinction = 2 / x**2 * np.sum((2 * n + 1) * (a + b).real)
        assert extinction == pytest.approx(published, abs=6e-7)


# Conductors


@pytest.fixture(scope="module")
def ball() -> MeshTarget:
    return as_target(trimesh.creation.icosphere(6, radius=0.15))


@pytest.mark.parametrize(
    ("azimuth", "elevation", "sent"), [(0, 0, "V"), (13, 5, "H"), (77, -40, "V")]
)
def test_sphere_is_mies(ball: MeshTarget, azimuth, elevation, sent) -> None:
    """Within 0.2 dB from far away; at 10 m the specular point's nearness adds 0.13 dB."""
    expected = 10 * math.log10(mie_cross_section(0.15, WAVELENGTH))
    port = "VH".index(sent)
    far = physical_optics(ball, Radar.at(azimuth, elevation), CARRIER, sent).amplitude
    assert dbsm(far)[port] == pytest.approx(expected, abs=0.2)
    assert dbsm(far)[1 - port] < expected - 60
    near = physical_optics(ball, Radar.at(azimuth, elevation, 10.0), CARRIER, sent).amplitude
    assert dbsm(near)[port] == pytest.approx(expected + 20 * math.log10(10 / (10 - 0.15)), abs=0.2)


@pytest.mark.parametrize("distance_m", [1.0, 5.0, 150.0])
@pytest.mark.parametrize("azimuth", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("sent", ["V", "H"])
def test_plate_is_the_surface_integral(distance_m: float, azimuth: float, sent) -> None:
    """0.2 m from 1 to 150 m, in magnitude within 0.05 dB and in phase within 1 deg."""
    radar, face = Radar.at(azimuth, 0.0, distance_m), rectangle(0.2, 0.2)
    port = "VH".index(sent)
    expected = image_integral([face], radar, WAVELENGTH, port)
    found = physical_optics(as_target(polygons(face)), radar, CARRIER, sent).amplitude[port]
    assert dbsm(found) == pytest.approx(dbsm(expected), abs=0.05)
    assert abs(np.angle(found / expected)) < math.radians(1)


@pytest.mark.parametrize("azimuth", [0.0, 3.0, 20.0, 37.0, 72.42])
def test_plate_far_away_is_the_closed_form(azimuth: float) -> None:
    """4 pi A^2 / lambda^2 cos^2 sinc^2 within 0.1 dB, 60 dB down; broadside -j A / lambda."""
    target = as_target(polygons(rectangle(0.2, 0.1)))
    sine, cosine = math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))
    expected = -1j * 0.02 / WAVELENGTH * cosine * np.sinc(2 * 0.2 / WAVELENGTH * sine)
    found = physical_optics(target, Radar.at(azimuth), CARRIER).amplitude
    assert dbsm(found[0]) == pytest.approx(dbsm(expected), abs=0.1)
    assert abs(np.angle(found[0] / expected)) < 0.02
    assert abs(found[1]) < 1e-9


@pytest.mark.parametrize("sent", ["V", "H"])
def test_dihedral_far_and_near(sent) -> None:
    """8 pi a^4 / lambda^2, and the surface integral over image sources at 5 m."""
    faces, port = dihedral(0.2), "VH".index(sent)
    target = as_target(polygons(*faces))
    far = physical_optics(target, Radar.at(0), CARRIER, sent).amplitude[port]
    assert dbsm(far) == pytest.approx(10 * math.log10(8 * np.pi * 0.2**4 / WAVELENGTH**2), abs=0.05)
    for radar in (Radar.at(0, 0, 5.0), Radar.at(0.3, 0.2, 20.0)):
        near = physical_optics(target, radar, CARRIER, sent).amplitude[port]
        assert dbsm(near) == pytest.approx(
            dbsm(image_integral(faces, radar, WAVELENGTH, port)), abs=0.2
        )


@pytest.mark.quick(1)
@pytest.mark.parametrize("distance_m", [5.0, 20.0, 150.0])
def test_trihedral_is_the_surface_integral(distance_m: float) -> None:
    """Legs of a 10 m^2 reflector, three bounces; with the closed form 4 pi a^4 / 3 lambda^2."""
    leg = (10 * 3 * WAVELENGTH**2 / (4 * np.pi)) ** 0.25
    faces = trihedral(leg)
    target = as_target(polygons(*faces))
    for azimuth, elevation in ((45.0, math.degrees(math.atan(math.sqrt(0.5)))), (30.0, 25.0)):
        radar = Radar.at(azimuth, elevation, distance_m)
        found = dbsm(physical_optics(target, radar, CARRIER).amplitude[0])
        assert found == pytest.approx(
            dbsm(image_integral(faces, radar, WAVELENGTH, 0, 180)), abs=0.2
        )
        if azimuth == 45.0:
            assert found == pytest.approx(10, abs=0.2)


def test_cylinder_far_and_near() -> None:
    """2 pi a h^2 / lambda at broadside; the integral over the lit side at 3 and 20 m."""
    a, h = 0.08, 0.114
    target = as_target(trimesh.creation.cylinder(a, h, sections=720))
    expected = 10 * math.log10(2 * np.pi * a * h**2 / WAVELENGTH)
    for azimuth, sent in ((0.0, "V"), (3.3, "H")):
        port = "VH".index(sent)
        found = physical_optics(target, Radar.at(azimuth), CARRIER, sent).amplitude[port]
        assert dbsm(found) == pytest.approx(expected, abs=0.3)
    s, v = np.polynomial.legendre.leggauss(60)
    t = np.concatenate([(s + panel) / 40 for panel in range(-39, 40, 2)])
    w = np.tile(v, 40) / 40
    for distance in (3.0, 20.0):
        half = math.acos(a / distance)
        phi, z = np.meshgrid(half * t, h / 2 * s, indexing="ij")
        normal = np.stack([np.cos(phi), np.sin(phi), 0 * z], axis=-1)
        way = a * normal + np.stack([0 * z, 0 * z, z], axis=-1) - [distance, 0, 0]
        r = np.linalg.norm(way, axis=-1)
        weight = np.outer(w, v) * half * h / 2 * a
        # V: J = 2 n x (d x E) against E again is -2 (n.d), to the order of (z/r)^2.
        part = -2 * np.sum(normal * way, axis=-1) / r * np.exp(-2j * K * (r - distance)) / r**2
        integral = -1j * K / (4 * np.pi) * distance**2 * np.sum(weight * part)
        found = physical_optics(target, Radar.at(0, 0, distance), CARRIER).amplitude[0]
        assert dbsm(found) == pytest.approx(dbsm(integral), abs=0.2)


@pytest.mark.parametrize("turn_deg", [0.0, 22.5, 45.0])
def test_a_turned_dihedral_crosses_polarisation(turn_deg: float) -> None:
    """cos^2 and sin^2 of twice the angle between fold and V, to 1 %; sent V or H alike."""
    mesh = polygons(*dihedral(0.2))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.radians(turn_deg), [1, 0, 0]))
    whole = 8 * np.pi * 0.2**4 / WAVELENGTH**2
    for sent in ("V", "H"):
        port = "VH".index(sent)
        share = (
            4
            * np.pi
            * np.abs(physical_optics(as_target(mesh), Radar.at(0), CARRIER, sent).amplitude) ** 2
            / whole
        )
        assert share[port] == pytest.approx(math.cos(2 * math.radians(turn_deg)) ** 2, abs=0.012)
        assert share[1 - port] == pytest.approx(
            math.sin(2 * math.radians(turn_deg)) ** 2, abs=0.012
        )


# Dielectrics


def test_reflection_is_fresnels_and_airys() -> None:
    """Half-space, Brewster's angle, slab, half-wave window, a slab cut in two, foam on metal."""
    cosine = np.linspace(0.02, 1, 50)
    glass = 6.25 - 0.3j
    te, tm = LayeredSurface(backing=glass).reflection(cosine, CARRIER)
    root = np.sqrt(glass - 1 + cosine**2)
    np.testing.assert_allclose(te, (cosine - root) / (cosine + root))
    np.testing.assert_allclose(tm, (glass * cosine - root) / (glass * cosine + root))
    brewster = np.array([math.cos(math.atan(2.5))])
    assert abs(LayeredSurface(backing=6.25).reflection(brewster, CARRIER)[1][0]) < 1e-12
    thickness = 1.3e-3
    slab = LayeredSurface((Layer(glass, thickness),), backing=1).reflection(cosine, CARRIER)
    turn = np.exp(-2j * K * thickness * root)
    for found, r in zip(slab, (te, tm), strict=True):
        np.testing.assert_allclose(found, r * (1 - turn) / (1 - r**2 * turn))
    halves = (Layer(glass, 0.5e-3), Layer(glass, 0.8e-3))
    np.testing.assert_allclose(LayeredSurface(halves, backing=1).reflection(cosine, CARRIER), slab)
    window = LayeredSurface((Layer(4.0, WAVELENGTH / 4),), backing=1)
    assert abs(window.reflection(np.ones(1), CARRIER)[0][0]) < 1e-12
    # Beyond the critical angle of a thinner medium the field in it decays, and turns by 90 deg.
    plasma = LayeredSurface(backing=0.5).reflection(np.array([0.5]), CARRIER)
    np.testing.assert_allclose(plasma[0], 1j, atol=1e-9)
    foam = LayeredSurface((Layer(1.0, WAVELENGTH / 8),)).reflection(np.ones(1), CARRIER)
    np.testing.assert_allclose(np.array(foam)[:, 0], [1j, -1j], atol=1e-12)


@pytest.mark.parametrize(
    "surface",
    [
        LayeredSurface(backing=5.24 - 0.3j),
        LayeredSurface((Layer(4.6 - 0.02j, 4.3e-3),), backing=1),
        LayeredSurface(
            (Layer(6.0 - 0.1j, 6e-3), Layer(1.1, 20e-3), Layer(6.0 - 0.1j, 4e-3)), backing=1
        ),
        LayeredSurface((Layer(3.0 - 0.05j, 0.15e-3),)),
    ],
    ids=["half-space", "slab", "double glazing", "painted metal"],
)
def test_dielectric_plate_and_dihedral(surface: LayeredSurface) -> None:
    """|r|^2 of the conductor at normal incidence, |r(45 deg)|^4 in a dihedral: within 0.1 dB."""
    plate, corner = polygons(rectangle(0.1, 0.1)), polygons(*dihedral(0.12))
    (straight,), _ = surface.reflection(np.ones(1), CARRIER)
    oblique = surface.reflection(np.array([math.sqrt(0.5)]), CARRIER)
    for port, sent in enumerate(("V", "H")):
        found = physical_optics(as_target(plate, surface), Radar.at(0), CARRIER, sent).amplitude
        metal = physical_optics(as_target(plate), Radar.at(0), CARRIER, sent).amplitude
        assert found[port] / metal[port] == pytest.approx(-straight, rel=0.005)
        found = physical_optics(as_target(corner, surface), Radar.at(0), CARRIER, sent).amplitude
        metal = physical_optics(as_target(corner), Radar.at(0), CARRIER, sent).amplitude
        expected = 40 * math.log10(abs(oblique[port][0]))
        assert dbsm(found[port]) - dbsm(metal[port]) == pytest.approx(expected, abs=0.1)


def test_lossy_sphere_is_mies() -> None:
    """Permittivity 6 - 3j, nothing comes through the sphere: within 0.2 dB."""
    surface, radius = LayeredSurface(backing=6 - 3j), 0.1
    mesh = trimesh.creation.icosphere(6, radius=radius)
    found = physical_optics(as_target(mesh, surface), Radar.at(20, 10), CARRIER).amplitude[0]
    expected = mie_cross_section(
        radius, WAVELENGTH, np.sqrt(6 + 3j)
    )  # Mie's time runs the other way
    assert dbsm(found) == pytest.approx(10 * math.log10(expected), abs=0.2)


def test_every_face_has_its_own_surface() -> None:
    """A dihedral of one metal and one dielectric face: |r(45 deg)|^2."""
    mesh, surface = polygons(*dihedral(0.2)), LayeredSurface(backing=4.0)
    geometry = Geometry(mesh.vertices, mesh.faces)
    target = MeshTarget(geometry, (PEC, surface), np.array([0, 0, 1, 1]))
    te, tm = surface.reflection(np.array([math.sqrt(0.5)]), CARRIER)
    for port, (sent, r) in enumerate((("V", te[0]), ("H", tm[0]))):
        found = physical_optics(target, Radar.at(0), CARRIER, sent).amplitude[port]
        metal = physical_optics(as_target(mesh), Radar.at(0), CARRIER, sent).amplitude[port]
        assert dbsm(found) - dbsm(metal) == pytest.approx(20 * math.log10(abs(r)), abs=0.1)


def test_faces_in_one_plane_echo_once() -> None:
    """A plate listed again with its other diagonal, or with a patch of itself upon it, is a plate:
    it was 6 and 1.9 dB too much.
    """
    plate = np.array(rectangle(0.2, 0.1))
    expected = 10 * math.log10(4 * np.pi * (0.02 / WAVELENGTH) ** 2)
    again, part = plate[[1, 2, 3, 0]], 0.5 * plate + [0, 0.03, 0.01]
    for upon in (again, part):
        echo = physical_optics(as_target(polygons(plate, upon)), Radar.at(0, 0), CARRIER).amplitude
        assert dbsm(echo)[0] == pytest.approx(expected, abs=0.02)


def test_a_mesh_far_from_its_origin_has_the_same_far_field() -> None:
    """A plate 10 km aside: a sphere about the origin of 5e7 plates took 5.6 dB of it. Its phase is
    that of its place.
    """
    at = np.array([30.0, 1e4, -20.0])
    radar = Radar.at(0.2, 0.0)
    here, there = (
        physical_optics(as_target(polygons(rectangle(0.2, 0.1) + off)), radar, CARRIER).amplitude[0]
        for off in (np.zeros(3), at)
    )
    assert abs(there) == pytest.approx(abs(here), rel=1e-3)
    turn = np.angle(there / here * np.exp(-2j * K * (at @ radar.direction)))
    assert turn == pytest.approx(0, abs=0.01)


@pytest.mark.parametrize(("sides", "coarse"), [(16, True), (32, True), (64, False)])
def test_coarse_cylinders_are_warned_of(sides: int, coarse: bool) -> None:
    """Of radius 40 mm: with 32 sides -2.4 to 1.0 dBsm, where the smooth one has -0.65."""
    mesh = trimesh.creation.cylinder(0.04, 0.3, sections=sides)
    told = sweep(as_target(mesh), CARRIER, [0.0]).warnings
    assert any("finer mesh" in text for text in told) == coarse


def test_edges_that_are_left_out_are_warned_of_where_they_count() -> None:
    """Of a plate at 40 deg they are larger than the facets' echo; a ball has none."""
    plate = as_target(polygons(rectangle(0.2, 0.2)))
    without, with_edges = (sweep(plate, CARRIER, [40.0], edges=edges) for edges in (False, True))
    told = [text for text in without.warnings if "sharp edges, left out" in text]
    share = abs(with_edges.amplitude_m[0] / without.amplitude_m[0] - 1)
    assert f"up to {share:.2g} of" in told[0]
    assert not any("left out" in text for text in with_edges.warnings)
    ball = as_target(trimesh.creation.icosphere(5, radius=0.02))
    assert not sweep(ball, CARRIER, [40.0]).warnings


def test_the_benchmark_has_the_former_time_beside_todays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each time of one aspect that the table has of the commit before, and no other."""
    for name in ("_dielectrics", "_tolerance", "_plates"):
        monkeypatch.setattr(rcs, name, lambda: ())
    monkeypatch.setattr(rcs, "_echo", lambda target, radar: 0.0)
    monkeypatch.setattr(rcs, "image_integral", lambda *_: 1.0)
    monkeypatch.setattr(rcs, "timed", lambda *_: Timing(1.0, 1.0, 1.0, 1))
    notes = {name: value.note for name, value, _ in rcs.figures() if isinstance(value, Timing)}
    assert {name for name, note in notes.items() if note} == set(rcs.AT_EE37B06)
    assert {name for name in notes if name.endswith("one aspect")} == set(rcs.AT_EE37B06)
    assert notes["sphere: one aspect"].startswith("at ee37b06: 1140 ms to .072 dB")
