"""Polygons of mesh files become triangles that fill them, and no more."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.files import InputError
from twin.geometry import Geometry
from twin.scene.meshes import read_mesh

Array = NDArray[np.float64]

# The true area is 0.00625 m2; the fan from the first corner covers 0.00875 m2.
NOTCHED = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0.05, 0.025], [0, 0.1]])
# A square of 3 with a hole of 1: the edge to the hole is walked there and back.
KEYHOLE = np.array([[0, 0], [3, 0], [3, 3], [0, 3], [0, 0], [1, 1], [1, 2], [2, 2], [2, 1], [1, 1]])
# Corners within edges, and a dart whose hollow is its second corner.
STEPS = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 1]])
DART = np.array([[1, 0], [0.3, 0.3], [0, 1], [0, 0]])


def star(seed: int, corners: int) -> Array:
    """Simple, and concave at about every second corner."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    radius = rng.uniform(0.1, 1, corners)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


SHAPES = {
    "notched": NOTCHED,
    "keyhole": KEYHOLE,
    "steps": STEPS,
    "dart": DART,
    "clockwise": NOTCHED[::-1],
    **{f"star {n}": star(n, n) for n in (5, 8, 30, 200)},
}


def shoelace(flat: Array) -> float:
    x, y = flat.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def inside(flat: Array, points: Array) -> NDArray[np.bool_]:
    """By the parity of the edges that a ray towards +x crosses."""
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in pairwise([*flat, flat[0]]):
        if y0 != y1:
            between = (points[:, 1] >= min(y0, y1)) & (points[:, 1] < max(y0, y1))
            odd ^= between & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return odd


def obj(vertices: Array, faces: list[list[int]], path: Path) -> Path:
    """Of these formats the one whose faces follow their vertices and count back from there."""
    lines = []
    for face in faces:
        lines += ["v " + " ".join(map(repr, map(float, vertices[i]))) for i in face]
        lines.append("f " + " ".join(str(i - len(face)) for i in range(len(face))))
    path.write_text("\n".join(lines))
    return path


def ply(vertices: Array, faces: list[list[int]], path: Path, encoding: str = "ascii") -> Path:
    """With texture coordinates, a colour per face, and in front of the corners."""
    head = (
        f"ply\nformat {encoding} 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        "property float u\nproperty float v\n"
        f"element face {len(faces)}\nproperty uchar shade\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    if encoding == "ascii":
        rows = [" ".join(map(repr, map(float, [*v, *v[:2]]))) for v in vertices]
        rows += [" ".join(map(str, [7, len(face), *face])) for face in faces]
        path.write_text(head + "\n".join(rows) + "\n")
        return path
    order = "<" if "little" in encoding else ">"
    data = b"".join(
        v.astype(f"{order}f8").tobytes() + v[:2].astype(f"{order}f4").tobytes() for v in vertices
    )
    for face in faces:
        data += bytes([7, len(face)]) + np.array(face, f"{order}i4").tobytes()
    path.write_bytes(head.encode() + data)
    return path


def written(vertices: Array, faces: list[list[int]], kind: str, folder: Path) -> Path:
    if kind == "obj":
        return obj(vertices, faces, folder / "x.obj")
    return ply(vertices, faces, folder / "x.ply", kind)


KINDS = ("obj", "ascii", "binary_little_endian", "binary_big_endian")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_triangles_fill_a_polygon_and_no_more(shape: str, kind: str, tmp_path: Path) -> None:
    """Wherever it lies, beside a triangle and a square: area by the shoelace formula, normals as
    the corners turn, and a thousand points as often in a triangle as in the polygon.
    """
    flat = np.asarray(SHAPES[shape], dtype=np.float64)
    turn, far = Rotation.from_rotvec([0.3, -1.1, 0.7]), np.array([300.0, -20.0, 1.0])
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + 5.0
    all_flat = np.vstack([flat, square, square[:3]])
    n = len(flat)
    faces = [list(range(n)), [n, n + 1, n + 2, n + 3], [n + 4, n + 5, n + 6]]
    vertices = turn.apply(np.column_stack([all_flat, np.zeros(len(all_flat))])) + far
    mesh = read_mesh(written(vertices, faces, kind, tmp_path))

    back = turn.inv().apply(mesh.vertices_m - far)
    np.testing.assert_allclose(back[:, 2], 0, atol=1e-12)
    corners = back[mesh.faces][:, :, :2]
    of_it = (corners < 4).all(axis=(1, 2))
    areas = np.array([shoelace(triangle) for triangle in corners])
    assert areas[~of_it].sum() == pytest.approx(1.5)
    assert areas[of_it].sum() == pytest.approx(shoelace(flat), rel=1e-9)
    assert (areas[of_it] * np.sign(shoelace(flat)) > -1e-12).all()
    low, high = flat.min(axis=0), flat.max(axis=0)
    points = np.random.default_rng(1).uniform(low - 0.1, high + 0.1, (1000, 2))
    times = np.sum([inside(triangle, points) for triangle in corners[of_it]], axis=0)
    np.testing.assert_array_equal(times, inside(flat, points))
    if kind != "obj":
        assert mesh.uv is not None
        np.testing.assert_allclose(mesh.uv, mesh.vertices_m[:, :2], rtol=1e-6)


def test_convex_polygons_stay_fans(tmp_path: Path) -> None:
    """From their first corner, in the order in which they stand."""
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    flat = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    for kind in KINDS:
        mesh = read_mesh(written(flat, [[0, 1, 2, 3, 4, 5]], kind, tmp_path))
        np.testing.assert_allclose(mesh.vertices_m[mesh.faces], flat[expected], atol=1e-15)


BOW_TIE = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0.0]])
PENTAGRAM = np.array([[np.cos(a), np.sin(a), 1.0] for a in 0.8 * np.pi * np.arange(5)])
# Edges that cross in a corner which both have.
KNOTTED = np.array([[0, 0, 0], [1, 1, 0], [2, 2, 0], [2, 0, 0], [1, 1, 0], [0, 2, 0.0]])
# There and back without any area, around which a fan would cover some.
SPIKES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 0, 0.0]])


