"""Convex bodies behind a black screen over a metal ground: echoes by brute force to compare with.

The ground is a mirror: by image theory it is left out, and what it shows is there instead, the
radar's image below it and the screen's. Behind both screens, the real one and the mirrored one, is
the field of `benchmarks.kirchhoff` from either place. The echo is that of physical optics of a
perfect conductor, by every pair of places, on triangles smaller than half a wavelength.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.kirchhoff import divided, field_behind, field_past, hides, interpolated, mean_over
from benchmarks.radar_estimates import thing
from twin.scene import SceneObject

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The radar itself and its image below the ground.
PAIRS = (0, 0), (0, 1), (1, 1)

_TRIANGLE_M = 1.4e-3  # at 79 GHz less than half a wavelength
_BESIDE_M = 4.0  # that the ground goes on beyond a body
_NEXT_TO_M = 0.01  # of the ground, above which a screen that does not stand on it ends
_WAVELENGTH_M = 3.8e-3  # that screens which hide bodies are made for
_OPEN = 1.0  # least height of an opening below a screen, over the radius of that zone
_WIDE_M = 20.0  # of a screen, to either side, that hides a body on all ways
_COUNTS_M = 1.0  # of its edge, to either side
_GRID = 5, 5, 129  # of places that the field is computed at there


class Echoes(NamedTuple):
    """Of a body by one pair of places: without the screen, with hard shadows, and in full."""

    free: complex
    lit: complex
    whole: complex


@dataclass(frozen=True)
class OverGround:
    """A body behind an upright screen, (4, 3), over a ground this far below the radar; of a wide
    screen's rim the edge across the ways alone counts.
    """

    body: SceneObject
    screen: Array
    below_m: float
    is_wide: bool = False

    @staticmethod
    def random(seed: int) -> "OverGround":
        """A box or a ball behind a screen that stands on the ground, hangs above it, or ends beside
        the ways; by its top or its middle near the direct way or that over the ground.
        """
        rng = np.random.default_rng([seed, 77])
        below_m, far_m = rng.uniform(0.2, 0.6), rng.uniform(4.0, 10.0)
        size = rng.uniform(0.04, 0.1)
        mesh = trimesh.creation.icosphere(4, radius=size / 2)
        if rng.random() < 0.5:
            mesh = trimesh.creation.box(size * rng.uniform(0.6, 1.5, 3))
            mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        center = np.array([far_m, rng.uniform(-0.3, 0.3), rng.uniform(0.06, 0.5) - below_m])
        share = rng.uniform(0.3, 0.8)
        direct = center[2] * share
        mirrored = abs((center[2] + 2 * below_m) * share - below_m) - below_m
        kind, wide, y = rng.integers(3), rng.uniform(0.1, 0.5), center[1] * share
        way = direct if rng.random() < 0.5 else mirrored
        if kind == 0:
            top = max(way + rng.uniform(-0.06, 0.06), 0.03 - below_m)
            sides, ends = (y - wide, y + wide), (-below_m, top)
        elif kind == 1:
            middle, half = way + rng.uniform(-0.05, 0.05), rng.uniform(0.03, 0.15)
            low = max(middle - half, _NEXT_TO_M - below_m)
            sides, ends = (y - wide, y + wide), (low, middle + half)
        else:
            edge = y + rng.uniform(-0.05, 0.05)
            sides, ends = (edge, edge + wide), (-below_m, rng.uniform(0.1, 0.5))
        body = thing("body", mesh.vertices + center, mesh.faces)
        return OverGround(body, _upright(far_m * share, sides, ends), below_m)

    @staticmethod
    def hidden(seed: int) -> "OverGround":
        """A ball behind a wide screen that stands on the ground or hangs above it: up to four radii
        of the first Fresnel zone beyond its edge on both ways, and where it hangs open by one at
        least.
        """
        rng = np.random.default_rng([seed, 78])
        while True:
            below_m, far_m, share = (rng.uniform(*x) for x in ((0.4, 0.9), (6.0, 12.0), (0.3, 0.8)))
            height = rng.uniform(0.3, 0.9)
            ways = below_m + share * (height - below_m), abs(share * (height + below_m) - below_m)
            zone_m = np.sqrt(_WAVELENGTH_M * far_m * share * (1 - share))
            beyond_m = rng.uniform(0.1, 4.0) * zone_m
            stands = rng.random() < 0.5
            edge_m = max(ways) + beyond_m if stands else min(ways) - beyond_m
            if edge_m > _OPEN * zone_m:
                break
        ends = (-below_m, edge_m - below_m) if stands else (edge_m - below_m, _WIDE_M)
        mesh = trimesh.creation.icosphere(4, radius=rng.uniform(0.05, 0.12))
        body = thing("body", mesh.vertices + [far_m, 0, height - below_m], mesh.faces)
        screen = _upright(far_m * share, (-_WIDE_M, _WIDE_M), ends)
        return OverGround(body, screen, below_m, is_wide=True)

    @property
    def objects(self) -> list[SceneObject]:
        """The body, the ground, and last the screen."""
        far_m, z = float(self.body.vertices_m[:, 0].max()) + _BESIDE_M, -self.below_m
        ground = [[-2, -8, z], [far_m, -8, z], [far_m, 8, z], [-2, 8, z]]
        quads = {"ground": np.array(ground), "screen": self.screen}
        roles = {"ground": "surface", "screen": "obstacle"}
        return [
            self.body,
            *(
                replace(thing(name, corners, [[0, 1, 2], [0, 2, 3]]), radar=roles[name])
                for name, corners in quads.items()
            ),
        ]

    def echoes(
        self, wavenumber: float, gain: Callable[[Array], Array]
    ) -> dict[tuple[int, int], Echoes]:
        """By the radar and its image, without what the ground's metal does to the sign, and one way
        of two alone; ``gain`` of directions (n, 3), in amplitude there and back.
        """
        ends = [self._place(number) for number in (0, 1)]
        parts, is_facing = _facing(self.body, ends)
        middle = parts.mean(axis=1)
        ways = [end - middle for end in ends]
        lengths = [np.linalg.norm(way, axis=1) for way in ways]
        units = [way / length[:, None] for way, length in zip(ways, lengths, strict=True)]
        sent = [gain(-units[0]), gain(-units[1] * [1, 1, -1])]
        fields = [self._field(number, middle, wavenumber) for number in (0, 1)]
        is_lit = [self._is_lit(number, middle) for number in (0, 1)]
        a, b, c = parts.swapaxes(0, 1)
        across = np.cross(b - a, c - a) / 2
        found = {}
        for i, j in PAIRS:
            both = units[i] + units[j]
            level = np.abs(np.sum(across * both, axis=1)) / 2 / (lengths[i] * lengths[j])
            level *= np.sqrt(sent[i] * sent[j]) * (is_facing[i] & is_facing[j])
            phase = wavenumber * np.einsum("nci,ni->nc", parts - middle[:, None], both)
            turn = np.exp(-1j * wavenumber * (lengths[i] + lengths[j]))
            wave = level * mean_over(phase) * turn
            shares = 1.0, is_lit[i] & is_lit[j], fields[i] * fields[j]
            found[i, j] = Echoes(*(complex(np.sum(wave * share)) for share in shares))
        return found

    def _place(self, number: int) -> Array:
        return np.array([0.0, 0.0, -2 * self.below_m * number])

    @property
    def _stands(self) -> bool:
        return bool(np.isclose(self.screen[0, 2], -self.below_m))

    @property
    def _shown(self) -> Array:
        """The screen's image in the ground, corner by corner."""
        return self.screen * [1, 1, -1] + self._place(1)

    def _screens(self, number: int) -> list[Array]:
        """As the radar or its image sees them, relative to it: from the radar too, the ground shows
        a screen, whose wave meets the ground before and behind it.
        """
        if self._stands:
            return [np.concatenate([self._shown[[3, 2]], self.screen[2:]]) - self._place(number)]
        return [self.screen - self._place(number), self._shown[::-1] - self._place(number)]

    def _field(self, number: int, places: Array, wavenumber: float) -> Complex:
        """Over the straight wave at places (n, 3), by Babinet's principle."""
        at = places - self._place(number)
        if self.is_wide:
            return self._past_edges(number, at, wavenumber)
        behind = [field_behind(s, at, wavenumber) for s in self._screens(number)]
        return 1 - sum((1 - one for one in behind), start=0j)

    def _past_edges(self, number: int, at: Array, wavenumber: float) -> Complex:
        """Of a wide screen: past its edge and past that which the ground shows, from the radar too,
        whose wave then meets the ground before and behind it.
        """
        both = self.screen - self._place(number), self._shown[::-1] - self._place(number)
        edges = (2, 0) if self._stands else (0, 2)
        short = np.array([1.0, _COUNTS_M / _WIDE_M, 1.0])

        def field(places: Array) -> Complex:
            parts = [
                field_past(screen[first : first + 2] * short, screen, places, wavenumber)
                for screen, first in zip(both, edges, strict=True)
            ]
            return parts[0] + parts[1] - (not self._stands)

        low, high = at.min(axis=0), at.max(axis=0)
        return interpolated(field, (low + high) / 2, 0.6 * float((high - low).max()), _GRID)(at)

    def _is_lit(self, number: int, places: Array) -> NDArray[np.bool_]:
        at = places - self._place(number)
        return ~np.any([hides(s, at) for s in self._screens(number)], axis=0)


def _upright(x: float, y: tuple[float, float], z: tuple[float, float]) -> Array:
    corners = [(i, j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return np.array([[x, y[i], z[j]] for i, j in corners])


def _facing(body: SceneObject, places: list[Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Small triangles (n, 3, 3) of a convex body that face any of some places, and which of these,
    (n_places, n).
    """
    corners = body.vertices_m[body.geometry.faces]
    a, b, c = corners.swapaxes(0, 1)
    normal, middle = np.cross(b - a, c - a), corners.mean(axis=1)
    outward = np.sign(np.sum(normal * (middle - body.vertices_m.mean(axis=0)), axis=1))
    heights = [outward * np.sum(normal * (place - middle), axis=1) for place in places]
    parts, facing = [], []
    for sides in np.unique(np.array(heights) > 0, axis=1).T:
        some = divided(
            corners[((np.array(heights) > 0) == sides[:, None]).all(axis=0)], _TRIANGLE_M
        )
        if sides.any():
            parts.append(some)
            facing.append(np.tile(sides[:, None], len(some)))
    return np.concatenate(parts), np.concatenate(facing, axis=1)
