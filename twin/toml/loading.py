"""Entries from TOML files: bases, parts, and files that are named in them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from hardware.files import read_toml as read_checked
from hardware.own_functions import is_file_function
from twin.files import InputError
from twin.own_parts import check_own_parts
from twin.toml.entries import Entry, described_by, without_rivals
from twin.toml.faults import describe
from twin.toml.sections import Strict

M = TypeVar("M", bound=Entry)


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file; InputError with line and column where it is malformed."""
    try:
        return read_checked(path)
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error


def load_entry(
    model: type[M], name: str | Path | M, kind: str, folder: Path, parts: Path | None = None
) -> M:
    """A catalogue entry by name, or a user's own file, validated; an entry is returned as it is.

    ``base = "NAME"`` in a file takes everything that it leaves out from another entry, or from a
    file beside it; ``part = "NAME"`` in a section everything that the section leaves out from an
    entry of ``parts``. Names of data files are relative to the file that gives them. Functions of a
    user's own are looked up, and not run.

    Raises InputError, one line that begins with the file, or with ``kind`` where there is none.
    """
    if isinstance(name, model):
        return name
    path = _find(str(name), kind, folder)
    try:
        content = _with_base(path, kind, folder, model)
        if parts:
            content = {k: _with_part(k, v, path, parts, model) for k, v in content.items()}
        entry = model.model_validate(content)
    except ValidationError as error:
        told = describe(error, model, content, _file_keys(model))
        raise InputError(f"{path}: {told}") from error
    for field, value in entry.values():
        if is_data_file(field) and not Path(value.value).is_file():
            raise InputError(f"{path}: {field} = {value.value!r}: expected a file, there is none")
    try:
        check_own_parts(entry.values())
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return entry


def _file_keys(model: type[Entry]) -> dict[str, tuple[str, ...]]:
    """Keys of files alone, by section."""
    return {"": ("base",), **dict.fromkeys(model.with_parts, ("part",))}


def bundled(folder: Path) -> list[str]:
    """Names of the entries in a catalogue folder."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def _find(name: str, kind: str, folder: Path) -> Path:
    entry, path = folder / f"{name.lower()}.toml", Path(name)
    if _is_file(entry) and path.suffix != ".toml":
        return entry
    if _is_file(path):
        return path
    raise InputError(
        f"{kind}: {name!r:.200} is neither a TOML file nor one of {', '.join(bundled(folder))}"
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file may have
        return False


def _with_base(
    path: Path, kind: str, folder: Path, model: type[Strict], seen: tuple[Path, ...] = ()
) -> dict[str, Any]:
    content = read_toml(path)
    for section in content.values():
        _place_files(section, path.parent)
    base = content.pop("base", None)
    if base is None:
        return content
    if not isinstance(base, str):
        raise InputError(f"{path}: base = {base!r}: expected the name of a {kind} or a file")
    content.setdefault("name", path.stem)
    path = path.resolve()
    if path in seen:
        raise InputError(f"{path}: base: {kind}s build on each other in a circle")
    sibling = path.parent / base
    found = sibling if _is_file(sibling) else _find(base, f"{path}: base", folder)
    below = _with_base(found, kind, folder, model, (*seen, path))
    for section, value in content.items():
        if isinstance(value, dict) and isinstance(below.get(section), dict):
            below[section] = without_rivals(model, section, below[section], value)
    if changed := _changed(content):
        content.setdefault("description", described_by(found.stem, changed))
    return _merged(below, content)


def _changed(content: Mapping[str, Any]) -> list[str]:
    """Dotted names of what a file with a base gives itself."""
    return [
        f"{section}.{field}" if isinstance(fields, dict) else section
        for section, fields in content.items()
        if section not in ("name", "description")
        for field in (fields if isinstance(fields, dict) else (None,))
    ]


def _with_part(section: str, value: Any, path: Path, parts: Path, model: type[Strict]) -> Any:
    """A section with what its part says, overridden by what the section says itself."""
    if not isinstance(value, dict) or "part" not in value:
        return value
    name = value["part"]
    if not isinstance(name, str):
        raise InputError(f"{path}: {section}.part = {name!r}: expected the name of a part")
    found = _find(name, f"{path}: {section}.part", parts)
    part = _with_base(found, "part", parts, model)
    if section not in part:
        raise InputError(f"{path}: {section}.part = {name!r}: this part has no {section}")
    below = without_rivals(model, section, part[section], value)
    return _merged(below, {k: v for k, v in value.items() if k != "part"})


def _place_files(section: Any, folder: Path) -> None:
    """Make the names of data and part files in a section absolute."""
    if isinstance(section, dict):
        part = section.get("part")
        if isinstance(part, str) and (folder / part).is_file():
            section["part"] = str((folder / part).resolve())
        for key, entry in section.items():
            if not names_file(key):
                continue
            if isinstance(entry, str):  # given without a source
                section[key] = placed(key, entry, folder)
            elif isinstance(entry, dict) and "value" in entry:
                entry["value"] = placed(key, str(entry["value"]), folder)


def is_data_file(field: str) -> bool:
    """Whether a field names a file of data, by the end of its name."""
    return field.endswith(("_csv", "_file"))


def names_file(field: str) -> bool:
    """Whether a field names a file: of data, of a user's own patterns, or, ``file.py:function``, of
    code.
    """
    return is_data_file(field) or field.rpartition(".")[2] in ("patterns", "function")


def placed(field: str, text: str, folder: Path) -> str:
    """A name of a file, relative to a folder, as an absolute one; an installed function's name, and
    that of what is not there, as it is.
    """
    if field.rpartition(".")[2] != "function":
        return str((folder / text).resolve())
    if not is_file_function(text):
        return text
    path, _, name = text.rpartition(":")
    return f"{(folder / path).resolve()}:{name}"


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        # A single value, and a section that names its part, replace what the base says.
        whole = {"value", "source", "assumed", "part"}
        section = isinstance(value, dict) and not whole & value.keys()
        known = base.get(key)
        merged[key] = _merged(known if isinstance(known, dict) else {}, value) if section else value
    return merged
