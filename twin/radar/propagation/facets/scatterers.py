"""Properties of facets and objects that scatter by physical optics."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.antenna import Antenna
from twin.radar.propagation.facets.convexity import convex_parts
from twin.radar.propagation.one_way.beams import AntennaGain, antenna_gain
from twin.radar.propagation.one_way.device_motion import MovingBodies
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.transfer import aligned

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scatterers:
    """Facets and objects that scatter.

    On the host, per facet of the world:

    body : (n_facets,)
        Number of its body, -1 where it does not scatter.
    counts : (n_facets,)
        Whether it scatters, has an area, and no other facet lies upon it.
    outward : (n_images, n_facets)
        Whether its normal points out of a closed mesh (1) or into it (-1); 0 of an open mesh, or
        where the image is inside the mesh's box.
    reachable : (n_images, n_facets)
        Whether paths between the image and the facet are traced.
    patch_area_m2 : (n_facets,)
        Area of the flat patch of its object that it is part of; 0 where it does not scatter.

    On the device: the ``antenna``; per object ``answers``, whether it scatters, its ``surface`` and
    ``motions``; per facet ``parts``, the number of its convex part (`convexity.convex_parts`).
    ``half_time_s``: half the duration of the burst, 0 where nothing moves. ``reach_m``: of the
    antennas, as of `Burst.reach_m`. ``is_over_band``:
    whether echoes become contributions that hold over the band (`wideband`), or count at single
    frequencies, each integrated by itself.
    """

    body: NDArray[np.intp]
    counts: NDArray[np.bool_]
    outward: NDArray[np.int8]
    reachable: NDArray[np.bool_]
    patch_area_m2: Array
    antenna: AntennaGain
    answers: Any
    surface: Any
    motions: MovingBodies
    parts: Any
    half_time_s: float = 0.0
    reach_m: float = 0.0
    is_over_band: bool = True


def scatterers(
    prepared: PreparedScene,
    antenna: Antenna,
    body: NDArray[np.int32],
    half_time_s: float = 0.0,
    reach_m: float = 0.0,
) -> Scatterers:
    """Scatterers of a scene, by the body of every object, -1 where it does not scatter."""
    world, mi = prepared.world, prepared.context.mi
    count = len(world.faces)
    outward, patch_area_m2 = np.zeros(count, dtype=np.int8), np.zeros(count)
    counts = world.plane_table[:, 3:].any(axis=1) & (body[world.object_of_face] >= 0)
    for number in np.flatnonzero(body[: len(world.face_ranges)] >= 0).tolist():
        item, rows = world.items[number], world.face_ranges[number]
        assert item is not None
        shape = item.geometry.shape
        counts[rows] &= ~shape.is_double
        outward[rows] = shape.outward
        patch_area_m2[rows] = shape.patch_area_m2[shape.patch_of_face]
    return Scatterers(
        body=body[world.object_of_face].astype(np.intp),
        counts=counts,
        outward=np.where(_within(prepared)[:, world.object_of_face], np.int8(0), outward),
        reachable=_reachable(prepared, antenna),
        patch_area_m2=patch_area_m2,
        antenna=antenna_gain(mi, antenna, prepared.axes),
        answers=mi.Bool(aligned(body >= 0)),
        surface=mi.UInt32(prepared.surface_of_object),
        motions=MovingBodies.of(mi, prepared.motions, prepared.accelerates),
        parts=mi.UInt32(aligned(convex_parts(world))),
        half_time_s=half_time_s if prepared.moves else 0.0,
        reach_m=reach_m,
    )


def _within(prepared: PreparedScene) -> NDArray[np.bool_]:
    """Whether images are inside the boxes around objects, (n_images, n_objects)."""
    world = prepared.world
    first = [rows.start for rows in world.vertex_ranges]
    low, high = (end.reduceat(world.vertices, first) for end in (np.minimum, np.maximum))
    places = np.array([image.place for image in prepared.images])[:, None]
    return np.asarray(((low <= places) & (places <= high)).all(axis=2))


def _reachable(prepared: PreparedScene, antenna: Antenna) -> NDArray[np.bool_]:
    worth: NDArray[np.bool_] = prepared.worth[:, prepared.world.object_of_face]
    return worth if antenna.gain_dbi is None else worth & _before(prepared)


def _before(prepared: PreparedScene) -> NDArray[np.bool_]:
    """Facets with a corner ahead of the antenna, as mirrored for every image, (n_images,
    n_facets).
    """
    world = prepared.world
    is_ahead = []
    for image in prepared.images:
        axis = prepared.axes[0]
        for patch in image.patches:
            normal = prepared.flats.normal[patch]
            axis = axis - 2 * (axis @ normal) * normal
        is_ahead.append((((world.vertices - image.place) @ axis) > 0)[world.faces].any(axis=1))
    return np.array(is_ahead)
