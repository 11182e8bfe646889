"""Declared targets beside wires, blades and sheets seen edge-on, closer to two edges than rays in
float32 can tell: against Fresnel's integrals over both edges.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from scipy.special import fresnel

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    RADAR,
    WAVELENGTH_M,
    paths_of,
    quad,
    thing,
    wave,
    world,
)
from twin.radar.propagation.solvers import trace
from twin.scene import SceneObject, Target

FAR_M = 10.0


def echo(*obstacles: SceneObject, height_m: float = 0.0) -> complex:
    """Of a point 10 m ahead, over that in free space."""
    target = Target("point", (FAR_M, 0.0, height_m), (0.0, 0.0, 0.0), 1.0, "declared")

    def total(*objects: SceneObject) -> complex:
        found = trace(world(*objects, targets=(target,)), RADAR)
        paths = found.contributions.take(np.arange(len(found.names)))
        return complex(np.sum(paths.amplitude * np.exp(-2j * np.pi * CARRIER_HZ * paths.delay_s)))

    return total(*obstacles) / total()


def past(edge_m: float, at_m: float) -> complex:
    """Share of the field that passes above an edge at a height over the line of sight."""
    s, c = fresnel(edge_m * np.sqrt(2 * FAR_M / (WAVELENGTH_M * at_m * (FAR_M - at_m))))
    return complex((1 + 1j) / 2 * ((0.5 - c) - 1j * (0.5 - s)))


def wire(at_m: float, aside_m: float, width_m: float) -> SceneObject:
    mesh = trimesh.creation.box((width_m, width_m, 6.0))
    place = [at_m, aside_m + width_m / 2, 0.0]
    return thing("wire", mesh.vertices + place, mesh.faces, radar="obstacle")


@pytest.mark.parametrize("at_m", [1.0, 5.0])
@pytest.mark.parametrize("width_m", [1e-5, 1e-4, 3e-4, 1e-3])
@pytest.mark.parametrize("beside_m", [-0.5, 1e-3, 0.01, 0.5, 2.0, 5.0])
def test_a_thin_wire_beside_the_way_takes_what_it_covers(at_m, width_m, beside_m) -> None:
    """Near one it took the whole echo. ``beside_m``: in widths, from its side."""
    aside_m = beside_m * width_m
    covered = past(aside_m, at_m) - past(aside_m + width_m, at_m)
    assert echo(wire(at_m, aside_m, width_m)) == pytest.approx((1 - covered) ** 2, abs=0.01)


@pytest.mark.parametrize("over_m", [0.0, 1e-9, 1e-6, 1e-4, -3e-4, 1e-3])
@pytest.mark.parametrize("height_m", [0.0, 1e-5, -1e-4, 6e-4])
def test_a_level_sheet_at_the_radars_height_hides_nothing(over_m, height_m) -> None:
    """Seen edge-on it took the whole echo. Its sides' waves, of no height, are 0.015 of it."""
    corners = [[4, -1, over_m], [6, -1, over_m], [6, 1, over_m], [4, 1, over_m]]
    sheet = quad("sheet", corners, radar="obstacle")
    assert echo(sheet, height_m=height_m) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("slit_m", [1e-5, 1e-4, 3e-4])
@pytest.mark.parametrize("beside_m", [1e-3, 0.5, 2.0])
def test_beside_a_slit_it_is_dark(slit_m: float, beside_m: float) -> None:
    """Between parts of one mesh; ``beside_m``: in slits, from its side."""
    side_m = beside_m * slit_m
    at = [(-3.0, -slit_m - side_m), (-side_m, 3.0)]
    corners = [
        [5, y, z] for ends in at for y, z in zip(np.repeat(ends, 2), [-3, 3, 3, -3], strict=True)
    ]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    sheets = thing("sheets", corners, faces, radar="obstacle")
    through = past(-slit_m - side_m, 5.0) - past(-side_m, 5.0)
    assert echo(sheets) == pytest.approx(through**2, abs=0.02)


def test_behind_the_middle_of_a_finely_divided_post_it_is_as_dark_as_of_a_plain_one() -> None:
    """Rays along a joint of triangles slipped through at every third place: 2.5 times the echo in
    free space for 0.4. The scene is turned, so that corners are rounded.
    """
    turn = Rotation.from_euler("ZY", [0.1612, 0.0472]).as_matrix()
    sides, ends = (-0.0197, 0.0197), (-2.45, 1.1425)
    corners = [[2.717, sides[j], ends[k]] for j, k in ((0, 0), (1, 0), (1, 1), (0, 1))]
    plain = trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)
    fine = plain.subdivide().subdivide()
    targets = tuple(
        Target(str(z), tuple(turn @ [6.0, 0.0, z]), (0.0, 0.0, 0.0), 1.0, "declared")
        for z in np.arange(-0.02, 0.02, 0.001)
    )
    waves = []
    for mesh in (plain, fine):
        post = thing("post", mesh.vertices @ turn.T, mesh.faces, radar="obstacle")
        found = trace(world(post, targets=targets), RADAR)
        waves.append([wave(paths_of(found, lambda p, t=t: p.target == t.name)) for t in targets])
    assert waves[1] == pytest.approx(waves[0], rel=1e-3)
