"""Figures of cross-sections at 79 GHz: error against references, time, error over tolerance.

Beside the rays of commit ee37b06, at the coarsest density that reaches today's error (in rays per
wavelength, of 1, 2, 3, 4, 6, 8, 12, 16, 24): CPU time of one thread, both in the same hour on the
same loaded machine, medians of up to 9 runs, errors in dB as printed here; of several aspects the
largest error over the strongest echo.

| | today | ee37b06 |
|---|---|---|
| plate, one aspect | .0009, 12 ms | .0005 at 24, 610 ms (.0013 at 16, 330 ms) |
| sphere, one aspect | .046, 93 ms | not reached: .072 at 12, 1140 ms |
| cylinder, one aspect | .0029, 8.5 ms | .0022 at 8, 95 ms |
| trihedral, 9 aspects of one call | .010, 20 to 30 ms | .0077 at 6, 185 ms |
| plate, 81 aspects of one call | .0003, 80 ms | not reached: .0049 at 2, 1020 ms |
| dihedral, one aspect | .0040, 38 to 44 ms | .0038 at 4, 58 ms |
| trihedral, one aspect | .015, 12 to 15 ms | .0083 at 4, 15 ms |

Measured again later on a machine about half as fast, of today alone: plate 8 to 10 ms, its 81
aspects 21, sphere 127, cylinder 15 to 21, dihedral 68 to 89, trihedral 25 to 28.

So all but single aspects of corner reflectors take less than a third; those are rays as before.
What is printed of one aspect has the time at ee37b06 beside it, of the table's machine; of the
table's calls of several aspects nothing is measured here.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from benchmarks.cross_section_references import image_integral, mie_cross_section
from benchmarks.timing import Figure, Timing, timed
from twin.geometry import Geometry
from twin.radar.cross_section import Aspects, Quality, physical_optics, scattered
from twin.radar.scattering import (
    PEC,
    Layer,
    LayeredSurface,
    MeshTarget,
    Radar,
    edge_diffraction,
    sharp_edges,
)

_CARRIER = 79e9
_WAVELENGTH = speed_of_light / _CARRIER
#: CPU time at commit ee37b06 and its error, by the name of today's figure; the table above.
AT_EE37B06 = {
    "plate 0.2 m: one aspect": "610 ms to .0005 dB",
    "sphere: one aspect": "1140 ms to .072 dB",
    "cylinder: one aspect": "95 ms to .0022 dB",
    "dihedral: one aspect": "58 ms to .0038 dB",
    "trihedral: one aspect": "15 ms to .0083 dB",
}
_PLATES = Path(__file__).parents[1] / "tests" / "physics" / "austin_rcs_plates"


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for name, value, unit in _conductors():
        if name in AT_EE37B06 and isinstance(value, Timing):
            note = f"at ee37b06: {AT_EE37B06[name]}, CPU time on another machine"
            value = replace(value, note=note)
        yield name, value, unit
    yield from _dielectrics()
    yield from _tolerance()
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
    radars = [Radar.at(a, e) for a, e in ((0, 0), (13, 5), (77, -40), (120, 63), (200, 20))]
    worst = max(abs(_echo(ball, radar) - expected) for radar in radars)
    yield "sphere r 0.15 m, 81 920 facets: largest error of 5 aspects (Mie)", worst, "dB"
    yield "sphere: one aspect", _time(ball, Radar.at(13, 5)), ""
    around = Aspects.monostatic([Radar.at(azimuth, 5) for azimuth in range(0, 360, 30)], "V")
    yield "sphere: 12 aspects", timed(lambda: scattered(ball, around, _CARRIER), 3), ""

    fold = math.sqrt(0.5) * 0.2
    corner = [[[0, 0, -0.1], [fold, y, -0.1], [fold, y, 0.1], [0, 0, 0.1]] for y in (fold, -fold)]
    closed = 10 * math.log10(8 * np.pi * 0.2**4 / _WAVELENGTH**2)
    yield "dihedral 0.2 m: error", _echo(_target(*corner), Radar.at(0)) - closed, "dB"
    near = Radar.at(0.3, 0.2, 5.0)
    expected = _decibel(image_integral(corner, near, _WAVELENGTH, 0))
    yield "dihedral at 5 m: error", _echo(_target(*corner), near) - expected, "dB"
    yield "dihedral: one aspect", _time(_target(*corner), near), ""

    trihedral = _trihedral()
    axis = math.degrees(math.atan(math.sqrt(0.5)))
    for distance in (20.0, 150.0):
        radar = Radar.at(45.0, axis, distance)
        found = _echo(_target(*trihedral), radar)
        expected = _decibel(image_integral(trihedral, radar, _WAVELENGTH, 0, 180))
        yield f"trihedral 10 m^2 at {distance:g} m: error to 10 m^2", found - 10, "dB"
        yield f"trihedral at {distance:g} m: error to the integral", found - expected, "dB"
    yield "trihedral: one aspect", _time(_target(*trihedral), radar), ""
    corner = _target(*trihedral)
    around = Aspects.monostatic([Radar.at(azimuth, 30.0) for azimuth in range(5, 86)], "V")
    yield "trihedral: 81 aspects", timed(lambda: scattered(corner, around, _CARRIER), 3), ""

    tube = _from(trimesh.creation.cylinder(0.08, 0.114, sections=720))
    closed = 10 * math.log10(2 * np.pi * 0.08 * 0.114**2 / _WAVELENGTH)
    worst = max(abs(_echo(tube, Radar.at(azimuth)) - closed) for azimuth in (0.0, 3.3, 21.0))
    yield "cylinder r 80, h 114 mm: largest error of 3 aspects", worst, "dB"
    yield "cylinder: one aspect", _time(tube, Radar.at(3.3)), ""


def _dielectrics() -> Iterator[Figure]:
    corners = _rectangle(0.2, 0.2)
    for name, surface in (
        ("half-space 5.24 - 0.3j", LayeredSurface(backing=5.24 - 0.3j)),
        ("slab 4.6 - 0.02j, 4.3 mm", LayeredSurface((Layer(4.6 - 0.02j, 4.3e-3),), backing=1)),
    ):
        found = _echo(_target(corners, surface=surface), Radar.at(0)) - _echo(
            _target(corners), Radar.at(0)
        )
        ((r,), _) = surface.reflection(np.ones(1), _CARRIER)
        yield f"plate of {name}: error to |r|^2", found - 20 * math.log10(abs(r)), "dB"
    radius, permittivity = 0.1, 6 - 3j
    ball = _from(trimesh.creation.icosphere(6, radius=radius), LayeredSurface(backing=permittivity))
    index = np.sqrt(np.conj(permittivity))
    expected = 10 * math.log10(mie_cross_section(radius, _WAVELENGTH, index))
    yield "sphere of 6 - 3j, r 0.1 m: error (Mie)", _echo(ball, Radar.at(20, 10)) - expected, "dB"


def _tolerance() -> Iterator[Figure]:
    """Error and time of a plate near by, of one behind a screen, and of a trihedral."""
    square, screen = _rectangle(0.2, 0.2), np.array(_rectangle(0.1, 0.3)) + [0.5, 0.05, 0]
    near, far = Radar.at(2.0, 1.0, 1.0), Radar.at(0.0)
    # Straight ahead both are in phase all over, and the screen hides a half of the plate.
    half = 0.02 + 0.03 * np.exp(4j * np.pi / _WAVELENGTH * 0.5)
    corner, radar = _trihedral(), Radar.at(30.0, 25.0, 20.0)
    for name, faces, seen, expected in (
        ("plate at 1 m", [square], near, image_integral([square], near, _WAVELENGTH, 0)),
        ("plate behind a screen", [square, screen.tolist()], far, -1j / _WAVELENGTH * half),
        ("trihedral", corner, radar, image_integral(corner, radar, _WAVELENGTH, 0)),
    ):
        target = _target(*faces)
        for tolerance in (0.1, 0.03, 0.01, 0.003):
            quality = Quality(tolerance)
            found = physical_optics(target, seen, _CARRIER, "V", quality).amplitude[0]
            yield f"{name}, tolerance {tolerance:g}: error", abs(found / expected - 1), "of it"
            one = timed(lambda t=target, r=seen, q=quality: physical_optics(t, r, _CARRIER, "V", q))
            yield f"{name}, tolerance {tolerance:g}: one aspect", one, ""


def _plates() -> Iterator[Figure]:
    """The Austin suite's plates, with its own measure of error."""
    target = _target(_rectangle(0.2667, 0.1524))
    edges = sharp_edges(target, 25)
    for name in ("f10", "fx1", "f11"):
        for port, sent in enumerate(("V", "H")):
            columns = np.loadtxt(_PLATES / f"ref_rcs.II.A.sx1.{name}.{sent}.txt")
            carrier, reference = float(columns[0, 0]), columns[:, 3]
            radars = [Radar.at(azimuth) for azimuth in columns[:, 2]]
            aspects = Aspects.monostatic(radars, sent)
            surface = scattered(target, aspects, carrier).amplitude[:, port]
            rim = np.array(
                [edge_diffraction(target, edges, r, carrier, sent)[port] for r in radars]
            )
            floor, near = reference.max() - 80, reference > reference.max() - 20
            for how, amplitude in (("", surface), (" and edges", surface + rim)):
                level = np.array([_decibel(value) for value in amplitude])
                error = np.abs(np.maximum(level, floor) - np.maximum(reference, floor))
                title = f"Austin plate, {carrier / 1e9:g} GHz {sent}, optics{how}"
                yield f"{title}, lobes", float(error[near].mean()), "dB"
                yield f"{title}, all angles", float(error.mean()), "dB"
            if sent == "V":
                work = timed(lambda w=aspects, f=carrier: scattered(target, w, f))
                title = f"Austin plate, {carrier / 1e9:g} GHz, optics"
                yield f"{title}, {len(radars)} aspects", work, ""
    work = timed(lambda: edge_diffraction(target, edges, Radar.at(30), 10.2e9))
    yield "edges of a plate, one aspect", work, ""


