"""Typed TOML files: values with their source, and errors that name file, field and value."""

import difflib
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar, get_args

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from hardware.files import read_toml as read_checked
from hardware.formatting import setting_text
from hardware.own_functions import is_file_function
from hardware.units import quantity, unit_of
from twin.files import InputError

T = TypeVar("T")

#: In a JSON Schema: text with a unit, and keys whose schemas may be of numbers.
_QUANTITY = r"^\s*[-+]?(\d|\.\d)"
_LISTS = {"anyOf", "prefixItems"}
# Numbers are numbers: no true or false, and text only where a field's name says its unit.
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Finite, Field(gt=0)]
NonNegative = Annotated[Finite, Field(ge=0)]
Fraction = Annotated[Finite, Field(gt=0, le=1)]


Count = Annotated[int, Field(strict=True, ge=1, le=2**20)]
#: Something is said.
Words = Annotated[str, Field(pattern=r"\S")]
Name = Annotated[str, Field(pattern=r"^[\w .,+()-]{1,80}$")]


class Strict(BaseModel):
    """Frozen, and an unknown field is an error. A number may be text with a unit of the dimension
    that the end of its field's name says (`hardware.units`): ``"200 um"`` for ``width_m``.

    ``alternatives``: groups of fields of which a section holds one or the other, each named by its
    first field. A file that gives the first of one group takes nothing of the others from its base
    or part.

    ``limits``: least and largest value of sourced numbers that no device has, beside what a field's
    own type says: within them products of several stay finite.

    The text below a field says what it means: it stands in the JSON Schema, which editors show, and
    in the reference.
    """

    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by content: classes like ``Sourced[float]`` cannot be found by their name."""
        return type(self).model_validate, (plain(self),)

    @field_validator("*", mode="before")
    @classmethod
    def _in_its_unit(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        if _holds_whole_numbers(cls.model_fields[name].annotation):
            return _integral(value)
        if not holds_numbers(cls.model_fields[name].annotation):
            return value
        return _converted(value, unit_of(name))

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for name, (least, most) in self.limits.items():
            sourced = getattr(self, name)
            if sourced is not None and not least <= sourced.value <= most:
                raise InputError(f"{name} = {sourced.value:g}: expected {least:g} to {most:g}")
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: Any, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        found = handler(schema)
        properties = handler.resolve_ref_schema(found).get("properties", {})
        for name, field in cls.model_fields.items():
            if name in properties and holds_numbers(field.annotation):
                form = "" if issubclass(cls, Sourced) else cls.form_of(name)  # its field says it
                said = " ".join(filter(None, [field.description, form]))
                properties[name] = _with_text(properties[name]) | {"description": said}
        for entry in properties.values():
            if "description" in entry:  # no lines of the source's width
                entry["description"] = " ".join(entry["description"].split())
        return found

    @classmethod
    def form_of(cls, name: str) -> str:
        """How a field of numbers is written: its unit, and the limits beside its type's own."""
        unit = unit_of(name)
        said = f"A number in {unit}, or text with a unit" if unit else "A number, or in per cent"
        if name in cls.limits:
            least, most = cls.limits[name]
            said += f"; {least:g} to {most:g}"
        return f"{said}."

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """The same with some fields changed, validated as a file is: pydantic's own copy takes
        whatever it is given. Raises InputError naming field, value and what was expected.
        """
        if not update:
            return super().model_copy(deep=deep)
        return self._validated({**_fields_set(self), **update})

    def unchecked_copy(self, update: Mapping[str, Any]) -> Self:
        """A copy for closed formulas alone, whose fields may hold what no file may: arrays, an
        exposure that is longer than its period.
        """
        return super().model_copy(update=update)

    def _validated(self, content: Mapping[str, Any]) -> Self:
        try:
            return type(self).model_validate(content)
        except ValidationError as error:
            raise InputError(f"{_label(self)}: {describe(error)}") from error


def _label(entry: BaseModel) -> str:
    """What it is called in messages: a system, a radar, a waveform; a value with its source."""
    return type(entry).__name__.partition("[")[0].removesuffix("Design").lower()


def plain(value: Any) -> Any:
    """Sections as dictionaries of their fields; all else, a user's own objects too, as it is."""
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        return {n: plain(getattr(value, n)) for n, field in fields.items() if not field.exclude}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return type(value)(plain(item) for item in value)
    return value


def holds_numbers(annotation: Any) -> bool:
    """Whether a field holds numbers with a fraction, in a list or with a source, and no text."""
    kinds = set(_kinds(annotation))
    return float in kinds and str not in kinds


