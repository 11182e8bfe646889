"""A user's own parts in place of modelled ones: code that a system or a radar names."""

from collections.abc import Callable, Iterable
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from hardware.own_functions import OwnFunction, OwnFunctionError, own_function
from twin.errors import InputError


def _code(value: Any) -> Any:
    if callable(value) or isinstance(value, str):
        return value
    raise InputError("expected file.py:function, the name of an installed one, or a callable")


#: Where code is: ``file.py:function``, the name of an installed one, or in Python itself.
OwnCode = Annotated[
    Any, BeforeValidator(_code), WithJsonSchema({"type": "string", "description": "file.py:name"})
]


def own_part(field: str, given: str | Callable[..., Any]) -> OwnFunction:
    """Code that a field names, called with one argument, the section or the whole system; installed
    packages offer theirs as entry points ``twin.SECTION``. Raises InputError naming the field.
    """
    try:
        return own_function(given, ("section",), group=f"twin.{field.partition('.')[0]}")
    except OwnFunctionError as error:
        raise InputError(f"{field}: {error}") from error


def check_own_parts(values: Iterable[tuple[str, Any]]) -> None:
    """Raise InputError for code that a field ``SECTION.function`` names and that is not there, or
    takes other arguments; it is looked up and not run. ``values``: sourced, by their dotted names.
    """
    for field, value in values:
        if field.endswith(".function"):
            own_part(field, value.value)


def made_by(field: str, given: str | Callable[..., Any], section: Any, kind: type[Any]) -> Any:
    """What a user's code makes of a section. Raises InputError, with what is missing, where that is
    no ``kind``, a protocol.
    """
    own = own_part(field, given)
    try:
        made = own(section)
    except OwnFunctionError as error:
        raise InputError(f"{field}: {error}") from error
    if isinstance(made, kind):
        return made
    names = (name for name in vars(kind) if not name.startswith("_"))
    missing = [name for name in names if not hasattr(made, name)]
    raise InputError(
        f"{field}: {own.name} gave a {type(made).__name__}, which has no {', '.join(missing)}"
    )
