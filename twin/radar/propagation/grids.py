"""Where rays of physical optics go: a grid of directions for each body, from each image of the
radar, with as many rays as the budget leaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.images import Image

Array = NDArray[np.float64]

_TILT = np.array([0.8506508083520399, 0.5257311121191336])  # cos, sin: tan is the golden ratio's
_PER_WAVELENGTH = 8.0
_LEAST_RAYS = 4096  # of a grid: its outline is off by some 1 / sqrt(rays) of its size


@dataclass(frozen=True, eq=False)
class Grid:
    """A rectangle of directions from an image: centre and axes (3,) of a plane, its bounds there,
    and the body that it is for.
    """

    source: int
    body: int
    center: Array
    forward: Array
    axes: tuple[Array, Array]
    low: Array
    high: Array

    @property
    def area_m2(self) -> float:
        """On the plane."""
        return float(np.prod(self.high - self.low))


@dataclass(frozen=True, eq=False)
class Launch:
    """Grids with their spacing: what the kernel reads, one row per grid.

    ``numbers`` (n, 16): centre, forward, first and second axis, spacing, left, bottom, columns.
    ``thinned``: how much wider than asked for rays are, (n,).
    """

    numbers: Array
    source: NDArray[np.uint32]
    body: NDArray[np.uint32]
    rays: NDArray[np.int64]
    thinned: Array


def grids(images: Sequence[Image], bodies: Sequence[Array], worth: NDArray[np.bool_]) -> list[Grid]:
    """Grids around bodies, whose hulls' points (n, 3) are given, from the images from which each is
    ``worth`` tracing, (n_images, n_bodies).
    """
    found = []
    for source, number in np.argwhere(worth).tolist():
        found += _around(source, number, images[source].place, bodies[number])
    return found


def _around(source: int, body: int, place: Array, points: Array) -> list[Grid]:
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - center, axis=1).max())
    towards = center - place
    distance = float(np.linalg.norm(towards))
    if distance < 1.5 * radius:
        return _cube(source, body, place, distance + radius)
    forward = towards / distance
    right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    # Tilted against the axes: rows of tubes parallel to an edge would all be cut alike.
    first = _TILT[0] * right + _TILT[1] * up
    second = _TILT[0] * up - _TILT[1] * right
    ray = points - place
    flat = ray * (distance / (ray @ forward))[:, None] @ np.stack([first, second], axis=1)
    return [
        Grid(source, body, center, forward, (first, second), flat.min(axis=0), flat.max(axis=0))
    ]


def _cube(source: int, body: int, place: Array, reach: float) -> list[Grid]:
    """The whole sphere of directions, for a radar inside a body or next to it."""
    half, found = np.full(2, reach), []
    for i, axis in enumerate(np.eye(3)):
        sides = (np.eye(3)[i - 2], np.eye(3)[i - 1])
        for way in (axis, -axis):
            found.append(Grid(source, body, place + reach * way, way, sides, -half, half))
    return found


def launch(found: Sequence[Grid], wavelength_m: float, most_rays: int) -> Launch:
    """Share the rays out: all grids equally dense in metres, but none very poor."""
    area = np.array([grid.area_m2 for grid in found])
    asked = wavelength_m / _PER_WAVELENGTH
    least = min(_LEAST_RAYS, max(most_rays // max(len(found), 1), 1))

    def spacings(common: float) -> Array:
        poor: Array = np.minimum(max(common, asked), np.sqrt(area / least))
        return np.maximum(poor, 1e-9)

    low, high = 1e-9, float(np.sqrt(area.max() / least)) + asked
    for _ in range(60):
        middle = np.sqrt(low * high)
        if (area / spacings(middle) ** 2).sum() > most_rays:
            low = middle
        else:
            high = middle
    spacing = spacings(high)
    rows, counts = [], []
    for grid, step in zip(found, spacing, strict=True):
        extent = (grid.high - grid.low) / step
        columns, lines = np.maximum(np.ceil(extent - 1e-6), 1).astype(np.int64)
        left, bottom = grid.low / step + 0.5 + (extent - (columns, lines)) / 2
        rows.append(
            [*grid.center, *grid.forward, *grid.axes[0], *grid.axes[1], step, left, bottom, columns]
        )
        counts.append(int(columns * lines))
    return Launch(
        numbers=np.array(rows, dtype=np.float64).reshape(-1, 16),
        source=np.array([g.source for g in found], dtype=np.uint32),
        body=np.array([g.body for g in found], dtype=np.uint32),
        rays=np.array(counts, dtype=np.int64),
        thinned=spacing / asked,
    )
