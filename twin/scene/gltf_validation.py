"""The JSON of a glTF file, validated before trimesh reads it; a list of what an import leaves out.

Materials are mapped in `imported_materials`.

Khronos Group, glTF 2.0 Specification.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from twin.files import InputError

_TRIANGLES = 4  # the least mode of a primitive that has faces
_TRANSFORMS = ("translation", "rotation", "scale", "matrix")
#: Extensions that hold the triangles themselves, and the package with which they are read.
_COMPRESSED = {
    "KHR_draco_mesh_compression": "DracoPy",
    "EXT_meshopt_compression": None,
    "KHR_meshopt_compression": None,
}
#: Extensions that are read, or told by what they hold.
_TOLD = {
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}


def check_gltf(path: Path) -> None:
    """Raise InputError for a file that is no glTF, one that no reader should be given, and one
    whose triangles are compressed in a way that is not read.
    """
    content = gltf_content(path)
    try:
        _check(path, content)
    except (AttributeError, IndexError, OSError, OverflowError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise _invalid(path, error) from error


def gltf_content(path: Path) -> dict[str, Any]:
    """The JSON of a file, text or binary. Raises InputError."""
    data = path.read_bytes()
    if data[:4] == b"glTF":  # binary: a header of 12 bytes, then the JSON with its length
        size = int.from_bytes(data[12:16], "little")
        if (total := int.from_bytes(data[8:12], "little")) > len(data):
            raise _invalid(path, f"truncated, {len(data)} of {total} bytes")
        data = data[20 : 20 + size]
    try:
        content = json.loads(data)
    except (RecursionError, ValueError) as error:
        raise _invalid(path, error) from error
    if not isinstance(content, dict):
        raise _invalid(path, "expected an object")
    return content


def _invalid(path: Path, reason: object) -> InputError:
    return InputError(f"{path}: can't be read as a mesh (no valid glTF: {reason!s:.200})")


def _check(path: Path, content: dict[str, Any]) -> None:
    for name in set(content.get("extensionsRequired", ())) & _COMPRESSED.keys():
        package = _COMPRESSED[name]
        if package is None or find_spec(package) is None:
            hint = f" (or install {package})" if package else ""
            raise InputError(f"{path}: needs {name}: export it without compression{hint}")
    _check_counts(path, content)
    _check_nodes(path, content.get("nodes", ()))


def _check_counts(path: Path, content: dict[str, Any]) -> None:
    """An accessor may promise any number of zeros: no more are taken than there are bytes."""
    held = path.stat().st_size
    for buffer in content.get("buffers", ()):
        if isinstance(uri := buffer.get("uri"), str) and not uri.startswith("data:"):
            beside = path.parent / unquote(uri)
            held += beside.stat().st_size if beside.is_file() else 0
    for number, accessor in enumerate(content.get("accessors", ())):
        count = accessor.get("count")
        if not isinstance(count, int) or not 0 <= count <= held:
            raise InputError(
                f"{path}: accessor {number}: {count!r:.40} elements in a model of {held} bytes"
            )


def _check_nodes(path: Path, nodes: list[dict[str, Any]]) -> None:
    """Nodes are disjoint strict trees (section 3.5.1), each placed by finite numbers."""
    parents = Counter(child for node in nodes for child in node.get("children", ()))
    for number, node in enumerate(nodes):
        if parents[number] > 1:
            raise InputError(f"{path}: node {number}: child of {parents[number]}, expected of one")
        for key in _TRANSFORMS:
            if not all(math.isfinite(value) for value in node.get(key, ())):
                raise InputError(f"{path}: node {number}: {key} = {node[key]!r:.60}: no numbers")
    left = [number for number in range(len(nodes)) if not parents[number]]
    reached = 0
    while left:
        reached += 1
        left += nodes[left.pop()].get("children", ())
    if reached < len(nodes):
        raise InputError(f"{path}: {len(nodes) - reached} nodes are children of their own children")


def left_out_of_gltf(path: Path) -> Iterator[str]:
    """What a scene of triangles at rest does not hold, in a few words each."""
    content = gltf_content(path)
    lights = content.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", ())
    flat = [
        primitive
        for mesh in content.get("meshes", ())
        for primitive in mesh.get("primitives", ())
        if primitive.get("mode", _TRIANGLES) < _TRIANGLES
    ]
    for what, found in (
        ("cameras", content.get("cameras", ())),
        ("lights", lights),
        ("parts of points or lines", flat),
        ("animations", content.get("animations", ())),
        ("skins", content.get("skins", ())),
    ):
        if found:
            yield f"{what} ({len(found)})"
    moved = [
        str(material.get("name", number))
        for number, material in enumerate(content.get("materials", ()))
        if "KHR_texture_transform"
        in material.get("pbrMetallicRoughness", {})
        .get("baseColorTexture", {})
        .get("extensions", {})
    ]
    if moved:
        yield f"KHR_texture_transform of {', '.join(moved)}, whose pictures lie elsewhere"
    known = _COMPRESSED.keys() | _TOLD
    if unread := sorted(set(content.get("extensionsRequired", ())) - known):
        yield ", ".join(unread)