def _holds_whole_numbers(annotation: Any) -> bool:
    """Whether a field holds whole numbers alone, with a source or without."""
    kinds = set(_kinds(annotation))
    return int in kinds and kinds <= {int, NoneType}


def _integral(value: Any) -> Any:
    """Whole numbers that are NumPy's, or written with a point or an exponent, such as 1e6, as an
    int.
    """
    if isinstance(value, np.integer) or (isinstance(value, float) and value.is_integer()):
        return int(value)
    if isinstance(value, dict) and "value" in value:
        return value | {"value": _integral(value["value"])}
    return value


def _kinds(annotation: Any) -> Iterator[type]:
    if isinstance(annotation, type) and issubclass(annotation, Sourced):
        yield from _kinds(annotation.model_fields["value"].annotation)
    elif isinstance(annotation, type) and not get_args(annotation):
        yield annotation
    for inner in get_args(annotation):
        yield from _kinds(inner)


def _converted(value: Any, unit: str | None) -> Any:
    """A value, with a source or in lists as well, whose text is a number of ``unit``."""
    if isinstance(value, str):
        return quantity(value, unit)
    if isinstance(value, list | tuple):
        return tuple(_converted(item, unit) for item in value)
    if isinstance(value, dict) and "value" in value:
        return value | {"value": _converted(value["value"], unit)}
    return value


