"""What the facets of a mesh send straight back: exact integrals over flat triangles.

The scene's own solver (`propagation.facets`) with one radar for each aspect: in the far field the
phase across a facet is linear, and a facet with nothing before it is one integral however large it
is. Where something may stand before it, or the phase is bent, it is divided until the echo of its
aspect is within the tolerance.
"""

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.engine import mitsuba_of_radar
from twin.radar.cross_section.aspects import Aspects
from twin.radar.cross_section.subject import Subject, are_within, bare, subject_of
from twin.radar.propagation.facets.adaptive_subdivision import subdivided_adaptively
from twin.radar.propagation.facets.currents import amplitude_of, echoes_of
from twin.radar.propagation.facets.error_budget import Budget, Leaves
from twin.radar.propagation.facets.front_facets import lit_facets
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.shadows import visible_samples
from twin.radar.propagation.facets.triangles import Triangles, incident_on
from twin.radar.propagation.one_way.beams import AntennaGain
from twin.radar.propagation.one_way.device_motion import MovingBodies, MovingImages
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.scattering.arrays import ComplexVector3, Index, Mask, Vector3
from twin.radar.scattering.kernel import turned
from twin.radar.scattering.surface import table
from twin.radar.scattering.target import MeshTarget
from twin.transfer import aligned

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Sizes of a mesh from which a wave counts as plane, from its middle on: its phase is off by
#: k D / 2e8 at the rim, and by as much from rounding.
_FAR = 5e7
_FAINT = 1e-3  # of the facets' echoes out of phase: what no error is counted below
_ALIKE = 0.25  # of the tolerance near by: what bent phases leave of a facet's parts is alike, not
# independent
_EDGE_ON = 1e-12  # sine of the angle below which a facet shows no side
_MOST_PAIRS = 2**17  # of facets, over all aspects: 20 MB
#: Images at an aspect: receivers of two polarisations, one of both, a transmitter of all, one each.
_ALL_HEARD, _ALL_SENT, _FIRST_SENT = 2, 3, 4
_GRAZING = 0.25881904510252074  # cosine of 75 deg


class _Isotropic(AntennaGain):
    """The same in all directions."""

    def log(self, direction: Any) -> Any:
        """None."""
        return self.mi.Float64(0)

    def most(self, direction: Any, half_width_rad: Any) -> Any:
        """One."""
        return self.mi.Float64(1)


@dataclass(frozen=True, eq=False)
class _Radars(TracingContext):
    """Three places to receive at for each aspect, and its transmitter: each an image of its own.

    ``antennas`` (9 n): unit vector from the mesh, and the polarisation, Re and Im.
    """

    antennas: Any = None

    def sent(self, source: Index, departure: Vector3) -> ComplexVector3:
        """The field of amplitude 1 in a direction."""
        here, re, im = (
            self.mi.Vector3d(
                *(
                    dr.gather(self.mi.Float64, self.antennas, 9 * source + 3 * k + i)
                    for i in range(3)
                )
            )
            for k in range(3)
        )
        return ComplexVector3(turned(re, here, departure), turned(im, here, departure))

    def both_ways(self, source: Index, receiver: Index) -> Mask:
        """Never: one place sends, others receive."""
        return self.mi.Bool(False)


def _radars(
    subject: Subject,
    target: MeshTarget,
    aspects: Aspects,
    receiver_m: Array,
    source_m: Array,
    wavelength_m: float,
    material_hz: float,
) -> _Radars:
    """Images at every aspect in a row.

    Two polarisations are sent at once along their diagonal and received at once by a circular
    antenna: neither mirrors nor corners that cross polarisation are missed.
    """
    mi, zero = mitsuba_of_radar(), np.zeros((len(aspects), 3))
    received, sent = aspects.received.swapaxes(0, 1), aspects.sent.swapaxes(0, 1)
    fields = [(field, zero) for field in received]
    fields += [(np.sqrt(0.5) * received[0], np.sqrt(0.5) * received[1])]
    fields += [(sent.sum(axis=0) / np.sqrt(len(sent)), zero)] + [(field, zero) for field in sent]
    here = [aspects.receiver] * _ALL_SENT + [aspects.source] * (1 + len(sent))
    antennas = [np.hstack([at, *field]) for at, field in zip(here, fields, strict=True)]
    at_m = [receiver_m] * _ALL_SENT + [source_m] * (1 + len(sent))
    places = [at - subject.anchor_m for at in at_m]
    count = len(here) * len(aspects)
    return _Radars(
        mi=mi,
        world=subject.world,
        order=0,
        n_sources=count,
        place=mi.Vector3d(0),  # of one antenna, as what follows
        boresight=mi.Vector3d(0),
        vertical=mi.Vector3d(0),
        patch_of_face=mi.UInt32(0),
        table=mi.Float64(aligned(table(target.surfaces, material_hz))),
        orders=mi.UInt32(aligned(np.zeros(count, dtype=np.uint32))),
        positions=mi.Float64(aligned(np.stack(places, axis=1))),
        motions=MovingImages(mi.Float64(aligned(np.zeros(3 * count)))),
        axes=mi.Float64(aligned(np.tile(np.eye(3), (count, 1)))),
        levels=mi.Float64(0),
        marks=mi.UInt32(0),
        windows=mi.Float64(0),
        wavelength=dr.opaque(mi.Float64, wavelength_m),
        walls=None,
        antennas=mi.Float64(aligned(np.stack(antennas, axis=1))),
    )


