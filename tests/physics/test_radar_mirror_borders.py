"""The radar's own echo in a mirror, near the mirror's border and behind a post, by Kirchhoff."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.special import fresnel

from benchmarks.behind_fences import (
    AWAY_M,
    echo_and_warnings,
    half_plane,
    past_posts,
    post,
    wall,
)
from tests.physics.radar_worlds import GAIN, RADAR, WAVELENGTH_M, plate, quad, thing, world
from twin.radar.propagation.diffraction import mirrors
from twin.radar.propagation.diffraction.open_edges import _beside
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, SceneObject


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


@pytest.mark.parametrize("aside_m", [0.0, 1e-9, 1e-7, 1e-5])
@pytest.mark.parametrize("end_m", [4.0, -4.0])
def test_a_corner_at_the_foot_leaves_a_quarter(end_m: float, aside_m: float) -> None:
    """By symmetry; at round coordinates it was all of the wall's echo, twice a quarter, or none."""
    y, z = (0.0 + aside_m, 4.0), (aside_m, end_m)
    corners = [
        [AWAY_M, y[0], z[0]],
        [AWAY_M, y[1], z[0]],
        [AWAY_M, y[1], z[1]],
        [AWAY_M, y[0], z[1]],
    ]
    assert abs(echo(quad("quarter", corners)) / echo(wall(4.0))) == pytest.approx(0.25, rel=0.03)


def test_at_a_border_nearer_than_its_zone_is_wide() -> None:
    """A wall 0.1 m ahead that ends before its foot: within 45 wavelengths it had no echo."""
    near = quad("near", [[0.1, -2, -2], [0.1, -0.003, -2], [0.1, -0.003, 2], [0.1, -2, 2]])
    whole = quad("near", [[0.1, -2, -2], [0.1, 2, -2], [0.1, 2, 2], [0.1, -2, 2]])
    opening = half_plane(np.array(0.003 / np.sqrt(WAVELENGTH_M * 0.1 / 4)))
    assert abs(echo(near) / echo(whole) - opening) < 0.02


def second(begin_m: tuple[float, float], turn_deg: float) -> SceneObject:
    """A wall of 4 m that begins at (x, y), its far end turned away from the radar."""
    way = 4 * np.array([np.sin(np.deg2rad(turn_deg)), np.cos(np.deg2rad(turn_deg))])
    (x, y), (ahead, aside) = begin_m, np.add(begin_m, way)
    return quad("second", [[x, y, -2], [ahead, aside, -2], [ahead, aside, 2], [x, y, 2]])


def by_two_half_planes(border_m: float, begin_m: NDArray[np.float64], turn_deg: float) -> complex:
    """Of a wall up to a border and of a second one, each with an image of its own."""
    turn, zone_m = np.deg2rad(turn_deg), np.sqrt(WAVELENGTH_M * AWAY_M / 4)
    along, across = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
    nearer_m = begin_m @ across - AWAY_M
    wave = np.exp(-4j * np.pi * nearer_m / WAVELENGTH_M)
    first = half_plane(np.array(-border_m / zone_m))
    return complex(first + half_plane(begin_m @ along / zone_m) * wave)


@pytest.mark.parametrize("turn_deg", [-1.0, -0.2, -0.01, 0.05, 0.4])
@pytest.mark.parametrize("fold_m", [-0.05, 0.0, 0.004, 0.03])
def test_a_wall_that_is_folded(turn_deg: float, fold_m: float) -> None:
    """By Kirchhoff, within 0.03: each part as far as the fold. It had been one of them, both or
    none.
    """
    begin_m = (AWAY_M, fold_m)
    found = whole_echo(wall(fold_m), second(begin_m, turn_deg)) / whole_echo(wall(4.0))
    assert abs(found - by_two_half_planes(fold_m, np.array(begin_m), turn_deg)) < 0.03


