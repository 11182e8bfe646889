"""Echoes of bodies over mirrors: waves over a mirror's border, and what obstacles beside the way
change.
"""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.special import wofz

from benchmarks.kirchhoff import echo_behind
from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, ball, quad, thing, world
from tests.physics.shadow_worlds import Array, K
from twin.fidelity import DEFAULT
from twin.radar.propagation.diffraction.cell_echoes import middle_facets
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject, Target

PLACE = (3.0, 2.0, 0.0)
FOOT_M = 10 / 7  # of the way to the ball, by a wall 5 m ahead


def upright(name: str, begin_m: tuple[float, float], end_m: tuple[float, float], **more):
    (x, y), (u, v) = begin_m, end_m
    return quad(name, [[x, y, -1], [u, v, -1], [u, v, 1], [x, y, 1]], **more)


def seen(*walls: SceneObject) -> Propagation:
    """A ball that the radar sees over walls alone: a screen stands before it."""
    screen = upright("screen", (1.5, 0.65), (1.5, 2.5), radar="obstacle")
    return trace(world(*walls, screen, ball("ball", PLACE, 0.1, 5)), RADAR)


def echo(found: Propagation) -> complex:
    c = found.contributions
    own = c.take(np.flatnonzero(c.object == found.objects.index("ball")))
    return complex(np.sum(own.amplitude * np.exp(-2j * np.pi * (79e9 * own.delay_s % 1))))


def stated(found: Propagation) -> float:
    """In amplitude."""
    (body,) = found.bodies
    return body.estimated_error * body.level_amplitude


class Direct:
    """The radar itself."""

    def field(self, places: Array) -> tuple[Array, Array, Array]:
        """As of `HalfPlane`."""
        straight_m = np.linalg.norm(places, axis=1)
        way = places / straight_m[:, None]
        return np.sqrt(RADAR.antenna.gain(way)), way, straight_m


class HalfPlane:
    """A wall from an upright edge at (x, y) on in a direction, and the radar's field by it."""

    def __init__(self, edge_m: tuple[float, float], towards: tuple[float, float]) -> None:
        self.edge_m, self.towards = np.array([*edge_m, 0.0]), np.array([*towards, 0.0])
        self.normal = np.array([self.towards[1], -self.towards[0], 0.0])
        self.image_m = 2 * (self.edge_m @ self.normal) * self.normal

    def field(self, places: Array) -> tuple[Array, Array, Array]:
        """At places (n, 3): Kirchhoff's share of the image's wave, with the antenna's gain; unit
        vectors from the image; and distances from there.
        """
        way = places - self.image_m
        straight_m = np.linalg.norm(way, axis=1)
        way /= straight_m[:, None]
        share = ((self.edge_m - self.image_m) @ self.normal) / (way @ self.normal)
        is_lit = (self.image_m + share[:, None] * way - self.edge_m) @ self.towards > 0
        level_m = np.hypot(*(self.edge_m - self.image_m)[:2])
        level_m = level_m + np.hypot(*(places - self.edge_m)[:, :2].T)
        phase = np.maximum(K * (np.hypot(level_m, places[:, 2]) - straight_m), 0)
        wave = 0.5 * wofz(np.exp(0.75j * np.pi) * np.sqrt(phase)) * np.exp(-1j * phase)
        gain = RADAR.antenna.gain(way - 2 * (way @ self.normal)[:, None] * self.normal)
        return np.sqrt(gain) * np.where(is_lit, 1 - wave, wave), way, straight_m


