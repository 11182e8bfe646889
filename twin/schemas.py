"""JSON Schemas of every TOML file that a user may write, and what each field of it means.

The text is that of the fields themselves: below them in models, under ``Parameters`` in the
docstrings of dataclasses.
"""

import inspect
import re
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from pydantic import TypeAdapter

from hardware.drivers.settings import SpiSettings
from hardware.patterns import Mode, PatternSet
from hardware.units import unit_of
from twin.files import InputError
from twin.radar.device.design import RadarDesign
from twin.scene.materials import MaterialTable
from twin.scene.settings import SceneSettings
from twin.sweep.study import Study
from twin.system import Part, System
from twin.toml import Entry

KINDS = ("system", "radar", "part", "scene", "materials", "study", "camera")

_BASE = "Another entry by name, or a file beside this one: what is left out here is taken from it."
_PART = "A part by name, or a file: what is left out in this section is taken from it."


def file_schema(kind: str) -> dict[str, Any]:
    """JSON Schema of one of `KINDS` as a file holds it. Raises InputError for no such kind."""
    if kind not in KINDS:
        raise InputError(f"schema: {kind!r}: expected {', '.join(KINDS)}")
    if kind == "camera":
        return _camera_schema()
    if kind == "scene":
        return SceneSettings.model_json_schema()
    if kind == "materials":
        return MaterialTable.model_json_schema()
    if kind == "study":
        return _study_schema()
    entries: dict[str, type[Entry]] = {"system": System, "radar": RadarDesign, "part": Part}
    entry = entries[kind]
    schema = entry.model_json_schema()
    # A base may give all that is required, and a part what is required in a section.
    schema["properties"]["base"] = {"type": "string", "description": _BASE}
    schema.pop("required", None)
    for name, section in entry.sections().items():
        definition = schema["$defs"][section.__name__]
        definition.pop("required", None)
        if name in entry.with_parts:
            definition["properties"]["part"] = {"type": "string", "description": _PART}
    return schema


def documented(kind: type) -> dict[str, str]:
    """What the docstring of a dataclass says of each of its fields, under ``Parameters`` or, where
    it has no such heading, anywhere.
    """
    text = inspect.getdoc(kind) or ""
    entries = re.findall(r"^(\w+(?:, \w+)*)\n((?:    .*\n?|\n(?=    ))+)", text, re.MULTILINE)
    return {
        name: " ".join(meaning.split()) for names, meaning in entries for name in names.split(", ")
    }


def _study_schema() -> dict[str, Any]:
    schema = Study.model_json_schema()
    for name in ("folder", "objects"):  # of Python alone
        del schema["properties"][name]
    schema["required"].remove("name")  # the file's
    return schema


def _camera_schema() -> dict[str, Any]:
    hadamard = _dataclass_schema(PatternSet, {})
    own = {
        "type": "object",
        "properties": {
            "file": {
                "type": "string",
                "description": "Binary patterns of a user's own: `.npy`, `.npz`, an image stack or "
                "a folder of images, beside this file.",
            },
            "mode": {
                **TypeAdapter(Mode).json_schema(),
                "description": "How a pattern of 0 and 1 becomes light. Default: differential.",
            },
        },
        "required": ["file"],
        "additionalProperties": False,
    }
    schema = _dataclass_schema(SpiSettings, {"patterns": {"anyOf": [hadamard, own]}})
    return {"title": "CameraSettings", **schema}


def _dataclass_schema(kind: type, known: dict[str, Any]) -> dict[str, Any]:
    """Of a dataclass of the vehicle, which knows no pydantic."""
    hints, meanings = get_type_hints(kind), documented(kind)
    properties: dict[str, Any] = {}
    definitions: dict[str, Any] = {}
    for field in fields(kind):
        entry = known.get(field.name) or TypeAdapter(hints[field.name]).json_schema()
        definitions |= entry.pop("$defs", {})
        said = meanings[field.name]
        if entry.get("type") == "number" and (unit := unit_of(field.name)):
            entry = {"anyOf": [entry, {"type": "string"}]}
            said += f" A number in {unit}, or text with a unit."
        properties[field.name] = {**entry, "description": said}
        if field.default is not MISSING:
            properties[field.name]["default"] = TypeAdapter(hints[field.name]).dump_python(
                field.default, mode="json"
            )
    required = [field.name for field in fields(kind) if field.default is MISSING]
    schema = {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }
    return schema | ({"$defs": definitions} if definitions else {})
