"""PLY files as readers take them: whole, with faces of triangles and convex polygons.

Readers take what lies between a header and the end of the text, however much that is, and no
binary file whose faces differ in the number of their corners.

G. Turk, "The PLY polygon file format" (1994).
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.files import InputError
from twin.scene.polygons import Triangles, fan, splits

_ENCODINGS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
_KINDS = {
    **dict.fromkeys((b"char", b"int8"), "i1"), **dict.fromkeys((b"uchar", b"uint8"), "u1"),
    **dict.fromkeys((b"short", b"int16"), "i2"), **dict.fromkeys((b"ushort", b"uint16"), "u2"),
    **dict.fromkeys((b"int", b"int32"), "i4"), **dict.fromkeys((b"uint", b"uint32"), "u4"),
    **dict.fromkeys((b"float", b"float32"), "f4"), **dict.fromkeys((b"double", b"float64"), "f8"),
    b"int64": "i8", b"uint64": "u8", b"float16": "f2",
}  # fmt: skip
_CORNERS = (b"vertex_indices", b"vertex_index")


@dataclass(frozen=True)
class _Property:
    name: bytes
    kind: np.dtype[Any]
    count: np.dtype[Any] | None  # kind of a list's length; None: one number

    @cached_property
    def is_of_indices(self) -> bool:
        return self.count is not None and self.kind.kind in "iu"


@dataclass(frozen=True)
class _Element:
    """A table of a file: its rows hold the properties one after another."""

    name: bytes
    rows: int
    properties: list[_Property]
    line: int  # in the header, from 0

    @cached_property
    def holds_lists(self) -> bool:
        return any(p.count is not None for p in self.properties)


@dataclass(frozen=True)
class _Header:
    lines: list[bytes]
    order: str  # of bytes; none in text
    elements: list[_Element]


#: What the properties of a row hold: a list's numbers, or one alone; words in text.
_Row = list[list[Any]]


@dataclass(frozen=True)
class _Table:
    """Where the rows of an element lie in a file, and what the rows of faces hold."""

    start: int
    end: int
    rows: list[_Row]


class _BrokenError(Exception):
    """Why a file is no whole PLY."""


def ply_in_triangles(path: Path) -> bytes:
    """The content of a file, in which polygons that are not convex are triangles.

    Raises InputError for a file that holds less or more than its header says, and for polygons
    whose edges cross.
    """
    content = path.read_bytes()
    try:
        header, start = _header(content)
        read = _read_binary if header.order else _read_text
        tables = read(header, content, start)
    except _BrokenError as error:
        raise InputError(f"{path}: can't be read as a mesh ({error})") from error
    return _written(path, header, content, tables)


def _header(content: bytes) -> tuple[_Header, int]:
    """What a file says of itself, and where that ends."""
    lines: list[bytes] = []
    elements: list[_Element] = []
    order, start = None, 0
    while True:
        end = content.find(b"\n", start) + 1
        if not lines and content[:end].strip() != b"ply":
            raise _BrokenError("no PLY file: its first line is not `ply`")
        if not end and content[start:].strip() != b"end_header":
            raise _BrokenError("PLY without `end_header`: cut short")
        lines.append(content[start : end or None])
        start = end or len(content)
        words = lines[-1].split()
        try:
            match words:
                case [b"end_header"]:
                    break
                case [b"format", encoding, *_]:
                    order = _ENCODINGS[encoding.lower()]
                case [b"element", name, rows]:
                    elements.append(_Element(name, _count(rows), [], len(lines) - 1))
                case [b"property", b"list", count, kind, name]:
                    listed = _Property(name, _kind(kind, order), _kind(count, order))
                    elements[-1].properties.append(listed)
                case [b"property", kind, name]:
                    elements[-1].properties.append(_Property(name, _kind(kind, order), None))
                case [b"element" | b"property" | b"format", *_]:
                    raise ValueError
        except (IndexError, KeyError, ValueError):
            wrong = lines[-1].strip()[:60].decode(errors="replace")
            raise _BrokenError(f"PLY header, line {len(lines)}: {wrong!r}") from None
    if order is None:
        raise _BrokenError("PLY header without its `format`")
    return _Header(lines, order, elements), start


def _count(word: Any) -> int:
    if (count := int(word)) < 0:
        raise ValueError
    return count


def _kind(word: bytes, order: str | None) -> np.dtype[Any]:
    return np.dtype((order or "") + _KINDS[word])


def _read_text(header: _Header, content: bytes, start: int) -> dict[bytes, _Table]:
    """One row in a line; places are numbers of lines after the header."""
    lines = content[start:].splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    tables, at = {}, 0
    for element in header.elements:
        name = element.name.decode(errors="replace")
        if len(lines) < at + element.rows:
            raise _BrokenError(
                f"cut short: {max(len(lines) - at, 0)} of the {element.rows} rows of {name!r} "
                "that its header gives"
            )
        rows = []
        for number, line in enumerate(lines[at : at + element.rows], len(header.lines) + at + 1):
            try:
                rows.append(_row_of_words(element, line.split()))
            except (IndexError, ValueError):
                wrong = line[:40].decode(errors="replace")
                raise _BrokenError(
                    f"line {number}: {wrong!r} is no whole row of {name!r}"
                ) from None
        tables[element.name] = _Table(at, at + element.rows, rows)
        at += element.rows
    if len(lines) > at:
        raise _BrokenError(f"{len(lines)} rows, expected the {at} that its header gives")
    return tables


def _row_of_words(element: _Element, words: list[bytes]) -> _Row:
    """Raises IndexError or ValueError for too few or too many words, and for those that are no
    numbers.
    """
    for word in words:
        float(word)
    if not element.holds_lists:
        if len(words) != len(element.properties):
            raise ValueError
        return [words]
    row, at = [], 0
    for prop in element.properties:
        length = 1 if prop.count is None else _count(words[at])
        at += prop.count is not None
        if prop.is_of_indices:
            _ = [int(word) for word in words[at : at + length]]
        row.append(words[at : at + length])
        at += length
    if at != len(words):
        raise ValueError
    return row


def _read_binary(header: _Header, content: bytes, start: int) -> dict[bytes, _Table]:
    """Places are bytes. Rows are taken apart only of faces of more than three corners."""
    tables, at = {}, start
    for element in header.elements:
        begun, rows = at, list[_Row]()
        alike = _alike(element, content, at)
        if alike is not None:
            at += element.rows * alike.itemsize
            if not _all_triangles(element, alike):
                rows = _rows(element, content, begun)[0]
        else:
            rows, at = _rows(element, content, begun)
        if len(content) < at:
            raise _BrokenError(f"cut short: {len(content)} bytes, expected {at} and more")
        tables[element.name] = _Table(begun, at, rows)
    if len(content) > at:
        raise _BrokenError(f"{len(content)} bytes, expected {at} by its header")
    return tables


def _alike(element: _Element, content: bytes, start: int) -> np.dtype[Any] | None:
    """One row, where the lists of all are as long as those of the first; None: they differ."""
    fields: list[tuple[str, Any] | tuple[str, Any, int]] = []
    if not element.rows:
        return np.dtype([])
    at = start
    for i, prop in enumerate(element.properties):
        if prop.count is None:
            fields.append((f"{i}", prop.kind))
            at += prop.kind.itemsize
            continue
        if at + prop.count.itemsize > len(content):
            return None
        length = max(int(np.frombuffer(content, prop.count, 1, at)[0]), 0)
        fields += [(f"n{i}", prop.count), (f"{i}", prop.kind, length)]
        at += prop.count.itemsize + length * prop.kind.itemsize
        if at > len(content):
            return None
    row = np.dtype(fields)
    held = min(element.rows, (len(content) - start) // max(row.itemsize, 1))
    table = np.frombuffer(content, row, held, start)
    differ = element.holds_lists and (
        held < element.rows
        or any((table[name] != table[name][:1]).any() for name in row.names or () if name[0] == "n")
    )
    return None if differ else row


def _all_triangles(element: _Element, row: np.dtype[Any]) -> bool:
    here = _corners(element)
    return here is None or not element.rows or row[str(here)].shape[0] <= 3


def _rows(element: _Element, content: bytes, start: int) -> tuple[list[_Row], int]:
    """Every row of an element, and where it ends."""
    rows, at = [], start
    for number in range(element.rows):
        row = []
        try:
            for prop in element.properties:
                length = 1
                if prop.count is not None:
                    length = _count(np.frombuffer(content, prop.count, 1, at)[0])
                    at += prop.count.itemsize
                row.append(list(np.frombuffer(content, prop.kind, length, at) if length else ()))
                at += length * prop.kind.itemsize
        except ValueError:
            name = element.name.decode(errors="replace")
            raise _BrokenError(
                f"cut short: row {number} of the {element.rows} of {name!r} goes on beyond its end"
            ) from None
        rows.append(row)
    return rows, at


def _corners(element: _Element) -> int | None:
    """Which property of a face holds its corners."""
    lists = [i for i, prop in enumerate(element.properties) if prop.is_of_indices]
    named = [i for i in lists if element.properties[i].name in _CORNERS]
    return next(iter(named or lists), None) if element.name == b"face" else None


def _written(path: Path, header: _Header, content: bytes, tables: dict[bytes, _Table]) -> bytes:
    """A file with triangles in place of polygons that readers would get wrong."""
    face = next((e for e in header.elements if e.name == b"face"), None)
    here = None if face is None else _corners(face)
    if face is None or here is None:
        return content
    table = tables[face.name]
    if max((len(row[here]) for row in table.rows), default=0) <= 3:
        return content
    vertices_m = _positions(header, content, tables)
    if vertices_m is None:
        return content
    polygons = [[int(corner) for corner in row[here]] for row in table.rows]
    if any(not 0 <= i < len(vertices_m) for polygon in polygons for i in polygon):
        split = dict[int, Triangles]()  # told by whoever checks the mesh
    else:
        split = splits(vertices_m, polygons, lambda number: f"{path}: face {number}")
    if not split and (not header.order or len({len(polygon) for polygon in polygons}) == 1):
        return content
    rows = [
        [_part(values, triangle, len(polygon)) for values in row]
        for number, (row, polygon) in enumerate(zip(table.rows, polygons, strict=True))
        for triangle in split.get(number, fan(len(polygon)))
    ]
    write = _binary_row if header.order else _text_row
    data = b"".join(write(face, row) for row in rows)
    lines = [*header.lines]
    lines[face.line] = b"element face %d\n" % len(rows)
    before, after = _around(header, content, table)
    return b"".join([*lines, before, data, after])


def _positions(
    header: _Header, content: bytes, tables: dict[bytes, _Table]
) -> NDArray[np.float64] | None:
    """(n, 3) of the vertices; None where there are none that a reader would find."""
    vertex = next((e for e in header.elements if e.name == b"vertex"), None)
    names = [] if vertex is None else [prop.name for prop in vertex.properties]
    if vertex is None or vertex.holds_lists or not {b"x", b"y", b"z"} <= set(names):
        return None
    table, axes = tables[vertex.name], [names.index(axis) for axis in (b"x", b"y", b"z")]
    if not header.order:
        return np.array([[float(row[0][i]) for i in axes] for row in table.rows]).reshape(-1, 3)
    row = np.dtype([(f"{i}", prop.kind) for i, prop in enumerate(vertex.properties)])
    held = np.frombuffer(content, row, vertex.rows, table.start)
    return np.column_stack([held[f"{i}"] for i in axes]).astype(np.float64)


def _part(values: list[Any], triangle: tuple[int, int, int], corners: int) -> list[Any]:
    """What a property of a polygon is of one of its triangles: a value or a pair per corner is."""
    if len(values) == corners:
        return [values[i] for i in triangle]
    if len(values) == 2 * corners:
        return [values[2 * i + k] for i in triangle for k in (0, 1)]
    return values


def _text_row(element: _Element, row: _Row) -> bytes:
    words: list[bytes] = []
    for prop, values in zip(element.properties, row, strict=True):
        words += values if prop.count is None else [b"%d" % len(values), *values]
    return b" ".join(words) + b"\n"


def _binary_row(element: _Element, row: _Row) -> bytes:
    data = b""
    for prop, values in zip(element.properties, row, strict=True):
        if prop.count is not None:
            data += np.array(len(values), prop.count).tobytes()
        data += np.array(values, prop.kind).tobytes()
    return data


def _around(header: _Header, content: bytes, table: _Table) -> tuple[bytes, bytes]:
    """What a file holds between its header and a table, and after the table."""
    start = sum(len(line) for line in header.lines)
    if header.order:
        return content[start : table.start], content[table.end :]
    lines = content[start:].splitlines()
    before, after = lines[: table.start], lines[table.end :]
    return b"".join(line + b"\n" for line in before), b"".join(line + b"\n" for line in after)
