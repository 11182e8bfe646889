"""OBJ files as readers take them: triangles and convex polygons, each checked against what the file
holds.

Readers take what is no OBJ for a mesh without faces, and bend numbers into shape: too few in a line
are taken from the next one, and vertices counted back from a face are counted from the end.

Wavefront Technologies, Advanced Visualizer Manual, appendix B1: object files.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.files import InputError
from twin.scene.polygons import Triangles, splits

_NUMBERED = (b"v", b"vt", b"vn")  # what a corner of a face refers to, in the order it does
_STATEMENTS = {*_NUMBERED, b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"mtllib", b"usemtl"}


@dataclass(frozen=True)
class _Face:
    line: int
    corners: list[bytes]  # "vertex/texture/normal" each, counted from 1
    vertices: list[int]  # counted from 0

    def statements(self, triangles: Triangles | None) -> bytes:
        """The whole face, or the triangles of it."""
        parts = [range(len(self.corners))] if triangles is None else triangles
        return b"\n".join(b"f " + b" ".join(self.corners[i] for i in part) for part in parts)


def obj_in_triangles(path: Path) -> bytes:
    """The content of a file in which polygons that are not convex are triangles.

    Raises InputError for a file without any statement of OBJ, too few numbers in a line, vertices
    that are not there and polygons whose edges cross.
    """
    others: list[bytes | _Face] = []
    counts = dict.fromkeys(_NUMBERED, 0)
    vertices: list[list[float]] = []
    known = False
    for line, statement in _statements(path):
        key, _, rest = statement.replace(b"\t", b" ").partition(b" ")
        known = known or key in _STATEMENTS
        if key not in (*_NUMBERED, b"f"):
            others.append(statement)
            continue
        words = rest.partition(b"#")[0].split()
        if key in (b"v", b"f") and len(words) < 3:
            raise InputError(f"{path}: line {line}: {statement[:40]!r}, expected three or more")
        if key == b"f":
            others.append(_face(path, line, words, list(counts.values())))
            continue
        counts[key] += 1
        others.append(key + b" " + b" ".join(words))
        if key == b"v":
            vertices.append(_position(path, line, words))
    if not known:
        raise InputError(
            f"{path}: can't be read as a mesh (no OBJ file: no line begins with v, f or another "
            "statement of OBJ)"
        )
    return _written(path, others, vertices)


def _statements(path: Path) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers, those that a backslash continues as one."""
    before = b""
    with path.open("rb") as file:
        for number, text in enumerate(file, 1):
            line = before + text.strip()
            before = b""
            if line.endswith(b"\\"):
                before = line[:-1] + b" "
            elif line:
                yield number, line


def _position(path: Path, line: int, words: list[bytes]) -> list[float]:
    try:
        return [float(word) for word in words[:3]]
    except ValueError:
        wrong = b" ".join(words)[:40].decode(errors="replace")
        raise InputError(f"{path}: line {line}: {wrong!r}, expected three numbers") from None


def _face(path: Path, line: int, words: list[bytes], counts: list[int]) -> _Face:
    """A face after ``counts`` vertices, texture coordinates and normals."""
    corners, vertices = [], []
    for word in words:
        try:
            numbers = [int(n) if n else None for n in word.split(b"/")]
            vertex = numbers[0]
            if vertex is None or len(numbers) > len(counts):
                raise ValueError
        except ValueError:
            wrong = word[:40].decode(errors="replace")
            raise InputError(
                f"{path}: line {line}: {wrong!r}, expected a vertex's number"
            ) from None
        if vertex == 0:
            raise InputError(f"{path}: line {line}: vertex 0, but OBJ counts from 1")
        if -vertex > counts[0]:
            raise InputError(f"{path}: line {line}: vertex {vertex}, of {counts[0]} before it")
        if b"-" in word:
            numbers = [
                n if n is None or n >= 0 else count + 1 + n
                for n, count in zip(numbers, counts, strict=False)
            ]
            word = b"/".join(b"" if n is None else b"%d" % n for n in numbers)
        corners.append(word)
        vertices.append((vertex if vertex > 0 else counts[0] + 1 + vertex) - 1)
    return _Face(line, corners, vertices)


def _written(path: Path, others: list[bytes | _Face], vertices: list[list[float]]) -> bytes:
    faces = [one for one in others if isinstance(one, _Face)]
    for face in faces:
        if max(face.vertices) >= len(vertices):
            raise InputError(
                f"{path}: line {face.line}: vertex {max(face.vertices) + 1} of {len(vertices)}"
            )
    made = splits(
        np.array(vertices).reshape(-1, 3),
        [face.vertices for face in faces],
        lambda number: f"{path}: line {faces[number].line}",
    )
    split = {id(faces[number]): triangles for number, triangles in made.items()}
    return b"\n".join(
        one if isinstance(one, bytes) else one.statements(split.get(id(one))) for one in others
    )
