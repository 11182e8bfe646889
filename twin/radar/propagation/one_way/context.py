"""The tracing context on the device: the radar itself, or its images in large flat mirrors too."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.one_way.device_motion import MovingImages
from twin.radar.propagation.one_way.motion import PointMotion, RigidMotions
from twin.radar.propagation.one_way.path import LEVEL, WINDOW, TracingContext
from twin.radar.propagation.scene.images import Image, in_plane
from twin.radar.propagation.scene.mesh_scene import Flats, MeshScene
from twin.radar.propagation.scene.slabs import Walls
from twin.radar.scattering.arrays import Index, Real, Vector3
from twin.transfer import aligned

Array = NDArray[np.float64]


def tracing_context(
    mi: Any,
    world: MeshScene,
    place: Array,
    boresight: Array,
    vertical: Array,
    wavelength_m: float,
    patch_of_face: Index,
    table: Real,
    walls: Walls | None,
) -> TracingContext:
    """The context on the device for the radar itself, at rest and without images."""
    return TracingContext(
        mi=mi,
        world=world,
        order=0,
        n_sources=1,
        place=_vector(mi, place),
        boresight=_vector(mi, boresight),
        vertical=_vector(mi, vertical),
        patch_of_face=patch_of_face,
        table=table,
        orders=mi.UInt32(0),
        positions=mi.Float64(aligned(place)),
        motions=MovingImages.of(mi, [PointMotion.still()], accelerated=False),
        axes=mi.Float64(aligned(np.eye(3).ravel())),
        levels=mi.Float64(0),
        marks=mi.UInt32(0),
        windows=mi.Float64(0),
        wavelength=dr.opaque(mi.Float64, wavelength_m),
        walls=walls,
    )


def with_images(
    context: TracingContext,
    images: Sequence[Image],
    flats: Flats,
    motions: tuple[PointMotion, RigidMotions],
    surface_of_object: NDArray[np.uint32],
    order: int,
) -> TracingContext:
    """The context with images of the radar of up to ``order`` reflections, in patches of objects
    with these surfaces (n,); ``motions`` of the radar, and of objects relative to the anchor.
    """
    mi = context.mi
    levels = np.zeros((len(images), order, LEVEL))
    levels[:, :, 6:9] = np.array(context.boresight).T  # any unit vector where there is no plane
    marks = np.zeros((len(images), order, 3), dtype=np.uint32)
    windows = np.zeros((len(images), order, WINDOW))
    at = [(row, k) for row, image in enumerate(images) for k in range(len(image.patches))]
    if at:
        patches = np.array([images[row].patches[k] for row, k in at])
        windows[tuple(np.array(at).T)] = _windows(flats, patches)
    for row, image in enumerate(images):
        for level, number in enumerate(image.patches):
            owner = flats.object[number]
            levels[row, level, 0:3] = image.places[level]
            levels[row, level, 3:6] = flats.point[number]
            levels[row, level, 6:9] = flats.normal[number]
            marks[row, level] = number, surface_of_object[owner], flats.is_wall[number]
    return replace(
        context,
        order=order,
        n_sources=len(images),
        orders=mi.UInt32(aligned(np.array([len(i.patches) for i in images], dtype=np.uint32))),
        positions=mi.Float64(aligned(np.concatenate([i.place for i in images]))),
        motions=_motions(mi, images, flats, *motions),
        axes=mi.Float64(aligned(_axes(images, flats).ravel())),
        levels=mi.Float64(aligned(levels if levels.size else np.zeros(1))),
        marks=mi.UInt32(aligned(marks if marks.size else np.zeros(1, dtype=np.uint32))),
        windows=mi.Float64(aligned(windows if windows.size else np.zeros(1))),
    )


def _windows(flats: Flats, patches: NDArray[np.int64]) -> Array:
    """Two directions in the plane of each patch, and its extents along these, (n, 10)."""
    columns = []
    for axis in in_plane(flats.normal[patches]):
        columns += [axis, flats.extent(patches, axis)]
    return np.hstack(columns)


def _motions(
    mi: Any, images: Sequence[Image], flats: Flats, radar: PointMotion, objects: RigidMotions
) -> MovingImages:
    """Motions of images, by those of the radar and of the objects that mirror it."""
    of_images = []
    for image in images:
        motion = replace(radar, spin_rad_per_s=np.zeros(3))  # of the world's axes
        for level, number in enumerate(image.patches):
            flat = flats.point[number], flats.normal[number], objects, int(flats.object[number])
            motion = motion.mirrored(image.places[level], *flat)
        of_images.append(motion)
    return MovingImages.of(mi, of_images, not (radar.is_uniform and objects.are_uniform))


def _axes(images: Sequence[Image], flats: Flats) -> Array:
    """The world's axes mirrored for each image, (n, 3 axes, 3)."""
    of_images = np.tile(np.eye(3), (len(images), 1, 1))
    for axes, image in zip(of_images, images, strict=True):
        for flat in (flats[number] for number in image.patches):
            axes -= 2 * np.outer(axes @ flat.normal, flat.normal)
    return of_images


def _vector(mi: Any, value: Array) -> Vector3:
    return mi.Vector3d(*(dr.opaque(mi.Float64, float(v)) for v in value))
