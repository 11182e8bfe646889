"""OBJ and STL files checked before they are read: readers take what is no such file for a mesh
without faces, and bend numbers into shape.
"""

import re
from pathlib import Path

from twin.files import InputError

#: Of a binary STL: header, number of triangles, bytes of one triangle.
_STL_HEADER, _STL_START, _STL_TRIANGLE = 80, 84, 50
_OBJ_STATEMENT = re.compile(rb"\s*(v|vt|vn|vp|f|l|p|o|g|s|mtllib|usemtl)\s")


def check_not_empty(path: Path) -> None:
    """Raise InputError for a file of no bytes."""
    if path.stat().st_size == 0:
        raise InputError(f"{path}: can't be read as a mesh (the file is empty)")


def check_obj(path: Path) -> None:
    """Raise InputError for a file without any statement of OBJ, and for what readers bend into
    shape: too few numbers in a line, which they take from the next one; vertex 0, for which they
    take the last (OBJ counts from 1, or from the end, negative).
    """
    zero = re.compile(rb"^f\s+(?:\S+\s+)*0(?:[/\s]|$)")
    before, known = b"", False
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            known = known or bool(_OBJ_STATEMENT.match(line))
            line = before + line.rstrip()
            before = b""
            if line.endswith(b"\\"):  # goes on in the next one
                before = line[:-1] + b" "
                continue
            if line[:2] in (b"v ", b"v\t", b"f ", b"f\t") and len(line.split(None, 3)) < 4:
                raise InputError(f"{path}: line {number}: {line[:40]!r}, expected three or more")
            if zero.match(line):
                raise InputError(f"{path}: line {number}: vertex 0, but OBJ counts from 1")
    if not known:
        raise InputError(
            f"{path}: can't be read as a mesh (no OBJ file: no line begins with v, f or another "
            "statement of OBJ)"
        )


def check_stl(path: Path) -> None:
    """Raise InputError for a file that is neither text from `solid` to `endsolid` nor binary of the
    length that its number of triangles asks for.
    """
    content = path.read_bytes()
    triangles = int.from_bytes(content[_STL_HEADER:_STL_START], "little")
    expected = _STL_START + _STL_TRIANGLE * triangles
    if len(content) == expected:
        return
    words = content[:_STL_HEADER].lower()
    if words.lstrip().startswith(b"solid") and b"\0" not in words:
        if b"endsolid" not in content[-4096:].lower():
            raise InputError(
                f"{path}: can't be read as a mesh (STL text without `endsolid`: cut short)"
            )
        return
    if len(content) < _STL_START:
        raise InputError(
            f"{path}: can't be read as a mesh (no STL file: {len(content)} bytes that do not "
            "begin with `solid`)"
        )
    raise InputError(
        f"{path}: can't be read as a mesh (no STL file, or a damaged one: {len(content)} bytes, "
        f"expected {expected} for the {triangles} triangles that its header gives)"
    )
