"""Moving scenes to measure motion compensation with: pictures and random scenes, eight samples a
cell, integrated exactly over each cell at each exposure's own time.

Pictures: those of `benchmarks.pictures`, over the field and 12 cells beyond it on each side; every
other one was looked at while knobs were chosen, the figures are of the rest. Random scenes: dead
leaves (Lee, Mumford and Huang, Int. J. Comput. Vision 41, 2001), discs over discs with radii of a
density 1/r^3, seeds 1000 and on. A lens blurs both by 0.3 cells (standard deviation).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures import NAMES
from hardware import PatternSet, SpiRecord
from hardware.patterns import hadamard_rows
from hardware.records import QuaternionPose

Array = NDArray[np.float64]

SIDE, BEYOND, SAMPLES, BLUR_CELLS = 64, 12, 8, 0.3
ELECTRONS = 1e5


@dataclass(frozen=True, eq=False)
class FineScene:
    """Light as constant in each sample: its integral from the corner, (n + 1, n + 1)."""

    integral: Array

    @classmethod
    def of(cls, samples: Array) -> "FineScene":
        """Of light 0 to 1, before the lens."""
        from scipy.ndimage import gaussian_filter

        light = gaussian_filter(samples, BLUR_CELLS * SAMPLES, mode="nearest")
        return cls(np.pad(light.cumsum(0).cumsum(1), ((1, 0), (1, 0))))

    def cells(self, down: float, right: float) -> Array:
        """Mean light of each cell, ``(SIDE, SIDE)``, when the scene has moved by so many cells."""
        edges = (np.arange(SIDE + 1) + BEYOND) * SAMPLES
        rows = _between(self.integral, edges - down * SAMPLES)
        corners = _between(rows.T, edges - right * SAMPLES).T
        return np.diff(np.diff(corners, axis=0), axis=1) / SAMPLES**2


@dataclass(frozen=True, eq=False)
class BoxedScene:
    """A box of one scene in front of another, which goes twice as far the other way.

    ``edges`` of the box at rest: top, left, bottom, right, cells, the first from -0.5 to 0.5.
    """

    behind: FineScene
    box: FineScene
    edges: tuple[float, float, float, float]

    def cells(self, down: float, right: float) -> Array:
        """Mean light of each cell when what is behind has moved by so many cells."""
        top, left, bottom, end = self.edges
        borders = np.arange(SIDE + 1) - 0.5
        rows = np.diff(np.clip(borders, top - 2 * down, bottom - 2 * down))
        columns = np.diff(np.clip(borders, left - 2 * right, end - 2 * right))
        share = np.outer(rows, columns)
        near = self.box.cells(-2 * down, -2 * right)
        return self.behind.cells(down, right) * (1 - share) + near * share


def _between(table: Array, at: Array) -> Array:
    place = np.clip(at, 0, len(table) - 1)
    before = np.minimum(place.astype(int), len(table) - 2)
    late = (place - before)[:, None]
    return table[before] * (1 - late) + table[before + 1] * late


def held_out_pictures() -> tuple[FineScene, ...]:
    """Every other picture."""
    import skimage
    from skimage import color, transform
    from skimage.io import imread

    size = (SIDE + 2 * BEYOND) * SAMPLES
    found = []
    for name in NAMES[1::2]:
        picture = imread(Path(skimage.__file__).parent / "data" / name)
        grey = color.rgb2gray(picture[..., :3]) if picture.ndim == 3 else picture / 255.0
        found.append(FineScene.of(transform.resize(grey, (size, size), anti_aliasing=True)))
    return tuple(found)


def dead_leaves(seed: int) -> FineScene:
    """Discs of radii from 1 to 24 cells, each in front of all before it."""
    rng = np.random.default_rng(seed)
    size = (SIDE + 2 * BEYOND) * SAMPLES
    image = np.full((size, size), 0.5)
    least, most = 1.0 * SAMPLES, 24.0 * SAMPLES
    for _ in range(3000):
        share = rng.random()
        radius = 1 / np.sqrt(1 / least**2 + share * (1 / most**2 - 1 / least**2))
        row, column = rng.uniform(-radius, size + radius, 2)
        light = rng.random()
        first, last = (
            np.clip([c - radius, c + radius + 1], 0, size).astype(int) for c in (row, column)
        )
        down, along = np.ogrid[first[0] : first[1], last[0] : last[1]]
        part = image[first[0] : first[1], last[0] : last[1]]
        part[(down - row) ** 2 + (along - column) ** 2 < radius**2] = light
    return FineScene.of(image)


def record_of(
    scene: FineScene | BoxedScene,
    patterns: PatternSet,
    moved_cells: tuple[float, float],
    noise: float,
    seed: int,
) -> SpiRecord:
    """A frame of 1 s within which the scene moves by so many cells, seen through differential
    patterns; ``noise`` of a cell of a full set's plain inverse.
    """
    rows, signs = patterns.exposures
    n = len(rows)
    time_ns = np.rint(1e9 * np.arange(n) / n).astype(np.int64)
    share = (np.arange(n) - (n - 1) / 2) / n
    light = np.empty(n)
    at_rest = scene.cells(0.0, 0.0).ravel()
    for start in range(0, n, 256):
        some = slice(start, start + 256)
        lit = hadamard_rows(rows[some], patterns.n_cells) * signs[some, None] > 0
        if any(moved_cells):
            fields = [
                scene.cells(moved_cells[0] * s, moved_cells[1] * s).ravel() for s in share[some]
            ]
            light[some] = np.einsum("ij,ij->i", lit, np.array(fields))
        else:
            light[some] = lit @ at_rest
    deviation = noise * np.sqrt(patterns.n_cells / 2)
    counts = ELECTRONS * (light + deviation * np.random.default_rng(seed).normal(size=n)) + 1e7
    return SpiRecord(
        counts=np.rint(counts).astype(np.int32)[:, None],
        device_time_ns=time_ns,
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        patterns=patterns,
        integration_time_s=1 / n,
        electrons_per_count=1.0,
        offset_counts=0.0,
        adc_bits=31,
        device="moving picture",
        pose=QuaternionPose(),
    )
