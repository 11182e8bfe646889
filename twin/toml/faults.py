"""What is wrong with a file or a change, in one line."""

import difflib
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError


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
    if fault["type"] == "extra_forbidden":
        message = "no such field"
    if fault["type"] == "bool_type":
        message = "expected true or false"
    value = fault["input"]
    if fault["type"] == "value_error" and isinstance(value, dict) and "value" in value:
        value = value["value"]  # of a value with its source
    shown = "" if isinstance(value, dict | BaseModel) else f" = {value!r:.60}"
    return f"{field}{shown}: {message}"