class DeepBorder(HalfPlane):
    """The same deep in the shadow: waves leave to, and come from, where the shortest way meets the
    edge.
    """

    def field(self, places: Array) -> tuple[Array, Array, Array]:
        """As of `HalfPlane`."""
        wave, way, straight_m = super().field(places)
        wave /= np.sqrt(RADAR.antenna.gain(way - 2 * (way @ self.normal)[:, None] * self.normal))
        there = np.hypot(*(self.edge_m - self.image_m)[:2])
        onwards = np.hypot(*(places - self.edge_m)[:, :2].T)
        place = np.tile(self.edge_m, (len(places), 1))
        place[:, 2] = places[:, 2] * there / (there + onwards)
        wave *= np.sqrt(RADAR.antenna.gain(place / np.linalg.norm(place, axis=1)[:, None]))
        way = places - place
        return wave, way / np.linalg.norm(way, axis=1)[:, None], straight_m


def by_walls(corners: Array, walls: Sequence[HalfPlane]) -> complex:
    """Physical optics of small facets (n, 3, 3) by waves over walls, out and home by any."""
    return sum(by_both(corners, one, other) for one in walls for other in walls)


def by_both(corners: Array, one: HalfPlane | Direct, other: HalfPlane | Direct) -> complex:
    """The same out by one and home by another."""
    middle = corners.mean(axis=1)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    (out, there, there_m), (home, back, back_m) = one.field(middle), other.field(middle)
    facing, answering = (-np.sum(across * way, axis=1) for way in (there, back))
    wave = out * home * np.exp(-1j * K * (there_m + back_m)) / (there_m * back_m)
    is_seen = (facing > 0) & (answering > 0)
    return complex(np.sum((wave * (facing + answering) / 2)[is_seen]))


def over_walls(found: Propagation, n_ways: int = 2) -> complex:
    """The last object's echo there and back by any walls; or out or home by one, direct on the
    other way.
    """
    c = found.contributions
    n_over = (c.source > 0).astype(int) + (c.receiver > 0)
    is_own = (c.object == len(found.objects) - 1) & (c.bounces <= 1)
    own = c.take(np.flatnonzero(is_own & (n_over == n_ways)))
    return complex(np.sum(own.amplitude * np.exp(-2j * np.pi * (79e9 * own.delay_s % 1))))


def tall(name: str, begin_m: tuple[float, float], end_m: tuple[float, float]) -> SceneObject:
    """A wall whose upper and lower borders are far away."""
    (x, y), (u, v) = begin_m, end_m
    return quad(name, [[x, y, -8], [u, v, -8], [u, v, 8], [x, y, 8]])


def facets(item: SceneObject) -> Array:
    """Of an object, each in four."""
    return divided(item.vertices_m[item.geometry.faces])


