"""The radar's own echo in a mirror, near the mirror's border and behind a post, by Kirchhoff."""

import numpy as np
import pytest

from benchmarks.behind_fences import (
    AWAY_M,
    echo_and_warnings,
    half_plane,
    past_posts,
    post,
    wall,
)
from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, plate, quad, world
from twin.radar.propagation.diffraction import mirrors
from twin.radar.propagation.solvers import trace


def echo(*objects) -> complex:
    """Of the wall itself."""
    return echo_and_warnings(RADAR, objects)[0]


@pytest.mark.parametrize("border_m", [0.1, 0.03, 0.005, -0.005, -0.03, -0.1])
def test_at_a_border_the_echo_is_a_knife_edges(border_m: float) -> None:
    """+1.1 to -14 dB, within 0.03 of the echo in a far larger wall, of which the other borders are
    most; one ray gave all or nothing.
    """
    ratio = echo(wall(border_m)) / echo(wall(4.0))
    opening = half_plane(np.array(-border_m / np.sqrt(WAVELENGTH_M * AWAY_M / 4)))
    assert abs(ratio - opening) < 0.03


@pytest.mark.parametrize(("post_m", "width_m"), [(5.0, 0.004), (5.0, 0.04), (3.0, 0.1), (8.0, 0.1)])
def test_a_post_dims_the_wall_behind_it(post_m: float, width_m: float) -> None:
    """-0.4 to -9 dB, within 0.05 of the echo without the post; one ray gave nothing."""
    ratio = echo(wall(4.0), post(post_m, width_m)) / echo(wall(4.0))
    assert abs(ratio - past_posts(post_m, width_m, [0.0], WAVELENGTH_M)) < 0.05


@pytest.mark.parametrize(("post_m", "width_m"), [(3.0, 0.1), (5.0, 0.04), (8.0, 0.1)])
def test_among_many_edges_the_integral_is_coarser(
    monkeypatch, post_m: float, width_m: float
) -> None:
    """A sixteenth of the points where edges are too many for all of them. It had been all or none,
    with a warning.
    """
    monkeypatch.setattr(mirrors, "_MOST_PAIRS", 2**14)
    behind, warnings = echo_and_warnings(RADAR, [wall(4.0), post(post_m, width_m)])
    assert not any("is not to be relied on" in text for text in warnings)
    ratio = behind / echo(wall(4.0))
    assert abs(ratio - past_posts(post_m, width_m, [0.0], WAVELENGTH_M)) < 0.12


@pytest.mark.parametrize("posts", [4, 24])
def test_behind_a_fence_the_walls_echo_is_told_to_be_uncertain(posts: int) -> None:
    """Waves of posts far aside come back: by 24 posts the echo is off by 0.3 of the free one, and
    by four it is right, without a warning. Only more than 400 edges had been warned of.
    """
    places_m = (np.arange(posts) - (posts - 1) / 2) * 0.05
    fence = [post(4.0, 0.02, place_m) for place_m in places_m]
    behind, warnings = echo_and_warnings(RADAR, [wall(4.0), *fence])
    told = [text for text in warnings if "specular echo of wall may be off by" in text]
    error = abs(behind / echo(wall(4.0)) - past_posts(4.0, 0.02, places_m, WAVELENGTH_M))
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
