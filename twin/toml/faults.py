"""What is wrong with a file or a change, in one line."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, RootModel, ValidationError

#: What was expected, by the type of pydantic's error; braces hold the limit that it names.
_EXPECTED = {
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "string_pattern_mismatch": "text that matches {pattern}",
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length} of them",
    "tuple_type": "a list",
    "dict_type": "a table",
}

_NUMBERS = {2: "two", 3: "three", 4: "four"}

_NONE: Mapping[str, Sequence[str]] = MappingProxyType({})


def no_such_field(name: str, known: Iterable[str]) -> str:
    """That there is no such field, and which is the nearest."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return "no such field" + (f"; did you mean {near[0]}?" if near else "")


def describe(
    error: ValidationError,
    model: type[BaseModel],
    content: Any,
    file_keys: Mapping[str, Sequence[str]] = _NONE,
) -> str:
    """All faults of a validation of ``content`` by ``model`` on one line, each with its field and
    the value as it was given; what is wrong before what is missing.

    ``file_keys``: by the name of a section, "" for none, keys that a file may have there beside the
    model's fields.
    """
    return describe_faults(error.errors(), model, content, file_keys)


def describe_faults(
    every: Sequence[Any],
    model: type[BaseModel],
    content: Any,
    file_keys: Mapping[str, Sequence[str]] = _NONE,
) -> str:
    """See `describe`, of some of its faults."""
    within = {fault["loc"][:n] for fault in every for n in range(1, len(fault["loc"]))}
    # Of a list, entries that are wrong count as none for pydantic: their own faults say it all.
    told = [f for f in every if f["type"] != "too_short" or f["loc"] not in within]
    faults = sorted(told, key=lambda fault: fault["type"] == "missing")
    # Of one list that is too short every number that is missing is a fault of its own.
    return "; ".join(dict.fromkeys(_fault(fault, model, content, file_keys) for fault in faults))


def _fault(
    fault: Any, model: type[BaseModel], content: Any, file_keys: Mapping[str, Sequence[str]]
) -> str:
    kind, place = fault["type"], _place(fault, model, content)
    message = fault["msg"].removeprefix("Value error, ")
    field = ".".join(str(part) for part in place)
    if not field:
        return message
    if (length := _length_of(fault, model)) is not None:
        of = place[:-1] if kind == "missing" else place
        given = list(fault["input"]) if isinstance(fault["input"], tuple) else fault["input"]
        numbers = f"{_NUMBERS.get(length, length)} numbers"
        return f"{'.'.join(map(str, of))} = {given!r:.60}: expected {numbers}"
    if kind == "missing":
        return f"{field}: missing"
    if kind == "extra_forbidden":
        section = ".".join(str(part) for part in place[:-1])
        known = sorted(_fields_at(model, place[:-1]).union(file_keys.get(section, ())))
        message = no_such_field(str(place[-1]), known)
        if "did you mean" not in message and known:
            message += f", expected {', '.join(known)}"
    if kind == "model_type":
        message = f"expected a table of {', '.join(sorted(_fields_at(model, place)))}"
    if kind in _EXPECTED:
        limits = {name: _limit(value) for name, value in fault.get("ctx", {}).items()}
        message = "expected " + _EXPECTED[kind].format(**limits)
    value = _written(content, place, fault["input"])
    if kind == "value_error" and isinstance(value, dict) and "value" in value:
        value = value["value"]  # of a value with its source
    shown = "" if isinstance(value, dict | BaseModel) else f" = {value!r:.60}"
    return f"{field}{shown}: {message}"


def _place(fault: Any, model: type[BaseModel], content: Any) -> tuple[Any, ...]:
    """Where a fault is in the file: of one of several types that a value may have, pydantic adds
    the type.
    """
    place: tuple[Any, ...] = fault["loc"]
    if not place or place[-1] in _fields_at(model, place[:-1]):
        return place
    for part in place[:-1]:
        content = content.get(part) if isinstance(content, Mapping) else None
    is_type = content is not None and content is fault["input"]
    return place[:-1] if is_type or "[" in str(place[-1]) else place


def _length_of(fault: Any, model: type[BaseModel]) -> int | None:
    """How many numbers a list has to have, of which a fault says that they are too few, too many or
    no list; None for another fault.
    """
    kind, place = fault["type"], fault["loc"]
    if kind == "missing" and isinstance(place[-1], int):
        place = place[:-1]
    elif kind not in ("too_long", "tuple_type"):
        return None
    for hint in _hints_at(model, place):
        if get_origin(hint) is tuple and Ellipsis not in get_args(hint):
            return len(get_args(hint))
    return None


def _hints_at(hint: Any, place: Sequence[str | int]) -> Iterator[Any]:
    """Types that a value may have at a place within a type."""
    inner, rest = get_args(hint), place[1:]
    if isinstance(hint, type) and issubclass(hint, RootModel):
        yield from _hints_at(hint.model_fields["root"].annotation, place)
    elif isinstance(hint, type) and issubclass(hint, BaseModel):
        if place and (field := hint.model_fields.get(str(place[0]))):
            yield from _hints_at(field.annotation, rest)
    elif get_origin(hint) is tuple and place:
        variable = Ellipsis in inner
        if isinstance(place[0], int) and (variable or place[0] < len(inner)):
            yield from _hints_at(inner[0 if variable else place[0]], rest)
    elif get_origin(hint) is dict and place:
        yield from _hints_at(inner[1], rest)
    elif get_origin(hint) in (Annotated, Union, UnionType):
        for kind in inner:
            yield from _hints_at(kind, place)
    elif not place:
        yield hint


def _written(content: Any, place: Sequence[str | int], read: Any) -> Any:
    """Text with a unit that stands at a place, or what was read there."""
    for part in place:
        if isinstance(content, Mapping):
            content = content.get(part)
        elif isinstance(content, list | tuple) and isinstance(part, int) and part < len(content):
            content = content[part]
    return content if isinstance(content, str) and isinstance(read, float) else read


def _limit(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _fields_at(model: type[BaseModel], place: Sequence[str | int]) -> set[str]:
    """Names of the fields that a file may have at a place; keys of tables and places in lists
    choose no other kind.
    """
    kinds = [model]
    for part in place:
        inner = [
            kind
            for outer in kinds
            if (field := outer.model_fields.get(str(part)))
            for kind in _models(field.annotation)
        ]
        kinds = inner or [kind for outer in kinds for kind in _rows(outer)]
    return {
        field.alias or name
        for kind in kinds
        for name, field in kind.model_fields.items()
        if not field.exclude
    }


def _rows(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Of a table of tables, its rows; else the model itself."""
    if issubclass(model, RootModel):
        yield from _models(model.model_fields["root"].annotation)
    else:
        yield model


def _models(hint: Any) -> Iterator[type[BaseModel]]:
    if isinstance(hint, type) and issubclass(hint, BaseModel):
        yield hint
    for inner in get_args(hint):
        yield from _models(inner)
