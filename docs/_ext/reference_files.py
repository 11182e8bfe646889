"""Pages of the TOML files: every key with unit, default, range and meaning."""

import inspect
import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from tables import table

from hardware.units import unit_of
from twin.toml import Sourced, Strict, meanings, plain

HEADS = ("key", "unit", "default", "values", "meaning")
_SIGNS = {"gt": "> {}", "ge": "≥ {}", "lt": "< {}", "le": "≤ {}"}
_INTRODUCTIONS = {
    "system": """# Optical systems

A camera as data: `twin run SCENE --system FILE.toml`. Each key takes a value (it then counts as
assumed), or a table `{ value = ..., source = "..." }` or `{ value = ..., assumed = "..." }`; both
origins are printed with every result. `base = "NAME"` takes all that a file leaves out from another
system, `part = "NAME"` in a section all that the section leaves out from a
[part of the catalogue](catalogue.md). Numbers may be text with a unit, `"200 um"`.
""",
    "radar": """# Radars

A radar as data: `twin run SCENE --radar FILE.toml`. Values, origins and `base` are as in
[systems](file-system.md).
""",
    "scene": """# Scenes

`scene.toml` beside a `scene.xml`: what Mitsuba's XML has no place for. All lengths in metres, axes
REP 103: x forward, y left, z up.
""",
    "materials": """# Materials

`materials.toml`: one table per material, which a BSDF in the scene names by its id. Each value has
its `source`, or says why it is `assumed`.
""",
    "study": """# Studies

`twin sweep FILE.toml`. Parameters are named by dotted names, listed [below](#parameters).
""",
    "camera": """# Camera settings

What a camera is to measure: `ugv capture PORT --settings FILE.toml`, and `twin serve` writes such a
file.
""",
}


def file_page(kind: str) -> str:
    """One kind of file of `twin.schemas.KINDS`."""
    from twin.radar.device.design import RadarDesign
    from twin.scene.materials import Material
    from twin.scene.settings import SceneSettings
    from twin.sweep.study import Study
    from twin.system import System

    models = {"system": System, "radar": RadarDesign, "scene": SceneSettings}
    models |= {"materials": Material, "study": Study}
    text = _INTRODUCTIONS[kind]
    if kind == "camera":
        return text + _camera() + _schema_note(kind)
    root = {"materials": "NAME"}.get(kind, "")
    skip = {"folder", "objects"} if kind == "study" else set()
    text += "".join(_sections(models[kind], root, skip))
    return text + (_parameters() if kind == "study" else "") + _schema_note(kind)


def catalogue_page() -> str:
    """Bundled systems, radars, parts and scenes."""
    from twin.files import scenes_folder
    from twin.radar.device.design import load_radar, radar_names
    from twin.scene.settings import SceneSettings
    from twin.system import load_part, load_system, part_names, system_names
    from twin.toml import read_toml

    scenes = sorted(scenes_folder().glob("*/scene.toml"))
    said = [
        (f"`{p.parent.name}`", SceneSettings.model_validate(read_toml(p)).description)
        for p in scenes
    ]
    parts = [load_part(name) for name in part_names()]
    return (
        "# Catalogue\n\nWhat is bundled; `twin systems` and `twin parts` print it, `twin parts "
        "NAME` each value with its source.\n\n## Scenes\n\n"
        + table(("scene", "what it is"), said)
        + "\n## Optical systems\n\n"
        + table(
            ("system", "what it is"),
            ((f"`{n}`", load_system(n).description) for n in system_names()),
        )
        + "\n## Radars\n\n"
        + table(
            ("radar", "what it is"), ((f"`{n}`", load_radar(n).description) for n in radar_names())
        )
        + "\n## Parts\n\n"
        + table(
            ("part", "section", "what it is"),
            (
                (f"`{n}`", f"`[{p.kind}]`", p.description)
                for n, p in zip(part_names(), parts, strict=True)
            ),
        )
    )