@dataclass(frozen=True, eq=False)
class Direct:
    """Straight back from the facets: ``amplitude`` (n, n_frequencies, m, 2) in metres, sent and
    received; ``grazing`` (n,) the share of the lit wavefront that meets its facet within 15 deg of
    grazing.
    """

    amplitude: Complex
    grazing: Array


def direct(
    target: MeshTarget,
    aspects: Aspects,
    frequency_hz: Array,
    tolerance: float,
    later: Complex,
    material_hz: float,
) -> Direct:
    """Scattered amplitudes of facets lit by the transmitter alone.

    Parameters
    ----------
    tolerance
        Of all that comes back at the highest frequency, ``later`` (n, m, 2) among it: after further
        bounces.
    material_hz
        The frequency at which surfaces reflect.
    """
    subject, (n, m) = subject_of(target), aspects.sent.shape[:2]
    center, radius = target.geometry.sphere
    is_far = aspects.distance_m > _FAR * 2 * radius
    distance = np.minimum(aspects.distance_m, _FAR * 2 * radius)
    middle = np.where(is_far[:, None], center, 0.0)
    source, receiver = (
        at * distance[:, None] + middle for at in (aspects.source, aspects.receiver)
    )
    # Of waves that are plane at the mesh, how much shorter their way is than by the origin.
    ahead = np.sum(middle * (aspects.source + aspects.receiver), axis=1)
    wave_numbers = 2 * np.pi * frequency_hz / speed_of_light
    k = float(wave_numbers.max())
    context = _radars(subject, target, aspects, receiver, source, 2 * np.pi / k, material_hz)
    scatterers = _scatterers(context, subject)
    aspect, face, side = _facing(subject, aspects, source, receiver)
    first = (_FIRST_SENT + m) * aspect
    amplitude = np.zeros((n, len(frequency_hz), m, 2), dtype=np.complex128)
    if not len(face):
        return Direct(amplitude, np.zeros(n))
    lit = lit_facets(context, scatterers, face, first + _ALL_SENT, first + _ALL_HEARD)
    lit = replace(lit, body=aspect)
    is_open = subject.is_open[(side < 0).astype(np.intp), face]
    if not is_open.all() and n * len(subject.world.faces) ** 2 <= _MOST_PAIRS:
        is_bare = bare(subject, source)[aspect, face]
        if not aspects.are_monostatic.all():
            is_bare &= bare(subject, receiver)[aspect, face]
        is_open |= is_bare
    # A wave of amplitude 1 at the origin, less the phase to it and back.
    both = later.sum(axis=1) / np.sqrt(m) @ np.array([1, 1j]) * np.sqrt(0.5)
    further = both * np.exp(-1j * (k * (2 * distance + ahead) % (2 * np.pi)))
    further = further / (2 * k * distance**2)
    if np.isfinite(aspects.distance_m).any():
        tolerance *= _ALIKE
    leaves, weight = _leaves(context, scatterers, lit, is_open, k, tolerance, further)
    for part in leaves:
        for row, other in enumerate(wave_numbers.tolist()):
            amplitude[:, row] += _answers(
                context, scatterers, part, other, other == k, distance, ahead, m
            )
    return Direct(amplitude, _grazing(subject, source, distance, aspect, face, weight))


def _answers(
    context: TracingContext,
    scatterers: Scatterers,
    leaves: Leaves,
    wave_number: float,
    is_divided_for: bool,
    distance_m: Array,
    ahead_m: Array,
    sent: int,
) -> Complex:
    """Amplitudes (n, m, 2) of triangles at a frequency, in metres."""
    body, n = leaves.body, len(distance_m)
    at = replace(context, wavelength=dr.opaque(context.mi.Float64, 2 * np.pi / wave_number))
    echoes = leaves.echoes if is_divided_for else echoes_of(at, scatterers, leaves.triangles)
    # A wave of amplitude 1 at the origin, less the phase to it and back.
    path = wave_number * (echoes.length_m - (2 * distance_m + ahead_m)[body]) % (2 * np.pi)
    wave = 2 * wave_number * distance_m[body] ** 2 * leaves.weight * echoes.mean
    wave = wave * np.exp(-1j * path)
    first = leaves.triangles.source - _ALL_SENT
    amplitude = np.empty((n, sent, 2), dtype=np.complex128)
    for number in range(sent):
        lit = leaves.triangles
        if sent > 1:
            lit = replace(lit, source=first + (_FIRST_SENT + number))
        for port in range(2):
            at_port = replace(lit, receiver=first + port)
            (re, im), _ = amplitude_of(at, scatterers, at_port, incident_on(at, at_port))
            echo = wave * (np.array(re) + 1j * np.array(im))
            amplitude[:, number, port] = np.bincount(body, echo.real, n)
            amplitude[:, number, port] += 1j * np.bincount(body, echo.imag, n)
    return amplitude


