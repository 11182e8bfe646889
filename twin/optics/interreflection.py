"""A bound of indirect light: what surfaces can pass on to each other, by spheres around them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry
from twin.geometry.faces import normals
from twin.optics.devices import Device
from twin.optics.paths import DeviceLight, Light

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Meshes of more faces, or more meshes, are taken to face each other: finding out takes too long.
_MOST_FACES, _MOST_BODIES, _MOST_PRODUCTS = 2000, 300, 2**20
#: Of a body's size: a vertex nearer to a plane lies in it.
_FLAT = 1e-6
#: After so many bounces the rest is bounded by a geometric series.
_BOUNCES = 30


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh as light meets it: where its vertices are, (n, 3), relative to the rig as the scene,
    and its largest reflectance.
    """

    geometry: Geometry
    vertices_m: Array
    reflectance: float

    @cached_property
    def solid(self) -> "_Solid":
        """What the bound needs of it."""
        return _Solid.of(self)


def indirect_bound(bodies: Sequence[Body], start: Device, light: Light) -> float:
    """Largest light of all bounces from the second surface on, per unit weight of the paths of a
    cell (`Tracer.all_indirect`), without scattering by the air; 0 where no surface that paths meet
    first faces another one, infinite where no bound is known.

    Of light that leaves a point diffusely, at most (R / d)^2 meets a body that lies in a sphere of
    radius R at the distance d; and all bodies together at most all of it. A surface that is met
    first sends it to the side from which paths come, and the last one must be lit from the side
    from which it is met. At a surface q the light's irradiance is at most that of a surface facing
    it, as near as the body's box.
    """
    bodies = [body for body in bodies if len(body.geometry)]
    reflectance = np.array([body.reflectance for body in bodies])
    if not bodies:
        return 0.0
    if len(bodies) > _MOST_BODIES or reflectance.max() >= 1:
        return math.inf
    parts = [body.solid for body in bodies]
    from_start = _facing_device(parts, start)
    if isinstance(light, DeviceLight):
        to_light = _facing_device(parts, light.device)
    else:
        to_light = _facing(parts, light.direction, at_infinity=True)
    ends = reflectance * np.array([_irradiance(part, light) for part in parts]) / np.pi
    if not np.isfinite(ends).all():
        return math.inf
    share = _form_factors(parts, start.origin_m)
    # Of light leaving each body: what the next surface sends to the light, and all further ones.
    last = _passed_on(np.where(to_light.T, share, 0.0), ends)
    beyond = np.zeros(len(bodies))
    for _ in range(_BOUNCES):
        beyond = _passed_on(share, reflectance * (last + beyond))
    rest = reflectance.max() ** _BOUNCES / (1 - reflectance.max()) * float(ends.max())
    first = np.where(from_start, share, 0.0)
    once = _passed_on(np.where(to_light.T, first, 0.0), ends)
    total = once + _passed_on(first, reflectance * (last + beyond) + rest)
    return float((reflectance * total).max())


def _passed_on(share: Array, values: Array) -> Array:
    """Of light from each body, sum over the bodies that it may meet of a value per light there:
    shares are at most 1 each and together.
    """
    largest = np.where(share > 0, values, 0.0).max(axis=1)
    return np.minimum(share @ values, largest)


@dataclass(frozen=True, eq=False)
class _Solid:
    """Vertices of a body, the sphere and the box (2, 3) around them; normals (m, 3) and a corner
    (m, 3) of its faces, none of a large mesh; ``outward``: of a closed convex body whether normals
    look out of it, 1, or into it, -1, else None.
    """

    vertices: Array
    center: Array
    radius: float
    box: Array
    normals: Array
    corners: Array
    outward: NDArray[np.int8] | None

    @classmethod
    def of(cls, body: Body) -> "_Solid":
        geometry, vertices = body.geometry, body.vertices_m
        box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        center = box.mean(axis=0)
        radius = float(np.linalg.norm(vertices - center, axis=1).max())
        if len(geometry) > _MOST_FACES:
            return cls(vertices, center, radius, box, np.zeros((0, 3)), np.zeros((0, 3)), None)
        outward = geometry.shape.outward if geometry.shape.is_convex else None
        turned = normals(vertices, geometry.faces)
        return cls(vertices, center, radius, box, turned, vertices[geometry.faces[:, 0]], outward)

    @property
    def is_flat(self) -> bool:
        """Whether all of it lies in one plane."""
        if not len(self.normals):
            return False
        normal = self.normals[np.abs(self.normals).sum(axis=1).argmax()]
        return bool(np.abs((self.vertices - self.center) @ normal).max() <= _FLAT * self.radius)

    def sides(self, place: Array, at_infinity: bool) -> Array:
        """Distance of a point from the planes of the faces, along their normals, (m,); of a
        direction, the cosine.
        """
        beyond = place if at_infinity else place - self.corners
        return np.asarray((self.normals * beyond).sum(axis=1))

    def holds(self, place: Array) -> bool:
        """Whether a point is inside a closed convex body."""
        return self.outward is not None and bool(
            (self.outward * self.sides(place, False) < 0).all()
        )


