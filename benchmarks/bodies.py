"""Cross-sections of the scenes' car, person and post over aspect, beside published ones.

Physical optics with up to six bounces, without ground, at the height of the target's origin, to a
tolerance of 5 % (``python -m benchmarks.bodies 0.01`` takes 1 %).
docs/bodies.md says where the published figures were read.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.timing import Figure
from twin.geometry import Geometry
from twin.radar.cross_section import Aspects, Quality, scattered
from twin.radar.scattering import PEC, LayeredSurface, MeshTarget, Radar

Array = NDArray[np.float64]

_BODIES = Path(__file__).parents[1] / "scenes" / "bodies"
_BAND_HZ = (76.5e9, 78e9, 79.5e9)
_SKIN = LayeredSurface(backing=6.45 - 8.71j)
_GLASS = LayeredSurface(backing=6.31 - 0.15j)
_RUBBER = LayeredSurface(backing=4 - 0.2j)
#: What each part of a body is made of: scenes/materials.toml at 79 GHz.
PARTS = {
    "car": {
        "car": PEC,
        "car_windows": _GLASS,
        "car_wheels": _RUBBER,
        "car_rims": PEC,
        "car_plate": PEC,
    },
    "person": {"person": _SKIN, "person_head": _SKIN},
}
#: Their middles at the height of the radar, in the frames of the files.
MIDDLE_M = {"car": (1.7, 0.0, 0.6), "person": (0.0, 0.0, 0.8)}


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from figures_at(0.05)


def figures_at(tolerance: float) -> Iterator[Figure]:
    """Mean, median and spread over aspect."""
    for name, distance in (("car", 10.0), ("person", 3.4)):
        found = over_aspect(body(name), np.arange(0.7, 360, 10.0), distance, _BAND_HZ, tolerance)
        for kind, sigma in (("band", found.mean(axis=0)), ("one frequency", found.ravel())):
            decibel = 10 * np.log10(sigma)
            place = f"{name} at {distance:g} m, {kind}"
            yield f"{place}: mean over aspect", float(10 * np.log10(sigma.mean())), "dBsm"
            yield f"{place}: median", float(np.median(decibel)), "dBsm"
            yield f"{place}: mean of dB", float(decibel.mean()), "dBsm"
            yield f"{place}: standard deviation", float(decibel.std()), "dB"


def body(name: str, folder: Path = _BODIES) -> MeshTarget:
    """A body of several parts as one target, about its middle."""
    vertices, faces, kinds, first = [], [], [], 0
    surfaces = tuple(dict.fromkeys(PARTS[name].values()))
    for part, surface in PARTS[name].items():
        mesh = trimesh.load(folder / f"{part}.ply", process=False)
        vertices.append(np.asarray(mesh.vertices, np.float64) - MIDDLE_M[name])
        faces.append(np.asarray(mesh.faces) + first)
        kinds.append(np.full(len(mesh.faces), surfaces.index(surface), np.uint32))
        first += len(mesh.vertices)
    return MeshTarget(
        Geometry(np.vstack(vertices), np.vstack(faces)), surfaces, np.concatenate(kinds)
    )


def over_aspect(
    target: MeshTarget,
    azimuth_deg: Array,
    distance_m: float,
    carriers_hz: tuple[float, ...],
    tolerance: float,
) -> Array:
    """Cross-section in m^2 for V, (carriers, aspects)."""
    quality = Quality(tolerance, max_bounces=6)
    aspects = Aspects.monostatic([Radar.at(a, 0.0, distance_m) for a in azimuth_deg], "V")
    return np.array(
        [
            4 * np.pi * np.abs(scattered(target, aspects, f, quality).amplitude[:, 0]) ** 2
            for f in carriers_hz
        ]
    )


if __name__ == "__main__":
    for name, value, unit in figures_at(float(sys.argv[1]) if len(sys.argv) > 1 else 0.05):
        print(f"{name}: {value:.1f} {unit}", flush=True)
