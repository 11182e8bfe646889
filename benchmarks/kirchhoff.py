"""Echoes of convex bodies behind black rectangular screens by brute force, to compare with.

Kirchhoff's field behind a screen by the integral along its rim (Maggi and Rubinowicz: Born and
Wolf, Principles of Optics, section 8.9), from a point at the origin, in float64; the echo by
physical optics of a perfect conductor, that field there and back, on triangles smaller than half a
wavelength, so that steps between them do not answer at right angles. It shares nothing with the
solver: no rays, no knife edges, no cells.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from twin.scene import SceneObject

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

_TRIANGLE_M = 1.4e-3  # at 79 GHz less than half a wavelength
_FINER = 14  # of triangles that a border divides, for the hard shadow
_PIECE = 1.25  # of the rim, with 4 points each, over what is near
_FAR_FROM_BORDER_M = 3e-3  # the same where no place is near a border, of edges of 2 m
_AT_ONCE = 200  # places
#: Nearer to a border the rim's integrand is too sharp: the field, which is smooth across it, is
#: interpolated between places so many times as far away, none near the border across.
_NEAR_M, _OF_WIDTH = 4e-3, 1 / 7
_BESIDE = np.array([-4.5, -3.0, -1.5, 1.5, 3.0, 4.5])


@dataclass(frozen=True)
class Echo:
    """Of a body at one frequency, over the antennas' factor: with hard shadows, and in full."""

    lit: complex
    whole: complex


def echo_behind(
    body: SceneObject,
    screens: Sequence[Array],
    wavenumber: float,
    gain: Callable[[Array], Array] | None = None,
    triangle_m: float = _TRIANGLE_M,
    field_at: Callable[[Array], Complex] | None = None,
) -> Echo:
    """Of a closed convex body behind screens, each of four corners (4, 3), all in one plane;
    ``gain`` of directions (n, 3), in amplitude there and back; ``field_at`` places (n, 3) over the
    straight wave, where screens are not in one plane.
    """
    corners = _front(body)
    parts = divided(corners, triangle_m)
    wave = _waves(parts, wavenumber, gain)
    middle, is_lit = parts.mean(axis=1), np.ones(len(parts), dtype=bool)
    if field_at is None:
        field = 1 - sum(1 - field_behind(s, middle, wavenumber) for s in screens)  # Babinet
    else:
        field = field_at(middle)
    mixed = np.zeros(len(parts), dtype=bool)
    for screen in screens:
        is_hidden = hides(screen, parts.reshape(-1, 3)).reshape(-1, 3)
        mixed |= is_hidden.any(axis=1) & ~is_hidden.all(axis=1)
        is_lit &= ~hides(screen, middle)
    fine = divided(parts[mixed], triangle_m / _FINER)
    seen = np.ones(len(fine), dtype=bool)
    for screen in screens:
        seen &= ~hides(screen, fine.mean(axis=1))
    at_borders = np.sum(_waves(fine, wavenumber, gain)[seen])
    return Echo(
        complex(np.sum(wave[is_lit & ~mixed]) + at_borders), complex(np.sum(wave * field**2))
    )


def field_behind(screen: Array, places: Array, wavenumber: float) -> Complex:
    """Over the straight wave, at places (n, 3) that are not in the screen's plane."""
    width = min(float(np.linalg.norm(screen[n] - screen[0])) for n in (1, 3))
    beyond = float(np.linalg.norm(places, axis=1).min() / np.linalg.norm(screen, axis=1).max())
    near_m = min(_NEAR_M, _OF_WIDTH * width * beyond)
    sides = np.stack([screen, np.roll(screen, -1, axis=0)], axis=1)
    return _beside_borders(sides, screen, places, wavenumber, near_m)