@pytest.mark.parametrize("step_m", [-0.02, -0.0003, 0.001, 0.02])
@pytest.mark.parametrize("place_m", [-0.03, 0.005])
def test_a_wall_with_a_step(step_m: float, place_m: float) -> None:
    """Likewise: the part behind had been whole or missing."""
    begin_m = (AWAY_M + step_m, place_m)
    found = whole_echo(wall(place_m), second(begin_m, 0.0)) / whole_echo(wall(4.0))
    assert abs(found - by_two_half_planes(place_m, np.array(begin_m), 0.0)) < 0.03


@pytest.mark.parametrize("angle_deg", [100.0, 150.0])
@pytest.mark.parametrize("place_m", [-0.02, 0.02])
def test_an_obtuse_corner_is_the_border_of_both_walls(angle_deg: float, place_m: float) -> None:
    """Before its foot and beyond: 0.6 and 0.4 of the wall's echo, which had been all or nothing."""
    found = whole_echo(wall(place_m), second((AWAY_M, place_m), angle_deg - 180))
    border = half_plane(np.array(-place_m / np.sqrt(WAVELENGTH_M * AWAY_M / 4)))
    assert abs(found / whole_echo(wall(4.0)) - border) < 0.05


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


def corner(angle_deg: float, gaps_m: tuple[float, float] = (0.0, 0.0)) -> list:
    """Two sheets of 3 m that open towards the radar, and end so far from their common line."""
    half = np.deg2rad(angle_deg) / 2
    sheets = []
    for side, gap_m in zip((1, -1), gaps_m, strict=True):
        along = np.array([-np.cos(half), side * np.sin(half), 0.0])
        inner, outer = (np.array([AWAY_M, 0, 0]) + way * along for way in (gap_m, 3.0))
        up = np.array([0, 0, 2.0])
        sheets.append(quad(f"sheet{side}", [inner - up, outer - up, outer + up, inner + up]))
    return sheets


def whole_echo(*objects) -> complex:
    """The sum of all contributions at the carrier."""
    c = trace(world(*objects), RADAR).contributions
    return complex(np.sum(c.amplitude * np.exp(-2j * np.pi * (79e9 * c.delay_s % 1))))


def seen_in_both(*objects) -> complex:
    """The radar's echo by both sheets, over that of a closed right corner."""
    echoes = []
    for some in (objects, corner(90.0)):
        paths = trace(world(*some), RADAR).paths
        echoes.append(sum(p.amplitude for p in paths if len(p.via) == 2))
    return complex(echoes[0] / echoes[1])


@pytest.mark.parametrize("angle_deg", [89.5, 89.9, 90.1, 90.4])
def test_a_corner_that_is_not_right_is_a_knife_edges(angle_deg: float) -> None:
    """Both orders of its sheets pass their common line, on the lit side where the corner is acute:
    by Fresnel's integrals, to 0.04 of the echo. It had been twice the right corner's, or nothing.
    """
    beside_m = AWAY_M * np.cos(np.deg2rad(angle_deg))
    sine, cosine = fresnel(2 * beside_m / np.sqrt(WAVELENGTH_M * AWAY_M))
    passed = abs((0.5 + cosine) - 1j * (0.5 + sine)) * np.sqrt(2)
    assert abs(seen_in_both(*corner(angle_deg))) == pytest.approx(passed, abs=0.04)


@pytest.mark.parametrize("sides", [(1, 1), (0, 1), (1, 0)])
@pytest.mark.parametrize(("gap_m", "passed"), [(1e-3, 0.99), (1e-2, 0.93)])
def test_a_corner_with_a_slit_echoes(sides: tuple[int, int], gap_m: float, passed: float) -> None:
    """Both orders pass the farther sheet's edge in its shadow, by the slit's cosine of 45 degrees.
    There was no echo at all.
    """
    sine, cosine = fresnel(-2 * gap_m / np.sqrt(2) / np.sqrt(WAVELENGTH_M * AWAY_M))
    expected = abs((0.5 + cosine) - 1j * (0.5 + sine)) * np.sqrt(2)
    assert expected == pytest.approx(passed, abs=0.01)
    assert abs(seen_in_both(*corner(90.0, (sides[0] * gap_m, sides[1] * gap_m)))) == pytest.approx(
        expected, abs=0.02
    )


