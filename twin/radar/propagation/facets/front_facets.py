"""Facets that face images of the radar, stored as indices; turned into triangles in batches.

Each triangle takes some kilobytes while its echo is computed, so all facets at once would not fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.facets.currents import Echoes, echoes_of
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.triangles import Triangles
from twin.radar.propagation.facets.uniform_subdivision import longest_edges
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.scene.images import Image
from twin.transfer import aligned, vector

Array = NDArray[np.float64]
Rows = NDArray[np.integer]

#: Triangles in a batch: some 0.5 GB while it is computed.
AT_ONCE = 2**18


def portions(rows: Rows, parts: int = 1) -> Iterator[Rows]:
    """Rows in portions, so small that ``parts`` triangles of each row fit in a batch."""
    size = max(AT_ONCE // parts, 1)
    for first in range(0, len(rows), size):
        yield rows[first : first + size]


def largest(values: Array, count: int) -> NDArray[np.bool_]:
    """Which of some values, (n,), are the ``count`` largest that are not 0."""
    is_largest = values > 0
    if np.count_nonzero(is_largest) > count:
        is_largest[:] = False
        is_largest[np.argsort(-values, kind="stable")[:count]] = True
    return is_largest


@dataclass(frozen=True, eq=False)
class FrontFacets:
    """Whole facets of the world, each with a source image and a receiver image, (n,)."""

    context: TracingContext
    scatterers: Scatterers
    face: NDArray[np.uint32]
    source: NDArray[np.uint32]
    receiver: NDArray[np.uint32]

    waves = None

    def __len__(self) -> int:
        return len(self.face)

    @property
    def body(self) -> NDArray[np.intp]:
        """Of each, (n,)."""
        return self.scatterers.body[self.face]

    @property
    def bounces(self) -> NDArray[np.uint8]:
        """Reflections at bodies on each path."""
        return np.ones(len(self.face), dtype=np.uint8)

    @property
    def all(self) -> NDArray[np.intp]:
        """Their rows."""
        return np.arange(len(self))

    def subset(self, rows: Rows) -> "FrontFacets":
        """Only some of them."""
        some = self.face[rows], self.source[rows], self.receiver[rows]
        return FrontFacets(self.context, self.scatterers, *some)

    def take(self, rows: Rows) -> Triangles:
        """Some of them as triangles, with the wave that lights them."""
        some = self.subset(rows)
        return lit_facets(self.context, self.scatterers, some.face, some.source, some.receiver)

    def echoes(self) -> Echoes:
        """Echo of each if all of it is visible."""
        return Echoes.concatenate(
            [
                echoes_of(self.context, self.scatterers, self.take(rows))
                for rows in portions(self.all)
            ]
        )

    def sizes(self) -> Array:
        """Longest edges in m, (n,)."""
        world, size_m = self.context.world, np.empty(len(self))
        for rows in portions(self.all):
            at = world.vertices[world.faces[self.face[rows]]]
            size_m[rows] = longest_edges(at[:, 0], at[:, 1], at[:, 2])
        return size_m

    @staticmethod
    def concatenate(parts: "Sequence[FrontFacets]") -> "FrontFacets":
        """One after the other."""
        columns = zip(*((p.face, p.source, p.receiver) for p in parts), strict=True)
        return FrontFacets(
            parts[0].context, parts[0].scatterers, *(np.concatenate(column) for column in columns)
        )


def bistatic_facets(
    context: TracingContext,
    scatterers: Scatterers,
    images: Sequence[Image],
    wanted: NDArray[np.bool_] | None = None,
) -> FrontFacets:
    """All facets with a source and a receiver on the same side, of closed meshes on the outside;
    occlusion is not tested. ``wanted`` (n_images, n_facets): only those with such an image as
    source or receiver.
    """
    b = scatterers
    rows = np.flatnonzero(b.counts if wanted is None else b.counts & wanted.any(axis=0))
    sides = sides_of(context, images, rows)
    facets = []
    for i, side in enumerate(sides):
        is_lit = (side != 0) & (b.outward[i, rows] * side >= 0) & b.reachable[i, rows]
        lit = np.flatnonzero(is_lit)
        face, of_lit = rows[lit], side[lit]
        for j in range(i, len(images)):
            both = face[(sides[j][lit] == of_lit) & b.reachable[j, face]]
            if wanted is not None:
                both = both[wanted[i, both] | wanted[j, both]]
            facets.append(_numbered(context, b, both, i, j))
    return FrontFacets.concatenate(facets)


def illuminated_facets(
    context: TracingContext,
    scatterers: Scatterers,
    images: Sequence[Image],
    wanted: NDArray[np.bool_] | None = None,
) -> FrontFacets:
    """All facets that a source faces, with the source as receiver; ``wanted`` as of
    `bistatic_facets`.
    """
    b = scatterers
    rows = np.flatnonzero(b.counts if wanted is None else b.counts & wanted.any(axis=0))
    facets = []
    for i, side in enumerate(sides_of(context, images, rows)):
        lit = (side != 0) & (b.outward[i, rows] * side >= 0)
        if wanted is not None:
            lit &= wanted[i, rows]
        facets.append(_numbered(context, b, rows[lit & b.reachable[i, rows]], i, i))
    return FrontFacets.concatenate(facets)


def _numbered(
    context: TracingContext,
    scatterers: Scatterers,
    face: NDArray[np.intp],
    source: int,
    receiver: int,
) -> FrontFacets:
    ends = (np.full(len(face), number, dtype=np.uint32) for number in (source, receiver))
    return FrontFacets(context, scatterers, face.astype(np.uint32), *ends)


def sides_of(
    context: TracingContext, images: Sequence[Image], rows: NDArray[np.intp]
) -> list[NDArray[np.int8]]:
    """Side of some facets on which each image is: 1 where their normal points."""
    sides = [np.empty(len(rows), dtype=np.int8) for _ in images]
    for some in portions(np.arange(len(rows))):
        plane = context.world.plane_table[rows[some]]
        for side, image in zip(sides, images, strict=True):
            height = np.einsum("ij,ij->i", image.place - plane[:, :3], plane[:, 3:])
            side[some] = np.sign(height)
    return sides


def lit_facets(
    context: TracingContext,
    scatterers: Scatterers,
    face: Rows,
    source: Rows,
    receiver: Rows,
) -> Triangles:
    """Triangles of whole facets, each lit directly from one image, with another as receiver."""
    mi, world = context.mi, context.world
    at = world.vertices[world.faces[face]]
    a, b, c = (vector(mi, at[:, k], "Vector3d") for k in range(3))
    return Triangles(
        corners=(a, b, c),
        face=mi.UInt32(aligned(face.astype(np.uint32))),
        source=mi.UInt32(aligned(source.astype(np.uint32))),
        receiver=mi.UInt32(aligned(receiver.astype(np.uint32))),
        wave=mi.UInt32(0),
        waves=None,
        body=scatterers.body[face],
        is_ray=np.zeros(len(face), dtype=bool),
        first=face.astype(np.uint32),
        bounces=np.ones(len(face), dtype=np.uint8),
    )