def _sections(model: type[BaseModel], place: str, skip: set[str]) -> Iterator[str]:
    """A heading and a table for a section, then those of the sections below it."""
    below: list[tuple[str, type[BaseModel]]] = []
    rows = []
    for name, field in model.model_fields.items():
        if name in skip:
            continue
        inner = _section_of(field.annotation)
        if inner is None:
            rows.append(row_of(model, name, field))
        else:
            key, kind = inner
            below.append((key.format(".".join(filter(None, [place, name]))), kind))
            meaning = meanings(model).get(name, "")
            rows.append((f"`[{below[-1][0]}]`", "", _default(field), "section", meaning))
    heading = f"\n## `[{place}]`\n\n" if place else "\n## Top level\n\n"
    yield heading + _first_paragraphs(model) + "\n\n" + table(HEADS, rows)
    if rivals := getattr(model, "alternatives", ()):
        groups = " or ".join(", ".join(f"`{name}`" for name in group) for group in rivals)
        yield f"\nOne or the other: {groups}.\n"
    for inner_place, kind in below:
        yield from _sections(kind, inner_place, set())


def row_of(model: type[BaseModel], name: str, field: FieldInfo) -> tuple[str, ...]:
    """Key, unit, default, values and meaning of one field."""
    values = values_of(field.annotation, field.metadata)
    if issubclass(model, Strict) and name in model.limits:
        least, most = model.limits[name]
        values = f"{least:g} to {most:g}"
    unit = unit_of(name) or ""
    return (f"`{name}`", unit, _default(field), values, meanings(model).get(name, ""))


def values_of(annotation: Any, metadata: Any = ()) -> str:
    """What a field may hold, in words: words to choose from, bounds, or the kind of value."""
    annotation = without_none(annotation)
    bounds = _bounds(metadata)
    if get_origin(annotation) is Annotated:
        inner, *more = get_args(annotation)
        return values_of(inner, [*metadata, *more])
    if isinstance(annotation, type) and issubclass(annotation, Sourced):
        field = annotation.model_fields["value"]
        return values_of(field.annotation, field.metadata)
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin in (tuple, list):
        if len(arguments) > 1 and arguments[1] is not Ellipsis:
            return f"{len(arguments)} × ({values_of(arguments[0])})"
        return f"list of ({values_of(arguments[0])})"
    if origin is dict:
        return f"by name: {values_of(arguments[1])}"
    if set(arguments) == {bool, int, float, str}:
        return "number, text, `true`, `false`"
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(values_of(argument) for argument in arguments))
    kind = {float: "number", int: "whole number", bool: "`true`, `false`", str: "text"}
    word = kind.get(annotation, "text")
    return f"{word} {', '.join(dict.fromkeys(bounds))}" if bounds else word


def _bounds(metadata: Any) -> list[str]:
    """The narrowest of what pydantic checks a number against."""
    entries = [entry for item in metadata for entry in (item, *getattr(item, "metadata", ()))]
    found: dict[str, list[float]] = {}
    for entry in entries:
        for key in _SIGNS:
            if getattr(entry, key, None) is not None:
                found.setdefault(key, []).append(getattr(entry, key))
    least = {key: max(found[key]) for key in ("gt", "ge") if key in found}
    most = {key: min(found[key]) for key in ("lt", "le") if key in found}
    narrowest = [max(least, key=lambda key: least[key])] if least else []
    narrowest += [min(most, key=lambda key: most[key])] if most else []
    return [_SIGNS[key].format(f"{(least | most)[key]:g}") for key in narrowest]


def without_none(annotation: Any) -> Any:
    """The type of an optional field."""
    if get_origin(annotation) in (Union, UnionType):
        rest = [kind for kind in get_args(annotation) if kind is not NoneType]
        if len(rest) == 1:
            return rest[0]
    return annotation


def _section_of(annotation: Any) -> tuple[str, type[BaseModel]] | None:
    """How a section is headed in TOML, with its model, where a field is one or holds some."""
    annotation = without_none(annotation)
    if get_origin(annotation) is Annotated:
        return _section_of(get_args(annotation)[0])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return None if issubclass(annotation, Sourced) else ("{}", annotation)
    arguments = get_args(annotation)
    if get_origin(annotation) is dict and (inner := _section_of(arguments[1])):
        return "{}.NAME", inner[1]
    if get_origin(annotation) is tuple and (inner := _section_of(arguments[0])):
        return "[{}]", inner[1]
    return None


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "required"
    value = plain(field.default)
    if value is None or value in ("", {}, (), []):
        return ""
    if isinstance(value, dict):  # a section, whose own table says it
        return ""
    return f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else f"{value}"


