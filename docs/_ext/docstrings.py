"""NumPy's docstrings for autodoc, where text and examples may follow the parameters without a
heading of their own.
"""

import re
from collections.abc import Iterator
from typing import Any

from sphinx.ext.napoleon import Config, NumpyDocstring

_ARRAY = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")
_CONFIG = Config(napoleon_use_rtype=False)


def with_headings(lines: list[str]) -> Iterator[str]:
    """The same with a heading before what ends a list of parameters and is none."""
    section = ""
    for n, line in enumerate(lines):
        following = lines[n + 1] if n + 1 < len(lines) else ""
        starts = line and not line[0].isspace() and (n == 0 or not lines[n - 1].strip())
        if starts and re.fullmatch(r"-{3,}", following):
            section = line
        elif starts and line.startswith(">>>"):
            if section not in ("", "Examples"):
                yield from ("Examples", "--------")
                section = "Examples"
        elif starts and (
            section == "Examples"
            or (section in ("Parameters", "Returns") and not following.startswith(" "))
        ):
            yield from ("Notes", "-----")
            section = "Notes"
        yield line


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """What a docstring is made of before it is read as reStructuredText."""
    if what in ("module", "class", "exception", "function", "method"):
        text = list(with_headings(lines))
        lines[:] = NumpyDocstring(text, _CONFIG, app, what, name, obj, options).lines()


def shorten(
    app: Any,
    what: str,
    name: str,
    obj: Any,
    options: Any,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Arrays by their element's type alone."""
    return tuple(text and _ARRAY.sub(r"ndarray[\1]", text) for text in (signature, returns))  # type: ignore[return-value]


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True}
