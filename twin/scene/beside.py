"""Files that a model refers to: found by the names that formats allow, told where they are not."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from twin.scene.gltf_validation import gltf_content, left_out_of_gltf
from twin.scene.obj import obj_in_triangles
from twin.scene.ply import ply_in_triangles

#: Stands for all material files of an OBJ, and materials that none of them defines.
_LIBRARY = "all materials"


class ModelFiles:
    """Finds files beside a model for trimesh's readers: glTF writes names percent-encoded (RFC
    3986); all ``mtllib`` of an OBJ are one, in which a material without definition has its name.
    """

    def __init__(self, model: Path) -> None:
        from trimesh.resolvers import FilePathResolver

        self._model, self._beside = model, FilePathResolver(str(model))
        self.file_name = model.name

    def get(self, name: str) -> Any:
        """Content of a file. Raises OSError, or ValueError where it lies outside the folder."""
        if name == _LIBRARY and _is_obj(self._model):
            return _library(self._model)
        found = _found(self._model, name)
        return self._beside.get(name if found is None else found)

    __getitem__ = get


def model_file(model: Path) -> tuple[Any, str | None]:
    """What trimesh is given of a model: its file and its kind, or its path alone. Raises InputError
    for an OBJ or PLY that it would bend into shape.
    """
    if _is_obj(model):
        return BytesIO(f"mtllib {_LIBRARY}\n".encode() + obj_in_triangles(model)), "obj"
    if model.suffix.lower() == ".ply":
        return BytesIO(ply_in_triangles(model)), "ply"
    return model, None


def missing_files(model: Path) -> Iterator[str]:
    """One line for what a model names that is not there, and one for what a scene of triangles at
    rest does not hold.
    """
    left_out: list[str] = []
    if _is_obj(model):
        yield from _of_obj(model)
        counts = _Statements(model).counts
        left_out = [f"{what} ({n})" for what, n in counts.items() if n]
    elif model.suffix.lower() in (".gltf", ".glb"):
        yield from _of_gltf(model)
        left_out = list(left_out_of_gltf(model))
    if left_out:
        yield f"{model.name}: left out: {', '.join(left_out)}"


def _is_obj(model: Path) -> bool:
    return model.suffix.lower() == ".obj"


def _found(model: Path, name: str) -> str | None:
    """The name by which a file lies beside a model; None: by none."""
    for one in (name.strip(), unquote(name.strip())):
        path = (model.parent / one).resolve()
        if path.is_file() and path.is_relative_to(model.parent.resolve()):
            return one
    return None


class _Statements:
    """What an OBJ says of its materials, each name once, and how often of points and lines."""

    def __init__(self, model: Path) -> None:
        libraries, used = dict[str, None](), dict[str, None]()
        self.counts = {"points": 0, "lines": 0, "curves and surfaces": 0}
        kinds = {"p": "points", "l": "lines"} | dict.fromkeys(
            ("curv", "curv2", "surf"), "curves and surfaces"
        )
        with model.open(encoding="utf-8", errors="replace") as file:
            for line in file:
                key, _, value = line.strip().partition(" ")
                if kind := kinds.get(key):
                    self.counts[kind] += 1
                elif key == "usemtl" and value.strip():
                    used[value.strip()] = None
                elif key == "mtllib" and value.strip():
                    whole = value.strip()  # names may have spaces, and there may be several
                    names = [whole] if (model.parent / whole).is_file() else whole.split()
                    libraries |= dict.fromkeys(names)
        self.libraries, self.used = list(libraries), list(used)


def _texts(model: Path, libraries: list[str]) -> Iterator[tuple[str, str]]:
    """Material files that are there, by name."""
    for name in libraries:
        if found := _found(model, name):
            yield name, (model.parent / found).read_text(encoding="utf-8", errors="replace")


def _undefined(said: _Statements, texts: list[tuple[str, str]]) -> list[str]:
    """Materials that an OBJ uses and none of its files defines."""
    defined = {
        " ".join(line.split()[1:])
        for _, text in texts
        for line in text.splitlines()
        if line.strip().lower().startswith("newmtl")
    }
    return [name for name in said.used if " ".join(name.split()) not in defined]


def _library(model: Path) -> bytes:
    """All material files of an OBJ as one, and the names of materials that none defines."""
    said = _Statements(model)
    texts = list(_texts(model, said.libraries))
    lines = [text for _, text in texts]
    lines += [f"newmtl {name}" for name in _undefined(said, texts)]
    return "\n".join(lines).encode()


def _of_obj(model: Path) -> Iterator[str]:
    said = _Statements(model)
    texts = list(_texts(model, said.libraries))
    if names := _undefined(said, texts):
        gone = [name for name in said.libraries if _found(model, name) is None]
        why = f"{', '.join(gone)} is not there" if gone else "no material file defines them"
        yield f"colours and pictures of {', '.join(names)} left out: {why}; their names are kept"
    for library, text in texts:
        for line in text.splitlines():
            key, _, name = line.strip().partition(" ")
            if key.lower() == "map_kd" and _found(model, name) is None:
                yield f"picture {name.strip()!r} of {library} left out: {_why(model, name)}"


def _of_gltf(model: Path) -> Iterator[str]:
    for picture in gltf_content(model).get("images", ()):
        uri = picture.get("uri")
        if isinstance(uri, str) and not uri.startswith("data:") and _found(model, uri) is None:
            yield f"picture {uri!r} left out: {_why(model, uri)}"


def _why(model: Path, name: str) -> str:
    there = any((model.parent / one).is_file() for one in (name.strip(), unquote(name.strip())))
    return "it lies outside the model's folder" if there else "it is not there"
