"""Edge diffraction of `twin rcs`: full-wave data, Sommerfeld's wedge, Keller's coefficient."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light
from scipy.special import jv

from tests.physics.rcs_targets import (
    as_target,
    dbsm,
    dihedral,
    polygons,
    rectangle,
)
from twin.geometry import Geometry
from twin.radar.cross_section import Aspects, physical_optics, scattered
from twin.radar.scattering import (
    EdgeQuality,
    MeshTarget,
    Radar,
    diffraction,
    edge_diffraction,
    sharp_edges,
)
from twin.radar.scattering.fringe import Incidence, moment, observed

PLATES = Path(__file__).parent / "austin_rcs_plates"


def plate_errors(name: str, sent: str, step: int) -> list[tuple[float, float]]:
    """The suite's error within 20 dB of the maximum and over all angles, without and with edges."""
    columns = np.loadtxt(PLATES / f"ref_rcs.II.A.sx1.{name}.{sent}.txt")[::step]
    carrier, reference = columns[0, 0], columns[:, 3]
    target, port = as_target(polygons(rectangle(0.2667, 0.1524))), "VH".index(sent)
    edges, radars = sharp_edges(target, 25), [Radar.at(azimuth) for azimuth in columns[:, 2]]
    surface = scattered(target, Aspects.monostatic(radars, sent), carrier).amplitude[:, port]
    rim = [edge_diffraction(target, edges, r, carrier, sent)[port] for r in radars]
    floor, near = reference.max() - 80, reference > reference.max() - 20
    errors = []
    for amplitude in (surface, surface + rim):
        error = np.abs(np.maximum(dbsm(amplitude), floor) - np.maximum(reference, floor))
        errors.append((float(error[near].mean()), float(error.mean())))
    return errors


LOBES_DB = {"f11": 0.3, "fx1": 0.35, "f10": 0.9}


@pytest.mark.parametrize("name", ["f10", "fx1", "f11"])
@pytest.mark.parametrize(("sent", "bound_db"), [("V", 1.3), ("H", 2.2)])
@pytest.mark.parametrize(
    "step", [5, pytest.param(1, marks=pytest.mark.slow)], ids=["some angles", "all angles"]
)
def test_plates_of_the_austin_suite(name: str, sent: str, bound_db: float, step: int) -> None:
    """Full-wave data: the lobes by physical optics alone, all angles down to edge on with edges.

    Without edges the latter is 8 to 12 dB off; with the fringe field's sign wrong 2.4 and more.
    """
    (lobes, without), (lobes_too, everywhere) = plate_errors(name, sent, step)
    assert max(lobes, lobes_too) <= LOBES_DB[name]
    assert without > 7
    assert everywhere <= bound_db


@pytest.mark.parametrize("sent", ["V", "H"])
def test_an_off_centre_plate_has_the_same_echo(sent) -> None:
    """Physical optics and edges turn in phase together: a conjugated edge field would show."""
    corners, shift = np.array(rectangle(0.2667, 0.1524)), np.array([0.31, -0.22, 0.17])
    port, carrier = "VH".index(sent), 7e9
    for azimuth in (10.0, 41.0, 68.0):
        radar, found = Radar.at(azimuth, 7.0), []
        for plate in (corners, corners + shift):
            target = as_target(polygons(plate))
            whole = physical_optics(target, radar, carrier, sent).amplitude
            whole = whole + edge_diffraction(target, sharp_edges(target, 25), radar, carrier, sent)
            found.append(whole[port])
        phase = 4 * np.pi * carrier / speed_of_light * (radar.direction @ shift)
        assert found[1] == pytest.approx(found[0] * np.exp(1j * phase), rel=2e-3)