def _beside_borders(
    sides: Array, screen: Array, places: Array, wavenumber: float, near_m: float
) -> Complex:
    """The same, between places farther away from the borders of some sides (n, 2, 3) where they are
    near these.
    """
    if not len(sides):
        return _by_rim(screen, places, wavenumber, _PIECE * near_m)
    (begin, end), others = sides[0], sides[1:]
    across = np.cross(screen[1] - screen[0], screen[3] - screen[0])
    met = places * ((screen[0] @ across) / (places @ across))[:, None]
    normal = np.cross(begin, end) / np.linalg.norm(np.cross(begin, end))
    length = float(np.linalg.norm(end - begin))
    off, at = places @ normal, (met - begin) @ (end - begin) / length
    is_near = (np.abs(off) < near_m) & (at > -near_m) & (at < length + near_m)
    field = np.zeros(len(places), dtype=complex)
    if not is_near.all():
        field[~is_near] = _beside_borders(others, screen, places[~is_near], wavenumber, near_m)
    if not is_near.any():
        return field
    nodes, near = near_m * _BESIDE, places[is_near]
    for number, node in enumerate(nodes):
        rest = np.delete(nodes, number)
        weight = np.prod((off[is_near, None] - rest) / (node - rest), axis=1)
        moved = near + (node - off[is_near])[:, None] * normal
        field[is_near] += weight * _beside_borders(others, screen, moved, wavenumber, near_m)
    return field


def field_past(edge: Array, screen: Array, places: Array, wavenumber: float) -> Complex:
    """Over the straight wave, at places (n, 3) behind half a plane and far from the border of its
    shadow: that of a ``screen``, (4, 3), beyond one ``edge`` (2, 3) of it, as if both went on.
    """
    at, along = _rim_of(edge, _FAR_FROM_BORDER_M)
    middle, half = edge.mean(axis=0), (edge[1] - edge[0]) / 2
    beyond = np.abs((at - middle) @ half) / (half @ half)
    # What the ends would send is taken off them smoothly.
    along = along * np.cos(np.pi / 2 * np.clip(2 * beyond - 1, 0, 1))[:, None] ** 2
    inward = screen.mean(axis=0) - middle
    across = np.cross(half, inward)
    met = places * ((middle @ across) / (places @ across))[:, None]
    is_hidden = (met - middle) @ inward > 0
    return np.asarray(1 - is_hidden - _by_waves(at, along, places, wavenumber))


def interpolated(
    field: Callable[[Array], Complex], center: Array, half_m: float, shape: tuple[int, int, int]
) -> Callable[[Array], Complex]:
    """A field over the straight wave to within a distance of a center, from a grid of so many
    places, at least 4 each, along the straight wave and across it.
    """
    axes = [np.linspace(-half_m, half_m, count) for count in shape]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    share = 1 + x / center[0]
    places = np.stack([center[0] + x, (center[1] + y) * share, (center[2] + z) * share], axis=-1)
    every = field(places.reshape(-1, 3)).reshape(shape)
    between = RegularGridInterpolator(axes, every, method="cubic")

    def field_at(targets: Array) -> Complex:
        share = targets[:, :1] / center[0]
        off = targets / share - center
        off[:, 0] = targets[:, 0] - center[0]
        return np.asarray(between(off))

    return field_at


def hides(screen: Array, places: Array) -> Flags:
    """Whether a screen is in the way from the origin to places, (n,)."""
    one, other = screen[1] - screen[0], screen[3] - screen[0]
    across = np.cross(one, other)
    share = (screen[0] @ across) / (places @ across)
    met = places * share[:, None] - screen[0]
    along, up = met @ one / (one @ one), met @ other / (other @ other)
    inside = (along > 0) & (along < 1) & (up > 0) & (up < 1)
    return np.asarray(inside & (share > 0) & (share < 1))


def _by_rim(screen: Array, places: Array, wavenumber: float, piece_m: float) -> Complex:
    """1 less the field behind a hole of the screen's shape: that of geometrical optics and of the
    rim.
    """
    sides = zip(screen, np.roll(screen, -1, axis=0), strict=True)
    parts = [_rim_of(np.array(side), piece_m) for side in sides]
    at, along = (np.concatenate(column) for column in zip(*parts, strict=True))
    return np.asarray(1 - hides(screen, places) - _by_waves(at, along, places, wavenumber))


