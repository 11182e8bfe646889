"""A geometry: read-only, closed forms, against trimesh, and nothing kept that outlives it."""

import copy
import gc
import pickle
from dataclasses import replace
from weakref import ref

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform, Rotation

from tests.physics.radar_worlds import ball, thing, world
from twin.digest import digest
from twin.errors import InputError
from twin.geometry import Geometry, are_too_large, divided, planes, shapes_of
from twin.geometry.coplanar import Facets, shared_by_two, shared_within
from twin.geometry.covered import covered
from twin.geometry.edges import doubles, edge_table
from twin.radar.propagation.scene.mesh_scene import mesher
from twin.radar.propagation.surface_clutter import field_of
from twin.scene.boxes import boxes_of

CUBE = trimesh.creation.box((2.0, 2.0, 2.0))
TURN = Rotation.from_euler("xyz", [0.4, 1.1, -2.3])


def geometry_of(mesh: trimesh.Trimesh) -> Geometry:
    return Geometry(mesh.vertices, mesh.faces)


def cube(center=(0.0, 0.0, 0.0)) -> Geometry:
    return Geometry(CUBE.vertices + np.asarray(center), CUBE.faces)


def test_nobody_can_write_to_it() -> None:
    """Neither to its arrays, nor to what was given, nor to a view of it that was read-only."""
    vertices, faces = np.array(CUBE.vertices), np.array(CUBE.faces, dtype=np.int32)
    view = vertices[:]
    view.setflags(write=False)
    made = Geometry(view, faces, vertices[:, :2])
    vertices[0], faces[0] = 7.0, 1
    np.testing.assert_array_equal(made.vertices_m, CUBE.vertices)
    np.testing.assert_array_equal(made.faces, CUBE.faces)
    np.testing.assert_array_equal(made.uv, CUBE.vertices[:, :2])
    for array in (made.vertices_m, made.faces, made.uv):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        made.faces = faces  # type: ignore[misc]


def test_arrays_of_one_geometry_are_not_copied_for_another() -> None:
    whole = cube()
    part = Geometry(whole.vertices_m, whole.faces[:4])
    assert np.shares_memory(part.vertices_m, whole.vertices_m)
    assert np.shares_memory(part.faces, whole.faces)


@pytest.mark.parametrize(
    ("vertices", "faces", "told"),
    [
        ([[0, 0, 0]], [[0, 0, 1]], "face 0 refers to vertex 1 of 1"),
        ([[0, 0, 0]], [[0, 0, -1]], "face 0 refers to vertex -1 of 1"),
        ([[0, 0, 0]], np.array([[0, 0, 2**32 - 1]], np.uint32), "refers to vertex 4294967295"),
        ([[0, 0, 0]], [[0.0, 0.0, 0.0]], "faces of type float64, expected indices"),
        ([[0, 0, np.nan]], [[0, 0, 0]], "vertex 0 is [0.0, 0.0, nan], expected finite numbers"),
        ([[0, 0]], [[0, 0, 0]], "vertices of shape (1, 2)"),
        ([[0, 0, 0]], [[0, 0]], "faces of shape (1, 2)"),
    ],
)
def test_what_is_no_mesh_is_refused(vertices, faces, told: str) -> None:
    with pytest.raises(InputError) as error:
        Geometry(vertices, faces, place="file: shape 'a'")
    assert str(error.value).startswith("file: shape 'a': ")
    assert told in str(error.value)


@pytest.mark.parametrize("offset_m", [0.0, 1e6])
def test_a_cube(offset_m: float) -> None:
    """Side 2: areas, normals, planes, thickness, sense of its normals; at any place."""
    made = cube((offset_m, -offset_m, offset_m))
    shape = made.shape
    np.testing.assert_allclose(made.areas_m2, 2.0, rtol=1e-9)
    np.testing.assert_allclose(made.normals, CUBE.face_normals, atol=1e-12)
    np.testing.assert_allclose(shape.patch_area_m2, np.full(6, 4.0), rtol=1e-9)
    np.testing.assert_allclose(shape.plane_area_m2, np.full(6, 4.0), rtol=1e-9)
    assert shape.area_m2 == pytest.approx(24)
    assert shape.thickness_m in (None, pytest.approx(2.0))  # the largest two of six equal patches
    assert shape.size_m == pytest.approx(2 * 3**0.5)
    assert (shape.outward == 1).all()
    assert shape.is_convex
    assert shape.bend_radius_m == np.inf
    assert shape.depth_m == 0
    assert made.sphere[1] == pytest.approx(3**0.5)
    assert made.merged.volume == pytest.approx(8, rel=1e-6)