@pytest.mark.parametrize("sent", ["V", "H"])
def test_edges_need_few_pieces(sent) -> None:
    """Phase runs up to a whole turn within the coarse pieces: 8 % rms."""
    target, port = as_target(polygons(rectangle(0.2667, 0.1524))), "VH".index(sent)
    edges, fields = sharp_edges(target, 25), []
    for segments in (2, 32):
        quality = EdgeQuality(pieces_per_wavelength=segments)
        fields.append(
            [
                edge_diffraction(target, edges, Radar.at(azimuth), 7e9, sent, quality)[port]
                for azimuth in np.arange(1.0, 89.0, 8.0)
            ]
        )
    coarse, fine = np.array(fields)
    assert np.linalg.norm(coarse - fine) < 0.08 * np.linalg.norm(fine)


@cache
def wedge_currents(n: float, phi0: float, end: float) -> tuple[np.ndarray, ...]:
    """Fringe part of H_z and (1/x) dE_z/dphi on a wedge's face from its eigenfunctions.

    At points x up to ``end``, with the weights of a quadrature; wavelength and incident fields 1.

    Bowman, Senior and Uslenghi, Electromagnetic and acoustic scattering by simple shapes, section
    6.2; the current of physical optics is taken out.
    """
    k = 2 * np.pi
    t, w = np.polynomial.legendre.leggauss(160)
    t = (t + 1) / 2 * end ** (1 / 3)  # x = t^3: the current along the edge is singular there
    x = np.append(t**3, end)
    weight = w / 2 * end ** (1 / 3) * 3 * t**2
    order = np.arange(80)[:, None] / n
    series = np.exp(0.5j * np.pi * order) * jv(order, k * x)
    hard = 2 / n * np.sum(np.where(order == 0, 1, 2) * series * np.cos(order * phi0), axis=0)
    soft = 4 / n * np.sum(order * series * np.sin(order * phi0), axis=0) / x
    if phi0 < np.pi:
        mirror = 2 * np.exp(1j * k * x * np.cos(phi0))
        hard, soft = hard - mirror, soft - 1j * k * np.sin(phi0) * mirror
    return x, np.append(weight, 0), hard, soft


def wedge_integrals(n: float, phi0: float, mu: float, end: float) -> tuple[complex, ...]:
    """Of H_z, dH_z/dx (by parts) and (1/x) dE_z/dphi times exp(j k mu x), over the face."""
    x, weight, hard, soft = wedge_currents(n, phi0, end)
    phase = np.exp(2j * np.pi * mu * x)
    total = np.sum(hard * phase * weight)
    at_edge = 2 / n - 2 * (phi0 < np.pi)
    slope = (hard * phase)[-1] - at_edge - 2j * np.pi * mu * total
    return total, slope, np.sum(soft * phase * weight)


@pytest.mark.parametrize("mu", [0.3, -0.9, -3.0, 0.97])
@pytest.mark.parametrize("phi0", [0.05, 0.7, np.pi / 2, 2.5, 3.3, 4.2])
@pytest.mark.parametrize(("n", "tolerance"), [(2.0, 1e-5), (1.75, 0.02), (1.5, 0.05)])
def test_fringe_currents_are_sommerfelds(n: float, phi0: float, mu: float, tolerance) -> None:
    """Face of two wavelengths; exact for a half-plane, within a few per cent for wedges.

    The moment's three parts are told apart by incidence at right angles and obliquely.
    """
    one = np.ones(1)
    hard, slope, soft = wedge_integrals(n, phi0, mu, 2.0)
    at = Incidence(n * one, phi0 * one, 0 * one, mu * one, 2.0 * one)
    x, z = (part[0] for part in moment(at, one, one, 2 * np.pi))
    assert x == pytest.approx(hard, rel=tolerance, abs=tolerance * 0.3)
    assert z == pytest.approx(-1j * soft / (2 * np.pi), rel=tolerance, abs=tolerance * 0.1)
    # Obliquely, on a scale on which the wavelength across the edge is 1 again.
    k = 2 * np.pi / 0.8
    tilted = Incidence(n * one, phi0 * one, 0.6 * one, mu * one, 2.0 * one)
    x, z = (part[0] for part in moment(tilted, 0 * one, one, k))
    assert x == pytest.approx(hard, rel=tolerance, abs=tolerance * 0.3)
    expected = 1j * k / (2 * np.pi) ** 2 * 0.6 * slope
    assert z == pytest.approx(expected, rel=tolerance, abs=tolerance * 0.3)


