"""Far field of a mesh by physical optics, from any direction into any other: many at once.

The kernel of `twin.radar.scattering.rays`, where source and receiver each have a direction of their
own. As there, a facet radiates only to where it is seen: the shadow that a target casts forwards,
which physical optics has as a wave of its own, is left out.
"""

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.engine import mitsuba
from twin.radar.scattering.kernel import launch, opaque, trace
from twin.radar.scattering.rays import TILT, Quality
from twin.radar.scattering.surface import table
from twin.radar.scattering.target import Target

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_RAYS_AT_ONCE = 2**20  # 300 MB while they are under way
_LEAST_SHORTENING = 0.05
_SIZES = 16  # of grids along a side


def scattering_dyadics(
    target: Target, source: Array, receiver: Array, frequency_hz: Array, quality: Quality
) -> Complex:
    """What turns the incident field at the target's origin into the scattered one.

    Parameters
    ----------
    source, receiver : (n, 3)
        Unit vectors from the target to where the wave comes from, and to where it is received.
    frequency_hz : (n,)
        Materials answer as at the first.

    Returns
    -------
    (n, 3, 3)
        Dyadics D in metres: an incident E gives D E exp(-j k r) / r at a distance r, so with unit
        polarisations the bistatic cross-section is 4 pi |e_r . D e_i|^2.
    """
    n, wavelength_m = len(source), speed_of_light / frequency_hz
    if n == 0:
        return np.zeros((0, 3, 3), dtype=np.complex128)
    spacing, _, outlines = _grids(target, source, frequency_hz, quality)
    sizes = _sizes(outlines, spacing, target.sphere[1])
    ways, heard = _transverse(source), _transverse(receiver)
    coefficients = table(target.surfaces, float(frequency_hz[0])).ravel()
    amplitude = np.empty((n, 2, 2), dtype=np.complex128)  # sent, received
    for size in np.unique(sizes, axis=0):
        alike = np.flatnonzero((sizes == size).all(axis=1))
        at_once = max(1, _RAYS_AT_ONCE // int(2 * np.prod(size)))
        for first in range(0, len(alike), at_once):
            part = alike[first : first + at_once]
            numbers = (source, receiver, heard, outlines, spacing, wavelength_m, ways)
            amplitude[part] = _shot(
                target, coefficients, [x[part] for x in numbers], size, quality.max_bounces
            )
    amplitude *= -1j / (2 * wavelength_m[:, None, None])
    return np.einsum("npq,nqx,npy->nxy", amplitude, heard, ways)


def thinning(target: Target, frequency_hz: float, quality: Quality) -> float:
    """Factor by which ``max_rays`` sets rays wider apart than asked for; at least 1.

    That of the worst of the three sides of the target's box.
    """
    return float(_grids(target, np.eye(3), np.full(3, frequency_hz), quality)[1].max())


def _transverse(direction: Array) -> Array:
    """Two unit vectors across each direction, (n, 2, 3)."""
    least = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def _grids(
    target: Target, source: Array, frequency_hz: Array, quality: Quality
) -> tuple[Array, Array, Array]:
    """Per source: spacing of the rays and by what factor it is wider than asked for, (n,); two axes
    across it and the outline's box along them, (n, 2, 3 + 2).

    Rays are those of the highest frequency. Nothing else depends on what is asked for together:
    the same direction has the same bits.
    """
    axes = _transverse(source)
    # Tilted against the axes: rows of tubes parallel to an edge would all be cut alike.
    axes = np.einsum("ab,nbx->nax", [[TILT[0], TILT[1]], [-TILT[1], TILT[0]]], axes)
    points = target.used_m - target.sphere[0]
    flat = np.einsum("nax,px->nap", axes, points)
    outlines = np.concatenate([axes, np.stack([flat.min(2), flat.max(2)], axis=2)], axis=2)
    area = np.prod(np.ptp(flat, axis=2), axis=1)
    a, b, c = (target.corners_m[:, i] for i in range(3))
    cosine = np.abs(target.normals @ source.T)
    seen = np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None] * cosine
    oblique = np.sum(seen * cosine, axis=0) / np.maximum(np.sum(seen, axis=0), 1e-300)
    shortening = np.clip(1.5 * oblique, _LEAST_SHORTENING, 1)
    asked = speed_of_light / frequency_hz.max() / quality.rays_per_wavelength * shortening
    # An outline seen edge on has no area, but one row of rays.
    row = 1e-3 * target.sphere[1]
    dense = np.maximum(np.minimum(asked, (area / quality.min_rays) ** 0.5), row)
    spacing = np.maximum(dense, (area / quality.max_rays) ** 0.5)
    return spacing, np.maximum(1.0, spacing / asked), outlines