@pytest.mark.parametrize(("angle_deg", "turn_deg"), [(89.8, 0), (90, 0), (90.2, 0), (90.9, 25)])
@pytest.mark.parametrize("past_m", [(-0.2, -0.2), (-1.0, -0.1), (-0.1, 0.0), (0.0, -0.003)])
def test_a_corner_whose_walls_go_on_behind_each_other(
    angle_deg: float, turn_deg: float, past_m: tuple[float, float]
) -> None:
    """Is one whose walls end there: it had been none, or half, or of waves from hidden edges."""
    crossed = seen_in_both(*turned(corner(angle_deg, past_m), turn_deg))
    ends = seen_in_both(*turned(corner(angle_deg), turn_deg))
    assert crossed == pytest.approx(ends, abs=1e-3)
    assert abs(ends) > 0.2


@pytest.mark.parametrize("border_m", [0.1, 0.01, 0.0, -0.01, -0.1])
@pytest.mark.parametrize("sides", [(1, -1), (1,)])
def test_a_corner_that_ends_near_the_radars_height(sides: tuple[int, ...], border_m: float) -> None:
    """Above it, or beside it: by the knife edge of its lower border, on one wall or on both. With
    the border above the radar there was no echo.
    """
    walls = []
    for side, sheet in zip((1, -1), corner(90.0), strict=True):
        points = np.array(sheet.vertices_m)
        if side in sides:
            points[points[:, 2] < 0, 2] = border_m
        walls.append(quad(sheet.name, points))
    opening = half_plane(np.array(border_m / np.sqrt(WAVELENGTH_M * AWAY_M / 4)))
    assert abs(seen_in_both(*walls)) == pytest.approx(abs(complex(opening)), abs=0.01)


def panelled(seam_m: float) -> list:
    """A right corner each of whose walls is two panels, one above the other."""
    panels = []
    for sheet in corner(90.0):
        for name, keeps in (("lo", -1), ("hi", 1)):
            points = np.array(sheet.vertices_m)
            points[keeps * points[:, 2] < 0, 2] = seam_m
            panels.append(quad(sheet.name + name, points))
    return panels


@pytest.mark.parametrize("seam_m", [-0.05, 0.0, 0.003, 0.06])
def test_a_seam_changes_no_corner(seam_m: float) -> None:
    """Of two panels one above the other, in both walls. It had been 0 to 1.16 of the echo."""
    assert seen_in_both(*panelled(seam_m)) == pytest.approx(1.0, abs=1e-3)


def passed(*borders_m: float) -> float:
    """The share of the echo from one border to the other, by Fresnel's integrals."""
    shares = half_plane(np.array(borders_m) / np.sqrt(WAVELENGTH_M * AWAY_M / 4))
    return float(abs(shares[0] - shares[1:].sum()))


def limited(low_m: float, high_m: float) -> list:
    """A right corner with one wall from a height on and the other up to a height."""
    walls = []
    for sheet, (below, above) in zip(corner(90.0), ((low_m, 2.0), (-2.0, high_m)), strict=True):
        points = [[x, y, above if z > 0 else below] for x, y, z in sheet.vertices_m]
        walls.append(quad(sheet.name, points))
    return walls


@pytest.mark.parametrize(
    ("low_m", "high_m"), [(-0.05, 0.005), (-0.01, 0.04), (0.02, 0.04), (0.02, 0.005)]
)
def test_walls_at_different_heights_echo_by_what_they_share(low_m: float, high_m: float) -> None:
    """0.11 to 0.4 of the corner's echo; nothing where one ends below the other's beginning."""
    expected = passed(low_m, high_m) if low_m < high_m else 0.0
    assert abs(seen_in_both(*limited(low_m, high_m))) == pytest.approx(expected, abs=1e-3)