def _trihedral() -> list[list[NDArray[np.float64] | list[int]]]:
    """Of 10 m^2."""
    a, b, c = (10 * 3 * _WAVELENGTH**2 / (4 * np.pi)) ** 0.25 * np.eye(3)
    return [[[0, 0, 0], p, q] for p, q in ((a, b), (b, c), (c, a))]


def _rectangle(width_m: float, height_m: float) -> list[list[float]]:
    y, z = width_m / 2, height_m / 2
    return [[0, -y, -z], [0, y, -z], [0, y, z], [0, -y, z]]


def _target(*polygons: list, surface: LayeredSurface = PEC) -> MeshTarget:  # type: ignore[type-arg]
    vertices, faces = [], []
    for polygon in polygons:
        n = len(vertices)
        vertices += polygon
        faces += [[n, n + i, n + i + 1] for i in range(1, len(polygon) - 1)]
    return MeshTarget(Geometry(np.array(vertices, dtype=np.float64), np.array(faces)), (surface,))


def _from(mesh: trimesh.Trimesh, surface: LayeredSurface = PEC) -> MeshTarget:
    return MeshTarget(Geometry(np.array(mesh.vertices), np.array(mesh.faces)), (surface,))


def _echo(target: MeshTarget, radar: Radar) -> float:
    return _decibel(physical_optics(target, radar, _CARRIER).amplitude[0])


def _time(target: MeshTarget, radar: Radar) -> Timing:
    return timed(lambda: physical_optics(target, radar, _CARRIER))


def _decibel(amplitude: complex | NDArray[np.complex128]) -> float:
    return float(10 * np.log10(np.maximum(4 * np.pi * np.abs(amplitude) ** 2, 1e-300)))