def _by_waves(at: Array, along: Array, places: Array, wavenumber: float) -> Complex:
    """Of a rim at points (n, 3) that stand for vectors along it, over the straight wave."""
    there = np.linalg.norm(at, axis=1)
    unit = at / there[:, None]
    rim: Complex = np.empty(len(places), dtype=complex)
    for first in range(0, len(places), _AT_ONCE):
        some = places[first : first + _AT_ONCE]
        back = at - some[:, None]
        distance, straight = np.linalg.norm(back, axis=2), np.linalg.norm(some, axis=1)
        back /= distance[..., None]
        turn = np.einsum("ijk,jk->ij", np.cross(back, unit), along)
        turn /= 1 + np.einsum("ijk,jk->ij", back, unit)
        longer = there + distance - straight[:, None]
        wave = np.exp(-1j * wavenumber * longer) / (there * distance) * turn
        rim[first : first + _AT_ONCE] = wave.sum(axis=1) * straight / (4 * np.pi)
    return rim


def _rim_of(edge: Array, piece_m: float) -> tuple[Array, Array]:
    """Points (n, 3) along an edge (2, 3), and what each stands for, as vectors along it."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    side = edge[1] - edge[0]
    n = max(int(np.ceil(np.linalg.norm(side) / piece_m)), 2)
    at = ((np.arange(n)[:, None] + (nodes + 1) / 2) / n).ravel()
    return edge[0] + at[:, None] * side, np.tile(weights / 2 / n, n)[:, None] * side


def _front(body: SceneObject) -> Array:
    """Triangles (n, 3, 3) of a convex body that face the origin."""
    corners = body.vertices_m[body.geometry.faces]
    a, b, c = corners.swapaxes(0, 1)
    normal, middle = np.cross(b - a, c - a), corners.mean(axis=1)
    outward = np.sign(np.sum(normal * (middle - body.vertices_m.mean(axis=0)), axis=1))
    return np.asarray(corners[outward * np.sum(normal * middle, axis=1) < 0])


def divided(corners: Array, size_m: float) -> Array:
    """Triangles (n, 3, 3) in as many equal ones as needed, (m, 3, 3)."""
    found = [np.zeros((0, 3, 3))]
    for a, b, c in corners:
        longest = max(np.linalg.norm(x) for x in (b - a, c - b, a - c))
        n = max(int(np.ceil(longest / size_m)), 1)
        i, j = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        i, j = i[i + j < n], j[i + j < n]
        one, other = (b - a) / n, (c - a) / n
        corner = a + i[:, None] * one + j[:, None] * other
        found.append(np.stack([corner, corner + one, corner + other], axis=1))
        corner = corner[i + j < n - 1] + one + other
        found.append(np.stack([corner, corner - one, corner - other], axis=1))
    return np.concatenate(found)


def _waves(corners: Array, wavenumber: float, gain: Callable[[Array], Array] | None) -> Complex:
    """Echoes of triangles: exact for a linear phase across each, by Gordon's integral along its
    longest side.
    """
    a, b, c = corners.swapaxes(0, 1)
    middle = corners.mean(axis=1)
    distance = np.linalg.norm(middle, axis=1)
    towards = middle / np.maximum(distance, 1e-300)[:, None]
    level = np.abs(np.sum(np.cross(b - a, c - a) / 2 * towards, axis=1)) / distance**2
    if gain is not None:
        level = level * gain(towards)
    phase = -2 * wavenumber * np.einsum("nci,ni->nc", corners - middle[:, None], towards)
    return np.asarray(level * mean_over(phase) * np.exp(-2j * wavenumber * distance))


def mean_over(phase: Array) -> Complex:
    """Means of exp(j phase) over triangles whose phases at the corners, (n, 3), add up to 0."""
    low, mid, high = np.sort(phase, axis=1).T
    is_flat = high - low < 2e-2
    span = np.where(is_flat, 1.0, high - low)
    mean = 2 * (_along(mid, high) - _along(low, mid)) / (1j * span)
    return np.asarray(np.where(is_flat, 1 - np.sum(phase**2, axis=1) / 24, mean))


def _along(one: Array, other: Array) -> Complex:
    """Mean of exp(j phase) from one phase to another."""
    return np.asarray(np.exp(0.5j * (one + other)) * np.sinc((other - one) / (2 * np.pi)))
