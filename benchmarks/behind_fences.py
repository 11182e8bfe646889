"""The radar's own echo in a wall behind a fence: how far it is off, and whether that is told.

The truth is the sum over the wall's plane of the square of the wave that arrives there, by brute
force across posts that are taken as endless; the fences are random ones, 2 m high.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, fresnel

from benchmarks.radar_estimates import scene_of_objects
from benchmarks.timing import Figure
from twin.geometry import Geometry
from twin.radar import RadarDesign, load_radar
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

AWAY_M = 10.0  # the wall
_FENCES, _SEED = 40, 5
_TOLD = 0.1  # of the free echo, from which on an error is to be told
_REACH, _FADE, _PLACES = 6.0, 0.8, 18001  # of the sum, in radii of the first Fresnel zone


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    radar = load_radar("hybrid-79")
    free = echo_and_warnings(radar, [wall(4.0)])[0]
    rng, errors, told = np.random.default_rng(_SEED), [], []
    for number in range(_FENCES):
        post_m, pitch_m = rng.uniform(2, 9), np.exp(rng.uniform(np.log(0.03), np.log(0.25)))
        width_m = pitch_m * rng.uniform(0.1, 0.7)
        count = int(np.exp(rng.uniform(np.log(2), np.log(40))))
        places_m = (np.arange(count) - (count - 1) / 2) * pitch_m + rng.uniform(-0.2, 0.2)
        posts = [post(post_m, width_m, place_m) for place_m in places_m.tolist()]
        echo, warnings = echo_and_warnings(radar, [wall(4.0), *posts])
        truth = past_posts(post_m, width_m, places_m.tolist(), radar.ofdm.wavelength_m)
        errors.append(abs(echo / free - truth))
        told.append(any("specular echo of wall" in text for text in warnings))
        what = f"fence {number}, {count} posts at {post_m:.2f} m, {1e3 * pitch_m:.0f} mm apart"
        yield f"{what}: error over the free echo", errors[-1], ""
        yield f"{what}: told", float(told[-1]), ""
    is_off, is_told = np.array(errors) > _TOLD, np.array(told)
    yield f"fences off by more than {_TOLD}", float(is_off.sum()), ""
    yield "of these told", float((is_off & is_told).sum()), ""
    yield "others told", float((~is_off & is_told).sum()), ""
    yield "worst error over the free echo", float(max(errors)), ""
    yield "worst of those not told", float(np.max(np.array(errors)[~is_told])), ""


def past_posts(
    post_m: float, width_m: float, places_m: Sequence[float], wavelength_m: float
) -> complex:
    """The wall's echo past posts at a distance over that without them."""
    zone = np.sqrt(wavelength_m * AWAY_M / 2)
    y = np.linspace(-1.5, 1.5, _PLACES) * _REACH * zone
    scale = np.sqrt(2 / wavelength_m * AWAY_M / (post_m * (AWAY_M - post_m)))
    once = np.ones(len(y), dtype=complex)
    for middle_m in places_m:
        sides_m = middle_m - width_m / 2, middle_m + width_m / 2
        low, high = ((side_m - y * post_m / AWAY_M) * scale for side_m in sides_m)
        once += half_plane(high) - half_plane(low)
    weight = erfc((np.abs(y) / zone - _REACH) / _FADE)
    weight = weight * np.exp(-2j * np.pi / wavelength_m * y**2 / AWAY_M)
    return complex((weight * once**2).sum() / weight.sum())


def half_plane(edge: Array) -> Complex:
    """Wave through all above an edge, in units of sqrt(wavelength R / 2), over that of all."""
    s, c = fresnel(edge)
    return np.asarray((1 + 1j) / 2 * (0.5 - c - 1j * (0.5 - s)))


def wall(border_m: float) -> SceneObject:
    """4 m high, up to a border at y."""
    return _upright("wall", AWAY_M, (-4.0, border_m), 2.0)


def post(post_m: float, width_m: float, middle_m: float = 0.0) -> SceneObject:
    """2 m high."""
    sides_m = middle_m - width_m / 2, middle_m + width_m / 2
    return _upright(f"post at {middle_m:.3f}", post_m, sides_m, 1.0)


def _upright(name: str, x_m: float, y_m: tuple[float, float], high_m: float) -> SceneObject:
    (low, high), h = y_m, high_m
    corners = np.array([[x_m, low, -h], [x_m, high, -h], [x_m, high, h], [x_m, low, h]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return SceneObject(name, Geometry(corners, faces), "metal", 0.5)


def echo_and_warnings(
    radar: RadarDesign, objects: Sequence[SceneObject]
) -> tuple[complex, tuple[str, ...]]:
    """Of the wall itself, at the carrier: what has no object."""
    found = trace(scene_of_objects(list(objects)), radar)
    carrier_hz = radar.ofdm.carrier_hz
    waves = (p.amplitude * np.exp(-2j * np.pi * (carrier_hz * p.delay_s % 1)) for p in found.paths)
    return complex(sum(waves)), found.warnings