class Endless:
    """Faces without an end."""

    def reach(self, patch, origin_m, direction) -> np.ndarray:
        return np.full(len(patch), np.inf)


@pytest.mark.parametrize("beta", [np.pi / 2, 1.0, 2.3])
@pytest.mark.parametrize("phi0", [0.7, 2.2])
def test_fringe_and_physical_optics_make_kellers_coefficient(phi0: float, beta: float) -> None:
    """A half-plane, observers all around on the cone of diffracted rays: what both currents radiate
    is D = -exp(-j pi/4) / (2 sqrt(2 pi k)) (sec((phi - phi0)/2) -+ sec((phi + phi0)/2)).

    Keller, J. Opt. Soc. Am. 52, 1962, eq. 15; k is its part across the edge.
    """
    k, sine, cosine = 7.0, np.sin(beta), np.cos(beta)
    across = k * sine
    strip = sharp_edges(as_target(polygons([[0, 0, -1], [3, 0, -1], [3, 0, 1], [0, 0, 1]])), 25)
    rim = int(np.argmin(strip.start_m[:, 0] + 9 * np.abs(strip.along[:, 0])))
    strip = replace(strip, patches=Endless())
    phi = np.array([0.4, 1.3, 2.0, 3.0, 4.4, 5.5])
    one = diffraction.EdgeSegments(np.full(6, rim), np.zeros((6, 3)), np.ones(6))
    direction = np.tile([-sine * np.cos(phi0), -sine * np.sin(phi0), cosine], (6, 1))
    towards = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.full(6, cosine)], axis=1)
    for angle in (0.0, 0.9, np.pi / 2):
        first = np.cross(direction, [0, 0, 1.0]) / sine
        field = np.cos(angle) * first + np.sin(angle) * np.cross(direction, first)
        magnetic = np.cross(direction, field)
        fringe = diffraction.fringe_moment(strip, one, direction, field, towards, k)
        optics = 2j / (across * (np.cos(phi0) + np.cos(phi)))
        x, z = fringe[:, 0] + optics * magnetic[:, 2], fringe[:, 2] - optics * magnetic[:, 0]
        line = -0.25j * np.sqrt(2 / (np.pi * across)) * np.exp(0.25j * np.pi)
        e_z = -1j * k * line * (sine**2 * z - cosine * sine * np.cos(phi) * x)
        h_z = 1j * across * np.sin(phi) * line * x
        scale = -np.exp(-0.25j * np.pi) / (2 * np.sqrt(2 * np.pi * across))
        direct, mirrored = 1 / np.cos((phi - phi0) / 2), 1 / np.cos((phi + phi0) / 2)
        np.testing.assert_allclose(e_z, scale * (direct - mirrored) * field[:, 2], atol=1e-9)
        np.testing.assert_allclose(h_z, scale * (direct + mirrored) * magnetic[:, 2], atol=1e-9)


def test_fringe_currents_pass_their_poles_and_grazing_smoothly() -> None:
    """Where two poles cancel, at normal incidence on a face, and edge on, nothing jumps."""
    one = np.ones(3)
    for phi0 in (np.pi / 2, np.pi, 1e-9, 0.75 * np.pi):
        for n in (2.0, 1.5):
            at = phi0 + np.array([-1e-5, 0, 1e-5])
            at = np.maximum(at, 0)
            back = observed(n * one, at, 0 * one, np.cos(at), 0 * one, 3 * one)
            found = np.array(moment(back, one, one, 2 * np.pi))
            assert np.isfinite(found).all()
            if phi0 != np.pi:  # the lit share of the face ends there: both parts jump
                np.testing.assert_allclose(found[:, 0], found[:, 2], rtol=1e-2, atol=1e-3)
                np.testing.assert_allclose(found[:, 1], found[:, 2], rtol=1e-2, atol=1e-3)


