"""Declared targets behind posts and rails that cross: heights over both are independent, so that
the field behind both planes is the product of those behind a strip each.
"""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.special import fresnel

from tests.physics.radar_worlds import WAVELENGTH_M, thing
from tests.physics.shadow_worlds import OPTICS, echo, point
from twin.scene import SceneObject

Bounds = tuple[float, float]
Rectangles = Sequence[tuple[Bounds, Bounds]]
Places = Sequence[tuple[float, float]]

AT_M, FAR_M = 3.0, 10.0
LOW = OPTICS.with_(radar_shadow_db=60.0)


def past(edge_m: float, at_m: float) -> complex:
    """Share of the field that passes above an edge at a height over the line of sight."""
    s, c = fresnel(edge_m * np.sqrt(2 * FAR_M / (WAVELENGTH_M * at_m * (FAR_M - at_m))))
    return complex((1 + 1j) / 2 * ((0.5 - c) - 1j * (0.5 - s)))


def beside(low_m: float, high_m: float, at_m: float) -> complex:
    """What a strip leaves."""
    return 1 - past(low_m, at_m) + past(high_m, at_m)


def crossed(kind: str, width_m: float, aside_m: float, gap_m: float) -> list[trimesh.Trimesh]:
    """A post, and a rail behind it."""
    low, high = aside_m, aside_m + width_m
    deep_m = 0.0 if kind == "sheets" else min(width_m, 2e-3)
    behind_m = AT_M + gap_m
    bounds = [
        [[AT_M, low, -2], [AT_M + deep_m, high, 2]],
        [[behind_m, -2, low], [behind_m + deep_m, 2, high]],
    ]
    if kind == "boxes":
        return [trimesh.creation.box(bounds=each) for each in bounds]
    faces = [[0, 1, 2], [0, 2, 3]]
    return [
        trimesh.Trimesh([[a[0], a[1], a[2]], [a[0], b[1], a[2]], b, [a[0], a[1], b[2]]], faces)
        for a, b in bounds
    ]


@pytest.mark.parametrize("kind", ["sheets", "boxes"])
@pytest.mark.parametrize("gap_m", [0.0, 0.002, 0.1])
@pytest.mark.parametrize("width_m", [2e-4, 2e-3, 0.02, 0.05])
@pytest.mark.parametrize("share", [0.5, 0.3, 1.2])
def test_behind_a_crossing_it_is_the_product_of_both(share, width_m, gap_m, kind) -> None:
    """In one mesh and in two: their rims end where they cross, told to 1.6 cm before; behind
    wires it was dark, or 4 times as bright, behind posts up to 0.6 of the free echo off.
    """
    meshes = crossed(kind, width_m, -share * width_m, gap_m)
    low, high = -share * width_m, (1 - share) * width_m
    due = (beside(low, high, AT_M) * beside(low, high, AT_M + gap_m)) ** 2
    together = trimesh.util.concatenate(meshes)
    for objects in ([together], meshes):
        things: list[SceneObject] = [
            thing(f"part{i}", mesh.vertices, mesh.faces, radar="obstacle")
            for i, mesh in enumerate(objects)
        ]
        assert abs(echo(*things, at=point(), fidelity=LOW) - due) < 0.03


def strip(bounds: Bounds, off_m: float, at_m: float = AT_M) -> complex:
    """What passes through one, to a place off the line of sight."""
    low, high = (x - off_m * at_m / FAR_M for x in bounds)
    return past(low, at_m) - past(high, at_m)


def sheet(y: Bounds, z: Bounds, at_m: float = AT_M) -> trimesh.Trimesh:
    """A rectangle across the line of sight."""
    corners = [[at_m, a, b] for a, b in ((y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1]))]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def compared(due: Rectangles, meshes: list[trimesh.Trimesh], mode: str, places: Places) -> float:
    """The largest difference from what disjoint rectangles in one plane leave."""
    objects = [trimesh.util.concatenate(meshes)] if mode == "one mesh" else meshes
    things = [
        thing(f"part{i}", m.vertices, m.faces, radar="obstacle") for i, m in enumerate(objects)
    ]
    off = []
    for y, z in places:
        left = 1 - sum(strip(a, y) * strip(b, z) for a, b in due)
        off.append(abs(echo(*things, at=point((FAR_M, y, z)), fidelity=LOW) - left**2))
    return max(off)