def turned(walls: list, turn_deg: float) -> list:
    """About the line in which they meet."""
    turn = np.deg2rad(turn_deg)
    way = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    moved = []
    for sheet in walls:
        points = np.array(sheet.vertices_m)
        points[:, :2] = (points[:, :2] - [AWAY_M, 0]) @ way + [AWAY_M, 0]
        moved.append(quad(sheet.name, points))
    return moved


@pytest.mark.parametrize("turn_deg", [-25.0, 15.0])
@pytest.mark.parametrize("border_m", [0.02, -0.04])
def test_a_corner_seen_beside_its_bisector(turn_deg: float, border_m: float) -> None:
    """One of its walls ends near the radar's height: its edge goes away from the radar, or back."""
    walls = turned(limited(border_m, 2.0), turn_deg)
    assert abs(seen_in_both(*walls)) == pytest.approx(passed(border_m), abs=1e-3)


@pytest.mark.parametrize("gaps_m", [(0.6, 0.6), (0.0, 0.4)])
def test_walls_that_end_far_beside_the_way_are_no_corner(gaps_m: tuple[float, float]) -> None:
    assert seen_in_both(*corner(90.0, gaps_m)) == 0


@pytest.mark.parametrize("gaps_m", [(0.0, 0.0), (0.08, 0.2)])
@pytest.mark.parametrize("angle_deg", [89.9, 90.1, 92.0])
def test_a_corner_seen_from_outside_has_no_echo(
    angle_deg: float, gaps_m: tuple[float, float]
) -> None:
    """The image behind it is that of a corner, and no way goes over both of its sides."""
    walls = []
    for sheet in corner(angle_deg, gaps_m):
        points = np.array(sheet.vertices_m)
        points[:, 0] = 2 * AWAY_M - points[:, 0]
        walls.append(quad(sheet.name, points))
    assert seen_in_both(*walls) == 0


