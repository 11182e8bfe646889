"""Typed TOML files: values with their source, and errors that name file, field and value."""

from twin.toml.entries import Entry, changed_name, check_changes
from twin.toml.faults import describe, no_such_field
from twin.toml.loading import bundled, load_entry, names_file, placed, read_toml
from twin.toml.meanings import meanings
from twin.toml.sections import (
    Count,
    Finite,
    Fraction,
    Name,
    NonNegative,
    Positive,
    Sourced,
    Strict,
    plain,
)

__all__ = [
    "Count",
    "Entry",
    "Finite",
    "Fraction",
    "Name",
    "NonNegative",
    "Positive",
    "Sourced",
    "Strict",
    "bundled",
    "changed_name",
    "check_changes",
    "describe",
    "load_entry",
    "meanings",
    "names_file",
    "no_such_field",
    "placed",
    "plain",
    "read_toml",
]