def _with_text(schema: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a number, or of lists of them, that takes text in its place."""
    if schema.get("type") in ("number", "integer"):
        return {"anyOf": [schema, {"type": "string", "pattern": _QUANTITY}]}
    inner: dict[str, Any] = {
        key: [_with_text(s) for s in schema[key]] for key in _LISTS if key in schema
    }
    if "items" in schema:
        inner["items"] = _with_text(schema["items"])
    return schema | inner


def _fields_set(section: BaseModel) -> dict[str, Any]:
    return {name: getattr(section, name) for name in section.model_fields_set}


class Sourced(Strict, Generic[T]):
    """A value with where it comes from: a source, or the reason why it is assumed."""

    # Docstrings below fields would be looked for, in vain, for each class such as `Sourced[float]`.
    model_config = ConfigDict(use_attribute_docstrings=False)

    value: T = Field(description="The value itself.")
    source: Words | None = Field(default=None, description="Where the value was read.")
    assumed: Words | None = Field(default=None, description="Why the value is assumed.")

    @model_validator(mode="before")
    @classmethod
    def _bare(cls, data: Any) -> Any:
        if isinstance(data, dict | BaseModel):
            return data
        return {"value": data, "assumed": "given without a source"}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: Any, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """A table, or the value alone."""
        found = super().__get_pydantic_json_schema__(schema, handler)
        own = handler.resolve_ref_schema(found)
        table = dict(own)
        own.clear()
        own |= {"anyOf": [table, table["properties"]["value"]]}
        return found

    @model_validator(mode="after")
    def _one_origin(self) -> "Sourced[T]":
        if (self.source is None) == (self.assumed is None):
            raise InputError("needs either `source` or `assumed`")
        return self


class Entry(Strict):
    """A catalogue entry: a name, and sections of sourced values."""

    name: Name
    """As results name it. Default: that of a file with a base."""
    description: str = ""
    """What it is, in words."""

    def values(self) -> list[tuple[str, Sourced[Any]]]:
        """Every sourced value with its dotted name, in the order of the sections."""
        return [
            (f"{section}.{name}", value)
            for section in type(self).model_fields
            if isinstance(part := getattr(self, section), Strict)
            for name in type(part).model_fields
            if isinstance(value := getattr(part, name), Sourced)
        ]

    def assumed(self) -> list[tuple[str, str]]:
        """Names of the values that are assumed, with what they are and why, in words."""
        return [
            (name, f"{name} = {setting_text(name, value.value)}: {value.assumed}")
            for name, value in self.values()
            if value.assumed
        ]

    def with_(self, changes: Mapping[str, Any]) -> Self:
        """The same with some of its values changed, validated at once.

        Parameters
        ----------
        changes
            By dotted name. ``SECTION.FIELD``: a value (counts as assumed), a table with ``value``
            and ``source`` or ``assumed``, a `Sourced`, or None for an optional one.
            ``SECTION.part``: a part by name, TOML file or object, in place of the section; fields
            of the section given beside it stand over the part's. ``SECTION``: the section itself,
            or None for an optional one. ``name``, ``description``.

        Without ``name``, the name says that something was changed. A field drops its alternatives,
        as in a file. Raises InputError naming field, value and what was expected.
        """
        check_changes(changes)
        content = _fields_set(self) | {"name": changed_name(self.name)}
        given: dict[str, dict[str, Any]] = {}
        for name, value in changes.items():
            section, _, field = name.partition(".")
            self._check_name(section, field)
            if not field:
                content[section] = value
            elif field == "part":
                content[section] = self._section_of(section, value)
            else:
                given.setdefault(section, {})[field] = value
        for section, fields in given.items():
            below = content.get(section)
            known = _fields_set(below) if isinstance(below, BaseModel) else dict(below or {})
            content[section] = without_rivals(type(self), section, known, fields) | fields
        return self._validated(content)

    def _section_of(self, section: str, part: Any) -> Any:
        raise InputError(f"{section}.part = {part!r}: a {type(self).__name__} has no parts")

    @classmethod
    def sections(cls) -> dict[str, type[Strict]]:
        """Its sections by name, optional ones as well."""
        found = {}
        for name, field in cls.model_fields.items():
            for kind in (field.annotation, *get_args(field.annotation)):
                if isinstance(kind, type) and issubclass(kind, Strict):
                    found[name] = kind
        return found

    def _check_name(self, section: str, field: str) -> None:
        """Raise InputError, with the nearest name, for what it has no place for."""
        sections = self.sections()
        known = [f"{s}.{f}" for s, kind in sections.items() for f in (*kind.model_fields, "part")]
        name = f"{section}.{field}" if field else section
        if name not in known and name not in type(self).model_fields:
            raise InputError(f"{_label(self)}: {name}: {no_such_field(name, known)}")


M = TypeVar("M", bound=Entry)

_CHANGED = " (changed)"


def check_changes(changes: Any) -> None:
    """Raise InputError for what is no mapping from dotted names."""
    if not isinstance(changes, Mapping) or not all(isinstance(name, str) for name in changes):
        raise InputError(f"changes = {changes!r:.60}: expected values by their dotted names")


def changed_name(name: str) -> str:
    """Name of what was made from something by changing some of its values."""
    return name if name.endswith(_CHANGED) else name[: 80 - len(_CHANGED)] + _CHANGED


def no_such_field(name: str, known: Iterable[str]) -> str:
    """That there is no such field, and which is the nearest."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return "no such field" + (f"; did you mean {near[0]}?" if near else "")


def describe(error: ValidationError) -> str:
    """All faults of a validation on one line, each with its field and value; what is wrong before
    what is missing.
    """
    faults = sorted(error.errors(), key=lambda fault: fault["type"] == "missing")
    return "; ".join(_fault(fault) for fault in faults)


def _fault(fault: Any) -> str:
    message = fault["msg"].removeprefix("Value error, ")
    field = ".".join(str(part) for part in fault["loc"])
    if not field:
        return message
    if fault["type"] == "missing":
        return f"{field}: missing"
    value = fault["input"]
    if fault["type"] == "value_error" and isinstance(value, dict) and "value" in value:
        value = value["value"]  # of a value with its source
    shown = "" if isinstance(value, dict | BaseModel) else f" = {value!r:.60}"
    return f"{field}{shown}: {message}"


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
    entry of ``parts``. Names of data files are relative to the file that gives them.

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
        raise InputError(f"{path}: {describe(error)}") from error
    for field, value in entry.values():
        if is_data_file(field) and not Path(value.value).is_file():
            raise InputError(f"{path}: {field} = {value.value!r}: expected a file, there is none")
    return entry


def bundled(folder: Path) -> list[str]:
    """Names of the entries in a catalogue folder."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def _find(name: str, kind: str, folder: Path) -> Path:
    entry, path = folder / f"{name.lower()}.toml", Path(name)
    if entry.is_file() and path.suffix != ".toml":
        return entry
    if path.is_file():
        return path
    raise InputError(
        f"{kind}: {name!r} is neither a TOML file nor one of {', '.join(bundled(folder))}"
    )


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
    found = sibling if sibling.is_file() else _find(base, f"{path}: base", folder)
    below = _with_base(found, kind, folder, model, (*seen, path))
    for section, value in content.items():
        if isinstance(value, dict) and isinstance(below.get(section), dict):
            below[section] = without_rivals(model, section, below[section], value)
    return _merged(below, content)


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


def without_rivals(
    model: type[Strict], name: str, below: dict[str, Any], over: Container[str]
) -> dict[str, Any]:
    """What the section ``name`` of a model takes from below when fields are given over it: nothing
    of the alternatives to these.
    """
    hint = model.model_fields[name].annotation if name in model.model_fields else None
    kinds = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type)]
    groups = next((kind.alternatives for kind in kinds if issubclass(kind, Strict)), ())
    given = [group for group in groups if group[0] in over]
    dropped = {field for group in groups if given and group not in given for field in group}
    return {field: value for field, value in below.items() if field not in dropped}


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
