"""Figures of cross-sections at 79 GHz: error against references, time, error over ray density."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from benchmarks.timing import Figure, Timing, timed
from twin.radar.scattering import (
    PEC,
    Layer,
    Quality,
    Radar,
    Surface,
    Target,
    edge_diffraction,
    physical_optics,
    sharp_edges,
    sweep,
)
from twin.radar.scattering.reference import image_integral, mie_cross_section

_CARRIER = 79e9
_WAVELENGTH = speed_of_light / _CARRIER
_PLATES = Path(__file__).parents[1] / "tests" / "physics" / "austin_rcs_plates"


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _conductors()
    yield from _dielectrics()
    yield from _density()
    yield from _plates()


def _conductors() -> Iterator[Figure]:
    plate = _rectangle(0.2, 0.2)
    for distance in (1.0, 5.0, 150.0):
        worst = 0.0
        for azimuth in (0.0, 1.0, 3.0):
            radar = Radar.at(azimuth, 0.0, distance)
            expected = _decibel(image_integral([plate], radar, _WAVELENGTH, 0))
            worst = max(worst, abs(_echo(_target(plate), radar) - expected))
        yield f"plate 0.2 m at {distance:g} m, 0, 1, 3 deg: largest error", worst, "dB"
    yield "plate 0.2 m: one aspect", _time(_target(plate), Radar.at(1.0)), ""

    ball = _from(trimesh.creation.icosphere(6, radius=0.15))
    expected = 10 * math.log10(mie_cross_section(0.15, _WAVELENGTH))
    aspects = [Radar.at(a, e) for a, e in ((0, 0), (13, 5), (77, -40), (120, 63), (200, 20))]
    worst = max(abs(_echo(ball, radar) - expected) for radar in aspects)
    yield "sphere r 0.15 m, 81 920 facets: largest error of 5 aspects (Mie)", worst, "dB"
    yield "sphere: one aspect", _time(ball, Radar.at(13, 5)), ""

    fold = math.sqrt(0.5) * 0.2
    corner = [[[0, 0, -0.1], [fold, y, -0.1], [fold, y, 0.1], [0, 0, 0.1]] for y in (fold, -fold)]
    closed = 10 * math.log10(8 * np.pi * 0.2**4 / _WAVELENGTH**2)
    yield "dihedral 0.2 m: error", _echo(_target(*corner), Radar.at(0)) - closed, "dB"
    near = Radar.at(0.3, 0.2, 5.0)
    expected = _decibel(image_integral(corner, near, _WAVELENGTH, 0))
    yield "dihedral at 5 m: error", _echo(_target(*corner), near) - expected, "dB"
    yield "dihedral: one aspect", _time(_target(*corner), near), ""

    a, b, c = (10 * 3 * _WAVELENGTH**2 / (4 * np.pi)) ** 0.25 * np.eye(3)
    trihedral = [[[0, 0, 0], p, q] for p, q in ((a, b), (b, c), (c, a))]
    axis = math.degrees(math.atan(math.sqrt(0.5)))
    for distance in (20.0, 150.0):
        radar = Radar.at(45.0, axis, distance)
        found = _echo(_target(*trihedral), radar)
        expected = _decibel(image_integral(trihedral, radar, _WAVELENGTH, 0, 180))
        yield f"trihedral 10 m^2 at {distance:g} m: error to 10 m^2", found - 10, "dB"
        yield f"trihedral at {distance:g} m: error to the integral", found - expected, "dB"
    yield "trihedral: one aspect", _time(_target(*trihedral), radar), ""

    tube = _from(trimesh.creation.cylinder(0.08, 0.114, sections=720))
    closed = 10 * math.log10(2 * np.pi * 0.08 * 0.114**2 / _WAVELENGTH)
    worst = max(abs(_echo(tube, Radar.at(azimuth)) - closed) for azimuth in (0.0, 3.3, 21.0))
    yield "cylinder r 80, h 114 mm: largest error of 3 aspects", worst, "dB"
    yield "cylinder: one aspect", _time(tube, Radar.at(3.3)), ""


def _dielectrics() -> Iterator[Figure]:
    corners = _rectangle(0.2, 0.2)
    for name, surface in (
        ("half-space 5.24 - 0.3j", Surface(backing=5.24 - 0.3j)),
        ("slab 4.6 - 0.02j, 4.3 mm", Surface((Layer(4.6 - 0.02j, 4.3e-3),), backing=1)),
    ):
        found = _echo(_target(corners, surface=surface), Radar.at(0)) - _echo(
            _target(corners), Radar.at(0)
        )
        ((r,), _) = surface.reflection(np.ones(1), _CARRIER)
        yield f"plate of {name}: error to |r|^2", found - 20 * math.log10(abs(r)), "dB"
    radius, permittivity = 0.1, 6 - 3j
    ball = _from(trimesh.creation.icosphere(6, radius=radius), Surface(backing=permittivity))
    index = np.sqrt(np.conj(permittivity))
    expected = 10 * math.log10(mie_cross_section(radius, _WAVELENGTH, index))
    yield "sphere of 6 - 3j, r 0.1 m: error (Mie)", _echo(ball, Radar.at(20, 10)) - expected, "dB"


def _density() -> Iterator[Figure]:
    """A plate of 0.2 x 0.1 m far away, its closed form over 40 angles each."""
    target = _target(_rectangle(0.2, 0.1))
    for density in (2, 4, 8, 16, 32):
        quality = Quality(rays_per_wavelength=density, min_rays=1)
        for low, high in ((0, 5), (40, 50)):
            angles = np.linspace(low, high, 40)
            sine, cosine = np.sin(np.radians(angles)), np.cos(np.radians(angles))
            closed = 0.02 / _WAVELENGTH * cosine * np.sinc(0.4 / _WAVELENGTH * sine)
            found = sweep(target, _CARRIER, angles, quality=quality).cross_section_dbsm
            error = float(np.median(np.abs(found - 10 * np.log10(4 * np.pi * closed**2))))
            yield f"{density} rays per wavelength, {low} to {high} deg: median error", error, "dB"
        one = timed(lambda q=quality: physical_optics(target, Radar.at(3), _CARRIER, "V", q))
        yield f"{density} rays per wavelength: one aspect", one, ""


def _plates() -> Iterator[Figure]:
    """The Austin suite's plates, with its own measure of error."""
    target, dense = _target(_rectangle(0.2667, 0.1524)), Quality(rays_per_wavelength=16)
    edges = sharp_edges(target, 25)
    for name in ("f10", "fx1", "f11"):
        for port, sent in enumerate(("V", "H")):
            columns = np.loadtxt(_PLATES / f"ref_rcs.II.A.sx1.{name}.{sent}.txt")
            carrier, reference = float(columns[0, 0]), columns[:, 3]
            aspects = [Radar.at(azimuth) for azimuth in columns[:, 2]]
            optics = [physical_optics(target, r, carrier, sent, dense) for r in aspects]
            surface = np.array([echo.amplitude[port] for echo in optics])
            rim = np.array(
                [edge_diffraction(target, edges, r, carrier, sent)[port] for r in aspects]
            )
            floor, near = reference.max() - 80, reference > reference.max() - 20
            for how, amplitude in (("", surface), (" and edges", surface + rim)):
                level = np.array([_decibel(value) for value in amplitude])
                error = np.abs(np.maximum(level, floor) - np.maximum(reference, floor))
                title = f"Austin plate, {carrier / 1e9:g} GHz {sent}, optics{how}"
                yield f"{title}, lobes", float(error[near].mean()), "dB"
                yield f"{title}, all angles", float(error.mean()), "dB"
    work = timed(lambda: edge_diffraction(target, edges, Radar.at(30), 10.2e9))
    yield "edges of a plate, one aspect", work, ""


def _rectangle(width_m: float, height_m: float) -> list[list[float]]:
    y, z = width_m / 2, height_m / 2
    return [[0, -y, -z], [0, y, -z], [0, y, z], [0, -y, z]]


def _target(*polygons: list, surface: Surface = PEC) -> Target:  # type: ignore[type-arg]
    vertices, faces = [], []
    for polygon in polygons:
        n = len(vertices)
        vertices += polygon
        faces += [[n, n + i, n + i + 1] for i in range(1, len(polygon) - 1)]
    return Target(np.array(vertices, dtype=np.float64), np.array(faces), (surface,))


def _from(mesh: trimesh.Trimesh, surface: Surface = PEC) -> Target:
    return Target(np.array(mesh.vertices), np.array(mesh.faces), (surface,))


def _echo(target: Target, radar: Radar) -> float:
    return _decibel(physical_optics(target, radar, _CARRIER).amplitude[0])


def _time(target: Target, radar: Radar) -> Timing:
    return timed(lambda: physical_optics(target, radar, _CARRIER))


def _decibel(amplitude: complex | NDArray[np.complex128]) -> float:
    return float(10 * np.log10(np.maximum(4 * np.pi * np.abs(amplitude) ** 2, 1e-300)))
