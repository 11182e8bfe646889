"""STL files checked before they are read: readers take what is no such file for a mesh without
faces.
"""

from pathlib import Path

from twin.files import InputError

#: Of a binary STL: header, number of triangles, bytes of one triangle.
_STL_HEADER, _STL_START, _STL_TRIANGLE = 80, 84, 50


def check_not_empty(path: Path) -> None:
    """Raise InputError for a file of no bytes."""
    if path.stat().st_size == 0:
        raise InputError(f"{path}: can't be read as a mesh (the file is empty)")


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