def _leaves(
    context: TracingContext,
    scatterers: Scatterers,
    lit: Triangles,
    is_open: NDArray[np.bool_],
    wave_number: float,
    tolerance: float,
    further: Complex,
) -> tuple[list[Leaves], Array]:
    """Triangles fine enough for the echo at every aspect, and whether facets seem seen, (n,)."""
    echoes, n = echoes_of(context, scatterers, lit), len(further)
    free, rest = np.flatnonzero(is_open), np.flatnonzero(~is_open)
    weight = np.ones(len(lit))
    if len(rest):
        some = lit.take(rest)
        weight[rest] = visible_samples(context, some, np.zeros(len(rest), dtype=bool))[3]
    out_of_phase = np.sqrt(np.bincount(lit.body, np.abs(echoes.total) ** 2, n)) + np.abs(further)
    floor = _FAINT * tolerance * out_of_phase
    wave_numbers = np.array([wave_number])
    first = Budget(n, tolerance, wave_numbers, floor, weakest=0.0)
    first.pending = further[:, None]
    first.estimate_levels([Leaves(lit, echoes, weight)])
    budget = Budget(n, tolerance, wave_numbers, floor, first, weakest=0.0)
    leaves: list[Leaves] = []
    for rows, others in ((free, rest), (rest, rest[:0])):
        if len(rows):
            hidden = echoes.take(others)
            echo = weight[others] * hidden.total
            budget.pending = further[:, None] + budget.summed(
                lit.body[others], echo, hidden.length_m
            )
            part = lit, echoes
            if len(rows) < len(lit):
                part = lit.take(rows), echoes.take(rows)
            leaves += subdivided_adaptively(
                context, scatterers, *part, budget, is_open=rows is free
            )
    return leaves, weight


def _facing(
    subject: Subject, aspects: Aspects, source_m: Array, receiver_m: Array
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Facets the same side of which transmitter and receiver see, closed meshes from outside: the
    aspect, the facet, and the side, 1 where its normal points to.
    """
    point, normal = subject.world.plane_table[:, :3], subject.world.plane_table[:, 3:]
    level = np.sum(point * normal, axis=1)
    counts = ~subject.shape.is_double & normal.any(axis=1)
    sides = []
    for at in (source_m, receiver_m):
        place = at - subject.anchor_m
        height = place @ normal.T - level
        edge_on = np.abs(height) < _EDGE_ON * np.linalg.norm(place, axis=1, keepdims=True)
        sides.append(np.where(edge_on, 0.0, np.sign(height)))
        if aspects.are_monostatic.all():
            break
    side = sides[0]
    lit = counts & (side != 0) & (side == sides[-1])
    inwards = subject.shape.outward * side < 0
    lit &= ~(inwards & ~are_within(subject, aspects)[:, None])
    aspect, face = np.nonzero(lit)
    return aspect, face, side[aspect, face]


def _scatterers(context: TracingContext, subject: Subject) -> Scatterers:
    count, kinds = len(subject.world.faces), len(subject.surface)
    zero, one = context.mi.Vector3d(0), context.mi.Float64(1)
    return Scatterers(
        body=np.zeros(count, dtype=np.intp),
        counts=~subject.shape.is_double,
        outward=subject.shape.outward[None],
        reachable=np.ones((1, count), dtype=bool),
        patch_area_m2=subject.shape.patch_area_m2[subject.shape.patch_of_face],
        antenna=_Isotropic(context.mi, (zero, zero, zero), None, one, one, one, 1),
        answers=context.mi.Bool(aligned(np.ones(kinds, dtype=bool))),
        surface=context.mi.UInt32(aligned(subject.surface)),
        motions=MovingBodies(context.mi.Float64(aligned(np.zeros(3 * kinds)))),
        parts=dr.arange(context.mi.UInt32, count),
        is_over_band=False,
    )


def _grazing(
    subject: Subject,
    source_m: Array,
    distance_m: Array,
    aspect: NDArray[np.intp],
    face: NDArray[np.intp],
    weight: Array,
) -> Array:
    corners = subject.world.vertices[subject.world.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    place = source_m - subject.anchor_m
    towards = place[aspect] - corners.mean(axis=1)[face]
    length = np.linalg.norm(towards, axis=1)
    normal = subject.world.plane_table[:, 3:]
    cosine = np.abs(np.sum(towards * normal[face], axis=1)) / length
    lit = weight * area[face] * cosine * (distance_m[aspect] / length) ** 2
    whole = np.bincount(aspect, lit, len(source_m))
    grazing = np.bincount(aspect, np.where(cosine < _GRAZING, lit, 0.0), len(source_m))
    share: Array = grazing / np.maximum(whole, 1e-300)
    return share
