"""Bodies that scatter by physical optics, as their facets are asked for it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.antenna import Antenna
from twin.radar.propagation.shape import shape_of
from twin.radar.propagation.stage import Stage

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scatterers:
    """Per facet of the world on the host: ``body``, -1 where nothing scatters; ``plane``, a number
    that facets in one plane of an object share, -1 likewise; ``counts``: it scatters, has an area,
    and lies upon no other; ``outward`` (n_images, n_facets), 1 or -1 where its normal looks out of
    a closed mesh or into it and the image stands outside, else 0; ``gain`` (n_images, n_facets),
    the antenna's in amplitude by way of every image, 0 where that is not worth tracing. Per object
    on the device: ``surface`` and ``velocity``.
    """

    body: NDArray[np.intp]
    plane: NDArray[np.int32]
    counts: NDArray[np.bool_]
    outward: NDArray[np.int8]
    gain: Array
    surface: Any
    velocity: Any


def scatterers(stage: Stage, antenna: Antenna, body: NDArray[np.int32]) -> Scatterers:
    """By the body of every object, -1 where it does not scatter."""
    world, mi = stage.world, stage.station.mi
    count = len(world.faces)
    plane, outward = (
        np.full(count, -1, dtype=np.int32),
        np.zeros((len(stage.images), count), np.int8),
    )
    counts = np.zeros(count, dtype=bool)
    first = 0
    for number, rows in enumerate(world.face_ranges):
        item = world.items[number]
        if item is None or body[number] < 0:
            continue
        shape = shape_of(item)
        plane[rows] = shape.patch_of_face + first
        counts[rows] = ~shape.is_double & world.plane_table[rows, 3:].any(axis=1)
        points = world.vertices[world.vertex_ranges[number]]
        low, high = points.min(axis=0), points.max(axis=0)
        for row, image in zip(outward, stage.images, strict=True):
            if not ((low <= image.place) & (image.place <= high)).all():
                row[rows] = shape.outward
        first += len(shape.patch_area_m2)
    velocities = np.array([item.velocity_m_per_s for item in stage.items], dtype=np.float64)
    return Scatterers(
        body=body[world.object_of_face].astype(np.intp),
        plane=plane,
        counts=counts,
        outward=outward,
        gain=_gains(stage, antenna),
        surface=mi.UInt32(stage.surface_of_object),
        velocity=mi.Float64(velocities.ravel()),
    )


def _gains(stage: Stage, antenna: Antenna) -> Array:
    world = stage.world
    middle = world.vertices[world.faces].mean(axis=1)
    found = []
    for image in stage.images:
        direction = middle - image.place
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
        for patch in reversed(image.patches):
            normal = stage.flats.normal[patch]
            direction -= 2 * np.outer(direction @ normal, normal)
        found.append(np.sqrt(antenna.gain(direction @ stage.axes.T)))
    return np.array(found) * stage.worth[:, world.object_of_face]
