"""Obstacles that waves go round, and their outlines as the radar or an image of it sees them."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.diffraction.flat_sides import Side, sides_of
from twin.radar.propagation.diffraction.mirror_borders import free_border
from twin.radar.propagation.diffraction.outermost import OuterRims
from twin.radar.propagation.meshes.silhouettes import Outline, outline
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]

#: By object, as last seen from a radar: that radar's place and the outline. Both stay the same from
#: frame to frame until the object or the radar moves.
_from_radar: WeakKeyDictionary[SceneObject, tuple[bytes, Outline]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Screens:
    """Obstacles of a prepared scene, (n, ...), and their bounding spheres, relative to its anchor.

    ``body`` (n,) numbers the bodies that objects are parts of, -1 for none; ``faintest`` is the
    least amplitude of a diffracted path, over the direct wave, that is kept; ``rims`` are outer
    rims that were asked for, by source, and ``borders`` those of mirrors, by their numbers.
    """

    prepared: PreparedScene
    items: tuple[SceneObject, ...]
    body: NDArray[np.int32]
    boxes: Array
    faintest: float
    rims: dict[bytes, OuterRims] = field(default_factory=dict)
    borders: dict[int, Outline | None] = field(default_factory=dict)

    @cached_property
    def centers(self) -> Array:
        """Of boxes, (n, 3)."""
        centers: Array = self.boxes.mean(axis=1)
        return centers

    @cached_property
    def radii(self) -> Array:
        """Of spheres around boxes, (n,)."""
        radii: Array = np.linalg.norm(self.boxes[:, 1] - self.boxes[:, 0], axis=1) / 2
        return radii

    @property
    def wavenumber(self) -> float:
        """At the carrier, rad/m."""
        return 2 * np.pi / self.prepared.wavelength_m

    @cached_property
    def sides(self) -> list[Side]:
        """Flat sides along which the radar looks at grazing incidence."""
        place = self.prepared.images[0].place
        found = []
        for number, item in enumerate(self.items):
            points = item.vertices_m - self.prepared.anchor_m - place
            outline = self.outline(number, place)
            table, wavelength_m = item.geometry.edges, self.prepared.wavelength_m
            found += sides_of(outline, table, points, number, wavelength_m)
        return found

    def outline(self, item: int, place: Array) -> Outline:
        """That of an obstacle from a place relative to the anchor."""
        if not np.array_equal(place, self.prepared.images[0].place):
            return outline(self.items[item], place + self.prepared.anchor_m)
        one, place_m = self.items[item], place + self.prepared.anchor_m
        held = _from_radar.get(one)
        if held is None or held[0] != place_m.tobytes():
            held = _from_radar[one] = place_m.tobytes(), outline(one, place_m)
        return held[1]

    def border(self, image: Image) -> Outline | None:
        """That of an image's only mirror, from there, as the opening through which the radar is
        seen; None of other images, and where the mirror goes on everywhere.
        """
        if len(image.patches) != 1:
            return None
        (number,) = image.patches
        if number not in self.borders:
            rim = free_border(self.prepared, image, 0)
            self.borders[number] = rim if len(rim.ends) else None
        return self.borders[number]

    def rim(self, item: int, source: Array, reach_m: float, own: int = -1) -> Outline:
        """Of an obstacle's outline what is on the outline of all that stands close to it, but for
        parts of a body that points are their ``own`` of, from the radar or an image of it, relative
        to the anchor, to points so far from there.
        """
        return self.rims_from(source).of(item, reach_m, own)

    def rims_from(self, source: Array) -> OuterRims:
        """From the radar or an image of it."""
        if (key := source.tobytes()) not in self.rims:
            alone = int(self.body.max(initial=-1)) + 1 + np.arange(len(self.items))
            owner = np.where(self.body >= 0, self.body, alone)
            outlines = partial(self.outline, place=source)
            self.rims[key] = OuterRims(self.prepared, self.items, owner, outlines, source)
        return self.rims[key]


def screens(
    prepared: PreparedScene, shadow_db: float, body: NDArray[np.int32] | None = None
) -> Screens | None:
    """Everything opaque in a scene, for shadows down to a depth in dB; None where it is 0.

    ``body`` (n,) numbers the bodies that objects are parts of, -1 for none.
    """
    items = prepared.originals[: len(prepared.world.face_ranges)]
    if shadow_db <= 0 or not items:
        return None
    bodies = np.full(len(items), -1, dtype=np.int32) if body is None else body[: len(items)]
    return Screens(
        prepared=prepared,
        items=items,
        body=bodies,
        boxes=boxes_of(items) - prepared.anchor_m,
        faintest=float(10 ** (-shadow_db / 20)),
    )
