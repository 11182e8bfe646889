"""What is wrong with a file or a change, in one line."""

import difflib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, get_args

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
}


def no_such_field(name: str, known: Iterable[str]) -> str:
    """That there is no such field, and which is the nearest."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return "no such field" + (f"; did you mean {near[0]}?" if near else "")


def describe(error: ValidationError, model: type[BaseModel]) -> str:
    """All faults of a validation by ``model`` on one line, each with its field and value; what is
    wrong before what is missing.
    """
    faults = sorted(error.errors(), key=lambda fault: fault["type"] == "missing")
    return "; ".join(_fault(fault, model) for fault in faults)


def _fault(fault: Any, model: type[BaseModel]) -> str:
    kind, place = fault["type"], fault["loc"]
    message = fault["msg"].removeprefix("Value error, ")
    field = ".".join(str(part) for part in place)
    if not field:
        return message
    if kind == "missing":
        return f"{field}: missing"
    if kind == "extra_forbidden":
        known = sorted(_fields_at(model, place[:-1]))
        message = no_such_field(str(place[-1]), known)
        if "did you mean" not in message and known:
            message += f", expected {', '.join(known)}"
    if kind in _EXPECTED:
        limits = {name: _limit(value) for name, value in fault.get("ctx", {}).items()}
        message = "expected " + _EXPECTED[kind].format(**limits)
    value = fault["input"]
    if kind == "value_error" and isinstance(value, dict) and "value" in value:
        value = value["value"]  # of a value with its source
    shown = "" if isinstance(value, dict | BaseModel) else f" = {value!r:.60}"
    return f"{field}{shown}: {message}"


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
