"""Ground truth: albedo and depth on the grid of the virtual image."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.devices import CellGrid, Device, primary_rays
from twin.optics.paths import albedo as reflectance
from twin.optics.ray_sets import RowRays

_ALBEDO_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth on the virtual image's grid, row 0 top, column 0 left.

    ``albedo``: reflectance at 1550 nm, mean over each cell, 0 where there is nothing. ``depth_m``:
    distance along the boresight in the middle of each cell, infinite where there is nothing.
    """

    albedo: NDArray[np.float64]
    depth_m: NDArray[np.float64]


def render_truth(scene: Any, camera: Device, shape: tuple[int, int]) -> Truth:
    """Albedo and depth in the field of a camera."""
    albedo, _ = _albedo_and_depth(scene, camera, shape, _ALBEDO_SAMPLES)
    return Truth(albedo, depths(scene, camera, shape))


def depths(scene: Any, camera: Device, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Depth in the middle of each cell of a camera, m, infinite where there is nothing."""
    return _albedo_and_depth(scene, camera, shape, 1)[1]


def object_shares(scene: Any, camera: Device, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Mean albedo of each cell by object, (n_objects, rows, columns): their sum is the albedo."""
    ray, _ = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], _ALBEDO_SAMPLES))
    hit = scene.ray_intersect(ray)
    albedo = np.where(np.array(hit.is_valid()), np.array(reflectance(hit), dtype=np.float64), 0.0)
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
    hit = scene.ray_intersect(ray)
    cosine = np.abs(np.array(dr.dot(ray.d, hit.n), dtype=np.float64))
    return np.where(np.array(hit.is_valid()), cosine, 0.0).reshape(shape)


def write_truth(truth: Truth, path: Path) -> None:
    """Write OpenEXR with the channels ``albedo`` and ``depth`` (metres), float32."""
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
    bitmap.write(str(path))


def _albedo_and_depth(
    scene: Any, camera: Device, shape: tuple[int, int], samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean albedo and depth over the samples of each cell."""
    ray, cos = primary_rays(CellGrid(camera, *shape), RowRays(0, shape[0], samples))
    hit = scene.ray_intersect(ray)
    is_hit = np.array(hit.is_valid())
    albedo = np.array(reflectance(hit), dtype=np.float64)
    depth = np.array(hit.t, dtype=np.float64) * np.array(cos, dtype=np.float64)
    cells = (*shape, samples)
    return (
        np.where(is_hit, albedo, 0.0).reshape(cells).mean(axis=-1),
        np.where(is_hit, depth, np.inf).reshape(cells).mean(axis=-1),
    )