def test_a_ball() -> None:
    """Its area from below, its normals along its radii, convex, seen as one smooth surface."""
    made = geometry_of(trimesh.creation.icosphere(4, radius=0.5))
    assert made.shape.area_m2 == pytest.approx(np.pi, rel=5e-3)
    assert made.shape.area_m2 < np.pi
    middle = made.corners_m.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    np.testing.assert_allclose(np.sum(made.normals * middle, axis=1), 1, atol=1e-3)
    assert made.shape.is_convex
    assert 0 < made.shape.depth_m < 0.5 * (1 - np.cos(0.05))
    inward = Geometry(made.vertices_m, made.faces[:, ::-1]).shape
    assert (inward.outward == -1).all()
    assert inward.is_convex


def test_pairs_of_neighbours_are_those_of_trimesh() -> None:
    for mesh in (
        trimesh.creation.icosphere(3),
        trimesh.creation.cylinder(0.3, 2.0),
        trimesh.Trimesh(*open_sheet(), process=False),
    ):
        found = np.sort(edge_table(np.asarray(mesh.faces)).neighbours, axis=1)
        expected = np.sort(mesh.face_adjacency, axis=1)
        assert set(map(tuple, found.tolist())) == set(map(tuple, expected.tolist()))
        edges = geometry_of(mesh).edges
        assert set(map(tuple, edges.ends.tolist())) == set(map(tuple, mesh.edges_unique.tolist()))
        np.testing.assert_array_equal(np.bincount(edges.edge_of_face.ravel()), edges.count)


