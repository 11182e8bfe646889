"""Typed TOML files: values with their source, and errors that name file, field and value."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from twin.files import InputError

T = TypeVar("T")
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, le=1)]


class Strict(BaseModel):
    """Frozen, and an unknown field is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Sourced(Strict, Generic[T]):
    """A value with where it comes from: a source, or the reason why it is assumed."""

    value: T
    source: str | None = None
    assumed: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _bare(cls, data: Any) -> Any:
        if isinstance(data, dict | BaseModel):
            return data
        return {"value": data, "assumed": "given without a source"}

    @model_validator(mode="after")
    def _one_origin(self) -> "Sourced[T]":
        if (self.source is None) == (self.assumed is None):
            raise ValueError("needs either `source` or `assumed`")
        return self


def describe(error: ValidationError) -> str:
    """All faults of a validation on one line, each with its field and value."""
    return "; ".join(
        f"{'.'.join(str(part) for part in fault['loc']) or 'file'} = {fault['input']!r:.60}: "
        + fault["msg"].removeprefix("Value error, ")
        for fault in error.errors()
    )


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file; InputError with line and column where it is malformed."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: no valid TOML: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error