def divided(corners: Array) -> Array:
    """Facets, each in four."""
    a, b, c = corners.swapaxes(0, 1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


@pytest.fixture(scope="module")
def whole() -> tuple[complex, complex]:
    """The ball's echo by a wall without a border near the way, as computed and as of `by_walls`."""
    found = trace(world(tall("wall", (5.0, -8.0), (5.0, 12.0)), ball("ball", PLACE, 0.1, 5)), RADAR)
    wall = HalfPlane((5.0, 12.0), (0.0, -1.0))
    return over_walls(found), by_walls(facets(ball("ball", PLACE, 0.1, 6)), [wall])


@pytest.mark.quick(1)
@pytest.mark.parametrize("border_m", [-0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2])
def test_waves_over_a_mirrors_border_are_kirchhoffs(
    border_m: float, whole: tuple[complex, complex]
) -> None:
    """From the lit side to 20 dB down in the shadow; rays gave all or nothing, 6 dB off."""
    end_m = FOOT_M + border_m
    found = trace(
        world(tall("wall", (5.0, -8.0), (5.0, end_m)), ball("ball", PLACE, 0.1, 5)), RADAR
    )
    wall = HalfPlane((5.0, end_m), (0.0, -1.0))
    truth = by_walls(facets(ball("ball", PLACE, 0.1, 6)), [wall]) / whole[1] * whole[0]
    error = abs(over_walls(found) - truth)
    assert error < stated(found)
    assert error < 0.05 * abs(whole[0])
    assert stated(found) < 0.1 * abs(whole[0])


def test_waves_over_a_border_do_not_end_where_the_straight_way_does(
    whole: tuple[complex, complex],
) -> None:
    """A screen 1 m before the wall hides the image from a ball past the border, and lets the waves
    over that border by: they had been left out with it, and nothing was stated.
    """
    end_m = FOOT_M - 0.2
    corners = [[4, 1.06, -3], [4, 1.27, -3], [4, 1.27, 3], [4, 1.06, 3]]
    screen = quad("screen", corners, radar="obstacle")
    wall = tall("wall", (5.0, -8.0), (5.0, end_m))
    found = trace(world(wall, screen, ball("ball", PLACE, 0.1, 5)), RADAR)
    small, by_wall = facets(ball("ball", PLACE, 0.1, 6)), DeepBorder((5.0, end_m), (0.0, -1.0))
    truth = by_both(small, Direct(), by_wall) + by_both(small, by_wall, Direct())
    truth *= -whole[0] / whole[1]  # metal: of one reflection the sign changes
    error = abs(over_walls(found, 1) - truth)
    assert error < stated(found)
    assert error < 0.1 * abs(truth)


@pytest.mark.parametrize("past_m", [0.45, 0.6])
def test_a_plate_far_past_a_border_answers_its_faint_waves(
    past_m: float, whole: tuple[complex, complex]
) -> None:
    """Of waves below 0.03 of the straight one nothing was followed or stated, though a plate that
    meets them at a right angle answers them fifty times as strongly as the direct wave; by the
    currents of the straight wave, as facets had them, 0.2 too weakly.
    """
    here, end = np.array(PLACE), (5.0, FOOT_M - past_m)
    onwards = np.array([*end, 0.0]) - here
    towards = onwards / np.linalg.norm(onwards) - here / np.linalg.norm(here)
    corners = square(here, towards, 0.05)
    plate = thing("plate", corners.reshape(-1, 3), np.arange(6).reshape(-1, 3))
    wall = tall("wall", (5.0, -8.0), end)
    found = trace(world(wall, plate), RADAR, fidelity=DEFAULT.with_(radar_edges=0))
    for _ in range(5):
        corners = divided(corners)
    by_wall = DeepBorder(end, (0.0, -1.0))
    truth = by_both(corners, Direct(), by_wall) + by_both(corners, by_wall, Direct())
    truth *= -whole[0] / whole[1]
    error = abs(over_walls(found, 1) - truth)
    assert error < 0.08 * abs(truth)  # 0.055 of it that of `whole`
    assert stated(found) > 0.01 * abs(truth)


@pytest.mark.quick(1)
@pytest.mark.parametrize("turn_deg", [-10, -3, 3, 10])
@pytest.mark.parametrize("fold_m", [-0.1, 0.0, 0.05])
def test_where_a_wall_is_folded_both_parts_end(
    fold_m: float, turn_deg: float, whole: tuple[complex, complex]
) -> None:
    """Each shows an image of its own, and a body past one has the waves of its border alone; these
    were off by up to the whole echo.
    """
    fold, turn = (5.0, FOOT_M + fold_m), np.deg2rad(turn_deg)
    towards = (float(np.sin(turn)), float(np.cos(turn)))
    end_m = (fold[0] + 10 * towards[0], fold[1] + 10 * towards[1])
    walls = tall("wall", (5.0, -8.0), fold), tall("rest", fold, end_m)
    found = trace(world(*walls, ball("ball", PLACE, 0.1, 5)), RADAR)
    parts = [HalfPlane(fold, (0.0, -1.0)), HalfPlane(fold, towards)]
    truth = by_walls(facets(ball("ball", PLACE, 0.1, 6)), parts) / whole[1] * whole[0]
    error = abs(over_walls(found) - truth)
    assert error < 1.1 * stated(found)
    assert error < 0.1 * abs(whole[0])


def test_a_surface_mirrors_however_small_where_it_is_declared(
    whole: tuple[complex, complex],
) -> None:
    """A strip two Fresnel zones wide: below ten no image was made of it, without a word."""
    begin, end = (5.0, FOOT_M - 0.15), (5.0, FOOT_M + 0.15)
    (x, y), (u, v) = begin, end
    strip = quad("wall", [[x, y, -2.5], [u, v, -2.5], [u, v, 2.5], [x, y, 2.5]], radar="surface")
    found = trace(world(strip, ball("ball", PLACE, 0.1, 5)), RADAR)
    small = facets(ball("ball", PLACE, 0.1, 6))
    near, far = (HalfPlane(edge, (0.0, -1.0)) for edge in (end, begin))
    seen_by = by_walls(small, [near]) + by_walls(small, [far])
    seen_by -= by_both(small, near, far) + by_both(small, far, near)
    truth = seen_by / whole[1] * whole[0]
    error = abs(over_walls(found) - truth)
    assert error < stated(found)
    assert error < 0.1 * abs(whole[0])
    assert abs(truth) > 0.5 * abs(whole[0])


def square(middle_m: Array, towards: Array, side_m: float) -> Array:
    """Corners (2, 3, 3) of two triangles that face in a direction."""
    one = np.cross([0.0, 0.0, 1.0], towards)
    one *= side_m / 2 / np.linalg.norm(one)
    up = np.cross(towards, one)
    up *= side_m / 2 / np.linalg.norm(up)
    a, b, c, d = (middle_m + i * one + j * up for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]])


