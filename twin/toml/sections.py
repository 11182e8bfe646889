"""Sections of numbers with units, and values with their source."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Self, TypeVar, get_args

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

from hardware.units import quantity, unit_of
from twin.files import InputError
from twin.toml.faults import describe, describe_faults
from twin.toml.meanings import meanings

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


if TYPE_CHECKING:
    _Model = BaseModel
else:

    class _Told(type(BaseModel)):
        """Makes entries whose faults, where Python code makes one itself, are told in one line.
        What is read from a file is validated without a call, and tells the file as well.
        """

        def __call__(cls, *args: Any, **fields: Any) -> Any:
            try:
                return super().__call__(*args, **fields)
            except ValidationError as error:
                raise InputError(f"{_label(cls)}: {describe(error, cls, fields)}") from error

    class _Model(BaseModel, metaclass=_Told):
        pass


class Strict(_Model):
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

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    def __hash__(self) -> int:
        return self._content_hash

    @cached_property
    def _content_hash(self) -> int:
        """Computed once: results are kept by what they are made of, and asked for often."""
        return hash((type(self), *(getattr(self, name) for name in type(self).model_fields)))

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
        for name in self.limits:
            if (sourced := getattr(self, name)) is not None:
                self._check_limit(name, sourced.value)
        return self

    @classmethod
    def _check_limit(cls, name: str, value: float) -> None:
        least, most = cls.limits[name]
        if not least <= value <= most:
            raise InputError(f"{name} = {value:g}: expected {least:g} to {most:g}")

    @classmethod
    def check_alone(cls, name: str, value: Any) -> None:
        """Raise InputError for a sourced value that no section of this kind may have, whatever
        stands beside it.
        """
        content = {name: {"value": value, "assumed": "by itself"}}
        try:
            cls.model_validate(content)
        except ValidationError as error:
            own = [fault for fault in error.errors() if fault["loc"][:1] == (name,)]
            if own:
                raise InputError(describe_faults(own, cls, content)) from error
        if name in cls.limits:
            cls._check_limit(name, value)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: Any, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        found = handler(schema)
        properties, meaning = handler.resolve_ref_schema(found).get("properties", {}), meanings(cls)
        for name, field in cls.model_fields.items():
            if name in properties and holds_numbers(field.annotation):
                form = "" if issubclass(cls, Sourced) else cls.form_of(name)  # its field says it
                said = " ".join(filter(None, [meaning.get(name), form]))
                properties[name] = _with_text(properties[name]) | {"description": said}
            elif name in properties and name in meaning:
                properties[name]["description"] = meaning[name]
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
        return self._validated({**fields_set(self), **update})

    def unchecked_copy(self, update: Mapping[str, Any]) -> Self:
        """A copy for closed formulas alone, whose fields may hold what no file may: arrays, an
        exposure that is longer than its period.
        """
        copy = super().model_copy(update=update)
        for name in vars(copy).keys() - type(self).model_fields.keys():
            del vars(copy)[name]  # what was computed of the fields as they were
        return copy

    def _validated(self, content: Mapping[str, Any]) -> Self:
        try:
            return type(self).model_validate(content)
        except ValidationError as error:
            raise InputError(f"{label(self)}: {describe(error, type(self), content)}") from error


def label(entry: BaseModel) -> str:
    """What it is called in messages: a system, a radar, a waveform; a value with its source."""
    return _label(type(entry))


def _label(kind: type) -> str:
    return kind.__name__.partition("[")[0].removesuffix("Design").lower()


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


def fields_set(section: BaseModel) -> dict[str, Any]:
    """What a section was given, by field; not its defaults."""
    return {name: getattr(section, name) for name in section.model_fields_set}


class Sourced(Strict, Generic[T]):
    """A value with where it comes from: a source, or the reason why it is assumed."""

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
