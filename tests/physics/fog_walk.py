"""A float64 random walk of light through fog to a striped wall and back, every order of scattering.

Independent of the twin: its own geometry, phase function, inversion and estimator, in NumPy. Light
that touches the wall goes there on one walk and back on another, which know nothing of each other
where the wall is Lambertian. So the way back is walked from the detector's pinhole, by reciprocity,
to a map of what it gathers from each place on the wall; and every hit of the wall by a walk from
the emitter scores reflectance x map / pi, then is reflected and goes on. No connection through the
air is made anywhere, and so nothing is singular.
"""

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Fog:
    """Extinction 1/m, single-scattering albedo, and two lobes after Henyey and Greenstein: mean
    cosine of each and the second one's share.
    """

    extinction_per_m: float
    albedo: float
    forward: float
    backward: float
    share: float


@dataclass(frozen=True)
class Bench:
    """Square fields of one half width (tangent) from emitter and detector, the detector a baseline
    to the left of it, an endless wall across; ``n`` cells along a field.
    """

    distance_m: float
    baseline_m: float
    tan: float
    n: int
    bright: float
    dark: float

    def stripes(self, tangent: Array, width: int) -> Array:
        """Whether a place on the wall is bright: stripes of ``width`` cells, the first from the
        left is.
        """
        return np.floor((1 - tangent / self.tan) / 2 * self.n / width).astype(int) % 2 == 0


_ORDERS = 60  # scatterings and reflections after which a walk is given up


def stripes_in_fog(
    fog: Fog, bench: Bench, widths: tuple[int, ...], *, walks: int, seed: int, inner: float = 0.75
) -> Array:
    """Light of bright and of dark stripes over that of bright ones in clear air, (n_widths, 2).

    Mean over the cells in the ``inner`` part of the field. Light that has touched the wall.
    """
    rng = np.random.default_rng(seed)
    gathered = _gathered(fog, bench, walks, rng)
    left, up = rng.uniform(-inner, inner, (2, walks)) * bench.tan
    cos = (1 + left**2 + up**2) ** -0.5
    tones = np.array([bench.stripes(left, width) for width in widths])
    clear = bench.bright * cos**3 * _straight(bench, left, up, 0.0)
    found = np.zeros((len(widths), walks))
    reflected = np.ones((len(widths), walks))
    for walk, place, weight in _hits(fog, bench, left, up, rng, reflects=True):
        wall = place[:, 1:] / bench.distance_m
        for i, width in enumerate(widths):
            tone = bench.stripes(wall[:, 0], width)
            reflected[i, walk] *= np.where(tone, bench.bright, bench.dark)
            found[i, walk] += reflected[i, walk] * cos[walk] ** 3 * weight * gathered(wall)
    return np.array(
        [
            [light[tone].mean() / clear.mean(), light[~tone].mean() / clear.mean()]
            for light, tone in zip(found, tones, strict=True)
        ]
    )


def wall_in_fog(fog: Fog, bench: Bench, emitter_tan: float, *, walks: int, seed: int) -> float:
    """Light of a wall of one tone (``bright``) that is reflected once, in 1/m^2: irradiance on the
    pupil per radiant intensity. The bench's field is the detector's; the emitter has its own.
    """
    rng = np.random.default_rng(seed)
    gathered = _gathered(fog, bench, walks, rng)
    left, up = rng.uniform(-1, 1, (2, walks)) * emitter_tan
    start = (2 * emitter_tan) ** 2 / walks * (1 + left**2 + up**2) ** -1.5
    total = 0.0
    for walk, place, weight in _hits(fog, bench, left, up, rng, reflects=False):
        total += float(start[walk] @ (weight * gathered(place[:, 1:] / bench.distance_m)))
    return bench.bright / np.pi * total


def _straight(bench: Bench, left: Array, up: Array, extinction_per_m: float) -> Array:
    """What the detector gathers straight from a place on the wall: cosines by squared distance."""
    across = left - bench.baseline_m / bench.distance_m
    inside = (np.abs(across) <= bench.tan) & (np.abs(up) <= bench.tan)
    distance = bench.distance_m * np.sqrt(1 + across**2 + up**2)
    cos = bench.distance_m / distance
    return inside * cos**2 / distance**2 * np.exp(-extinction_per_m * distance)


