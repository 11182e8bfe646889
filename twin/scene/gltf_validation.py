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

_TRIANGLES, _FAN = 4, 6  # modes of a primitive: the least that has faces, and one that is not read
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}  # of a component
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
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
    whose triangles are compressed or told in a way that is not read.
    """
    content = gltf_content(path)
    try:
        _check(path, content)
    except (
        AttributeError,
        IndexError,
        KeyError,
        OSError,
        OverflowError,
        TypeError,
        ValueError,
    ) as error:
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
    _check_lengths(path, content)
    _check_primitives(path, content)
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


def _check_lengths(path: Path, content: dict[str, Any]) -> None:
    """Buffers hold what is said to lie in them (sections 3.6.1 and 3.6.2)."""
    buffers, views = content.get("buffers", ()), content.get("bufferViews", ())
    for number, buffer in enumerate(buffers):
        held, said = _held(path, buffer), buffer.get("byteLength", 0)
        if held is not None and held < said:
            raise InputError(f"{path}: buffer {number}: {held} bytes, expected {said}")
    for number, view in enumerate(views):
        end = view.get("byteOffset", 0) + view.get("byteLength", 0)
        held = buffers[view.get("buffer", 0)].get("byteLength", 0)
        if end > held:
            raise InputError(f"{path}: bufferView {number}: ends at byte {end} of {held}")
    for number, accessor in enumerate(content.get("accessors", ())):
        size = _BYTES.get(accessor.get("componentType"), 0) * _COMPONENTS.get(
            accessor.get("type"), 0
        )
        if size == 0:
            told = f"{accessor.get('type')!r} of component {accessor.get('componentType')!r}"
            raise InputError(f"{path}: accessor {number}: {told:.80}, which glTF does not have")
        if "bufferView" in accessor and accessor["count"]:
            view = views[accessor["bufferView"]]
            steps = (accessor["count"] - 1) * view.get("byteStride", size)
            end = accessor.get("byteOffset", 0) + steps + size
            if end > (held := view.get("byteLength", 0)):
                raise InputError(
                    f"{path}: accessor {number}: {accessor['count']} elements end at byte {end} "
                    f"of {held}"
                )


def _held(path: Path, buffer: dict[str, Any]) -> int | None:
    """Bytes of a buffer; None: those of a file that is not there, which its reader tells."""
    uri = buffer.get("uri")
    if uri is None:  # the second chunk of a binary file, its length in front
        data = path.read_bytes()
        start = 20 + int.from_bytes(data[12:16], "little")
        return max(len(data) - start - 8, 0) if data[:4] == b"glTF" else None
    if uri.startswith("data:"):
        coded = uri.partition(";base64,")[2].rstrip("=")
        return len(coded) * 3 // 4 if coded else None
    beside = path.parent / unquote(uri)
    return beside.stat().st_size if beside.is_file() else None


def _check_primitives(path: Path, content: dict[str, Any]) -> None:
    """What changes triangles and is not read: without it they would be others, or none."""
    accessors = content.get("accessors", ())
    for number, mesh in enumerate(content.get("meshes", ())):
        for part, primitive in enumerate(mesh.get("primitives", ())):
            place = f"{path}: mesh {number}, primitive {part}"
            if (mode := primitive.get("mode", _TRIANGLES)) < _TRIANGLES:
                continue
            if mode >= _FAN:
                raise InputError(f"{place}: a triangle fan (mode {mode}): export it as triangles")
            used = [*primitive.get("attributes", {}).values(), primitive.get("indices")]
            if sparse := [n for n in used if n is not None and "sparse" in accessors[n]]:
                raise InputError(
                    f"{place}: accessor {sparse[0]} is sparse: export it without sparse accessors"
                )
            corners = primitive.get("indices", primitive.get("attributes", {}).get("POSITION"))
            count = 0 if corners is None else accessors[corners]["count"]
            if mode == _TRIANGLES and count % 3:
                raise InputError(f"{place}: {count} corners of triangles, expected three of each")
    for kind in ("meshes", "nodes"):
        for number, holder in enumerate(content.get(kind, ())):
            if any(weights := holder.get("weights", ())):
                raise InputError(
                    f"{path}: {kind} {number}: weights = {weights!r:.60} "
                    "of morph targets: apply these before it is exported"
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
    morphs = [
        target
        for mesh in content.get("meshes", ())
        for primitive in mesh.get("primitives", ())[:1]  # of the others the same
        for target in primitive.get("targets", ())
    ]
    for what, found in (
        ("cameras", content.get("cameras", ())),
        ("lights", lights),
        ("parts of points or lines", flat),
        ("animations", content.get("animations", ())),
        ("skins", content.get("skins", ())),
        ("morph targets", morphs),
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