@pytest.mark.parametrize("corners", [BOW_TIE, PENTAGRAM, KNOTTED, SPIKES])
@pytest.mark.parametrize("kind", KINDS)
def test_a_polygon_whose_edges_cross_is_refused(corners: Array, kind: str, tmp_path: Path) -> None:
    path = written(corners, [list(range(len(corners)))], kind, tmp_path)
    where = f"line {len(corners) + 1}" if kind == "obj" else "face 0"
    with pytest.raises(InputError, match=f"^{path}: {where}: edges of the polygon cross"):
        read_mesh(path)


def test_texture_and_normals_of_an_obj_stay_with_their_corners(tmp_path: Path) -> None:
    """Of a polygon that is split, each corner by its own numbers, from the end as from 1."""
    lines = [f"v {x} {y} 0\nvt {x * 10} {y * 10}" for x, y in NOTCHED]
    for face in ("f 1/1/1 2/2/1 3/3/1 4/4/1 5/5/1", "f -5/-5/-1 -4/-4/-1 -3/-3/-1 -2/-2/-1 5/5/1"):
        (tmp_path / "x.obj").write_text("\n".join([*lines, "vn 0 0 1", face]))
        mesh = read_mesh(tmp_path / "x.obj")
        assert mesh.uv is not None
        np.testing.assert_allclose(mesh.uv, mesh.vertices_m[:, :2] * 10)
        assert area(mesh) == pytest.approx(0.00625)


def test_texture_per_corner_of_a_ply_stays_with_its_corner(tmp_path: Path) -> None:
    """A list of pairs per face, as MeshLab writes it."""
    rows = [f"{x} {y} 0" for x, y in NOTCHED]
    pairs = " ".join(f"{10 * x} {10 * y}" for x, y in NOTCHED)
    (tmp_path / "x.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
        + "\n".join([*rows, f"5 0 1 2 3 4 10 {pairs}"])
    )
    mesh = read_mesh(tmp_path / "x.ply")
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv, mesh.vertices_m[:, :2] * 10, rtol=1e-6)
    assert area(mesh) == pytest.approx(0.00625)


def area(mesh: Geometry) -> float:
    return float(mesh.areas_m2.sum())
