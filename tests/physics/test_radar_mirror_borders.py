"""The radar's own echo in a mirror, near the mirror's border and behind a post, by Kirchhoff."""

import numpy as np
import pytest
from scipy.special import erfc, fresnel

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, quad, world
from twin.radar.propagation.diffraction import mirrors
from twin.radar.propagation.solvers import trace

K = 2 * np.pi / WAVELENGTH_M
AWAY_M = 10.0


def wall(border_m: float):
    """4 m high and wide, up to a border at y."""
    low, high = (AWAY_M, -4.0, -2.0), (AWAY_M, border_m, 2.0)
    x, (y, z) = AWAY_M, zip(low[1:], high[1:], strict=True)
    return quad("wall", [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]])


def echo(*objects) -> complex:
    """Of the wall itself: what has no object."""
    paths = trace(world(*objects), RADAR).paths
    return sum(p.amplitude * np.exp(-2j * np.pi * (79e9 * p.delay_s % 1)) for p in paths)


def half_plane(edge: np.ndarray) -> np.ndarray:
    """Wave through all above an edge, in units of sqrt(wavelength R / 2), over that of all."""
    s, c = fresnel(edge)
    return (1 + 1j) / 2 * (0.5 - c - 1j * (0.5 - s))


@pytest.mark.parametrize("border_m", [0.1, 0.03, 0.005, -0.005, -0.03, -0.1])
def test_at_a_border_the_echo_is_a_knife_edges(border_m: float) -> None:
    """+1.1 to -14 dB, within 0.03 of the echo in a far larger wall, of which the other borders are
    most; one ray gave all or nothing.
    """
    ratio = echo(wall(border_m)) / echo(wall(4.0))
    opening = half_plane(np.array(-border_m / np.sqrt(WAVELENGTH_M * AWAY_M / 4)))
    assert abs(ratio - opening) < 0.03


def behind(post_m: float, width_m: float, places_m=(0.0,)) -> complex:
    """Past strips and their image in the mirror: the mirror's sum, brute force, across the
    strips.
    """
    zone = np.sqrt(WAVELENGTH_M * AWAY_M / 2)
    y = np.linspace(-9, 9, 18001) * zone
    scale = np.sqrt(2 / WAVELENGTH_M * AWAY_M / (post_m * (AWAY_M - post_m)))
    once = np.ones(len(y), dtype=complex)
    for middle_m in places_m:
        sides_m = middle_m - width_m / 2, middle_m + width_m / 2
        low, high = ((side_m - y * post_m / AWAY_M) * scale for side_m in sides_m)
        once += half_plane(high) - half_plane(low)
    weight = erfc((np.abs(y) / zone - 6) / 0.8) * np.exp(-1j * K * y**2 / AWAY_M)
    return complex((weight * once**2).sum() / weight.sum())


def post(post_m: float, width_m: float, middle_m: float = 0.0):
    """2 m high."""
    low, high = middle_m - width_m / 2, middle_m + width_m / 2
    corners = [[post_m, low, -1], [post_m, high, -1], [post_m, high, 1], [post_m, low, 1]]
    return quad(f"post at {middle_m:.3f}", corners)


@pytest.mark.parametrize(("post_m", "width_m"), [(5.0, 0.004), (5.0, 0.04), (3.0, 0.1), (8.0, 0.1)])
def test_a_post_dims_the_wall_behind_it(post_m: float, width_m: float) -> None:
    """-0.4 to -9 dB, within 0.05 of the echo without the post; one ray gave nothing."""
    ratio = echo(wall(4.0), post(post_m, width_m)) / echo(wall(4.0))
    assert abs(ratio - behind(post_m, width_m)) < 0.05


@pytest.mark.parametrize(("post_m", "width_m"), [(3.0, 0.1), (5.0, 0.04), (8.0, 0.1)])
def test_among_many_edges_the_integral_is_coarser(
    monkeypatch, post_m: float, width_m: float
) -> None:
    """A sixteenth of the points where edges are too many for all of them. It had been all or none,
    with a warning.
    """
    monkeypatch.setattr(mirrors, "_MOST_PAIRS", 2**14)
    found = trace(world(wall(4.0), post(post_m, width_m)), RADAR)
    assert not any("is not to be relied on" in text for text in found.warnings)
    ratio = echo(wall(4.0), post(post_m, width_m)) / echo(wall(4.0))
    assert abs(ratio - behind(post_m, width_m)) < 0.12


@pytest.mark.parametrize("posts", [4, 24])
def test_behind_a_fence_the_walls_echo_is_told_to_be_uncertain(posts: int) -> None:
    """Waves of posts far aside come back: by 24 posts the echo is off by 0.3 of the free one, and
    by four it is right, without a warning. Only more than 400 edges had been warned of.
    """
    places_m = (np.arange(posts) - (posts - 1) / 2) * 0.05
    fence = [post(4.0, 0.02, place_m) for place_m in places_m]
    found = trace(world(wall(4.0), *fence), RADAR)
    told = [text for text in found.warnings if "specular echo of wall may be off by" in text]
    error = abs(echo(wall(4.0), *fence) / echo(wall(4.0)) - behind(4.0, 0.02, places_m))
    assert len(told) == (posts > 4)
    assert error < (float(told[0].split("off by ")[1].split()[0]) if told else 0.02)


def test_a_label_takes_its_place_on_the_wall() -> None:
    """A sheet of 0.3 m in the wall's plane: its shadow takes off what it sends itself, within 15 %
    of the wall's echo; both had been added, 2.3 times the wall's echo.
    """
    alone = echo(wall(4.0))
    both = trace(world(wall(4.0), plate("label", (AWAY_M, 0, 0), 0.3)), RADAR)
    c = both.contributions
    total = np.sum(c.amplitude * np.exp(-2j * np.pi * (79e9 * c.delay_s % 1)))
    assert abs(total - alone) < 0.15 * abs(alone)


def test_where_a_surface_goes_on_there_is_no_border() -> None:
    """A wall of two halves side by side answers as one."""
    halves = echo(
        wall(0.02), quad("rest", [[10, 0.02, -2], [10, 4, -2], [10, 4, 2], [10, 0.02, 2]])
    )
    assert abs(halves / echo(wall(4.0)) - 1) < 0.03