def open_sheet(n: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy sheet of n x n points."""
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = np.stack([x, y, np.sin(x) * np.cos(y)], axis=-1).reshape(-1, 3)
    number = np.arange(n * n).reshape(n, n)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return points, np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


def test_corners_at_one_place_are_one() -> None:
    """A cube whose faces have corners of their own is as closed as one that shares them."""
    soup = Geometry(CUBE.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert len(np.unique(soup.welded_faces)) == 8
    assert soup.shape.is_convex
    assert len(soup.edges.first) == 18
    shared = cube()
    assert shared.welded_faces is shared.faces
    for made in (soup, shared):  # measured, or asked for alone
        again = Geometry(made.vertices_m, made.faces)
        assert made.shape
        np.testing.assert_array_equal(made.welded_faces, again.welded_faces)


def test_an_edge_of_three_faces_has_no_pair() -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0.1], [0, 0.1, 1]]
    fan = Geometry(vertices, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert not len(fan.edges.neighbours)
    assert fan.edges.count.max() == 3
    assert (fan.shape.outward == 0).all()


def test_doubles_and_faces_without_area() -> None:
    faces = np.vstack([CUBE.faces, CUBE.faces[3, [1, 2, 0]][None], [[0, 0, 1]], [[0, 1, 1]]])
    made = Geometry(CUBE.vertices, faces)
    np.testing.assert_array_equal(np.flatnonzero(made.shape.is_double), [12])
    np.testing.assert_array_equal(np.flatnonzero(made.areas_m2 == 0), [13, 14])
    np.testing.assert_array_equal(made.normals[13:], 0)
    assert (made.shape.outward[:12] == 1).all()
    assert len(made.without_empty_faces().faces) == 13
    assert cube().without_empty_faces() is not None
    with pytest.raises(InputError, match="here: no face has an area"):
        Geometry(CUBE.vertices, [[0, 0, 1]]).without_empty_faces("here")


def test_doubles_against_every_pair_of_faces() -> None:
    faces = np.random.default_rng(1).integers(0, 6, (300, 3)).astype(np.int32)
    rows = np.sort(faces, axis=1).tolist()
    np.testing.assert_array_equal(doubles(faces), [row in rows[:i] for i, row in enumerate(rows)])


def test_empty() -> None:
    none = Geometry([], [])
    assert none.vertices_m.shape == none.faces.shape == (0, 3)
    assert none.normals.shape == (0, 3)
    assert none.areas_m2.sum() == 0
    assert not are_too_large(none.vertices_m, none.faces).any()
    assert Geometry.concatenate([]).faces.shape == (0, 3)
    with pytest.raises(InputError, match="has no faces"):
        shapes_of([cube(), none])
    pickle.loads(pickle.dumps(none))


def test_joined_and_transformed() -> None:
    both = Geometry.concatenate([cube(), cube((5, 0, 0))])
    assert both.areas_m2.sum() == pytest.approx(48)
    assert len(both.vertices_m) == 16
    mirrored = cube().transformed(np.diag([-1.0, 1, 1, 1]))
    assert (mirrored.shape.outward == 1).all()
    with pytest.raises(InputError, match="there: vertex 0 is"):
        cube().transformed(np.diag([np.inf, 1.0, 1, 1]), "there")


def test_what_is_kept_is_not_pickled() -> None:
    """A sweep's workers get arrays, which stay read-only and shared, and nothing else."""
    item = ball("b", (5, 0, 0), level=5)
    plain = len(pickle.dumps(item))
    assert item.geometry.shape is item.geometry.shape
    assert item.box_m.shape == item.vertices_m[:2].shape
    assert item.geometry.edges.ends.size
    assert len(pickle.dumps(item)) == plain
    again, other = pickle.loads(pickle.dumps((item, replace(item, name="c"))))
    assert again.geometry is other.geometry
    assert not again.geometry.vertices_m.flags.writeable
    np.testing.assert_array_equal(again.vertices_m, item.vertices_m)
    assert digest(again) == digest(item) != digest(item.moved([0.1, 0, 0]))
    assert copy.deepcopy(item.geometry).shape.hull.tolist() == item.geometry.shape.hull.tolist()


def test_a_thousand_objects_of_one_geometry_are_measured_once(monkeypatch) -> None:
    from twin.geometry import shape

    count = []
    measure = shape._measured
    monkeypatch.setattr(shape, "_measured", lambda some: count.append(len(some)) or measure(some))
    one = thing("t", CUBE.vertices, CUBE.faces)
    items = [replace(one, name=f"t{i}").moved([3.0 * i, 0, 0]) for i in range(1000)]
    boxes = boxes_of(items)
    assert count == [1]
    np.testing.assert_allclose(boxes[:, 0, 0], 3.0 * np.arange(1000) - 1)


def test_many_at_once_give_what_each_gives() -> None:
    makers = [
        cube,
        lambda: geometry_of(trimesh.creation.icosphere(2)),
        lambda: Geometry(*open_sheet()),
        lambda: Geometry(CUBE.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3)),
    ]
    together = shapes_of([make() for make in makers])
    for make, shape in zip(makers, together, strict=True):
        alone = make().shape
        for name, value in vars(alone).items():
            np.testing.assert_array_equal(getattr(shape, name), value, err_msg=name)


