"""Echoes of lit triangles: currents of physical optics, integrated over each triangle."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.triangles import (
    Incident,
    Triangles,
    incident_on,
)
from twin.radar.propagation.one_way.device_motion import turning
from twin.radar.propagation.one_way.motion import NEAREST_M
from twin.radar.propagation.one_way.path import (
    Axes,
    OneWayPath,
    TracingContext,
    along,
    mirrored_axes,
    one_way_path,
)
from twin.radar.propagation.scene.slabs import SlabTransmission
from twin.radar.scattering.arrays import Complex, ComplexVector3, Index, Real, Vector3
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.scattering.triangle import (
    Node,
    change_by_curvature,
    curvature,
    mean_bound,
    mean_over,
    node,
    relative_curvature,
    span,
)

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_MOST_CURVATURE = 0.5  # relative, up to which its first power is what it changes
#: Of its square: what higher powers change of the echo that a triangle may return. Of random
#: triangles 0.1 to 0.2 in the median, 0.5 for one in twenty.
_OF_SQUARE = 0.5
_OVER_BAND = 0.001  # likewise what `wideband` is off by over the band, of phases across it of 1 rad
#: Of a path's length, by which rounding alone may bend the phases across a triangle: twice what
#: 2000 directions show at most.
_ROUNDING = 4 * np.finfo(np.float64).eps
#: Of the phase that motion adds across a triangle by the end of a burst, or an element aside.
_TURNED = 0.7
_NARROW = 0.15  # size over distance, up to which the gain is bounded by that at the corners
_NEAREST = 0.05  # of the distance of the centroid
_MOST_AGAIN = 0.9  # ratio of successive round trips within a wall, at most


@dataclass(frozen=True, eq=False)
class Echoes:
    """Echoes of triangles at the carrier, on the host, each (n,).

    amplitude
        Echo if all currents were in phase and as strong as at the centroid, without antenna gain.
    mean
        Mean over the triangle of the antenna's gain times exp(j phase); the phase is relative to
        that of the path by the centroid.
    length_m, gain
        Length of the path by the centroid, and the antenna's two-way gain there, in amplitude.
    strength
        Upper bound of the echo of the triangle, or of any part of it, with the gain.
    curved
        Error by the curvature of phase and amplitude, with the gain.

    Both directions between two different images count as one echo.
    """

    amplitude: ComplexArray
    mean: ComplexArray
    length_m: Array
    gain: Array
    strength: Array
    curved: Array

    @property
    def total(self) -> ComplexArray:
        """Echo with the antenna's gain, without the phase of the path."""
        return self.amplitude * self.mean

    def take(self, which: Any) -> "Echoes":
        """Only some of them, by index or mask."""
        return Echoes(*(getattr(self, f.name)[which] for f in fields(Echoes)))

    @staticmethod
    def concatenate(parts: Sequence["Echoes"]) -> "Echoes":
        """One after the other."""
        names = [f.name for f in fields(Echoes)]
        return Echoes(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def plane_of(context: TracingContext, face: Index) -> tuple[Vector3, Vector3]:
    """A point of a facet's plane, and its normal."""
    point, normal = (
        context.mi.Vector3d(
            *(
                dr.gather(context.mi.Float64, context.world.planes, 6 * face + k + i)
                for i in range(3)
            )
        )
        for k in (0, 3)
    )
    return point, normal


def normal_of(context: TracingContext, face: Index, place: Vector3, towards: Vector3) -> Vector3:
    """A facet's normal on the side of a point."""
    _, normal = plane_of(context, face)
    return normal * dr.select(dr.dot(normal, towards - place) < 0, -1.0, 1.0)


def reflection(
    context: TracingContext, scatterers: Scatterers, lit: Triangles, wave: Incident
) -> tuple[Vector3, Vector3, Vector3, ComplexVector3]:
    """At the centroid: direction of the incident wave, normal on its side, direction and field of
    the reflected wave.
    """
    direction = dr.normalize(lit.center - wave.origin)
    normal = normal_of(context, lit.face, lit.center, wave.origin)
    away, reflected_field = _mirrored(context, scatterers, lit, direction, normal, wave.field)
    return direction, normal, away, reflected_field


def _mirrored(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    direction: Vector3,
    normal: Vector3,
    field: ComplexVector3,
) -> tuple[Vector3, ComplexVector3]:
    """Direction and field of the wave that facets reflect."""
    cosine = -dr.dot(normal, direction)
    number = dr.gather(context.mi.UInt32, context.world.object_index, lit.face)
    surface = dr.gather(context.mi.UInt32, scatterers.surface, number)
    row = coefficients_at(context.mi, context.table, surface, cosine, context.mi.Bool(True))
    return direction + 2 * cosine * normal, reflected(field, direction, normal, row)


def amplitude_of(
    context: TracingContext, scatterers: Scatterers, lit: Triangles, wave: Incident
) -> tuple[Complex, OneWayPath]:
    """Echo with all currents in phase, without the antenna's gain, and the return path.

    If a directly lit triangle has another image as receiver than as source, both directions of the
    path are added. Physical optics is not reciprocal: each direction has its own currents.
    """
    place = lit.center
    normal = normal_of(context, lit.face, place, wave.origin)
    return_path = one_way_path(
        context, lit.receiver, place, normal * 0, context.mi.Bool(True), tested=False
    )
    there = dr.normalize(place - wave.origin), wave.field
    back = -return_path.back, return_path.field
    re, im = _induced(context, scatterers, lit, normal, there, back)
    if lit.waves is None:
        more = _induced(context, scatterers, lit, normal, back, there)
        both = context.both_ways(lit.source, lit.receiver)
        re, im = re + dr.select(both, more[0], 0), im + dr.select(both, more[1], 0)
    a, b, c = lit.corners
    area = dr.norm(dr.cross(b - a, c - a)) / 2
    # a = -j / (8 pi) times the sum.
    scale = area / (8 * dr.pi * dr.norm(place - wave.origin) * return_path.length)
    return (scale * im, -scale * re), return_path


def _induced(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    normal: Vector3,
    wave: tuple[Vector3, ComplexVector3],
    received: tuple[Vector3, ComplexVector3],
) -> Complex:
    """Amplitude that the currents of one incident wave radiate to the source of another, with that
    one's polarisation; each wave is given by its direction and field.
    """
    direction, field = wave
    towards, polarization = received
    away, reflected_field = _mirrored(context, scatterers, lit, direction, normal, field)
    return polarization.dot(radiating(field, reflected_field, direction, away, normal, -towards))


def level_at(
    scatterers: Scatterers, wave: Incident, point: Vector3, receiver: Vector3, axes: Axes
) -> tuple[Real, Real, Real]:
    """At points of triangles: logarithms of the antenna's two-way gain and of spreading times
    obliquity, and the length of the path without walls.

    The cosines at a plane are its distance over the lengths of the paths, so spreading times
    obliquity goes as the -3/2 power of these.
    """
    from_source, from_receiver = point - wave.origin, point - receiver
    there, again = (
        dr.maximum(dr.norm(segment), NEAREST_M) for segment in (from_source, from_receiver)
    )
    gain = scatterers.antenna.log(along(from_source / there, wave.axes))
    gain += scatterers.antenna.log(along(from_receiver / again, axes))
    return gain, -1.5 * dr.log(there * again), there + again


def echoes_of(context: TracingContext, scatterers: Scatterers, lit: Triangles) -> Echoes:
    """Echo of each triangle if all of it is visible."""
    wave = incident_on(context, lit)
    (re, im), return_path = amplitude_of(context, scatterers, lit, wave)
    a, b, c = lit.corners
    receiver = lit.center + return_path.back * return_path.length
    axes = mirrored_axes(context, lit.receiver)
    k = 2 * dr.pi / context.wavelength
    gain, spread, length = level_at(scatterers, wave, lit.center, receiver, axes)
    nodes = []
    for point in (a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2):
        more, less, path = level_at(scatterers, wave, point, receiver, axes)
        nodes.append(node(k * (length - path), more + less - spread))
    linear, change = mean_over(nodes[:3]), change_by_curvature(nodes)
    corners = [value.phase for value in nodes[:3]]
    phase_curvature = curvature([value.phase for value in nodes])
    level = dr.sqrt(dr.square(re) + dr.square(im))
    most = level * _most(scatterers, lit, wave, receiver, axes, [value.log for value in nodes])
    strength = most * mean_bound(corners, phase_curvature)
    relative = relative_curvature(nodes)
    # No division lessens what is rounding.
    beyond = dr.maximum(_beyond_square(nodes, gain) - _ROUNDING * k * length, 0)
    curved = _OF_SQUARE * dr.square(relative) + beyond
    if scatterers.is_over_band:
        curved += _OVER_BAND * dr.minimum(dr.square(span(corners)), 1)
    curved *= strength
    # Where the curvature is large, its first power says nothing.
    is_flat = relative < _MOST_CURVATURE
    curved = dr.select(is_flat, dr.minimum(curved, strength), strength)
    if scatterers.half_time_s or scatterers.reach_m:
        turned_m = context.mi.Float64(0)
        if scatterers.half_time_s:
            turning_m_per_s = _turning(context, scatterers, lit, wave, return_path)
            turned_m += scatterers.half_time_s * turning_m_per_s
        if scatterers.reach_m:
            turned_m += scatterers.reach_m * _turned_by_elements(lit, wave, return_path)
        curved += strength * dr.minimum(_TURNED * k * turned_m * strength / most, 1)
    if context.walls is not None:  # internal reflections of walls repeat the echo
        again = 1 + _again(wave.transmission) + _again(return_path.transmission)
        strength, curved = strength * again, curved * again
    mean = [
        straight + dr.select(is_flat, more, 0)
        for straight, more in zip(linear, change, strict=True)
    ]
    values = (re, im, *mean, length, dr.exp(gain), strength, curved)
    dr.eval(values)
    columns = [np.broadcast_to(np.array(value), len(lit)) for value in values]
    return Echoes(columns[0] + 1j * columns[1], columns[2] + 1j * columns[3], *columns[4:])


def _beyond_square(nodes: Sequence[Node], log: Real) -> Real:
    """How far a wave at the centroid, of this logarithm and of phase 0, is from what a square
    through the nodes gives there.
    """
    phase = (4 * sum(n.phase for n in nodes[3:]) - sum(n.phase for n in nodes[:3])) / 9
    off = log - (4 * sum(n.log for n in nodes[3:]) - sum(n.log for n in nodes[:3])) / 9
    distance: Real = dr.sqrt(dr.square(off) + dr.square(phase))
    return distance


def _again(transmission: SlabTransmission) -> Real:
    """Sum of all round trips within a wall, in phase, over the first transmission, in amplitude."""
    share = dr.sqrt(dr.square(transmission.rho_re) + dr.square(transmission.rho_im))
    return dr.minimum(share, _MOST_AGAIN) / (1 - dr.minimum(share, _MOST_AGAIN))


def _turned_by_elements(lit: Triangles, wave: Incident, return_path: OneWayPath) -> Real:
    """Change of the difference of path length between two corners, over how far aside an element
    is.
    """
    nearest = dr.minimum(dr.norm(lit.center - wave.origin), return_path.length)
    return dr.sqrt(_longest2(lit)) / dr.maximum(nearest, NEAREST_M)


def _longest2(lit: Triangles) -> Real:
    """Squares of the longest edges."""
    a, b, c = lit.corners
    return dr.maximum(
        dr.squared_norm(b - a), dr.maximum(dr.squared_norm(c - b), dr.squared_norm(a - c))
    )


def _turning(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    wave: Incident,
    return_path: OneWayPath,
) -> Real:
    """Largest rate at which the difference of path length between two corners grows, m/s."""
    number = dr.gather(context.mi.UInt32, context.world.object_index, lit.face)
    own = scatterers.motions.at(context.mi, number, lit.center)
    incident = lit.center - wave.origin
    length, size = dr.norm(incident), _longest2(lit)
    there = turning(own.velocity - wave.motion.velocity, incident / length, length)
    again = turning(
        own.velocity - return_path.motion.velocity, -return_path.back, return_path.length
    )
    if own.spin is None:
        return dr.sqrt(size) * (dr.norm(there) + dr.norm(again))
    # The triangle turns, too: of the change of the gradient what lies in its plane counts.
    change = there + again - dr.cross(own.spin, incident / length - return_path.back)
    _, normal = plane_of(context, lit.face)
    return dr.sqrt(size) * dr.norm(change - dr.dot(change, normal) * normal)


def _most(
    scatterers: Scatterers,
    lit: Triangles,
    wave: Incident,
    receiver: Vector3,
    axes: Axes,
    logs: Sequence[Real],
) -> Real:
    """Bound over triangles of the antenna's gain times spreading, relative to the latter at
    centroids.
    """
    place = lit.center
    a, b, c = (dr.squared_norm(point - place) for point in lit.corners)
    size = dr.sqrt(dr.maximum(a, dr.maximum(b, c)))
    most: Real = type(size)(1)
    widest: Real = type(size)(0)
    for begin, shown in ((wave.origin, wave.axes), (receiver, axes)):
        segment = place - begin
        length = dr.norm(segment)
        ratio = size / length
        cone = dr.select(ratio < 1, dr.safe_asin(ratio), dr.pi)
        most *= scatterers.antenna.most(along(segment / length, shown), cone)
        nearer = 1 / dr.maximum(1 - ratio, _NEAREST)
        most *= nearer * dr.sqrt(nearer)
        widest = dr.maximum(widest, ratio)
    pairs: list[Real] = [dr.maximum(logs[i], logs[i + 1]) for i in (0, 2, 4)]
    highest: Real = dr.maximum(pairs[0], pairs[1])
    highest = dr.maximum(highest, pairs[2])
    return dr.select(widest < _NARROW, dr.exp(highest), most)
