"""What the fields of a section mean: the text below each of them in its class.

It is read from the source when a schema or the reference asks for it, and not, as pydantic does,
whenever the classes are imported, which takes 0.2 s.
"""

import ast
import inspect
import textwrap
from functools import lru_cache
from itertools import pairwise

from pydantic import BaseModel


@lru_cache(maxsize=128)
def meanings(model: type[BaseModel]) -> dict[str, str]:
    """By the name of a field, those of the classes above included."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if kind is not BaseModel and issubclass(kind, BaseModel):
            found |= _below_fields(kind)
    said = {name: field.description for name, field in model.model_fields.items()}
    return found | {name: text for name, text in said.items() if text}


def _below_fields(model: type[BaseModel]) -> dict[str, str]:
    """Texts that stand below the fields of a class itself; none of one made from a generic one."""
    if model.__pydantic_generic_metadata__["origin"]:
        return {}
    (parsed,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(parsed, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in pairwise(parsed.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