def _gathered(fog: Fog, bench: Bench, walks: int, rng: np.random.Generator):
    """The same with all that is scattered on the way: a function of places, tangents (n, 2)."""
    bins, reach = 48, 3 * bench.tan
    left, up = rng.uniform(-1, 1, (2, walks)) * bench.tan
    # A Lambertian pupil: cosine times solid angle, cos^4 by area of the field.
    start = (2 * bench.tan) ** 2 / walks * (1 + left**2 + up**2) ** -2
    sums = np.zeros((bins, bins))
    for walk, place, weight in _hits(fog, bench, left, up, rng, reflects=False, scattered=True):
        wall = place[:, 1:] / bench.distance_m
        at = np.floor((wall + reach) / (2 * reach) * bins).astype(int)
        here = ((at >= 0) & (at < bins)).all(axis=1)
        np.add.at(sums, tuple(at[here].T), (start[walk] * weight)[here])
    per_area = sums / (2 * reach * bench.distance_m / bins) ** 2

    def gathered(wall: Array) -> Array:
        across = wall - [bench.baseline_m / bench.distance_m, 0.0]
        at = np.floor((across + reach) / (2 * reach) * bins).astype(int)
        here = ((at >= 0) & (at < bins)).all(axis=1)
        at = np.clip(at, 0, bins - 1)
        halo = np.where(here, per_area[at[:, 0], at[:, 1]], 0.0)
        return halo + _straight(bench, wall[:, 0], wall[:, 1], fog.extinction_per_m)

    return gathered


def _hits(
    fog: Fog,
    bench: Bench,
    left: Array,
    up: Array,
    rng: np.random.Generator,
    *,
    reflects: bool,
    scattered: bool = False,
):
    """Every hit of the wall by walks from a pinhole: which walks, where (n, 3), and their weights.

    ``scattered``: without those that came straight. Walls that do not reflect end a walk.
    """
    walk = np.arange(len(left))
    direction = np.stack([np.ones_like(left), left, up], axis=1)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    place, weight = np.zeros((len(left), 3)), np.ones(len(left))
    for order in range(_ORDERS):
        path = rng.exponential(1 / fog.extinction_per_m, len(walk))
        ahead = direction[:, 0] > 1e-9
        to_wall = np.full(len(walk), np.inf)
        to_wall[ahead] = (bench.distance_m - place[ahead, 0]) / direction[ahead, 0]
        hit = to_wall <= path
        place = place + np.minimum(path, to_wall)[:, None] * direction
        if order or not scattered:
            yield walk[hit], place[hit], weight[hit]
        direction = np.where(
            hit[:, None], _reflected(len(walk), rng), _scattered(fog, direction, rng)
        )
        weight = np.where(hit, weight, weight * fog.albedo)
        place[hit, 0] = bench.distance_m
        on = (place[:, 0] > -3 / fog.extinction_per_m) & (reflects | ~hit)
        walk, place, direction, weight = walk[on], place[on], direction[on], weight[on]
        if not len(walk):
            return


def _reflected(n: int, rng: np.random.Generator) -> Array:
    """Directions from a Lambertian wall, back."""
    sine2, angle = rng.random(n), rng.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(sine2)
    return np.stack([-np.sqrt(1 - sine2), sine * np.cos(angle), sine * np.sin(angle)], axis=1)


def _scattered(fog: Fog, direction: Array, rng: np.random.Generator) -> Array:
    n = len(direction)
    g = np.where(rng.random(n) < fog.share, fog.backward, fog.forward)
    base = (1 - g**2) / (1 - g + 2 * g * rng.random(n))
    cos = (1 + g**2 - base**2) / (2 * g)
    sine, angle = np.sqrt(np.maximum(1 - cos**2, 0)), rng.uniform(0, 2 * np.pi, n)
    helper = np.where(np.abs(direction[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    one = np.cross(direction, helper)
    one /= np.linalg.norm(one, axis=1)[:, None]
    other = np.cross(direction, one)
    aside = np.cos(angle)[:, None] * one + np.sin(angle)[:, None] * other
    return cos[:, None] * direction + sine[:, None] * aside