BESIDE = ((5e-4, 0.0), (1e-3, 0.0), (-1e-3, 0.0), (1e-3, 1e-3), (3e-3, 3e-3))


@pytest.mark.parametrize("mode", ["one mesh", "two"])
@pytest.mark.parametrize(("post_m", "rail_m"), [(0.2, 0.05), (0.1, 0.1), (0.4, 0.4)])
@pytest.mark.parametrize("width_m", [0.003, 0.01])
def test_two_bars_that_meet_at_a_corner_are_one_shape(width_m, post_m, rail_m, mode) -> None:
    """A post on a rail's end, each of its own corners, and the way by the inner corner of both: the
    rail's edge ends where the post's does, as of one shape, also of short bars. The echo was up to
    2.2 times the true one, or a fifth of it.
    """
    post, rail = ((-width_m, 0.0), (0.0, post_m)), ((-width_m, rail_m), (-width_m, 0.0))
    meshes = [sheet(*post), sheet(*rail)]
    assert compared([post, rail], meshes, mode, ((0.0, 0.0), *BESIDE)) < 0.06


@pytest.mark.parametrize("mode", ["one mesh", "two"])
@pytest.mark.parametrize("sides_m", [(0.003, 0.003), (0.0012, 0.0028), (0.01, 0.01)])
@pytest.mark.parametrize("arms_m", [(0.05, 0.05), (0.23, 0.05), (0.3, 0.3)])
def test_two_bars_whose_ends_overlap_are_one_shape(arms_m, sides_m, mode) -> None:
    """Sides of both lie in one line: of these one counts, the same in all pieces. 0.1 to 1 off."""
    post = (-sides_m[0], 0.0), (-sides_m[1], arms_m[0])
    rail = (-sides_m[0], arms_m[1]), (-sides_m[1], 0.0)
    beside = (0.0, arms_m[1]), rail[1]
    meshes = [sheet(*post), sheet(*rail)]
    assert compared([post, beside], meshes, mode, BESIDE) < 0.04


@pytest.mark.parametrize("mode", ["one mesh", "two"])
@pytest.mark.parametrize(("beside_m", "within"), [(2e-4, 0.1), (1e-3, 0.01), (3e-3, 0.01)])
@pytest.mark.parametrize("thick_m", [0.0018, 0.006])
def test_a_rail_that_ends_beside_a_post_hides_no_more_than_itself(
    thick_m, beside_m, within, mode
) -> None:
    """Exactly in the way: waves over the post's edge were taken to meet the rail, 1 mm beside it,
    0.4 to 0.8 of the free echo.
    """
    post = (-0.0035, 0.0035), (-1.0, 1.0)
    rail = (-1.0, -0.0035 - beside_m), (-thick_m / 2, thick_m / 2)
    meshes = [sheet(*post), sheet(*rail)]
    places = ((0.0, 0.0), (0.01, 0.0), (-0.01, 0.0), (0.0, 0.01))
    assert compared([post, rail], meshes, mode, places) < within


@pytest.mark.parametrize("gap_m", [0.0, 0.002, 0.05])
@pytest.mark.parametrize("beside_m", [0.0, 1e-3])
def test_corners_of_two_rectangles_touch_as_on_a_chessboard(beside_m: float, gap_m: float) -> None:
    """Each stood in the light of the other's corner, past which waves were taken to be stopped: 0.3
    to 0.7 of the free echo.
    """
    post, rail = ((0.017, 0.025), (-0.31, 0.01)), ((-0.04, 0.017 - beside_m), (0.01, 0.013))
    meshes = [sheet(*post), sheet(*rail, at_m=AT_M + gap_m)]
    assert compared([post, rail], meshes, "two", ((0.0, 0.0), (0.01, 0.0), (0.08, -0.05))) < 0.03
