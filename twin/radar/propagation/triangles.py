"""Lit triangles of the scene's facets, which are divided until their echo is known well enough.

A triangle is lit from a point, its origin: the radar, an image of it in a large surface, or, after
bounces between bodies, the image of that in the facets on the way. It answers to one image of the
radar.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.legs import Station, leg, mirrored_axes
from twin.radar.propagation.walls import Passage
from twin.transfer import aligned, concatenated

Array = NDArray[np.float64]
Indices = NDArray[np.integer]


@dataclass(frozen=True, eq=False)
class Incident:
    """The wave that lights a triangle at its centroid, on the device; see `legs.Leg`.

    ``origin`` is the point from which it spreads, ``velocity`` that of this point, ``axes`` the
    world's as mirrors and facets show them.
    """

    origin: Any
    velocity: Any
    axes: tuple[Any, Any, Any]
    field: Any
    field_im: Any
    departure: Any
    passage: Passage


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles on the device, one element each, relative to the anchor.

    ``corners``: three vectors; ``face``: the facet on which they lie; ``source`` and ``receiver``:
    images of the radar; ``spot``: a point of it that is lit; ``lift``: how far from their plane
    surfaces may be that it stands for, in m. On the host (n,): ``body``, and ``is_ray``: its
    corners may not be lit, and the spot stands for all of it. ``bounces`` before.
    """

    corners: tuple[Any, Any, Any]
    face: Any
    source: Any
    receiver: Any
    spot: Any
    lift: Any
    incident: Incident
    body: NDArray[np.intp]
    is_ray: NDArray[np.bool_]
    bounces: int = 0

    def __len__(self) -> int:
        return len(self.body)

    @property
    def center(self) -> Any:
        """Centroids."""
        a, b, c = self.corners
        return (a + b + c) / 3

    def taken(self, which: Indices) -> "Triangles":
        """Only some of them, by index."""
        index = type(self.face)(aligned(which.astype(np.uint32)))
        found = mapped(self, lambda value: dr.gather(type(value), value, index))
        return replace(found, body=self.body[which], is_ray=self.is_ray[which]).evaluated()

    def repeated(self, times: int) -> "Triangles":
        """Each of them several times in a row."""
        index = dr.arange(type(self.face), times * len(self)) // times
        found = mapped(self, lambda value: dr.gather(type(value), value, index))
        body, is_ray = (np.repeat(value, times) for value in (self.body, self.is_ray))
        return replace(found, body=body, is_ray=is_ray)

    def evaluated(self) -> "Triangles":
        """The same, computed."""
        dr.eval(_arrays(self))
        return self

    @staticmethod
    def joined(parts: Sequence["Triangles"]) -> "Triangles":
        """One after the other; of equal bounces."""
        parts = [part for part in parts if len(part)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        columns = list(zip(*(_numbers(part) for part in parts), strict=True))
        joined = iter(concatenated(columns, [len(part) for part in parts]))

        def longer(value: Any) -> Any:
            if dr.depth_v(value) == 1:
                return next(joined)
            return type(value)(*(next(joined) for _ in range(len(value))))

        found = mapped(parts[0], longer)
        body = np.concatenate([part.body for part in parts])
        is_ray = np.concatenate([part.is_ray for part in parts])
        return replace(found, body=body, is_ray=is_ray)


def _arrays(triangles: "Triangles") -> list[Any]:
    """All arrays on the device, in order."""
    found: list[Any] = []

    def note(value: Any) -> Any:
        found.append(value)
        return value

    mapped(triangles, note)
    return found


def _numbers(triangles: "Triangles") -> list[Any]:
    """The same, vectors by their axes."""
    arrays = _arrays(triangles)
    return [axis for a in arrays for axis in ([a] if dr.depth_v(a) == 1 else [*a])]


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """The same structure with every array on the device changed."""
    if isinstance(value, tuple):
        return tuple(mapped(part, change) for part in value)
    if isinstance(value, Triangles | Incident | Passage):
        parts = {f.name: getattr(value, f.name) for f in fields(value)}
        return replace(value, **{name: mapped(part, change) for name, part in parts.items()})
    return value if isinstance(value, np.ndarray | int) else change(value)


def lit_directly(s: Station, triangles: Triangles) -> Triangles:
    """The same with the wave that comes by the leg from their source; what stands in between is not
    looked at.
    """
    mi, place = s.mi, triangles.center
    way = leg(s, triangles.source, place, mi.Vector3d(0), mi.Bool(True), tested=False)
    wide = dr.zeros(mi.Float64, len(triangles))
    passage = Passage(*(value + wide for value in vars(way.passage).values()))
    incident = Incident(
        origin=place + way.back * way.length,
        velocity=way.velocity,
        axes=mirrored_axes(s, triangles.source),
        field=way.field,
        field_im=way.field_im + wide,
        departure=way.departure,
        passage=passage,
    )
    return replace(triangles, incident=incident).evaluated()


def quartered(s: Station, triangles: Triangles) -> Triangles:
    """Each in four, by two cuts across the longest edge; those lit directly anew."""
    corners = triangles.corners
    four = triangles.repeated(4)
    number = dr.arange(s.mi.UInt32, len(four))
    for cut in (2, 1):
        a, b, c = four.corners if cut == 2 else corners
        ab, bc, ca = (dr.squared_norm(q - p) for p, q in ((a, b), (b, c), (c, a)))
        first, second = (ab >= bc) & (ab >= ca), bc >= ca
        p = dr.select(first, a, dr.select(second, b, c))
        q = dr.select(first, b, dr.select(second, c, a))
        r = dr.select(first, c, dr.select(second, a, b))
        is_later, middle = (number & cut) > 0, (p + q) / 2
        corners = (dr.select(is_later, middle, p), dr.select(is_later, q, middle), r)
    is_ray = s.mi.Bool(aligned(four.is_ray))
    middle = (corners[0] + corners[1] + corners[2]) / 3
    four = replace(four, corners=corners, spot=dr.select(is_ray, four.spot, middle))
    return four.evaluated() if triangles.bounces else lit_directly(s, four)