def _first_paragraphs(model: type[BaseModel]) -> str:
    """The docstring up to what is not for files: Python, examples."""
    text = inspect.cleandoc(model.__dict__.get("__doc__") or "")
    keep: list[str] = []
    for paragraph in text.split("\n\n"):
        if re.match(r"(>>>|In Python|Parameters|Raises)", paragraph):
            break
        keep.append(" ".join(paragraph.split()).replace("``", "`"))
    return "\n\n".join(keep)


def _schema_note(kind: str) -> str:
    return f"""
## In an editor

`twin schema {kind} > {kind}.schema.json` writes the same as a JSON Schema. Editors with Taplo (Even
Better TOML among them) check and explain keys while one types, when the first line of the file is

```toml
#:schema ./{kind}.schema.json
```
"""


def _camera() -> str:
    from dataclasses import MISSING, fields

    from hardware.drivers.settings import SpiSettings
    from hardware.patterns import PatternSet
    from twin.schemas import documented

    text = ""
    for place, kind in (("Top level", SpiSettings), ("`[patterns]`", PatternSet)):
        meanings, rows = documented(kind), []
        for field in fields(kind):
            default = "required" if field.default is MISSING else f"`{_camera_toml(field.default)}`"
            default = "" if field.default is None else default
            shown = "`[patterns]`" if field.name == "patterns" else f"`{field.name}`"
            rows.append(
                (shown, unit_of(field.name) or "", default, _kind(field), meanings[field.name])
            )
        text += f"\n## {place}\n\n" + table(HEADS, rows)
    return (
        text
        + "\nIn place of Hadamard patterns, `file` names binary patterns of one's own (`.npy`, "
        "`.npz`, an image stack or a folder of images), beside `mode` alone.\n"
    )


def _kind(field: Any) -> str:
    from typing import get_type_hints

    from hardware.drivers.settings import SpiSettings
    from hardware.patterns import PatternSet

    hints = get_type_hints(SpiSettings) | get_type_hints(PatternSet)
    special = {"patterns": "section", "shutters": "list of 4 numbers", "pose": "7 numbers"}
    return special.get(field.name) or values_of(hints[field.name])


def _camera_toml(value: Any) -> str:
    return _toml(value)


def _parameters() -> str:
    from twin.radar.device.design import RadarDesign
    from twin.scene.changes import SCENE_NAMES
    from twin.system import System

    rows = [
        ("`scene`, `system`, `radar`", "name, file or folder"),
        ("`seed`", "of noise and light paths"),
        (
            "`system.SECTION.FIELD`",
            "any key of an [optical system](file-system.md): " + ", ".join(System.sections()),
        ),
        ("`system.SECTION.part`", "a [part](catalogue.md) in place of the section"),
        ("`weather.FIELD`", "short for `system.weather.FIELD`"),
        (
            "`radar.SECTION.FIELD`",
            "any key of a [radar](file-radar.md): " + ", ".join(RadarDesign.sections()),
        ),
        (", ".join(f"`scene.{name}`" for name in SCENE_NAMES), "the scene's rig and sun"),
        (
            "`scene.objects.NAME.FIELD`",
            "`reflectance`, `shift_x_m` (y, z), `velocity_m_per_s`, `radar`, `thickness_m`; `*` "
            "names every object",
        ),
        ("`scene.targets.NAME.rcs_m2`", "cross-section of a declared target"),
        ("`fidelity.tolerance`", "error that is allowed: share of the noise, `0.5 dB`, `2 mm`"),
        ("`fidelity.preset`", "`draft`, `standard` or `reference`"),
        ("`fidelity.KNOB`", "a single [knob](knobs.md)"),
        ("`processing.method`", "reconstruction: a bundled method, or `file.py:function`"),
        ("`processing.detection`", "detection of one's own, `file.py:function`; empty: bundled"),
        ("`link.distance_m`, `link.reflectance`", "of the closed form alone"),
    ]
    return "\n## Parameters\n\n" + table(("name", "what it is"), rows)
