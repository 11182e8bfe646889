"""What a lit triangle sends back: the currents of physical optics, integrated exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.legs import Leg, Station, leg
from twin.radar.propagation.scatterers import Scatterers
from twin.radar.propagation.triangles import Triangles
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.scattering.triangle import bend, largest, mean_over, phasor

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Corners of the four equal parts of a triangle, by its corners 0 to 2 and the middles 3 to 5 of
#: its edges.
_BENT_RAD = 0.5  # up to which the error of a linear phase can be extrapolated
_QUARTERS = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))


@dataclass(frozen=True, eq=False)
class Echoes:
    """Echoes of triangles at the carrier, on the host, each (n,), without the antenna's gain.

    ``amplitude``: of all currents in phase; ``mean``: of exp(j phase) over the triangle, the phase
    counted from ``length_m``, the path by the centroid; ``linear``: the same for a phase that is
    linear between the corners. With the gain: ``strength``, a bound of what it or any part of it
    returns, and ``curved``, what the curvature of the phase may still change.
    """

    amplitude: Complex
    mean: Complex
    linear: Complex
    length_m: Array
    gain: Array
    strength: Array
    curved: Array

    @property
    def total(self) -> Complex:
        """With the antenna's gain, less the phase of the path."""
        return self.gain * self.amplitude * self.mean

    def chosen(self, which: Any) -> "Echoes":
        """Only some of them, by index or mask."""
        return Echoes(*(getattr(self, f.name)[which] for f in fields(Echoes)))

    @staticmethod
    def joined(parts: Sequence["Echoes"]) -> "Echoes":
        """One after the other."""
        names = [f.name for f in fields(Echoes)]
        return Echoes(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def normal_of(s: Station, face: Any, place: Any, towards: Any) -> Any:
    """A facet's normal on the side of a point."""
    normal = s.mi.Vector3d(
        *(dr.gather(s.mi.Float64, s.world.planes, 6 * face + i) for i in (3, 4, 5))
    )
    return normal * dr.select(dr.dot(normal, towards - place) < 0, -1.0, 1.0)


def reflection(
    s: Station, scatterers: Scatterers, lit: Triangles
) -> tuple[Any, Any, Any, Any, Any]:
    """At the centroid: direction of the wave, the normal against it, direction and field (Re, Im)
    of the reflected wave.
    """
    place, wave = lit.center, lit.incident
    direction = dr.normalize(place - wave.origin)
    normal = normal_of(s, lit.face, place, wave.origin)
    cosine = -dr.dot(normal, direction)
    number = dr.gather(s.mi.UInt32, s.world.object_index, lit.face)
    surface = dr.gather(s.mi.UInt32, scatterers.surface, number)
    row = coefficients_at(s.mi, s.table, surface, cosine, s.mi.Bool(True))
    out, out_im = reflected(wave.field, wave.field_im, direction, normal, row)
    return direction, normal, direction + 2 * cosine * normal, out, out_im


def amplitude_of(s: Station, scatterers: Scatterers, lit: Triangles) -> tuple[Any, Any, Leg]:
    """Echo of all currents in phase (Re, Im), without the antenna's gain, and the leg home."""
    wave, place = lit.incident, lit.center
    direction, normal, away, out, out_im = reflection(s, scatterers, lit)
    home = leg(s, lit.receiver, place, normal * 0, s.mi.Bool(True), tested=False)
    way = (direction, away, normal, home.back)
    current = radiating(wave.field, out, *way)
    current_im = radiating(wave.field_im, out_im, *way)
    re = dr.dot(home.field, current) - dr.dot(home.field_im, current_im)
    im = dr.dot(home.field, current_im) + dr.dot(home.field_im, current)
    a, b, c = lit.corners
    area = dr.norm(dr.cross(b - a, c - a)) / 2
    # a = -j / (8 pi) times the sum.
    scale = area / (8 * dr.pi * dr.norm(place - wave.origin) * home.length)
    return scale * im, -scale * re, home


def path_by(lit: Triangles, point: Any, receiver: Any) -> Any:
    """Length of the way from the source to a point of the triangle and to a place, walls apart."""
    return dr.norm(point - lit.incident.origin) + dr.norm(point - receiver)


def echoes_of(s: Station, scatterers: Scatterers, lit: Triangles) -> Echoes:
    """What each triangle returns if all of it is seen."""
    re, im, home = amplitude_of(s, scatterers, lit)
    a, b, c = lit.corners
    receiver = lit.center + home.back * home.length
    length = path_by(lit, lit.center, receiver)
    k = 2 * dr.pi / s.wavelength
    points = (a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2)
    phases = [k * (length - path_by(lit, point, receiver)) for point in points]
    phasors = [phasor(phase) for phase in phases]
    linear = mean_over(phases[:3], phasors[:3])
    parts = [mean_over([phases[i] for i in q], [phasors[i] for i in q]) for q in _QUARTERS]
    finer = [sum(part[i] for part in parts) / 4 for i in (0, 1)]
    change = [(fine - coarse) / 3 for fine, coarse in zip(finer, linear, strict=True)]
    level = lit.gain * dr.sqrt(dr.square(re) + dr.square(im))
    bent = bend(phases)
    strength = level * largest(phases[:3], bent)
    curved = level * dr.sqrt(dr.square(change[0]) + dr.square(change[1]))
    curved = dr.select(bent < _BENT_RAD, curved, strength)  # else two sizes of parts tell nothing
    mean = [fine + more for fine, more in zip(finer, change, strict=True)]
    values = (re, im, *mean, *linear, length, lit.gain, strength, curved)
    dr.eval(values)
    re, im, mean_re, mean_im, linear_re, linear_im, *rest = (
        np.broadcast_to(np.array(value), len(lit)) for value in values
    )
    return Echoes(re + 1j * im, mean_re + 1j * mean_im, linear_re + 1j * linear_im, *rest)