def _sizes(outlines: Array, spacing: Array, radius_m: float) -> NDArray[np.int64]:
    """Columns and rows (n, 2) that hold each outline, in steps: neighbours share a launch."""
    extent = (outlines[:, :, 4] - outlines[:, :, 3]) / spacing[:, None]
    step = np.ceil(2 * radius_m / spacing / _SIZES)[:, None]
    return (step * np.maximum(np.ceil(extent / step - 1e-6), 1)).astype(np.int64)


def _shot(
    target: Target,
    coefficients: Array,
    directions: list[Array],
    size: NDArray[np.int64],
    bounces: int,
) -> Complex:
    """Sums (n, 2, 2), sent and received: one ray per lane, each with its own directions."""
    mi, engine = mitsuba(), target.engine
    source, receiver, heard, outlines, spacing, wavelength_m, ways = directions
    middle = (outlines[:, :, 3] + outlines[:, :, 4]) / 2
    corner = middle / spacing[:, None] - (size - 1) / 2
    n, count = len(source), int(np.prod(size))
    # A row of numbers for each direction and polarisation; what varies is gathered, what does not
    # is opaque, so that no other numbers compile anew.
    parts = (source, receiver, heard, outlines[:, :, :3], corner, wavelength_m, spacing)
    rows = [np.repeat(part.reshape(n, -1), 2, axis=0) for part in parts]
    numbers = np.concatenate([*rows, ways.reshape(2 * n, 3)], axis=1)
    values, width = mi.Float64(numbers.ravel()), numbers.shape[1]
    lane = dr.arange(mi.UInt32, 2 * n * count)
    per_row = dr.opaque(mi.UInt32, count)
    row = lane // per_row
    at = row * dr.opaque(mi.UInt32, width)

    def number(i: int) -> Any:
        return dr.gather(mi.Float64, values, at + i)

    def vector(i: int) -> Any:
        return mi.Vector3d(number(i), number(i + 1), number(i + 2))

    setting = opaque(
        mi,
        {
            "inverse_distance": 0.0,
            "distance": 1e200,
            "center": engine.center_m,
            "radius": 1.01 * engine.radius_m,
            "apart": True,
        },
    ) | {
        "towards": vector(0),
        "listener": vector(3),
        "vertical": vector(6),
        "horizontal": vector(9),
        "wavelength": number(20),
        "sent": vector(22),
    }
    grid = opaque(mi, {"center": engine.center_m, "columns": int(size[0])}) | {
        "forward": -setting["towards"],
        "first": vector(12),
        "second": vector(15),
        "left": number(18),
        "bottom": number(19),
        "spacing": number(21),
    }
    launched = launch(mi, setting, grid, lane - row * per_row)
    shelf, most = mi.Float64(coefficients), dr.opaque(mi.UInt32, bounces)
    echoes = trace(mi, engine, setting, shelf, most, *launched)[:4]
    sums = [np.array(dr.block_reduce(dr.ReduceOp.Add, echo, count)) for echo in echoes]
    both: Complex = np.stack([sums[0] + 1j * sums[1], sums[2] + 1j * sums[3]], axis=1)
    return both.reshape(n, 2, 2)
