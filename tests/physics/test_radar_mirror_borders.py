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


def two_screens(post_m: float, width_m: float) -> complex:
    """Past a strip and its image in the mirror: the mirror's sum, brute force, across the strip."""
    zone = np.sqrt(WAVELENGTH_M * AWAY_M / 2)
    y = np.linspace(-6, 6, 6001) * zone
    scale = np.sqrt(2 / WAVELENGTH_M * AWAY_M / (post_m * (AWAY_M - post_m)))
    low, high = ((edge - y * post_m / AWAY_M) * scale for edge in (-width_m / 2, width_m / 2))
    once = 1 - half_plane(low) + half_plane(high)
    weight = erfc((np.abs(y) / zone - 4) / 0.6) * np.exp(-1j * K * y**2 / AWAY_M)
    return complex((weight * once**2).sum() / weight.sum())


@pytest.mark.parametrize(("post_m", "width_m"), [(5.0, 0.004), (5.0, 0.04), (3.0, 0.1), (8.0, 0.1)])
def test_a_post_dims_the_wall_behind_it(post_m: float, width_m: float) -> None:
    """-0.4 to -9 dB, within 0.05 of the echo without the post; one ray gave nothing."""
    h = width_m / 2
    corners = [[post_m, -h, -1], [post_m, h, -1], [post_m, h, 1], [post_m, -h, 1]]
    ratio = echo(wall(4.0), quad("post", corners)) / echo(wall(4.0))
    assert abs(ratio - two_screens(post_m, width_m)) < 0.05


@pytest.mark.parametrize(("post_m", "width_m"), [(3.0, 0.1), (5.0, 0.04), (8.0, 0.1)])
def test_among_many_edges_the_integral_is_coarser(
    monkeypatch, post_m: float, width_m: float
) -> None:
    """A sixteenth of the points where edges are too many for all of them. It had been all or none,
    with a warning.
    """
    monkeypatch.setattr(mirrors, "_MOST_PAIRS", 2**14)
    h = width_m / 2
    corners = [[post_m, -h, -1], [post_m, h, -1], [post_m, h, 1], [post_m, -h, 1]]
    found = trace(world(wall(4.0), quad("post", corners)), RADAR)
    assert not any("is not to be relied on" in text for text in found.warnings)
    ratio = echo(wall(4.0), quad("post", corners)) / echo(wall(4.0))
    assert abs(ratio - two_screens(post_m, width_m)) < 0.12


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
