"""Ground truth: albedo and depth on the grid of the virtual image."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from twin.engine import exr_threads, mitsuba
from twin.optics.devices import CellGrid, Device, primary_rays
from twin.optics.paths import albedo as reflectance
from twin.optics.ray_sets import RowRays

_ALBEDO_SAMPLES = 64


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Described):
    """Ground truth on the virtual image's grid, row 0 top, column 0 left.

    ``albedo``: reflectance at 1550 nm, mean over each cell, 0 where there is nothing. ``depth_m``:
    distance along the boresight in the middle of each cell, infinite where there is nothing.
    """

    albedo: NDArray[np.float64]
    depth_m: NDArray[np.float64]


def render_truth(scene: Any, camera: Device, shape: tuple[int, int]) -> Truth:
    """Albedo and depth in the field of a camera."""
    ray, _ = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], _ALBEDO_SAMPLES))
    hit = scene.ray_intersect(ray, mitsuba().RayFlags.All, coherent=True)
    albedo = np.array(dr.select(hit.is_valid(), reflectance(hit), 0.0), dtype=np.float64)
    return Truth(
        albedo.reshape(*shape, _ALBEDO_SAMPLES).mean(axis=-1), depths(scene, camera, shape)
    )


def depths(
    scene: Any,
    camera: Device,
    shape: tuple[int, int],
    instants: NDArray[np.int64] | None = None,
) -> NDArray[np.float64]:
    """Depth in the middle of each cell of a camera, m, infinite where there is nothing;
    ``instants`` (n_cells,): of a scene that moves, that of each cell.
    """
    ray, cos = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], 1))
    if instants is not None:
        ray.time = mitsuba().Float(instants.astype(np.float32))
    hit = scene.ray_intersect(ray, mitsuba().RayFlags.All, coherent=True)
    is_hit = hit.is_valid()
    dr.eval(is_hit, hit.t, cos)  # in one go, else rays are traced for each
    depth = np.array(hit.t, dtype=np.float64) * np.array(cos, dtype=np.float64)
    return np.where(np.array(is_hit), depth, np.inf).reshape(shape)


def object_shares(scene: Any, camera: Device, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Mean albedo of each cell by object, (n_objects, rows, columns): their sum is the albedo."""
    ray, _ = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], _ALBEDO_SAMPLES))
    hit = scene.ray_intersect(ray, mitsuba().RayFlags.All, coherent=True)
    met = dr.select(hit.is_valid(), reflectance(hit), 0.0)
    dr.eval(met, hit.shape)  # in one go, else rays are traced for each
    albedo = np.array(met, dtype=np.float64)
    shares = [
        np.where(np.array(hit.shape == item), albedo, 0.0)
        .reshape(*shape, _ALBEDO_SAMPLES)
        .mean(axis=-1)
        for item in scene.shapes()
    ]
    return np.array(shares).reshape(-1, *shape)


def incidence_cosines(scene: Any, camera: Device, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Cosine of the angle of incidence in the middle of each cell, 0 where there is no surface."""
    ray, _ = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], 1))
    hit = scene.ray_intersect(ray, mitsuba().RayFlags.All, coherent=True)
    cosine = dr.select(hit.is_valid(), dr.abs(dr.dot(ray.d, hit.n)), 0.0)
    return np.array(cosine, dtype=np.float64).reshape(shape)


def write_truth(truth: Truth, path: Path) -> None:
    """Write OpenEXR with the channels ``albedo`` and ``depth`` (metres), float32.

    In memory first: Mitsuba tells of a full disk by a RuntimeError without its number.
    """
    mi = mitsuba()
    rows, columns = truth.albedo.shape
    bitmap = mi.Bitmap(
        mi.Bitmap.PixelFormat.MultiChannel,
        mi.Struct.Type.Float32,
        (columns, rows),
        2,
        ["albedo", "depth"],
    )
    np.array(bitmap, copy=False)[:] = np.stack([truth.albedo, truth.depth_m], axis=-1)
    stream = mi.MemoryStream()
    with exr_threads():
        bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    path.write_bytes(stream.raw_buffer())