def test_a_pose_moves_and_turns() -> None:
    item = thing("t", CUBE.vertices, CUBE.faces)
    assert item.vertices_m is item.geometry.vertices_m
    posed = replace(item, pose=RigidTransform.from_components([1e6, 2, 3], TURN)).moved([1, 0, 0])
    expected = TURN.apply(CUBE.vertices) + [1e6 + 1, 2, 3]
    np.testing.assert_allclose(posed.vertices_m, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(posed.box_m[1], expected.max(axis=0), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(item.moved([0.1, 0, 0]).vertices_m, CUBE.vertices + [0.1, 0, 0])


def test_what_is_at_rest_stays_the_same_object_later() -> None:
    still, moving = ball("s", (5, 0, 0)), ball("m", (9, 0, 0), velocity_m_per_s=(1.0, 0.0, 0.0))
    later = world(still, moving).after(0.5).objects
    assert later[0] is still
    assert later[1].geometry is moving.geometry
    np.testing.assert_array_equal(later[1].vertices_m, moving.vertices_m + [0.5, 0, 0])


def test_a_geometry_made_where_another_one_was_freed_is_not_taken_for_it() -> None:
    """Python gives a new object the id of one that is gone: what was kept must not be found by it.

    One box after another, each of another size, through everything that is kept for the radar.
    """
    seen, alive = set(), []
    for number in range(200):
        size = 1.0 + number / 10
        item = thing("t", CUBE.vertices * size, CUBE.faces)
        seen.add(id(item.geometry))
        assert item.geometry.shape.area_m2 == pytest.approx(24 * size**2)
        assert field_of(item, 8, 1).area_m2 * 8 == pytest.approx(24 * size**2)
        held = mesher([item], np.zeros(3))
        assert np.abs(held.vertices).max() == size
        assert held.items[0] is item
        alive.append(ref(item.geometry))
        del item, held
    gc.collect()
    assert len(seen) < 200  # ids were given again
    assert sum(there() is not None for there in alive) <= 20  # those of the last mesh scenes


def test_planes_of_tiny_and_of_flat_faces() -> None:
    corners = np.array([[0, 0, 0], [1e-170, 0, 0], [0, 1e-170, 0], [1.0, 1, 1]])
    found = planes(corners, np.array([[0, 1, 2], [0, 0, 3]]))
    np.testing.assert_array_equal(found[:, 3:], [[0, 0, 1], [0, 0, 0]])


def test_large_triangles_are_divided_and_keep_their_surface() -> None:
    corners = np.array([[-1e4, -1e4, -2], [1e4, -1e4, -2], [1e4, 1e4, -2], [-1e4, 1e4, -2.0]])
    whole = Geometry(corners, [[0, 1, 2], [0, 2, 3]])
    vertices, faces, uv = divided(whole.vertices_m, whole.faces)
    assert len(faces) > 100
    assert uv is None
    assert not are_too_large(vertices, faces).any()
    assert Geometry(vertices, faces).areas_m2.sum() == pytest.approx(4e8)


def facets_of(geometry: Geometry) -> Facets:
    every = np.arange(len(geometry))
    return Facets.of(geometry, geometry.vertices_m, every).known(geometry)


def test_what_others_cover_of_triangles_is_marked_and_nothing_else() -> None:
    """Random triangles in a tilted plane, against points of it: covered are those that any cover
    holds. The surface itself stays what it was.
    """
    rng = np.random.default_rng(3)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5])
    own, covers = (
        turn.apply(np.column_stack([rng.uniform(0, 1, (3 * n, 2)), np.zeros(3 * n)]))
        for n in (5, 12)
    )
    under, over = (Geometry(at, np.arange(len(at)).reshape(-1, 3)) for at in (own, covers))
    shared = shared_by_two(facets_of(under), facets_of(over), 1e-9)
    made, part_of = covered(under, shared.one, over.corners_m[shared.other])
    np.testing.assert_allclose(
        np.bincount(part_of, made.areas_m2, len(under)), under.areas_m2, rtol=1e-9
    )
    weights = rng.dirichlet(np.ones(3), 20_000)
    for face in range(len(under)):
        points = turn.inv().apply(weights @ under.corners_m[face])[:, :2]
        inside = np.zeros(len(points), dtype=bool)
        for corners in turn.inv().apply(covers)[:, :2].reshape(-1, 3, 2):
            edge = np.roll(corners, -1, axis=0) - corners
            off = points[:, None] - corners
            side = edge[:, 0] * off[..., 1] - edge[:, 1] * off[..., 0]
            inside |= (side > 0).all(axis=1) | (side < 0).all(axis=1)
        rows = (part_of == face) & made.shape.is_double
        share = made.areas_m2[rows].sum() / under.areas_m2[face]
        assert share == pytest.approx(inside.mean(), abs=0.015)  # four sigma of the points


def test_a_mesh_that_lies_upon_itself_is_told_from_one_that_only_touches() -> None:
    """The other diagonal of a square, and a patch apart in its plane; not neighbours in a plane,
    two squares beside each other, or the inner walls of two closed boxes that touch.
    """
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    halves, others = [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]
    within = np.array(square) * 0.3 + [0.1, 0.4, 0]
    for vertices, faces, pairs in (
        (square, halves, 0),
        (square, halves + others, 4),
        (np.vstack([square, within]), halves + [[4, 5, 6], [4, 6, 7]], 2),
        (np.vstack([square, np.add(square, [1, 0, 0])]), halves + [[4, 5, 6], [4, 6, 7]], 0),
    ):
        assert len(shared_within(Geometry(vertices, faces), 1e-6)[1].one) == pairs
    one, other = cube(), cube((2.0, 0.5, 0.0))
    assert not len(shared_by_two(facets_of(one), facets_of(other), 1e-6).one)
    assert len(shared_by_two(facets_of(one), facets_of(cube((0.5, 1.0, 0.0))), 1e-6).one) > 0
