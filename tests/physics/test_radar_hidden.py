"""What is known to stand in shadow: against rays to many points of every triangle."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from tests.physics.radar_worlds import RADAR, WAVELENGTH_M, ball, ground, quad, thing, world
from twin.radar.propagation.facets.convexity import convex_parts
from twin.radar.propagation.facets.front_facets import bistatic_facets
from twin.radar.propagation.facets.hidden import wholly_hidden
from twin.radar.propagation.facets.scatterers import scatterers
from twin.radar.propagation.facets.shadows import is_visible
from twin.radar.propagation.physical_optics import _bodies
from twin.radar.propagation.prepared_scene import prepare_scene
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.scene import Scene, SceneObject

BOX = trimesh.creation.box(extents=(1, 1, 1))


def block(name: str, center, size) -> SceneObject:
    return thing(
        name, BOX.vertices * np.asarray(size) + np.asarray(center), BOX.faces, radar="optics"
    )


def yard(rng: np.random.Generator) -> Scene:
    """Blocks, two of them side by side but for a slit, and slabs with a gap, before a wall over
    metal ground, beside a mirror.
    """
    blocks = [
        block(f"b{i}", (rng.uniform(5, 15), rng.uniform(-4, 4), 0), rng.uniform(0.5, 3, 3))
        for i in range(4)
    ]
    wide = [block("left", (8, 1.02, 0), (1, 2, 3)), block("right", (8, -1.01, 0), (1, 2, 3))]
    across = trimesh.creation.box(extents=(0.2, 12, 12)).subdivide().subdivide().subdivide()
    far = thing("far", across.vertices + [20, 0, 3], across.faces, radar="optics")
    beside = quad("mirror", [[2, 6, -1], [18, 6, -1], [18, 6, 5], [2, 6, 5]], radar="surface")
    return world(*blocks, *wide, far, ground(-1.2), beside)


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(4))
def test_what_is_known_to_be_hidden_has_no_point_that_is_seen(seed: int) -> None:
    """150 points of every facet over all pairs of images: of those of which none is seen most are,
    whatever the image, known to be hidden, and of none of them a point is seen. Fails without the
    search along edges for where one part goes on for another, and without the sides of mirrors.
    """
    rng = np.random.default_rng(seed)
    scene = yard(rng)
    prepared = prepare_scene(
        scene, RADAR, assign_scattering_models(scene, WAVELENGTH_M, with_optics=True), 1
    )
    assert len(prepared.images) == 3  # the radar, in the ground, in the mirror
    s, bodies = prepared.context, scatterers(prepared, RADAR.antenna, _bodies(prepared))
    facets = bistatic_facets(s, bodies, prepared.images)
    lit = facets.take(facets.all)
    hidden = wholly_hidden(s, bodies.parts, lit)
    is_seen = np.zeros(len(lit), dtype=bool)
    for u, v in rng.random((150, 2)).tolist():
        a, b, c = (1 - u**0.5, u**0.5 * (1 - v), u**0.5 * v)
        corners = lit.corners
        place = a * corners[0] + b * corners[1] + c * corners[2]
        place += 1e-3 * (lit.center - place)
        is_seen |= np.array(is_visible(s, lit, place))
    assert not (hidden & is_seen).any()
    receiver = np.array(lit.receiver)
    for image, least in enumerate((0.8, 0.7, 0.8)):
        unseen = ~is_seen & (receiver == image)
        assert np.count_nonzero(hidden & unseen) > least * np.count_nonzero(unseen)
    assert 100 < np.count_nonzero(is_seen) < 0.5 * len(lit)


def parts_of(item: SceneObject) -> np.ndarray:
    faces = item.geometry.faces
    mesh = SimpleNamespace(items=[item], faces=faces, face_ranges=[slice(0, len(faces))])
    return convex_parts(mesh)


def test_convex_parts_are_flat_patches_without_a_corner_that_juts_in() -> None:
    """A rectangle of eight triangles is one part and a ball is one, of an L and of a frame each
    triangle is its own, and so are a chimney's walls.
    """
    corners = np.array([[x, y, 0.0] for y in range(3) for x in range(3)])
    cells = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 8], [4, 8, 7]]
    assert len(set(parts_of(thing("whole", corners, cells)).tolist())) == 1
    assert len(set(parts_of(thing("L", corners, cells[:6])).tolist())) == 6
    grid = np.array([[x, y, 0.0] for y in range(4) for x in range(4)])
    around = [(x, y) for y in range(3) for x in range(3) if (x, y) != (1, 1)]
    frame = [
        [n, *rest]
        for x, y in around
        for n in [4 * y + x]
        for rest in ((n + 1, n + 5), (n + 5, n + 4))
    ]
    assert len(set(parts_of(thing("frame", grid, frame)).tolist())) == 16
    assert len(set(parts_of(ball("ball", (5, 0, 0), level=2)).tolist())) == 1
    chimney = thing("chimney", BOX.vertices, BOX.faces[np.abs(BOX.face_normals[:, 2]) < 0.5])
    assert sorted(np.bincount(parts_of(chimney)).tolist()) == [2, 2, 2, 2]
