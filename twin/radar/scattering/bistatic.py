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
    n = len(source)
    if n == 0:
        return np.zeros((0, 3, 3), dtype=np.complex128)
    spacing, _, outlines = _grids(target, source, frequency_hz, quality)
    count = int(np.prod(_size(outlines, spacing)))
    ways, heard = _transverse(source), _transverse(receiver)
    coefficients = table(target.surfaces, float(frequency_hz[0])).ravel()
    at_once = max(1, _RAYS_AT_ONCE // (2 * count))
    amplitude = np.empty((n, 2, 2), dtype=np.complex128)  # sent, received
    for first in range(0, n, at_once):
        part = slice(first, first + at_once)
        amplitude[part] = _shot(
            target,
            coefficients,
            (source[part], receiver[part], ways[part], heard[part]),
            outlines[part],
            spacing,
            speed_of_light / frequency_hz[part],
            quality.max_bounces,
        )
    return np.einsum("npq,nqx,npy->nxy", amplitude, heard, ways)


def thinning(target: Target, frequency_hz: float, quality: Quality) -> float:
    """Factor by which ``max_rays`` sets rays wider apart than asked for; at least 1.

    That of the three sides of the target's box together.
    """
    return _grids(target, np.eye(3), np.full(3, frequency_hz), quality)[1]


def _transverse(direction: Array) -> Array:
    """Two unit vectors across each direction, (n, 2, 3)."""
    least = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def _grids(
    target: Target, source: Array, frequency_hz: Array, quality: Quality
) -> tuple[float, float, Array]:
    """Spacing of the rays, by what factor it is wider than asked for, and per source two axes
    across it and the outline's box along them: (n, 2, 3 + 2).
    """
    axes = _transverse(source)
    # Tilted against the axes: rows of tubes parallel to an edge would all be cut alike.
    tilt = np.array([[TILT[0], TILT[1]], [-TILT[1], TILT[0]]])
    axes = np.einsum("ab,nbx->nax", tilt, axes)
    points = target.used_m - target.sphere[0]
    flat = np.einsum("nax,px->nap", axes, points)
    outlines = np.concatenate([axes, np.stack([flat.min(2), flat.max(2)], axis=2)], axis=2)
    area = float(np.prod(np.ptp(flat, axis=2), axis=1).max())
    across = np.cross(
        target.corners_m[:, 1] - target.corners_m[:, 0],
        target.corners_m[:, 2] - target.corners_m[:, 0],
    )
    cosine = np.abs(target.normals @ source.T)
    seen = np.linalg.norm(across, axis=1)[:, None] * cosine
    shortening = np.clip(1.5 * np.sum(seen * cosine) / np.sum(seen), _LEAST_SHORTENING, 1)
    asked = speed_of_light / frequency_hz.max() / quality.rays_per_wavelength * shortening
    dense = min(float(asked), (area / quality.min_rays) ** 0.5)
    spacing = max(dense, (area / quality.max_rays) ** 0.5)
    return spacing, max(1.0, spacing / float(asked)), outlines


def _size(outlines: Array, spacing: float) -> NDArray[np.int64]:
    """Columns and rows that hold every outline."""
    extent = (outlines[:, :, 4] - outlines[:, :, 3]).max(axis=0) / spacing
    return np.maximum(np.ceil(extent - 1e-6), 1).astype(np.int64)


def _shot(
    target: Target,
    coefficients: Array,
    directions: tuple[Array, Array, Array, Array],
    outlines: Array,
    spacing: float,
    wavelength_m: Array,
    bounces: int,
) -> Complex:
    """Amplitudes (n, 2, 2), sent and received: one ray per lane, each with its own directions."""
    mi, engine = mitsuba(), target.engine
    source, receiver, ways, heard = directions
    columns, rows = _size(outlines, spacing)
    middle = (outlines[:, :, 3] + outlines[:, :, 4]) / 2
    corner = middle / spacing - (np.array([columns, rows]) - 1) / 2
    n, count = len(source), int(columns * rows)
    # A row of numbers for each direction and polarisation; what varies is gathered, what does not
    # is opaque, so that no other numbers compile anew.
    numbers = np.concatenate(
        [
            np.repeat(block.reshape(n, -1), 2, axis=0)
            for block in (source, receiver, heard, outlines[:, :, :3], corner, wavelength_m)
        ]
        + [ways.reshape(2 * n, 3)],
        axis=1,
    )
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
        "sent": vector(21),
    }
    grid = opaque(mi, {"center": engine.center_m, "spacing": spacing, "columns": int(columns)}) | {
        "forward": -setting["towards"],
        "first": vector(12),
        "second": vector(15),
        "left": number(18),
        "bottom": number(19),
    }
    launched = launch(mi, setting, grid, lane - row * per_row)
    coefficients = mi.Float64(coefficients)
    most = dr.opaque(mi.UInt32, bounces)
    parts = trace(mi, engine, setting, coefficients, most, *launched)[:4]
    v_re, v_im, h_re, h_im = (
        np.array(dr.block_reduce(dr.ReduceOp.Add, part, count)) for part in parts
    )
    both = np.stack([v_re + 1j * v_im, h_re + 1j * h_im], axis=1).reshape(n, 2, 2)
    scale: Complex = -1j / (2 * wavelength_m[:, None, None])
    return both * scale