def test_a_part_that_glints_past_a_border_is_followed() -> None:
    """Four plates of a body are lit by the wall, askew; a fifth, past the border, glints between
    radar and wall: all of its echo was missing.
    """
    here, image_m = np.array(PLACE), np.array([10.0, 0.0, 0.0])
    to_radar, to_image = -here / np.linalg.norm(here), image_m - here
    glint = to_radar + to_image / np.linalg.norm(to_image)
    askew = glint + 0.8 * np.cross(glint, [0.0, 0.0, 1.0])
    lit = [square(here - [0.0, 0.4 + 0.1 * n, 0.0], askew, 0.05) for n in range(4)]
    corners = np.concatenate([*lit, square(here, glint, 0.05)])
    body = thing("plates", corners.reshape(-1, 3), np.arange(30).reshape(-1, 3))
    small = corners
    for _ in range(5):
        small = divided(small)
    ends = {"whole": 12.0, "cut": FOOT_M - 0.02}
    without_edges = DEFAULT.with_(radar_edges=0)
    found = {
        name: trace(
            world(tall("wall", (5.0, -8.0), (5.0, end)), body), RADAR, fidelity=without_edges
        )
        for name, end in ends.items()
    }
    truth = {
        name: by_both(small, Direct(), HalfPlane((5.0, end), (0.0, -1.0)))
        for name, end in ends.items()
    }
    echoes = {name: over_walls(each, 1) for name, each in found.items()}
    off = echoes["cut"] - truth["cut"] / truth["whole"] * echoes["whole"]
    assert abs(off) < 2 * stated(found["cut"])  # out and home are two ways
    assert abs(off) < 0.05 * abs(echoes["whole"])


@pytest.mark.parametrize("border_m", [-0.05, 0.02, 0.1])
def test_a_declared_target_has_the_waves_of_a_mirrors_border(border_m: float) -> None:
    """It was there or missing."""
    echoes = []
    for end_m in (12.0, FOOT_M + border_m):
        wall = tall("wall", (5.0, -8.0), (5.0, end_m))
        found = trace(
            world(wall, targets=(Target("post", PLACE, (0.0, 0.0, 0.0), 1.0, "test"),)), RADAR
        )
        c = found.contributions.take(slice(len(found.names)))
        over = (c.source > 0) & (c.receiver > 0)
        over &= [name.target == "post" for name in found.names]
        own = c.take(np.flatnonzero(over))
        echoes.append(np.sum(own.amplitude * np.exp(-2j * np.pi * (79e9 * own.delay_s % 1))))
    place = np.array([PLACE])
    cut, free = (
        HalfPlane((5.0, end_m), (0.0, -1.0)).field(place)[0][0]
        for end_m in (FOOT_M + border_m, 1e3)
    )
    assert echoes[1] / echoes[0] == pytest.approx((cut / free) ** 2, abs=0.03)


