"""Echoes of bodies by diffracted paths around obstacles: a pedestrian behind a parked car.

Echoes whose forward and return paths are both direct are found elsewhere
(`twin.radar.propagation.physical_optics`). Here at least one of the two is diffracted over the
edges of obstacles. A body's facets, small against the changes of the incident field, carry the
currents of physical optics and reflect once. Left out are diffracted paths over mirrors. Each
triangle has one delay: at oblique incidence, where it is 2 cm deep, its phase is off by up to 0.8
rad at the ends of a band of 4 GHz. A triangle crossed by a shadow's border is lit or not as its
centroid is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.around_edges import (
    Screens,
    all_paths_to_points,
    is_near_edges,
)
from twin.radar.propagation.diffraction.rims import is_strong, matching_pairs
from twin.radar.propagation.one_way.path import offset_m
from twin.radar.propagation.one_way.points import PointPaths, between
from twin.radar.scattering.arrays import ComplexVector3
from twin.radar.scattering.kernel import coefficients_at, radiating, reflected
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

_FINE_M = 0.02  # edges of triangles, at most
_FLAT_RAD = 2e-2  # phase across a triangle, below which its square is enough


@dataclass(frozen=True, eq=False)
class _Facets:
    """Triangles (n, 3, 3) of a body relative to the anchor and their objects' numbers (n,)."""

    corners: Array
    object: Indices

    @property
    def middle(self) -> Array:
        """Centroids (n, 3)."""
        middle: Array = self.corners.mean(axis=1)
        return middle

    @property
    def across(self) -> Array:
        """Normals (n, 3) as long as the area."""
        a, b, c = self.corners.swapaxes(0, 1)
        across: Array = np.cross(b - a, c - a) / 2
        return across

    def phase(self, slope: Array) -> Array:
        """Phase at the corners (n, 3), less that at the centroid, for a gradient (n, 3) in
        rad/m.
        """
        phase: Array = np.einsum("nci,ni->nc", self.corners - self.middle[:, None], slope)
        return phase

    def take(self, which: Any) -> "_Facets":
        """Only some of them, by index."""
        return _Facets(self.corners[which], self.object[which])


