"""Catalogue entries: sections of sourced values under a name, and how they are changed."""

from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Self, get_args

from pydantic import BaseModel

from hardware.formatting import setting_text
from twin.files import InputError
from twin.own_parts import check_own_parts
from twin.toml.faults import no_such_field
from twin.toml.sections import Name, Sourced, Strict, fields_set, label

_CHANGED = " (changed)"
_BUT_FOR = ", but for "


class Entry(Strict):
    """A catalogue entry: a name, and sections of sourced values.

    ``with_parts``: sections that may name a part.
    """

    with_parts: ClassVar[tuple[str, ...]] = ()

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

    def __repr__(self) -> str:
        """Every value on a line: what `print` and a notebook show."""
        lines = [f"  {name}: {setting_text(name, value.value)}" for name, value in self.values()]
        return "\n".join([f"{type(self).__name__} {self.name}", *lines])

    __str__ = __repr__

    def assumed(self) -> list[tuple[str, str]]:
        """Names of the values that are assumed, with what they are and why, in words."""
        return list(self._assumed)

    @cached_property
    def _assumed(self) -> tuple[tuple[str, str], ...]:
        return tuple(
            (name, f"{name} = {setting_text(name, value.value)}: {value.assumed}")
            for name, value in self.values()
            if value.assumed
        )

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

        Without ``name``, the name says that something was changed; without ``description``, that
        says what, as of a file with a base. A field drops its alternatives, as in a file. Raises
        InputError naming field, value and what was expected.
        """
        check_changes(changes)
        content = fields_set(self) | {"name": changed_name(self.name)}
        if changed := [name for name in changes if name not in ("name", "description")]:
            content["description"] = self._description_with(changed)
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
            known = fields_set(below) if isinstance(below, BaseModel) else dict(below or {})
            content[section] = without_rivals(type(self), section, known, fields) | fields
        changed_entry = self._validated(content)
        check_own_parts(changed_entry.values())
        return changed_entry

    def _description_with(self, changed: Sequence[str]) -> str:
        """Of what differs in some fields more."""
        base, but_for, known = self.description.rpartition(_BUT_FOR)
        if not (but_for and self.name.endswith(_CHANGED)):
            return described_by(self.name, changed)
        return base + but_for + ", ".join(dict.fromkeys([*known.split(", "), *changed]))

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
            raise InputError(f"{label(self)}: {name}: {no_such_field(name, known)}")


def check_changes(changes: Any) -> None:
    """Raise InputError for what is no mapping from dotted names."""
    if not isinstance(changes, Mapping) or not all(isinstance(name, str) for name in changes):
        raise InputError(f"changes = {changes!r:.60}: expected values by their dotted names")


def described_by(base: str, changed: Iterable[str]) -> str:
    """Description, in place of its own, of what differs from a base in some fields."""
    return f"as {base}{_BUT_FOR}{', '.join(changed)}"


def changed_name(name: str) -> str:
    """Name of what was made from something by changing some of its values."""
    return name if name.endswith(_CHANGED) else name[: 80 - len(_CHANGED)] + _CHANGED


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
