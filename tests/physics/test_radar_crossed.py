"""Declared targets behind posts and rails that cross: heights over both are independent, so that
the field behind both planes is the product of those behind a strip each.
"""

import numpy as np
import pytest
import trimesh
from scipy.special import fresnel

from tests.physics.radar_worlds import WAVELENGTH_M, thing
from tests.physics.shadow_worlds import OPTICS, echo, point
from twin.scene import SceneObject

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
