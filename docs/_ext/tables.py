"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; empty where there is no row."""
    lines = ["| " + " | ".join(map(cell, row)) + " |" for row in rows]
    if not lines:
        return ""
    rule = "|" + "---|" * len(heads)
    return "\n".join(["| " + " | ".join(heads) + " |", rule, *lines]) + "\n"


def cell(text: str) -> str:
    """Text on one line, whose bars and dollars are no marks."""
    return " ".join(text.split()).replace("|", r"\|").replace("``", "`").replace("$", r"\$")