@pytest.mark.quick(10)
@pytest.mark.parametrize("thick_m", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("divided", [0, 1])
@pytest.mark.parametrize("border_m", [-0.05, 0.0, 0.02, 0.1])
def test_a_thick_wall_ends_as_a_thin_one(border_m: float, divided: int, thick_m: float) -> None:
    """Its end, large enough for a mirror, had stood for a wall that goes on: there or missing."""
    targets = (Target("post", PLACE, (0.0, 0.0, 0.0), 1.0, "test"),)
    mesh = trimesh.creation.box(bounds=[[5, -3, -2], [5 + thick_m, FOOT_M + border_m, 2]])
    for _ in range(divided):
        mesh = mesh.subdivide()
    corners = [[5, y, z] for y, z in ((-3, -2), (FOOT_M + border_m, -2))]
    corners += [[5, y, z] for y, z in ((FOOT_M + border_m, 2), (-3, 2))]
    echoes = []
    for wall in (thing("wall", mesh.vertices, mesh.faces), quad("wall", corners)):
        found = trace(world(wall, targets=targets), RADAR)
        c = found.contributions
        echoes.append(np.sum(c.amplitude * np.exp(-2j * np.pi * (79e9 * c.delay_s % 1))))
    assert abs(echoes[0] - echoes[1]) < 1e-3 * abs(echoes[1])


@pytest.mark.quick(1)
@pytest.mark.parametrize("border_m", [FOOT_M + 0.05, FOOT_M - 0.05])
def test_where_a_wall_goes_on_it_has_no_border(border_m: float) -> None:
    """Two in one plane echo as one, and about the same is stated."""
    one = seen(upright("wall", (5.0, -3.0), (5.0, 6.0)))
    two = seen(
        upright("wall", (5.0, -3.0), (5.0, border_m)), upright("rest", (5.0, border_m), (5.0, 6.0))
    )
    assert abs(echo(two) - echo(one)) < 0.05 * abs(echo(one))
    assert stated(two) == pytest.approx(stated(one), rel=0.4)


@pytest.mark.thorough
def test_on_the_ground_a_wall_has_no_border() -> None:
    """Its lower edge is 5 cm below the way; in a right corner the waves of both cancel."""
    ground = quad("ground", [[-1, -4, -0.05], [5, -4, -0.05], [5, 7, -0.05], [-1, 7, -0.05]])
    wall = quad("wall", [[5, -3, -0.05], [5, 6, -0.05], [5, 6, 1], [5, -3, 1]])
    waves = [
        next(d.bound for d in found.decisions if d.effect.startswith("waves diffracted round"))
        for found in (seen(wall), seen(wall, ground))
    ]
    assert waves[1] < waves[0] / 4


#: Echo of the ball of `seen` behind the next test's obstacle over the free one, by brute force:
#: as `test_what_passes_is_kirchhoffs` computes it.
_PASSED = {
    ("before the wall", 0.02): 0.429 + 0.253j,
    ("before the wall", 0.05): 1.043 + 0.502j,
    ("before the wall", 0.1): 0.819 - 0.128j,
    ("behind it", 0.02): 0.616 + 0.383j,
    ("behind it", 0.05): 1.283 - 0.170j,
    ("behind it", 0.1): 0.880 + 0.084j,
}


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "below_m"), list(_PASSED))
def test_what_passes_is_kirchhoffs(leg: str, below_m: float) -> None:
    """Without the wall, the ball and the obstacle where the wall shows them."""
    whole_m = float(np.hypot(7, 2))
    along = np.array([7.0, 2.0]) / whole_m
    aside = np.array([along[1], -along[0]])
    place = (2.5 if leg == "before the wall" else whole_m - 0.8) * along
    (x, y), (u, v) = place + below_m * aside, place + (below_m + 0.6) * aside
    obstacle = np.array([[x, y, 1], [u, v, 1], [u, v, -1], [x, y, -1]])
    body, wavenumber = ball("ball", (7.0, 2.0, 0.0), 0.1, 5), 2 * np.pi / WAVELENGTH_M
    free, whole = (echo_behind(body, some, wavenumber).whole for some in ([], [obstacle]))
    assert whole / free == pytest.approx(_PASSED[leg, below_m], abs=2e-3)


