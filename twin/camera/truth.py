"""What is really there: albedo and depth on the grid of the virtual image."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.transport import Pinhole, primary_rays

_ALBEDO_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth on the virtual image's grid, row 0 top, column 0 left.

    ``albedo``: reflectance at 1550 nm, mean over each cell, 0 where there is nothing. ``depth_m``:
    distance along the boresight in the middle of each cell, infinite where there is nothing.
    """

    albedo: NDArray[np.float64]
    depth_m: NDArray[np.float64]


def render_truth(scene: Any, camera: Pinhole, shape: tuple[int, int]) -> Truth:
    """Look through a camera, no light needed."""
    albedo, _ = _look(scene, camera, shape, _ALBEDO_SAMPLES)
    _, depth = _look(scene, camera, shape, 1)
    return Truth(albedo, depth)


def write_truth(truth: Truth, path: Path) -> None:
    """OpenEXR with the channels ``albedo`` and ``depth`` (metres), float32."""
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


def _look(
    scene: Any, camera: Pinhole, shape: tuple[int, int], samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean albedo and depth over the samples of each cell."""
    ray, cos = primary_rays(camera, shape, (0, shape[0]), samples, None)
    hit = scene.ray_intersect(ray)
    found = np.array(hit.is_valid())
    albedo = np.array(hit.bsdf(ray).eval_diffuse_reflectance(hit)[0], dtype=np.float64)
    depth = np.array(hit.t, dtype=np.float64) * np.array(cos, dtype=np.float64)
    cells = (*shape, samples)
    return (
        np.where(found, albedo, 0.0).reshape(cells).mean(axis=-1),
        np.where(found, depth, np.inf).reshape(cells).mean(axis=-1),
    )
