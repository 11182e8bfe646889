"""Files that a model refers to: trimesh leaves out in silence what it does not find."""

import json
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote


def missing_files(model: Path) -> Iterator[str]:
    """One line for each picture or material file that an OBJ or glTF names and that is not there,
    or that readers do not find by that name.
    """
    suffix = model.suffix.lower()
    if suffix == ".obj":
        yield from _of_obj(model)
    elif suffix in (".gltf", ".glb"):
        yield from _of_gltf(model)


def obj_materials(model: Path) -> dict[str, str]:
    """Statements ``mtllib`` and ``usemtl`` of an OBJ with the first value of each."""
    found: dict[str, str] = {}
    with model.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            key, _, value = line.strip().partition(" ")
            if key in ("mtllib", "usemtl") and value.strip():
                found.setdefault(key, value.strip())
    return found


def _of_obj(model: Path) -> Iterator[str]:
    named = obj_materials(model)
    library = named.get("mtllib")
    if library is None or not (model.parent / library).is_file():
        if "usemtl" in named:
            what = f"{library!r} is not there" if library else "the file names no mtllib"
            yield f"materials left out: {what} ({named['usemtl']} and what follows it)"
        return
    text = (model.parent / library).read_text(encoding="utf-8", errors="replace")
    for line in text.splitlines():
        key, _, name = line.strip().partition(" ")
        if key.lower() == "map_kd" and not (model.parent / name.strip()).is_file():
            yield f"picture {name.strip()!r} of {library} left out: it is not there"


def _of_gltf(model: Path) -> Iterator[str]:
    data = model.read_bytes()
    if data[:4] == b"glTF":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    content = json.loads(data)
    for picture in content.get("images", ()):
        uri = picture.get("uri")
        if not isinstance(uri, str) or uri.startswith("data:") or (model.parent / uri).is_file():
            continue
        coded = (model.parent / unquote(uri)).is_file()
        why = "its name is percent-encoded: rename the file" if coded else "it is not there"
        yield f"picture {uri!r} left out: {why}"