@pytest.mark.quick(1)
@pytest.mark.parametrize("leg", ["before the wall", "behind it"])
@pytest.mark.parametrize("below_m", [-0.05, 0.02, 0.05, 0.1])
def test_what_an_obstacles_edge_changes_of_a_way_over_a_mirror_is_stated(
    leg: str, below_m: float
) -> None:
    """An upright edge beside the way there and back: 6 dB, where 2 % had been stated. One of the
    six is off by 1.17 times the stated 95 % interval.
    """
    wall = upright("wall", (5.0, -3.0), (5.0, 6.0))
    along = np.array([7.0, 2.0]) / np.hypot(7, 2)
    if leg == "before the wall":
        at_m, way = 2.5, along
        place = at_m * way
    else:  # as the wall shows it, on the way from the wall to the ball
        at_m, way = float(np.hypot(7, 2)) - 0.8, along
        place = at_m * way
        place = np.array([10 - place[0], place[1]])
        way = np.array([-way[0], way[1]])
    aside = np.array([way[1], -way[0]])  # away from the screen before the ball
    edge, end = place + below_m * aside, place + (below_m + 0.6) * aside
    obstacle = upright("obstacle", tuple(edge), tuple(end), radar="obstacle")
    free, found = seen(wall), seen(wall, obstacle)
    if below_m > 0:
        error = abs(echo(found) - echo(free) * _PASSED[leg, below_m])
        assert error < 1.2 * stated(found)
        assert stated(found) < 4 * error + 0.2 * abs(echo(free))
    else:  # of what is not lit nothing is stated
        assert abs(echo(found)) < 0.3 * abs(echo(free))


def test_the_waves_of_a_wires_two_edges_cancel() -> None:
    """A strip of 1 mm, 20 mm beside the way, takes off some 2 %; its edges by themselves 80."""
    wall, along = upright("wall", (5.0, -3.0), (5.0, 6.0)), np.array([7.0, 2.0]) / np.hypot(7, 2)
    aside = np.array([along[1], -along[0]])
    ends = (2.5 * along + far_m * aside for far_m in (0.02, 0.021))
    wire = upright("wire", *(tuple(end) for end in ends), radar="obstacle")
    free, found = seen(wall), seen(wall, wire)
    assert stated(found) < stated(free) + 0.45 * abs(echo(free))


def test_waves_to_a_cell_are_looked_for_where_both_ways_meet_it() -> None:
    """A box beside the way over a wall: its middle seen from the radar is on a side along which the
    image looks, so that the box hides it from the border's waves, and all of its echo over the wall
    had none.
    """
    along_x = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 1]]]) + [0.0, -0.5, 0.0]
    askew = np.array([[[0, 0, 0], [1, 1, 0], [0, 0, 1]]]) + [0.0, -0.6, 0.0]
    none = np.zeros(2, dtype=np.int64)
    some = Facets(np.concatenate([along_x, askew]), none, none)
    radar_m, image_m = np.array([0.2, -9.0, 0.3]), np.array([90.0, -0.51, 0.3])
    assert middle_facets(some, radar_m) == [0]
    assert middle_facets(some, radar_m, image_m) == [1]