def echoes_behind(
    obstacles: Screens, surface_of_object: NDArray[np.uint32], most: int
) -> Contributions:
    """Contributions of bodies by diffracted paths, without gains, from ``most`` facets in all:
    those that would be brightest without obstacles.
    """
    image, bodies = obstacles.prepared.images[0], []
    for body in np.unique(obstacles.body[obstacles.body >= 0]):
        members = np.flatnonzero(obstacles.body == body)
        items = [obstacles.items[i] for i in members]
        corners = [item.vertices_m[item.geometry.faces] for item in items]
        low, high = (
            side([side(c, axis=(0, 1)) for c in corners], axis=0) for side in (np.min, np.max)
        )
        place, radius = (
            (low + high) / 2 - obstacles.prepared.anchor_m,
            np.linalg.norm(high - low) / 2,
        )
        if is_near_edges(obstacles, image, place, float(radius), int(body)):
            bodies.append((int(body), members))
    contributions = []
    for body, members in bodies:
        facets = _facets(obstacles, members)
        bright = np.argsort(-_brightness(obstacles, facets), kind="stable")
        some = np.sort(bright[: max(most // len(bodies), 1)])
        contributions.append(_answers(obstacles, facets.take(some), body, surface_of_object))
    return Contributions.concatenate(contributions)


def _brightness(obstacles: Screens, facets: _Facets) -> Array:
    """Echo amplitude of facets (n,) without obstacles, as of a conductor at normal incidence."""
    towards = obstacles.prepared.images[0].place - facets.middle
    length = np.linalg.norm(towards, axis=1, keepdims=True)
    slope = 4 * np.pi / obstacles.prepared.wavelength_m * towards / length
    echo = np.sum(facets.across * slope, axis=1) / length[:, 0] ** 2
    bright: Array = np.abs(echo * _mean(facets.phase(slope)))
    return bright


def _facets(obstacles: Screens, members: Indices) -> _Facets:
    """All triangles of a body, divided until they are fine."""
    from trimesh.remesh import subdivide_to_size

    corners, number = [], []
    for i in members:
        item = obstacles.items[i]
        vertices, faces = subdivide_to_size(
            item.vertices_m, item.geometry.faces, _FINE_M, max_iter=16
        )
        corners.append(vertices[faces] - obstacles.prepared.anchor_m)
        number.append(np.full(len(faces), i))
    facets = _Facets(np.concatenate(corners), np.concatenate(number))
    return facets.take(np.flatnonzero((facets.across != 0).any(axis=1)))


def _answers(
    obstacles: Screens, facets: _Facets, body: int, surface_of_object: NDArray[np.uint32]
) -> Contributions:
    """Contributions of facets whose forward path, return path or both are diffracted."""
    middle, across = facets.middle, facets.across
    side = np.sign(np.sum((obstacles.prepared.images[0].place - middle) * across, axis=1))
    normal = side[:, None] * across / np.linalg.norm(across, axis=1, keepdims=True)
    off = offset_m(middle) * normal
    own = np.full(len(middle), body)
    paths, at = all_paths_to_points(obstacles.prepared.context, obstacles, 0, middle, off, own)
    faces = np.sum(paths.back * normal[at], axis=1) > 0
    paths, at = paths.take(faces), at[faces]
    there, back = matching_pairs(at, at)
    # All of a body's facets against the brightest one.
    strong = is_strong(paths.level[there] * paths.level[back], 0 * there, obstacles.faintest)
    strong &= (paths.over[there] >= 0) | (paths.over[back] >= 0)
    forward_path, return_path, rows = (
        paths.take(there[strong]),
        paths.take(back[strong]),
        at[there[strong]],
    )
    if not len(rows):
        return Contributions.none()
    objects = facets.object[rows]
    motion = obstacles.prepared.motions.at(objects, middle[rows])
    amplitude = _radiated(
        obstacles, facets.take(rows), forward_path, return_path, surface_of_object
    )
    return between(forward_path, return_path, amplitude, motion, objects)


def _radiated(
    obstacles: Screens,
    facets: _Facets,
    forward_path: PointPaths,
    return_path: PointPaths,
    surface_of_object: NDArray[np.uint32],
) -> Complex:
    """Amplitude of each facet without spreading: of its currents, times the mean of their
    phasors.
    """
    context, n = obstacles.prepared.context, len(facets.object)
    mi = context.mi
    across = facets.across
    area = np.linalg.norm(across, axis=1)
    facing = (
        np.sign(np.sum(across * forward_path.back, axis=1, keepdims=True)) * across / area[:, None]
    )
    travel, normal, back = (
        vector(mi, v, "Vector3d") for v in (-forward_path.back, facing, return_path.back)
    )
    cosine = -(travel.x * normal.x + travel.y * normal.y + travel.z * normal.z)
    surface = mi.UInt32(aligned(surface_of_object[facets.object].astype(np.uint32)))
    row = coefficients_at(mi, context.table, surface, cosine, mi.Bool(True))
    parts = (forward_path.field.real, forward_path.field.imag)
    field = ComplexVector3(*(vector(mi, np.ascontiguousarray(v), "Vector3d") for v in parts))
    off = travel + 2 * cosine * normal
    current = radiating(field, reflected(field, travel, normal, row), travel, off, normal, back)
    current_re, current_im = host([current.re, current.im], n)
    received = np.sum(return_path.field * (current_re + 1j * current_im), axis=1)
    slope = 2 * np.pi / obstacles.prepared.wavelength_m * (forward_path.back + return_path.back)
    amplitude: Complex = -1j / (8 * np.pi) * area * received * _mean(facets.phase(slope))
    return amplitude


def _mean(phase: Array) -> Complex:
    """Mean of exp(j phase) over triangles, the phase linear and at the corners (n, 3) of sum 0."""
    a, b, c = np.sort(phase, axis=1).T

    def along(x: Array, y: Array) -> Complex:
        value: Complex = np.exp(0.5j * (x + y)) * np.sinc((y - x) / (2 * np.pi))
        return value

    span = np.where(c - a > _FLAT_RAD, c - a, 1.0)
    mean: Complex = 2 * (along(b, c) - along(a, b)) / (1j * span)
    return np.where(c - a > _FLAT_RAD, mean, 1 - np.sum(phase**2, axis=1) / 24)