def _facing_device(parts: Sequence[_Solid], device: Device) -> Flags:
    """`_facing` from all points of a device: any, where it is more than a point."""
    if device.pupil_radius_m or device.pitch_m is not None:
        return np.ones((len(parts), len(parts)), dtype=bool)
    return _facing(parts, device.origin_m, at_infinity=False)


def _facing(parts: Sequence[_Solid], place: Array, at_infinity: bool) -> Flags:
    """Whether something of one body (row) may be before a face of another or the same one (column)
    on the side on which a point, or a direction, is.
    """
    centers, radii = np.array([p.center for p in parts]), np.array([p.radius for p in parts])
    halves = np.array([p.box[1] - p.center for p in parts])
    found, products = np.ones((len(parts), len(parts)), dtype=bool), 0
    for number, (row, part) in enumerate(zip(found, parts, strict=True)):
        if not len(part.normals):
            continue
        side = part.sides(place, at_infinity)
        towards = np.where(side < 0, -1.0, 1.0)
        is_met = np.ones(len(side), dtype=bool)
        if part.outward is not None and (at_infinity or not part.holds(place)):
            is_met = part.outward * side > 0
            row[number] = False
        normal = (towards[:, None] * part.normals)[is_met]
        offset = np.einsum("ij,ij->i", normal, part.corners[is_met])
        reach = normal @ centers.T - offset[:, None]
        reach += np.minimum(radii, np.abs(normal) @ halves.T)
        row &= (reach > _FLAT * (radii + part.radius)).any(axis=0)
        for column in np.flatnonzero(row).tolist():
            other = parts[column]
            products += len(normal) * len(other.vertices)
            if products <= _MOST_PRODUCTS:
                beyond = (other.vertices @ normal.T - offset).max(initial=0.0)
                row[column] = beyond > _FLAT * (part.radius + other.radius)
    return found


def _form_factors(parts: Sequence[_Solid], start: Array) -> Array:
    """Largest share of the light leaving a point of each body (row) that meets each one (column):
    (R / d)^2 of the sphere around it. No body that is flat, or closed, convex and met from outside,
    meets itself.
    """
    centers, radii = np.array([p.center for p in parts]), np.array([p.radius for p in parts])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1) - radii[:, None]
    share = np.where(apart > radii, (radii / np.maximum(apart, 1e-30)) ** 2, 1.0)
    meets_itself = [
        not (part.is_flat or (part.outward is not None and not part.holds(start))) for part in parts
    ]
    np.fill_diagonal(share, meets_itself)
    return share


def _irradiance(part: _Solid, light: Light) -> float:
    """The largest that a light has on a body."""
    if not isinstance(light, DeviceLight):
        return 1.0
    device = light.device
    low, high = part.box - device.origin_m
    if not _in_sight(part, device):
        return 0.0
    nearest = np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)) - device.pupil_radius_m
    if nearest <= 0:
        return math.inf
    return max(device.edge_illumination, 1.0) ** 2 / float(nearest) ** 2


def _in_sight(part: _Solid, device: Device) -> bool:
    """Whether the sphere around a body may reach into a device's field, or before it if blurred."""
    middle = part.center - device.origin_m
    distance, ahead = float(np.linalg.norm(middle)), float(middle @ device.axes[0])
    if ahead + part.radius <= 0:
        return False
    if device.blur_tan or device.pupil_radius_m or device.pitch_m or distance <= part.radius:
        return True
    corner = math.sqrt(2) if device.outline == "square" else 1.0
    angle = math.acos(min(max(ahead / distance, -1.0), 1.0)) - math.asin(part.radius / distance)
    return angle <= math.atan(corner * device.tan_half_field) + _FLAT