def test_edges_of_solids_are_found_whatever_the_winding() -> None:
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    rng = np.random.default_rng(1)
    for mesh in (box, box.subdivide().subdivide()):
        faces = np.array(mesh.faces)
        flip = rng.random(len(faces)) < 0.5
        faces[flip] = faces[flip][:, ::-1]
        edges = sharp_edges(MeshTarget(Geometry(np.array(mesh.vertices), faces)), 25)
        np.testing.assert_allclose(edges.wedge, 1.5)
        assert edges.length_m.sum() == pytest.approx(4 * 0.6)
        assert len(np.unique(edges.patch)) == 6
        assert edges.sagitta_m < 1e-12
    ball = sharp_edges(as_target(trimesh.creation.icosphere(3, radius=0.15)), 25)
    assert len(ball.length_m) == 0
    soup = polygons(*dihedral(0.2))  # the fold's corners are there twice
    fold = sharp_edges(as_target(soup), 25)
    assert sorted(fold.wedge.round(6)) == [1.5] + 6 * [2.0]


def test_ways_along_a_face_end_at_its_rim() -> None:
    """An L-shaped plate, turned anyhow: to the notch, to the far side, past a corner."""
    outline = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]
    flat = np.array([(x, y, 0) for x, y in outline], dtype=float)
    turn = trimesh.transformations.euler_matrix(0.4, 1.1, -2.3)[:3, :3]
    target = MeshTarget(
        Geometry(flat @ turn.T, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]))
    )
    edges = sharp_edges(target, 25)
    assert edges.length_m.sum() == pytest.approx(14)
    starts = np.array([(3, 0, 0), (0.5, 0, 0), (0, 1.8, 0), (4, 0.5, 0)], dtype=float)
    ways = np.array([(0, 1, 0), (0, 1, 0), (1, -1, 0), (-1, 0.1, 0)], dtype=float)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    patch = np.full(4, edges.patch[0, 0])
    found = edges.patches.reach(patch, starts @ turn.T, ways @ turn.T)
    expected = [1, 3, 1.8 * math.sqrt(2), 4 * math.sqrt(1.01)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_face_ends_at_its_width_however_obliquely_it_is_met(monkeypatch) -> None:
    """Along a long strip the way to the far side grows, its part across the strip does not."""
    ends, real = [], diffraction.moment
    monkeypatch.setattr(
        diffraction, "moment", lambda at, *rest: ends.append(at.end_m) or real(at, *rest)
    )
    target = as_target(polygons(rectangle(0.1, 20.0)))
    for elevation in (0.0, 30.0, 60.0):
        edge_diffraction(target, sharp_edges(target, 25), Radar.at(40.0, elevation), 1e9)
        assert np.median(ends[-1]) == pytest.approx(0.1)


def test_the_fold_of_a_corner_diffracts_outwards_only() -> None:
    """Seen from within the corner its two faces are left to bouncing rays."""
    target = as_target(polygons(*dihedral(0.2)))
    edges = sharp_edges(target, 25)
    rims = edges.wedge > 1.9
    kept = ("start_m", "along", "length_m", "wedge", "inwards", "upwards", "patch")
    without = replace(edges, **{name: getattr(edges, name)[rims] for name in kept})
    for azimuth, same in ((10.0, True), (170.0, False)):
        both = [edge_diffraction(target, e, Radar.at(azimuth, 4.0), 10e9) for e in (edges, without)]
        assert np.allclose(*both, rtol=1e-12) == same
