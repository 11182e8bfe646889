"""Walls that the radar sees through: transmission of a path through dielectric slabs.

Rays go straight on. Phase, amplitude and spreading are those of the refracted path between the same
two points, by stationary phase (exact to second order in the sideways shift). Both interfaces
together transmit 1 - r^2 of the amplitude, r Fresnel's coefficient (Born and Wolf, Principles of
Optics, section 1.6). Each further round trip within the slab is a path of its own, weaker by r^2
and longer by 2 d q; so the model holds over the whole band, with the carrier's conductivity.
q = sqrt(eps - sin^2) is the normal component of the wave number in the slab over that in air.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.scene.mesh_scene import MeshScene
from twin.radar.scattering.arrays import ComplexVector3, Index, Mask, Real, Vector3
from twin.radar.scattering.kernel import coefficients_at, plane
from twin.radar.scattering.surface import TABLE_STEPS, LayeredSurface

Array = NDArray[np.float64]

#: One-way loss at normal incidence from which a wall is opaque: diffraction around it is stronger.
OPAQUE_DB = 40.0
_CROSSINGS = 4  # faces on a segment: two closed walls
_COLUMNS = 8
_CLEARANCE = 4e-6  # of the distance from the anchor: some 30 steps of float32


@dataclass(frozen=True, eq=False)
class Walls:
    """All walls as one mesh; of each its thickness (0: that of the mesh) and its `wall_table`."""

    mesh: MeshScene
    thickness: Real
    table: Real
    patch_of_face: Index


@dataclass(eq=False)
class SlabTransmission:
    """Transmission of a path through the walls that it crosses.

    ``extra``: electrical length beyond that in air, m; ``rho_re``, ``rho_im`` and ``lag``: ratio of
    successive internal reflections in the wall where they are strongest, and by how much each is
    longer, m; all 0 where no wall is crossed.
    """

    extra: Real
    rho_re: Real
    rho_im: Real
    lag: Real


def lets_through(permittivity: complex, thickness_m: float, wavelength_m: float) -> bool:
    """Whether a wall transmits enough for rays to be traced through it."""
    loss = -2 * np.pi / wavelength_m * thickness_m * float(np.sqrt(permittivity).imag)
    return bool(20 / np.log(10) * loss < OPAQUE_DB)


@lru_cache(maxsize=64)
def wall_table(permittivity: complex, carrier_hz: float) -> Array:
    """1 - r^2 (TE and TM), q, and the mean r^2, Re and Im each, over the cosine of incidence."""
    cosine = np.linspace(0, 1, TABLE_STEPS + 1)
    te, tm = LayeredSurface(backing=permittivity).reflection(cosine, carrier_hz)
    q = np.sqrt(permittivity - (1 - cosine**2) + 0j)
    q = np.where(q.imag > 0, -q, q)
    columns = (1 - te**2, 1 - tm**2, q, (te**2 + tm**2) / 2)
    return np.stack([part for c in columns for part in (c.real, c.imag)], axis=1)


def walls(
    mi: Any,
    mesh: MeshScene,
    slabs: Sequence[tuple[complex, float]],
    patch_of_face: NDArray[np.uint32],
    carrier_hz: float,
) -> Walls:
    """Walls on the device; ``slabs``: permittivity and thickness of each (see `Walls`)."""
    rows = [wall_table(permittivity, carrier_hz).ravel() for permittivity, _ in slabs]
    return Walls(
        mesh,
        mi.Float64(np.array([thickness for _, thickness in slabs])),
        mi.Float64(np.concatenate(rows)),
        mi.UInt32(patch_of_face),
    )


def no_slab(mi: Any) -> SlabTransmission:
    """A path in air."""
    return SlabTransmission(mi.Float64(0), mi.Float64(0), mi.Float64(0), mi.Float64(0))


def cross(
    mi: Any,
    through: Walls,
    transmission: SlabTransmission,
    field: ComplexVector3,
    begin: Vector3,
    direction: Vector3,
    segment: Real,
    length: Real,
    wavelength: Real,
    active: Mask,
) -> ComplexVector3:
    """Field behind a straight segment of a path of some length; ``transmission`` is updated."""
    k = 2 * dr.pi / wavelength
    at, rest = mi.Vector3d(begin), mi.Float64(segment)
    entry, entry_cosine, inside = mi.Float64(0), mi.Float64(1), mi.Bool(False)
    travelled = mi.Float64(0)
    at_end = _clearance(at + rest * direction)
    active = mi.Bool(active)
    for _ in range(_CROSSINGS):
        step = _clearance(at)
        start, reach = at + direction * step, mi.Float(rest - step - at_end)
        ray = mi.Ray3f(mi.Point3f(start), mi.Vector3f(direction), reach, 0.0, [])
        hit = through.mesh.scene.ray_intersect_preliminary(ray, active=active)
        active &= hit.is_valid()
        normal, distance = plane(mi, through.mesh, hit.prim_index, at, direction, active)
        at = dr.select(active, at + distance * direction, at)
        travelled = dr.select(active, travelled + distance, travelled)
        rest = dr.select(active, rest - distance, rest)
        number = dr.gather(mi.UInt32, through.mesh.object_index, hit.prim_index, active)
        sheet = dr.gather(mi.Float64, through.thickness, number, active)
        cosine = dr.select(inside, entry_cosine, -dr.dot(normal, direction))
        done = active & (inside | (sheet > 0))
        depth = dr.select(sheet > 0, sheet, (travelled - entry) * cosine)
        row = coefficients_at(mi, through.table, number, cosine, done, _COLUMNS)
        field = _through_slab(
            mi, transmission, field, direction, normal, cosine, depth, row, length, k, done
        )
        enters = active & ~done
        entry = dr.select(enters, travelled, entry)
        entry_cosine = dr.select(enters, cosine, entry_cosine)
        inside = enters
    return field


def _clearance(place: Vector3) -> Real:
    """How far from a surface at a place float32 rays start and end so as not to cross it."""
    return _CLEARANCE * (dr.norm(place) + 1e-3)


def _through_slab(
    mi: Any,
    transmission: SlabTransmission,
    field: ComplexVector3,
    direction: Vector3,
    normal: Vector3,
    cosine: Real,
    depth: Real,
    row: list[Real],
    length: Real,
    k: Real,
    done: Mask,
) -> ComplexVector3:
    te_re, te_im, tm_re, tm_im, q_re, q_im, r2_re, r2_im = row
    cosine = dr.maximum(cosine, 1e-3)
    sine2 = dr.maximum(1 - cosine * cosine, 0)
    # Spreading in the plane of incidence and across it, as distances.
    q_re = dr.maximum(q_re, 1e-6)
    within = length - depth / cosine + depth * cosine**2 * (q_re**2 + sine2) / q_re**3
    across = length - depth / cosine + depth / q_re
    shift = depth * dr.sqrt(sine2) * (1 - cosine / q_re)
    extra = depth * (q_re - cosine) + shift**2 / (2 * within)
    fade = dr.exp(k * depth * q_im)
    weight = fade * length / dr.sqrt(within * across)
    side = dr.cross(direction, normal)
    norm = dr.maximum(dr.squared_norm(side), 1e-30)
    part = field.parts(lambda f: side * (dr.dot(side, f) / norm))
    more_re, more_im = te_re - tm_re, te_im - tm_im
    beyond = ComplexVector3(
        weight * (tm_re * field.re - tm_im * field.im + more_re * part.re - more_im * part.im),
        weight * (tm_im * field.re + tm_re * field.im + more_im * part.re + more_re * part.im),
    )
    transmission.extra += dr.select(done, extra, 0)
    rho_re, rho_im = r2_re * fade * fade, r2_im * fade * fade
    strongest = done & (
        rho_re**2 + rho_im**2 > dr.square(transmission.rho_re) + dr.square(transmission.rho_im)
    )
    transmission.rho_re = dr.select(strongest, rho_re, transmission.rho_re)
    transmission.rho_im = dr.select(strongest, rho_im, transmission.rho_im)
    transmission.lag = dr.select(strongest, 2 * depth * q_re, transmission.lag)
    return beyond.where(done, field)