def test_a_seam_beyond_the_zone_changes_no_corner() -> None:
    assert seen_in_both(*panelled(0.5)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("length_m", [0.1, 0.2, 0.5, 0.9])
def test_a_corner_with_a_short_wall(length_m: float) -> None:
    """As an aperture from the corner's line to the wall's outer edge, in both orders: 0.98 to 1.22
    of the whole corner's echo. As a mirror, or where too small for one, by its facets.
    """
    short, other = corner(90.0)
    points = np.array(short.vertices_m)
    inner = points[[0, 0, 3, 3]]
    short = quad("short", inner + (points - inner) * length_m / 3)
    expected = 2 * passed(0.0, length_m / np.sqrt(2))
    total = whole_echo(short, other) / whole_echo(*corner(90.0))
    assert abs(total) == pytest.approx(expected, abs=0.02)


def test_a_right_corner_of_three_walls_echoes_once() -> None:
    """Its image stands behind the corner's point, on the borders of all orders of its walls."""
    ahead = quad("ahead", [[8, -3, -1], [8, 2, -1], [8, 2, 4], [8, -3, 4]])
    side = quad("side", [[2, 2, -1], [8, 2, -1], [8, 2, 4], [2, 2, 4]])
    floor = quad("floor", [[2, -3, -1], [8, -3, -1], [8, 2, -1], [2, 2, -1]])
    paths = [p for p in trace(world(ahead, side, floor), RADAR).paths if len(p.via) == 3]
    towards = np.array([8.0, 2.0, -1.0])
    gain = RADAR.antenna.gain((towards / np.linalg.norm(towards))[None])[0] * GAIN / 100
    free = gain * WAVELENGTH_M / (8 * np.pi * np.linalg.norm(towards))
    assert abs(sum(p.amplitude for p in paths)) == pytest.approx(free, rel=1e-6)


@pytest.mark.parametrize(
    ("turn_deg", "from_corner_m"),
    [(238.6235, (4.1012, 3.5519, 3.5761)), (156.9606, (4.2573, 5.986, 2.08))],
)
def test_a_corner_of_three_walls_far_from_the_origin(turn_deg: float, from_corner_m) -> None:
    """Turned, and 120 m away: the ways beside it had been nearer to the corner than steps of
    float32, and some had no echo.
    """
    turn = np.deg2rad(turn_deg)
    way = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    corner_m, axes = np.array([100.0, 70.0, 0.1]), 9 * np.eye(3)
    walls = []
    for number in range(3):
        one, other = np.delete(axes, number, axis=0)
        points = np.array([0 * one, one, one + other, other])
        walls.append(quad(f"wall{number}", points @ way.T + corner_m))
    place = way @ np.array(from_corner_m)
    away_m = float(np.linalg.norm(place))
    yaw, pitch = np.arctan2(-place[1], -place[0]), np.arcsin(place[2] / away_m)
    here = Pose(tuple(place + corner_m), yaw_deg=np.rad2deg(yaw), pitch_deg=np.rad2deg(pitch))
    rig = Rig(here, radar=Pose((0.0, 0.0, 0.0)))
    paths = [p for p in trace(world(*walls, rig=rig), RADAR).paths if len(p.via) == 3]
    free = GAIN * WAVELENGTH_M / (8 * np.pi * away_m)
    assert abs(sum(p.amplitude for p in paths)) == pytest.approx(free, rel=1e-3)


def test_a_corner_behind_a_sheet_is_not_seen() -> None:
    assert seen_in_both(*corner(90.1), plate("sheet", (3.0, 0, 0), 0.5)) == 0


def test_a_label_takes_its_place_on_the_wall() -> None:
    """A sheet of 0.3 m in the wall's plane: its shadow takes off what it sends itself, within 15 %
    of the wall's echo; both had been added, 2.3 times the wall's echo.
    """
    alone = echo(wall(4.0))
    total = whole_echo(wall(4.0), plate("label", (AWAY_M, 0, 0), 0.3))
    assert abs(total - alone) < 0.15 * abs(alone)


@pytest.mark.parametrize("border_m", [0.02, 0.0, -0.03])
def test_where_a_surface_goes_on_there_is_no_border(border_m: float) -> None:
    """A wall beside a box in its plane answers as one, before the foot and beyond it."""
    box = trimesh.creation.box(bounds=[[AWAY_M, border_m, -2], [AWAY_M + 0.2, 4, 2]])
    both = echo(wall(border_m), thing("box", box.vertices, box.faces))
    assert abs(both / echo(wall(4.0)) - 1) < 1e-3


@pytest.mark.parametrize("place_m", [0.03, 0.1])
def test_in_a_right_corner_no_wall_has_a_border(place_m: float) -> None:
    """The radar is 3 or 10 cm before the other wall; what their borders send cancels."""
    paths = trace(world(wall(place_m), second((AWAY_M, place_m), -90.0)), RADAR).paths
    single = sum(
        p.amplitude * np.exp(-2j * np.pi * (79e9 * p.delay_s % 1)) for p in paths if len(p.via) == 1
    )
    assert abs(single / whole_echo(wall(4.0)) - 1) < 1e-6


@pytest.mark.parametrize("place_m", [(0.01, 0.02), (-0.1, 0.03), (0.0, 0.0)])
def test_where_four_panels_meet_there_is_no_border(place_m: tuple[float, float]) -> None:
    assert abs(whole_echo(*four_panels(place_m, 0.0)) / whole_echo(wall(4.0)) - 1) < 1e-3


@pytest.mark.parametrize("place_m", [(0.01, 0.02), (0.03, -0.01), (0.0, 0.02)])
def test_four_panels_one_behind_the_other(place_m: tuple[float, float]) -> None:
    """Each by a millimetre: quarters of a plane, by Fresnel's integrals."""
    step_m, zone_m = 1e-3, np.sqrt(WAVELENGTH_M * AWAY_M / 4)
    expected = 0j
    for number, signs in enumerate([(-1, -1), (1, -1), (-1, 1), (1, 1)]):
        quarter = np.prod(half_plane(np.array(signs) * place_m / zone_m))
        expected += quarter * np.exp(-4j * np.pi * step_m * number / WAVELENGTH_M)
    found = whole_echo(*four_panels(place_m, step_m)) / whole_echo(wall(4.0))
    assert abs(found - expected) < 1e-3


def four_panels(place_m: tuple[float, float], step_m: float) -> list[SceneObject]:
    """Of 3 to 4 m, that meet beside the foot, each farther ahead by a step."""
    (y, z), panels = place_m, []
    ranges = [(-4, y, -3, z), (y, 4, -3, z), (-4, y, z, 3), (y, 4, z, 3)]
    for number, (left, right, low, high) in enumerate(ranges):
        x = AWAY_M + number * step_m
        corners = [[x, left, low], [x, right, low], [x, right, high], [x, left, high]]
        panels.append(quad(f"panel{number}", corners))
    return panels


@pytest.mark.parametrize("ahead_m", [0.1, 0.5])
def test_a_body_that_begins_where_a_wall_ends(ahead_m: float) -> None:
    """Takes nothing of the wall's echo but what its border does: both are one edge."""
    border_m, x = 0.02, AWAY_M - ahead_m
    y = border_m * x / AWAY_M
    body = quad("body", [[x, y, -0.4], [x, y + 0.4, -0.4], [x, y + 0.4, 0.4], [x, y, 0.4]])
    zone_m = np.sqrt(WAVELENGTH_M * AWAY_M / 4)
    found = abs(echo(wall(border_m), body) / echo(wall(4.0)))
    assert found == pytest.approx(abs(half_plane(np.array(-border_m / zone_m))), abs=0.1)


@pytest.mark.parametrize("side_m", [0.08, 0.1, 0.4])
@pytest.mark.parametrize("distance_m", [0.01, 0.013])
def test_a_mirror_close_to_the_radar_is_seen(side_m: float, distance_m: float) -> None:
    """Rays of less than 4 cm, or 8 a metre from the anchor, were taken to end before it: mirrors
    of no longer ones had no echo at all, without a warning.
    """
    high = Rig(Pose((0.0, 0.0, 1.0)), radar=Pose((0.0, 0.0, 0.0)))
    found = trace(world(plate("mirror", (distance_m, 0, 1), side_m), rig=high), RADAR)
    free = GAIN * WAVELENGTH_M / (8 * np.pi * distance_m)
    strongest = np.abs(found.contributions.amplitude).max()
    assert strongest == pytest.approx(free, rel=0.02)


def test_of_many_triangles_few_are_beside_the_edges() -> None:
    """All boxes that touch one of the others are found, and of 500 x 500 squares those at the rim:
    with all 10 million of a wall 24 GB were not enough for their pairs.
    """
    rng = np.random.default_rng(1)
    for number in range(50):
        normal = np.eye(3)[number % 3] + 0.2 * rng.normal(size=3)
        low = rng.uniform(-5, 5, (320, 3))
        boxes = np.stack(
            [low, low + rng.uniform(0, 10.0 ** rng.uniform(-2, 1, (320, 1)), (320, 3))], 1
        )
        others, axes = boxes[:20], np.argsort(np.abs(normal))[:2]
        reach, begin = boxes[:, None, 1, axes], boxes[:, None, 0, axes]
        touches = (begin <= others[:, 1, axes]) & (reach >= others[:, 0, axes])
        found = _beside(boxes, others, normal)
        assert not np.any(touches.all(axis=2).any(axis=1) & ~found)
    x, y = (places.ravel() / 500 for places in np.meshgrid(np.arange(500.0), np.arange(500.0)))
    squares = np.stack([np.stack([x, y, 0 * x], 1), np.stack([x + 0.002, y + 0.002, 0 * x], 1)], 1)
    rim = squares[(x == 0) | (y == 0)] - 0.001
    assert np.mean(_beside(squares, rim, np.array([0.0, 0.0, 1.0]))) < 0.02
